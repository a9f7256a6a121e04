"""Diagnose recordings without knowing what is concealed; this is all that runs behind the fence."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from shj_bayes._util.arrays import FloatArray
from shj_bayes.inference.binning import runs_of
from shj_bayes.inference.fit import fit
from shj_bayes.inference.sampler import LIBRARY, SamplingPlan
from shj_bayes.mismatch.diagnosis import diagnose
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.options import DiagnoseOptions
from shj_bayes.recording.reader import read
from shj_bayes.results.diagnosis import Sampled

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
    model : {"published", "continuous"}
        Reversal rule.
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
    runs = runs_of(recordings)

    def sample(found: DeviceModel, top: FloatArray) -> tuple[dict[str, FloatArray], Sampled]:
        result = fit(runs, found, plan=SamplingPlan(max_steps=N_STEPS, tops=(top,), threads=1))
        draws = {str(n): v.to_numpy().ravel() for n, v in result.data["posterior"].data_vars.items()}
        return draws, Sampled(how=f"{LIBRARY}; {'; '.join(result.verdict.reasons)}", verdict=result.verdict.word)

    device = DeviceModel(len(runs), read_priors(priors), variant=model)
    return diagnose(runs, device, DiagnoseOptions(tuple(without), quick), sample=sample if intervals else None).content
