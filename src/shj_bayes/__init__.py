"""Posteriors, design margins and missing physics for sliding steel friction connections.

The package is the method, one room per step:
recording -> model -> inference -> mismatch -> population -> margins -> planning -> report.

For scripts and notebooks: read a `Recording`, `fit` it, `diagnose` it, `plan` its next test, run a `Campaign`, `load`
what was finished.
"""

import importlib
from typing import TYPE_CHECKING, Any

from shj_bayes._util.imports import import_elsewhere

if TYPE_CHECKING:
    from shj_bayes.api import (
        Campaign,
        CampaignResult,
        Diagnosis,
        FitResult,
        NextTest,
        diagnose,
        fit,
        load,
        plan,
        tables,
    )
    from shj_bayes.recording.recording import Recording

import_elsewhere()

__version__ = "0.1.0"
__all__ = [  # noqa: RUF022 - in the order of the pipeline
    "Recording",
    "fit",
    "FitResult",
    "diagnose",
    "Diagnosis",
    "plan",
    "NextTest",
    "Campaign",
    "CampaignResult",
    "tables",
    "load",
]


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used: the command line must not wait for what it does not need."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    room = "shj_bayes.recording.recording" if name == "Recording" else "shj_bayes.api"
    return getattr(importlib.import_module(room), name)


def __dir__() -> list[str]:
    """Names for completion."""
    return sorted([*globals(), *__all__])
