"""What is asked of a plan: what users choose, apart from what plans."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class PlanOptions:
    """What is asked of a plan; the same words as on the command line.

    Parameters
    ----------
    question : str or None
        ``which``, ``force`` or a quantity (``gamma``, ``ratio``, ``K``, ``Fy``, ``beta``, ``least``); by default
        ``which``, and ``gamma`` of a device about which nothing is undecided.
    among : tuple of str
        Mechanisms to tell apart; ``velocity`` is the base law.
    priors : str
        Family, where there are no devices.
    histories : tuple of path
        Further candidates: displacement (mm) over time (s).
    seed : int
        Same seed and inputs, same plan.
    limits : mapping of str to float
        Of the rig: fields of `shj_bayes.planning.protocol.Rig`; what is not stated is what the tests so far reached.
    """

    question: str | None = None
    among: tuple[str, ...] = ()
    priors: str = "afc"
    histories: tuple[str | Path, ...] = ()
    seed: int = 1
    limits: Mapping[str, float] = field(default_factory=dict)
