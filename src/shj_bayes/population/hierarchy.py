"""The partially pooled model of a population of sets: level and spread of each set learn from all sets.

For every quantity on its pooled scale::

    device value ~ Normal(mu_set, tau_set)
    mu_set       ~ Normal(M, S)
    log tau_set  ~ Normal(log tau0, omega)

so that sets may differ in level and in spread, and a set of one or two devices borrows both, at the price that
the data themselves set (S and omega). Quantities are pooled independently of each other: correlation between
K, Fy, ratio and gamma of one device is not modelled. Device values are integrated out in closed form, for rounded
values as well as for posterior draws (docs/decisions/0004-population.md).

Levels and spreads are integrated on grids in place of sampled.
Given the hyperparameters sets are independent, and each is an integral over its level and the logarithm of its spread,
whose prior is a product. The evidence of a set at all hyperparameters is therefore one product of three matrices: (M, S
by level) x (level by log spread) x (log spread by tau0, omega). Passes on wide axes find where the probability is; the
last one has its cells there.

A cell counts with the density in its middle times its width, which converges fast as long as a normal is not much
narrower than the cells, so the normals of levels and spreads are kept at least `NARROWEST` cells wide.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import pairwise
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import ndtr
from tqdm import tqdm

from shj_bayes._util.arrays import FloatArray, freeze, one_blas_thread
from shj_bayes.errors import PopulationError, did_you_mean
from shj_bayes.inference.likelihood import n_threads
from shj_bayes.population.device import DeviceEstimate, RangeTested, Tags, sets_of
from shj_bayes.population.quantities import (
    ASSUMED,
    DESIGN,
    QUANTITIES,
    PopulationPrior,
    QuantityLikelihood,
    other_priors,
    population_prior,
    quantity,
    spaced,
    stream,
)

COARSE, FINE = (48, 32, (14, 14, 16, 10)), (64, 48, (20, 20, 18, 14))
"""Cells of a level, of a log spread, and of M, S, log tau0, omega: of the passes that find, and of the last one."""
NARROWEST = 0.7
PARTS = 4
"""Parts of a cell of level over which likelihoods with sharp ends, of rounded values, are averaged."""
FAINT = 1e-5
"""Probability of a cell below which it is left out of the next pass."""
_LEAST = 1e-300
SCHEMA: Literal["shj-bayes/population/1"] = "shj-bayes/population/1"
ANY_SET = "(any set)"
"""Name of a set that was never tested, like the tested ones."""
LISTED = 12
"""Sets that a refusal lists."""
MAIN_PRIOR = "default"
N_DRAWS, FEWER_DRAWS = 8000, 4000
"""Draws under the default prior; and under the others, or of many quantities of which only quantiles are asked."""


class Axis(NamedTuple):
    """Cells of one coordinate, evenly spaced in x: values are centre + scale sinh(x), or centre + x for a scale of 0.

    Hyperbolic axes follow what narrows towards one value, over as many powers of ten as it takes.
    """

    centre: float
    scale: float
    # low, high: ends in x
    low: float
    high: float
    n: int

    @classmethod
    def between(cls, low: float, high: float, n: int, centre: float = 0.0, scale: float = 0.0) -> Axis:
        """Axis between two values."""
        first, last = (math.asinh((v - centre) / scale) if scale else v - centre for v in (low, high))
        return cls(centre, scale, first, last, n)

    def values(self, cells: NDArray[np.floating]) -> FloatArray:
        """Values at places counted in cells from the lower end."""
        x = self.low + (self.high - self.low) * cells / self.n
        return np.asarray(self.centre + (self.scale * np.sinh(x) if self.scale else x))

    @property
    def nodes(self) -> FloatArray:
        """Middle of each cell."""
        return self.values(np.arange(self.n) + 0.5)

    def width_at(self, values: FloatArray) -> FloatArray:
        """Width that a cell has there."""
        stretched = np.hypot(self.scale, values - self.centre) if self.scale else np.ones_like(values)
        return np.asarray((self.high - self.low) / self.n * stretched)

    def narrowed(self, probability: FloatArray, n: int) -> Axis:
        """Lay `n` cells where those of now, and their neighbours, hold a probability."""
        kept = np.flatnonzero(probability > FAINT)
        step = (self.high - self.low) / self.n
        low, high = max(kept[0] - 1, 0), min(kept[-1] + 2, self.n)
        return self._replace(low=self.low + step * low, high=self.low + step * high, n=n)


class SetGrid(NamedTuple):
    """A set on its grid."""

    level: Axis
    spread: Axis  # logarithm of the spread
    given_level: FloatArray  # shape (M and S, level): prior probability of each cell
    given_spread: FloatArray  # shape (tau0 and omega, spread)
    likelihood: FloatArray  # shape (level, spread), largest 1
    by_spread: FloatArray  # given_level @ likelihood


class Integral(NamedTuple):
    """Posterior of a population on its grid."""

    hyper: tuple[Axis, ...]  # M, S, log tau0, omega
    weights: FloatArray  # shape (M and S, tau0 and omega), summing to 1
    sets: tuple[SetGrid, ...]


def integrate(sets: Sequence[Sequence[QuantityLikelihood]], prior: PopulationPrior) -> Integral:
    """Integrate over the levels and spreads of all sets and what they have in common; one set must hold a device."""
    found = _evaluated(*_widest(sets, prior), sets, prior)
    for n_level, n_spread, n_hyper in (COARSE, FINE):  # where the probability was found
        joint = found.weights.reshape([axis.n for axis in found.hyper])
        hyper = tuple(
            axis.narrowed(joint.sum(axis=tuple({0, 1, 2, 3} - {i})), n)
            for i, (axis, n) in enumerate(zip(found.hyper, n_hyper, strict=True))
        )
        axes = []
        for one in found.sets:
            cells = cells_of(found, one)
            level, spread = cells.sum(axis=1), cells.sum(axis=0)
            axes.append((one.level.narrowed(level, n_level), one.spread.narrowed(spread, n_spread)))
        found = _evaluated(hyper, axes, sets, prior)
    return found


def _widest(
    sets: Sequence[Sequence[QuantityLikelihood]], prior: PopulationPrior
) -> tuple[tuple[Axis, ...], list[tuple[Axis, Axis]]]:
    """Lay axes from end to end of what priors and devices allow, dense where each set is if it hardly spreads."""
    n_level, n_spread, n_hyper = COARSE
    known = [np.array([d.centre_and_sd for d in group]).reshape(-1, 2).T for group in sets]
    values, errors = np.concatenate(known, axis=1)
    widest = float(np.ptp(values))
    reach = widest + 4.0 * float(errors.max()) + 30.0 * prior.between_scale + 4.0 * prior.centre_sd
    median = math.log(prior.spread_median)
    low = min(median, math.log(errors.min())) - 12.0
    high = max(median + 10.0, math.log(max(widest, _LEAST)) + 5.0)
    places = [_apex(*of_set) for of_set in known if of_set.size]
    centres, close, _ = np.array(places).T
    middle = float(centres.mean())
    between = math.hypot(float(centres.std()), float(close.min())) if len(places) > 1 else prior.between_scale
    untested = (middle, 0.2 * prior.between_scale, prior.spread_median)
    axes = []
    for centre, scale, apart in (_apex(*of_set) if of_set.size else untested for of_set in known):
        level = Axis.between(centre - reach, centre + reach, n_level, centre, scale)
        axes.append((level, Axis.between(low, high, n_spread, math.log(apart), 1.0)))
    hyper = (
        Axis.between(middle - reach, middle + reach, n_hyper[0], middle, between / math.sqrt(centres.size)),
        Axis.between(0.0, 60.0 * prior.between_scale + widest, n_hyper[1], 0.0, between),
        Axis.between(low, high, n_hyper[2]),
        Axis.between(0.0, 4.5 * prior.unequal_scale, n_hyper[3], 0.0, 0.1 * prior.unequal_scale),
    )
    return hyper, axes


def _apex(values: FloatArray, errors: FloatArray) -> tuple[float, float, float]:
    """Level of a set, how well it is known, and spread with errors, by moments (DerSimonian and Laird 1986)."""
    precision = errors**-2.0
    total = precision.sum()
    excess = precision @ (values - precision @ values / total) ** 2 - (values.size - 1)
    precision = 1.0 / (errors**2 + max(excess, 0.0) / max(total - precision @ precision / total, _LEAST))
    known = float(precision.sum() ** -0.5)
    return float(precision @ values / precision.sum()), known, known * math.sqrt(values.size)


def _evaluated(
    hyper: tuple[Axis, ...],
    axes: Sequence[tuple[Axis, Axis]],
    sets: Sequence[Sequence[QuantityLikelihood]],
    prior: PopulationPrior,
) -> Integral:
    weights, out = _log_prior(hyper, prior), []
    for (level, spread), group in zip(axes, sets, strict=True):
        parts = PARTS if any(device.pieces for device in group) else 1
        log = log_likelihood(group, level.values((np.arange(level.n * parts) + 0.5) / parts), spread.nodes)
        likelihood = np.exp(log - log.max()).reshape(level.n, parts, spread.n).mean(axis=1)
        given_level, given_spread = _given(level, *hyper[:2]), _given(spread, *hyper[2:])
        by_spread = given_level @ likelihood
        weights += np.log(np.maximum(by_spread @ given_spread.T, _LEAST))
        out.append(SetGrid(level, spread, given_level, given_spread, likelihood, by_spread))
    weights = np.exp(weights - weights.max())
    return Integral(hyper, weights / weights.sum(), tuple(out))


def _log_prior(hyper: Sequence[Axis], prior: PopulationPrior) -> FloatArray:
    """Logarithm of the prior probability of each cell of the hyperparameters, shape (M and S, tau0 and omega)."""
    level, between, typical, unequal = (axis.nodes for axis in hyper)
    away = typical - math.log(prior.spread_median)
    densities = (
        -0.5 * ((level - prior.centre) / prior.centre_sd) ** 2,
        -2.5 * np.log1p(0.25 * (between / prior.between_scale) ** 2),  # half Student-t, 4 degrees of freedom
        -0.5 * (away / prior.spread_log_sd) ** 2 if prior.spread_log_sd > 0 else -np.logaddexp(away, -away),
        -0.5 * (unequal / prior.unequal_scale) ** 2,
    )
    logs = [log + np.log(axis.width_at(axis.nodes)) for log, axis in zip(densities, hyper, strict=True)]
    first, second = (np.add.outer(logs[i], logs[i + 1]).ravel() for i in (0, 2))
    return np.asarray(np.add.outer(first, second))


def _given(axis: Axis, centres: Axis, scales: Axis) -> FloatArray:
    """Probability of each cell under a normal of each centre and scale; a centre lies anywhere in its own cell."""
    centre, own = (np.repeat(x, scales.n) for x in (centres.nodes, centres.width_at(centres.nodes)))
    scale = np.hypot(np.tile(scales.nodes, centres.n), own / math.sqrt(12.0))
    scale = np.maximum(scale, NARROWEST * axis.width_at(centre))[:, None]
    density = np.exp(-0.5 * ((axis.nodes - centre[:, None]) / scale) ** 2) / (scale * math.sqrt(2.0 * math.pi))
    return np.asarray(density * axis.width_at(axis.nodes))


def log_likelihood(group: Sequence[QuantityLikelihood], level: FloatArray, log_spread: FloatArray) -> FloatArray:
    """Log likelihood of the devices of a set, their values integrated out, shape (level, log spread)."""
    out = np.zeros((level.size, log_spread.size))
    spread = np.exp(log_spread)
    with np.errstate(divide="ignore"):
        for device in group:
            out += np.log(sum(_masses(device, level, spread)))
    return out


def _masses(device: QuantityLikelihood, level: FloatArray, spread: FloatArray) -> Iterator[FloatArray]:
    """Integral of each part of the likelihood of a device against the normal of its set."""
    if device.pieces:
        ends = [(x - level)[:, None] / spread for x in (*device.first, device.second[-1])]
        for (a, b), weight in zip(pairwise(ends), device.weight, strict=True):
            right = a > 0  # both tails are exact on the left
            yield weight * (ndtr(np.where(right, -a, b)) - ndtr(np.where(right, -b, a)))
    else:
        for centre, sd, weight in zip(device.first, device.second, device.weight, strict=True):
            precision = 1.0 / (spread**2 + sd**2)
            yield np.exp((-0.5 * (centre - level) ** 2)[:, None] * precision) * (weight * np.sqrt(precision))


def cells_of(found: Integral, one: SetGrid) -> FloatArray:
    """Posterior probability of the cells of a set, shape (level, spread): the evidence the other way round."""
    shares = found.weights / np.maximum(one.by_spread @ one.given_spread.T, _LEAST)
    return np.asarray(one.likelihood * (one.given_level.T @ (shares @ one.given_spread)))


def drawn(found: Integral, n: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Draw levels and spreads of all sets, shape (n, sets), and the hyperparameters M, S, tau0, omega, shape (n, 4)."""
    weights, hyper = found.weights, found.hyper
    total = np.cumsum(weights)
    cell = np.minimum(np.searchsorted(total, spaced(n, rng) * total[-1]), total.size - 1)
    of_level, of_spread = np.divmod(cell, weights.shape[1])
    places = (*np.divmod(of_level, hyper[1].n), *np.divmod(of_spread, hyper[3].n))
    common = np.array([axis.values(i + spaced(n, rng)) for axis, i in zip(hyper, places, strict=True)]).T
    common[:, 2] = np.exp(common[:, 2])
    mu, log_tau = np.empty((2, n, len(found.sets)))
    for s, one in enumerate(found.sets):
        tables = one.given_level, one.given_spread, one.by_spread, np.ascontiguousarray(one.likelihood.T)
        level, spread = _draw_cells(of_level, of_spread, *tables, spaced(n, rng), spaced(n, rng))
        mu[:, s] = one.level.values(level + spaced(n, rng))
        log_tau[:, s] = one.spread.values(spread + spaced(n, rng))
    return mu, np.exp(log_tau), common


