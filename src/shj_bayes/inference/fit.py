"""The fit of one device, from recordings to the files of INTERFACE (without the page)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from shj_bayes.inference import store
from shj_bayes.inference.compiling import told_when_slow
from shj_bayes.inference.convergence import Diagnostics, Verdict, judge
from shj_bayes.inference.displacement import of_displacement
from shj_bayes.inference.problem import Problem, Run
from shj_bayes.inference.quiet_arviz import az
from shj_bayes.inference.sampler import Plan, run_ensembles
from shj_bayes.inference.start import find_start
from shj_bayes.model.parameters import Layout
from shj_bayes.model.priors import Priors, read_priors
from shj_bayes.recording.kinematics import motion_of
from shj_bayes.recording.recording import Recording

CHECKPOINT = "checkpoint.h5"


@dataclass(frozen=True, eq=False)
class Fit:
    """A finished fit.

    Parameters
    ----------
    problem : Problem
        What was asked.
    data : arviz.InferenceData
        Posterior and what goes with it.
    summary : pandas.DataFrame
        One row for each parameter.
    figures : Diagnostics
        Convergence.
    verdict : Verdict
        Can the numbers be used.
    record : dict
        Content of ``fit.json``.
    """

    problem: Problem
    data: az.InferenceData
    summary: pd.DataFrame
    figures: Diagnostics
    verdict: Verdict
    record: dict[str, Any]


def make_problem(
    recordings: Sequence[Recording],
    *,
    priors: Priors | None = None,
    noise: str = "ar1",
    free: tuple[str, ...] = (),
    variant: str = "seed",
) -> Problem:
    """Bind consecutive runs of one device, the law, the noise and the priors.

    Parameters
    ----------
    recordings : sequence of Recording
        Runs in the order they were made.
    priors : Priors, optional
        Prior laws; the shipped family ``afc`` by default.
    noise : {"ar1", "independent", "student"}
        Noise model.
    free : tuple of str
        Which of K, beta, gamma may differ between runs.
    variant : {"seed", "continuous"}
        Reversal rule.

    Returns
    -------
    Problem
    """
    runs = tuple(Run(recording, motion_of(recording)) for recording in recordings)
    return Problem(runs, Layout(len(runs), noise, free), priors or read_priors("afc"), variant)


def fit(
    problem: Problem,
    *,
    name: str = "device",
    key: str = "",
    plan: Plan | None = None,
    folder: Path | None = None,
    progress: bool = False,
    threads: int = 0,
) -> Fit:
    """Sample the posterior of one device.

    Parameters
    ----------
    problem : Problem
        What is asked.
    name : str
        Name of the device, for the files and the page.
    key : str
        Digest of everything the result depends on, stored with it so that an unchanged fit can be recognised.
    plan : Plan, optional
        Seed, number of ensembles, when to stop.
    folder : Path, optional
        Where the files of the fit and the checkpoint go; nothing is written without it. A checkpoint found there is
        gone on from.
    progress : bool
        Show a progress bar on standard error.
    threads : int
        Ensembles that run at the same time, 0 for one per processor.

    Returns
    -------
    Fit
    """
    plan = plan or Plan()
    path = None
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / CHECKPOINT
    with told_when_slow(progress):
        problem.log_likelihood(problem.natural(np.zeros((1, len(problem.layout.names)))))
    start = find_start(problem, threads=threads)
    states, figures = run_ensembles(
        problem,
        problem.layout.names,
        start,
        plan,
        fingerprint=problem.fingerprint,
        path=path,
        progress=progress,
        threads=threads,
    )
    displacement = of_displacement(problem, start, plan.seed)
    states = displacement.spread(states, plan.seed)
    verdict = judge(figures)
    verdict = Verdict(verdict.word, (*verdict.reasons, *displacement.words))
    table = store.summary(figures, store.natural_chains(problem, states, figures.n_burn))
    data = store.inference_data(problem, states, figures, plan.seed)
    record = store.fit_record(problem, figures, verdict, table, name=name, seed=plan.seed, key=key)
    record["sampling"]["displacement_noise_over_force_noise"] = displacement.ratio
    record["sampling"]["displacement_copies"] = int(displacement.moves.shape[0])
    if folder is not None:
        store.write_fit(folder, data, table, record)
    return Fit(problem, data, table, figures, verdict, record)
