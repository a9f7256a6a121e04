"""The fit of one device, from recordings to its files, without the page."""

import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from shj_bayes.inference import store
from shj_bayes.inference.convergence import Diagnostics, FitVerdict, judge
from shj_bayes.inference.posterior import Posterior, make_posterior
from shj_bayes.inference.robust import Floor, floor_of
from shj_bayes.inference.run import Run
from shj_bayes.inference.sampler import LIBRARY, SamplingPlan, run_ensembles
from shj_bayes.inference.start import find_start
from shj_bayes.inference.store import remarks_of
from shj_bayes.model.device import DeviceModel
from shj_bayes.results.fit import FitRecord, Trust
from shj_bayes.results.store import CHECKPOINT

WAIT_S = 2.0  # reading the cache takes a tenth of it
TEXT = "compiling the law for this machine: once after installation, up to a minute\n"


@contextmanager
def told_when_slow(tell: bool, wait_s: float = WAIT_S) -> Iterator[None]:
    """Print one line to a terminal if what is inside takes `wait_s` seconds, longer than the cache would."""
    if not (tell and sys.stderr.isatty()):
        yield
        return
    timer = threading.Timer(wait_s, lambda: (sys.stderr.write(TEXT), sys.stderr.flush()))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


DEFAULT_PLAN = SamplingPlan()


@dataclass(frozen=True, eq=False)
class Fit:
    """A finished fit."""

    posterior: Posterior
    data: xr.DataTree  # posterior and what goes with it
    summary: pd.DataFrame  # one row for each parameter
    figures: Diagnostics
    floor: Floor  # how the intervals compare with the scatter from cycle to cycle
    verdict: FitVerdict  # can the numbers be used
    record: FitRecord


def fit(
    runs: Sequence[Run],
    model: DeviceModel,
    *,
    name: str = "device",
    key: str = "",
    plan: SamplingPlan = DEFAULT_PLAN,
    folder: Path | None = None,
) -> Fit:
    """Sample the posterior of one device.

    Parameters
    ----------
    runs : sequence of Run
        Consecutive runs.
    model : DeviceModel
        What is believed of the device: law, effects, noise, priors.
    name : str
        Name of the device, for the files and the page.
    key : str
        Digest of everything the result depends on, stored with it so that an unchanged fit can be recognised.
    plan : Plan
        Seed, number of ensembles, when to stop.
    folder : Path, optional
        Where the files of the fit and the checkpoint go; nothing is written without it. A checkpoint found there is
        gone on from.
    """
    path = None
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / CHECKPOINT
    with told_when_slow(plan.progress):
        posterior, start = find_start(make_posterior(runs, model), threads=plan.threads, tops=plan.tops)
    states, figures = run_ensembles(
        posterior, posterior.names, start, plan, fingerprint=posterior.fingerprint, path=path
    )
    floor = floor_of(posterior, start)
    kept = np.stack([state.chain[figures.n_burn :] for state in states])
    converged = judge(figures)
    verdict = with_floor(converged, floor)
    shown = floor.spread(kept, kept.reshape(-1, kept.shape[-1]).mean(axis=0))
    natural = posterior.natural(shown)
    table = store.summary(posterior.model, figures, natural)
    heights = np.stack([state.log_posterior[figures.n_burn :] for state in states])
    data = store.inference_data(posterior, shown, kept, heights, plan.seed, LIBRARY)
    record = store.fit_record(
        posterior, figures, floor, verdict, table,
        device=name, seed=plan.seed, key=key, convergence=converged.word, remarks=remarks_of(posterior.model, natural),
    )  # fmt: skip
    if folder is not None:
        record = store.write_fit(folder, data, table, record)
    return Fit(posterior, data, table, figures, floor, verdict, record)


def with_floor(verdict: FitVerdict, floor: Floor) -> FitVerdict:
    """Verdict of a fit whose intervals were held against the scatter from cycle to cycle."""
    if not floor.widened:
        return verdict
    worst = int(np.argmax(floor.factor))
    reason = (
        f"the cycles scatter more than the model and its noise allow ({floor.names[worst]} {floor.factor[worst]:.1f} "
        f"times, over {floor.n_pieces} cycles): the intervals of {', '.join(floor.widened)} are as wide as that; "
        "`shj-bayes diagnose` looks for what the model leaves out"
    )
    word = Trust.TENTATIVE if verdict.word == Trust.RELIABLE else verdict.word
    return FitVerdict(word, (*verdict.reasons, reason))