@njit(cache=True, nogil=True, error_model="numpy")
def _draw_cells(of_level, of_spread, given_level, given_spread, by_spread, likelihood, u, v):  # type: ignore[no-untyped-def]
    """Draw the cell of log spread, then that of level, of a set at each draw of the hyperparameters."""
    level, spread = np.empty(u.size, np.int64), np.empty(u.size, np.int64)
    for i in range(u.size):
        a, b = of_level[i], of_spread[i]
        spread[i] = _place(by_spread[a], given_spread[b], u[i])
        level[i] = _place(given_level[a], likelihood[spread[i]], v[i])
    return level, spread


@njit(cache=True, nogil=True, error_model="numpy")
def _place(first, second, u):  # type: ignore[no-untyped-def]
    """First cell at which the running sum of the products passes the share `u` of the whole."""
    left = 0.0
    for j in range(first.size):
        left += first[j] * second[j]
    left *= u
    for j in range(first.size):
        left -= first[j] * second[j]
        if left < 0.0:
            return j
    return first.size - 1


@dataclass(frozen=True)
class DeviceSet:
    """A set of nominally identical devices."""

    name: str
    devices: tuple[str, ...]  # names of its devices
    tags: Tags  # what makes the set what it is
    # per quantity the point value of each device on the pooled scale; NaN where it gives none
    points: Mapping[str, tuple[float, ...]] = field(repr=False)
    # how well each of these is known: standard deviation of the device's likelihood (rounding, or posterior)
    errors: Mapping[str, tuple[float, ...]] = field(default_factory=dict, repr=False)


