"""Diagnose recordings without knowing what is concealed; this is all that runs behind the fence."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes.inference.problem import Run
from shj_bayes.inference.sampler import Plan
from shj_bayes.mismatch.diagnosis import diagnose
from shj_bayes.mismatch.evidence import evidence_of
from shj_bayes.mismatch.posterior import augmented_posterior, sample
from shj_bayes.mismatch.refit import make_model, refit
from shj_bayes.model.effects.catalogue import catalogue
from shj_bayes.model.priors import Priors, read_priors
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
        Whether to sample the posterior of what a quick search found.

    Returns
    -------
    dict
        Content of ``diagnosis.json``.
    """
    recordings = [read(path, columns=columns, units=units) for path in paths]
    runs = [Run(recording, motion_of(recording)) for recording in recordings]
    laws = read_priors(priors)
    record = diagnose(runs, laws, variant=model, without=without, quick=quick, threads=1).record
    if quick and intervals:
        record = _with_intervals(record, runs, laws)
    return record


def _with_intervals(record: dict[str, Any], runs: Sequence[Run], priors: Priors) -> dict[str, Any]:
    """Replace the approximate intervals of a quick look by sampled ones."""
    effects = [catalogue()[effect["id"]] for effect in record["effects"]]
    model = make_model(
        priors,
        len(runs),
        effects,
        variant=record["model"]["variant"],
        speed="velocity" not in record["model"]["without"],
    )
    evidence = evidence_of(runs, SAMPLED)
    start = {name: row["after"]["mean"] for name, row in record["shift"].items()}
    start |= {f"{e['id']}.{name}": p["mean"] for e in record["effects"] for name, p in e["parameters"].items()}
    z = [float(law.to_free(np.asarray(start[name]))) for name, law in zip(model.names, model.priors, strict=True)]
    fit = refit(evidence, model, [np.clip(z, -8.0, 8.0)])
    plan = Plan(seed=record["seed"], n_walkers=max(24, 2 * len(model.names) + 6), max_steps=N_STEPS)
    draws, verdict = sample(augmented_posterior(evidence, fit, priors), fit, plan, threads=1)
    for name, row in record["shift"].items():
        row["after"] = _interval(draws[name])
    for effect in record["effects"]:
        for name, row in effect["parameters"].items():
            row.update(_interval(draws[f"{effect['id']}.{name}"]))
    record["sampling"] = {"how": f"emcee on every {evidence.stride}. sample", "verdict": verdict.word}
    return record


def _interval(values: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, float]:
    low, high = np.quantile(values, [0.05, 0.95])
    return {"mean": float(values.mean()), "sd": float(values.std(ddof=1)), "q05": float(low), "q95": float(high)}
