"""The fit of one device, from recordings to its files, without the page."""

from __future__ import annotations

import math
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from shj_bayes._util.arrays import FloatArray, IntArray
from shj_bayes.inference import store
from shj_bayes.inference.binning import Run
from shj_bayes.inference.convergence import Diagnostics, FitVerdict, Widening, judge, pareto_k, widening_of
from shj_bayes.inference.likelihood import Likelihood, SharedDensity, make_likelihood, n_threads
from shj_bayes.inference.sampler import LIBRARY, SamplingPlan, run_ensembles
from shj_bayes.inference.start import Start, find_start, root_of
from shj_bayes.inference.store import remarks_of
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.filter import whiten
from shj_bayes.results.fit import FitRecord, Trust
from shj_bayes.results.store import CHECKPOINT, Group

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

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

    likelihood: Likelihood
    groups: Mapping[str, Group]  # content of ``posterior.nc``
    figures: Diagnostics
    widening: Widening  # how the intervals compare with the scatter from cycle to cycle
    verdict: FitVerdict  # can the numbers be used
    record: FitRecord

    @cached_property
    def data(self) -> xr.DataTree:
        """Posterior and what goes with it."""
        import xarray as xr  # noqa: PLC0415  it and pandas take a second to import, which commands need not wait for

        of_group = {name: xr.Dataset(group.arrays, attrs=group.words) for name, group in self.groups.items()}
        return xr.DataTree.from_dict({name: xr.decode_cf(one, decode_times=False) for name, one in of_group.items()})

    @property
    def summary(self) -> pd.DataFrame:
        """Table of the parameters, one row for each."""
        import pandas as pd  # noqa: PLC0415  (as above)

        return pd.DataFrame([vars(row) for row in self.record.parameters])


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
        likelihood, start = find_start(make_likelihood(runs, model), threads=plan.threads, tops=plan.tops)
    states, figures = run_ensembles(
        likelihood, likelihood.model.names, start, plan, fingerprint=likelihood.fingerprint, path=path
    )
    converged, widening = judge(figures), widening_of(likelihood, start)
    kept = np.stack([state.chain[figures.n_burn :].reshape(-1, start.free.size) for state in states])
    heights = np.stack([state.log_posterior[figures.n_burn :].ravel() for state in states])
    weights, tail = weights_of_all_samples(likelihood, start, kept, plan.threads)
    if tail < PARETO_LIMIT:
        some = evenly_spread(weights)
        kept, heights = np.take_along_axis(kept, some[:, :, None], axis=1), np.take_along_axis(heights, some, axis=1)
        worth = float(weights.mean() ** 2 / np.mean(weights**2))
        figures = replace(figures, ess_bulk=worth * figures.ess_bulk, ess_tail=worth * figures.ess_tail)
    verdict = with_widening(converged, widening, tail)
    shown = widening.spread(kept, kept.reshape(-1, kept.shape[-1]).mean(axis=0))
    natural = likelihood.model.laws.natural(shown)
    table = store.summary(likelihood.model, figures, natural)
    groups = store.groups_of(likelihood, shown, kept, heights, plan.seed, LIBRARY)
    record = store.fit_record(
        likelihood, figures, widening, verdict, table, pareto_k=tail,
        device=name, seed=plan.seed, key=key, convergence=converged.word, remarks=remarks_of(likelihood.model, natural),
    )  # fmt: skip
    if folder is not None:
        record = store.write_fit(folder, groups, record)
    return Fit(likelihood, groups, figures, widening, verdict, record)


def with_widening(verdict: FitVerdict, widening: Widening, tail: float = 0.0) -> FitVerdict:
    """Verdict of a fit whose intervals were held against the scatter of cycles; `tail` is Pareto k of its weights."""
    reasons = list(verdict.reasons)
    if widening.widened:
        worst = int(np.argmax(widening.factor))
        reasons.append(
            f"the cycles scatter more than the model and its noise allow ({widening.names[worst]} "
            f"{widening.factor[worst]:.1f} times, over {widening.n_pieces} cycles): the intervals of "
            f"{', '.join(widening.widened)} are as wide as that; `shj-bayes diagnose` looks for what the model leaves "
            "out"
        )
    if tail >= PARETO_LIMIT:
        reasons.append(
            f"the draws are those of averages of the readings, whose weights for all readings rest on few (Pareto k "
            f"{tail:.2f}, below {PARETO_LIMIT} is wanted): the readings within the averages contradict their means; "
            "`shj-bayes diagnose` looks for what the model leaves out"
        )
    doubted = verdict.word == Trust.RELIABLE and len(reasons) > len(verdict.reasons)
    return FitVerdict(Trust.TENTATIVE if doubted else verdict.word, tuple(reasons))