@dataclass(frozen=True)
class QuantityPosterior:
    """Posterior of level and spread of one quantity over all sets, on its pooled scale."""

    name: str  # pooled quantity
    # mu, tau: shape (n_draws, n_sets): level and device-to-device standard deviation of each set
    mu: FloatArray = field(repr=False)
    tau: FloatArray = field(repr=False)
    hyper: FloatArray = field(repr=False)  # shape (n_draws, 4): M, S, tau0, omega
    n_devices: tuple[int, ...]  # devices of each set that give this quantity

    def __post_init__(self) -> None:
        """Freeze the arrays and check that they belong together."""
        freeze(self, "mu", "tau", "hyper")
        n = len(self.n_devices)
        if self.mu.shape != self.tau.shape or self.mu.shape[1] != n or self.hyper.shape != (self.mu.shape[0], 4):
            raise PopulationError(
                f"draws of {self.name} do not belong together: mu {self.mu.shape}, tau {self.tau.shape}, "
                f"hyper {self.hyper.shape}, {n} sets"
            )

    def level_and_spread(self, index: int | None, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Draws of mu and tau of one set, or of a set never tested when ``index`` is None."""
        if index is not None:
            return self.mu[:, index], self.tau[:, index]
        level, between, spread, unequal = self.hyper.T
        mu = rng.normal(level, between)
        return mu, np.exp(rng.normal(np.log(spread), unequal))


@dataclass(frozen=True, eq=False)
class PopulationResult:
    """A fitted population."""

    sets: tuple[DeviceSet, ...]  # in the order given
    posteriors: Mapping[str, QuantityPosterior]  # per quantity, under the default prior of the spread
    # the same under each other prior of the spread ("alike", "free")
    other_priors: Mapping[str, Mapping[str, QuantityPosterior]]
    priors: Mapping[str, PopulationPrior]  # default prior per quantity
    # smallest effective number of importance draws behind any device; infinity when all are tables
    importance_draws: Mapping[str, float]
    seed: int  # seed of every number here
    tested: RangeTested | None = None  # amplitudes and speeds that the devices went through, as far as known

    @property
    def set_names(self) -> tuple[str, ...]:
        """Names of the sets, in order."""
        return tuple(s.name for s in self.sets)

    def index(self, name: str) -> int:
        """Position of a set; `PopulationError` with the sets that there are where there is no such set."""
        if name in self.set_names:
            return self.set_names.index(name)
        folded = {s.casefold(): s for s in self.set_names}
        if name.casefold() in folded:
            return self.set_names.index(folded[name.casefold()])
        known = ", ".join(repr(s) for s in self.set_names[:LISTED])
        more = f" and {len(self.set_names) - LISTED} more" if len(self.set_names) > LISTED else ""
        raise PopulationError(f"there is no set {name!r}; sets are: {known}{more}{did_you_mean(name, self.set_names)}")

    def fit(self, name: str, prior: str = "default") -> QuantityPosterior:
        """Posterior of one quantity under a prior; `PopulationError` where there is none."""
        known = {"default": self.posteriors, **self.other_priors}
        if prior not in known:
            raise PopulationError(f"no prior {prior!r} was tried; these were: {', '.join(known)}")
        if name not in known[prior]:
            raise PopulationError(f"no device gives {name!r}; pooled here: {', '.join(known[prior])}")
        return known[prior][name]


def fit_quantity(
    name: str,
    sets: Sequence[Sequence[QuantityLikelihood]],
    prior: PopulationPrior,
    seed: np.random.SeedSequence,
    n_draws: int = N_DRAWS,
) -> QuantityPosterior:
    """Posterior of level and spread of every set, for one quantity.

    A set may hold no device and then rests on the others alone; `PopulationError` if none holds one. The draws alone
    hang on the seed.
    """
    if not any(len(group) for group in sets):
        raise PopulationError(f"no device gives {quantity(name).name}; there is nothing to pool")
    draws = drawn(integrate(sets, prior), n_draws, np.random.default_rng(seed))
    mu, tau, hyper = (x.astype(np.float32).astype(np.float64) for x in draws)  # as they are stored
    return QuantityPosterior(name, mu, tau, hyper, tuple(len(group) for group in sets))


def fit_quantities(
    sets: Mapping[str, Sequence[Sequence[QuantityLikelihood]]],
    priors: Mapping[str, PopulationPrior],
    seed: int,
    *labels: str,
    n_draws: int = FEWER_DRAWS,
    progress: bool = False,
    known: Mapping[str, Mapping[str, QuantityPosterior]] = MappingProxyType({}),
) -> dict[str, dict[str, QuantityPosterior]]:
    """Posteriors of many quantities under the default prior of each and two others of the spread, by prior, quantity.

    `labels` are those of their streams of chance, `n_draws` the draws under the default prior; what is `known` is not
    made again.
    """
    given = {q: {MAIN_PRIOR: prior, **other_priors(prior)} for q, prior in priors.items()}

    def one(task: tuple[str, str]) -> QuantityPosterior:
        label, q = task
        n = n_draws if label == MAIN_PRIOR else FEWER_DRAWS
        return fit_quantity(q, sets[q], given[q][label], stream(seed, *labels, q, label), n)

    fits = {label: dict(of_prior) for label, of_prior in known.items()}
    tasks = [(label, q) for label in (MAIN_PRIOR, *ASSUMED) for q in sets if q not in fits.get(label, {})]
    with ThreadPoolExecutor(n_threads(0)) as threads:
        done = tqdm(threads.map(one, tasks), "population", len(tasks), disable=None if progress else True, leave=False)
        for (label, q), fitted in zip(tasks, done, strict=True):
            fits.setdefault(label, {})[q] = fitted
    return fits


@one_blas_thread
def fit_population(
    devices: Sequence[DeviceEstimate],
    *,
    seed: int,
    progress: bool = False,
    brief: bool = False,
    known: Mapping[str, Mapping[str, QuantityPosterior]] | None = None,
) -> PopulationResult:
    """Pool devices, set by set, quantity by quantity, under the default prior and two others of the spread.

    With `brief` there are fewer draws, for many quantities of which only a few quantiles are asked. Posteriors that are
    `known`, by prior and quantity, are not made again. `PopulationError` if devices contradict each other or give
    nothing to pool.
    """
    if seed < 0:
        raise PopulationError(f"the seed must be zero or a positive whole number, not {seed}")
    grouped = sets_of(devices)
    names = [q for q in (*QUANTITIES, *DESIGN) if any(q in device.measurements for device in devices)]
    sets = {q: [[d.measurements[q] for d in group if q in d.measurements] for group in grouped.values()] for q in names}
    chosen = {q: population_prior(q) for q in names}
    n_draws = FEWER_DRAWS if brief else N_DRAWS
    fits = fit_quantities(sets, chosen, seed, n_draws=n_draws, progress=progress, known=known or {})
    return PopulationResult(
        sets=tuple(
            DeviceSet(
                name,
                tuple(d.name for d in group),
                group[0].tags,
                {q: tuple(d.point(q) for d in group) for q in names},
                {q: tuple(d.error(q) for d in group) for q in names},
            )
            for name, group in grouped.items()
        ),
        posteriors=fits.pop(MAIN_PRIOR),
        other_priors=fits,
        priors=chosen,
        importance_draws={q: min(x.effective_draws for group in sets[q] for x in group) for q in names},
        seed=seed,
    )
