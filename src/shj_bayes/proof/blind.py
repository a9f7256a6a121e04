"""Diagnose recordings without knowing what is concealed; this is all that runs behind the fence."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from shj_bayes.inference.problem import Run
from shj_bayes.mismatch.diagnosis import diagnose
from shj_bayes.mismatch.intervals import Effort
from shj_bayes.model.priors import read_priors
from shj_bayes.recording.kinematics import motion_of
from shj_bayes.recording.reader import read

SAMPLED = 1500  # samples for the posterior: the noise is correlated, and denser ones cost time
N_STEPS = 600  # enough for 5 and 95 % quantiles of a posterior with one top, from a start at that top


def diagnose_blind(
    paths: Sequence[Path],
    *,
    columns: str | None = None,
    units: str | None = None,
    model: str = "continuous",
    priors: str = "afc",
    without: Sequence[str] = (),
    quick: bool = True,
    intervals: bool = True,
) -> dict[str, Any]:
    """Read recordings and diagnose them.

    Parameters
    ----------
    paths : sequence of Path
        Consecutive runs.
    columns, units : str or None
        As for `shj_bayes.recording.reader.read`.
    model : {"seed", "continuous"}
        Reversal rule; the simulated devices have no jump.
    priors : str
        Prior family.
    without : sequence of str
        Effects taken out of the catalogue.
    quick : bool
        Whether to search on fewer samples.
    intervals : bool
        Whether to sample the posterior of what was found.

    Returns
    -------
    dict
        Content of ``diagnosis.json``.
    """
    recordings = [read(path, columns=columns, units=units) for path in paths]
    runs = [Run(recording, motion_of(recording)) for recording in recordings]
    effort = Effort(SAMPLED, N_STEPS, threads=1) if intervals else None
    return diagnose(runs, read_priors(priors), variant=model, without=without, quick=quick, effort=effort).record