FINER = 32.0  # times shorter than the averages that are sampled: averages that stand for all samples
N_HELD = 200  # draws at which both densities are evaluated, and at least four for each number that is fitted to them
PARETO_LIMIT = 0.7


def weights_of_all_samples(
    likelihood: Likelihood, start: Start, draws: FloatArray, threads: int = 1
) -> tuple[FloatArray, float]:
    """Weights that take draws from averages of the samples to all samples, and Pareto k of the weights.

    Averages leave out what the samples within each say of the law: means move by up to 0.3 standard deviations at 20
    Hz, by more at higher rates. The log ratio of both likelihoods is smooth: it is evaluated at some draws, and a
    polynomial that is fitted to these by least squares (all of second degree, and cubes: a sharp knee has a long tail)
    gives it for all. The noise keeps its most probable size, which is that of the averages (decision 0010); where
    samples scatter more within them, by hum say, what they tell counts as much less.

    `draws` are unbounded, shape (n_ensembles, n, d); the weights are of shape (n_ensembles, n) with mean 1.
    """
    flat = draws.reshape(-1, draws.shape[-1])
    fine = likelihood.refined(start.free, coarser=1.0 / FINER)
    law = flat[:, : likelihood.model.n_law]
    along = np.linalg.solve(root_of(np.cov(law.T)), (law - law.mean(axis=0)).T).T
    i, j = np.triu_indices(law.shape[1])
    terms = np.concatenate([np.ones((law.shape[0], 1)), along, along[:, i] * along[:, j], along**3], axis=1)
    held = np.linspace(0, flat.shape[0] - 1, max(N_HELD, 4 * terms.shape[1])).astype(int)
    points = np.tile(start.free, (held.size, 1))
    points[:, : law.shape[1]] = law[held]
    n = n_threads(threads)
    with ThreadPoolExecutor(n) as pool:
        of_fine, of_averages = (SharedDensity(p, pool, n).log_posterior_free(points) for p in (fine, likelihood))
    of_samples, of_means = _whitened(fine, start), _whitened(likelihood, start)
    within = (np.sum(of_samples**2) - np.sum(of_means**2)) / max(of_samples.size - of_means.size, 1)
    ratio = (of_fine - of_averages) / max(1.0, within)
    if not np.isfinite(ratio).all():
        return np.ones(draws.shape[:2]), math.inf
    smooth = terms @ np.linalg.lstsq(terms[held], ratio, rcond=None)[0]
    weights = np.exp(np.minimum(smooth, ratio.max()) - ratio.max()).reshape(draws.shape[:2])
    return weights / weights.mean(), pareto_k(ratio)


def _whitened(likelihood: Likelihood, start: Start) -> FloatArray:
    """Give the residual at the top, in units of what its noise lets expect, shape (n,)."""
    model = likelihood.model
    theta = model.laws.natural(start.free[None])
    values = {name: float(value[0]) for name, value in model.noise_values(theta).items()}
    held = [(*part.residual_and_slope(part.force(model, theta)), part.timing) for part in likelihood.blocks]
    pairs = [whiten(model.noise, values, rest.T, slope[0], timing) for rest, slope, timing in held]
    return np.concatenate([white.ravel() for white, _ in pairs])


def evenly_spread(weights: FloatArray) -> IntArray:
    """Choose as many draws as there are, in their order, as often as their weights ask, shape (n_ensembles, n)."""
    n = weights.shape[1]
    shares, places = np.cumsum(weights, axis=1) / weights.sum(axis=1, keepdims=True), (np.arange(n) + 0.5) / n
    return np.stack([np.minimum(np.searchsorted(own, places), n - 1) for own in shares])
