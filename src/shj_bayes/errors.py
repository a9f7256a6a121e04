"""What can go wrong, as a tree; every message says what came, what is allowed and what to do.

::

    ShjError
    |-- RecordingError    a recording cannot be read or cannot be used
    |-- ModelError        a parameter or a model choice outside what the law allows
    |-- PriorError        a prior file that is malformed or cannot hold the data
    |-- InferenceError    the sampler could not start or gave nothing usable
    |   `-- CheckpointError   a checkpoint of another problem, or an altered one
    |-- CampaignError     a manifest or a campaign folder that cannot be used
    |-- PopulationError   too little, or contradictory, input for a population statement
    `-- ReportError       a results folder that cannot be shown
"""


class ShjError(Exception):
    """Base of every error that a user can mend; the command line prints it as one line and exits 1."""


class RecordingError(ShjError):
    """A recording cannot be read or cannot be used."""


class ModelError(ShjError):
    """A parameter or a model choice outside what the law allows."""


class PriorError(ShjError):
    """A prior file that is malformed or cannot hold the data."""


class InferenceError(ShjError):
    """The sampler could not start or gave nothing usable."""


class CheckpointError(InferenceError):
    """A checkpoint of another problem, or an altered one."""


class CampaignError(ShjError):
    """A manifest or a campaign folder that cannot be used."""


class PopulationError(ShjError):
    """Too little, or contradictory, input for a population statement."""


class ReportError(ShjError):
    """A results folder that cannot be shown."""
