"""Levels and spreads of sets, integrated on grids in place of sampled.

Given the hyperparameters sets are independent, and each is an integral over its level and the logarithm of its spread,
whose prior is a product. The evidence of a set at all hyperparameters is therefore one product of three matrices: (M, S
by level) x (level by log spread) x (log spread by tau0, omega). Passes on wide axes find where the probability is; the
last one has its cells there.

A cell counts with the density in its middle times its width, which converges fast as long as a normal is not much
narrower than the cells, so the normals of levels and spreads are kept at least `NARROWEST` cells wide.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import ndtr

from shj_bayes.population.quantities import FloatArray, Likelihood, PopulationPrior, spaced

COARSE, FINE = (48, 32, (14, 14, 16, 10)), (64, 48, (20, 20, 18, 14))
"""Cells of a level, of a log spread, and of M, S, log tau0, omega: of the passes that find, and of the last one."""
NARROWEST = 0.7
PARTS = 4
"""Parts of a cell of level over which likelihoods with sharp ends, of rounded values, are averaged."""
FAINT = 1e-5
"""Probability of a cell below which it is left out of the next pass."""
_LEAST = 1e-300


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


def integrate(sets: Sequence[Sequence[Likelihood]], prior: PopulationPrior) -> Integral:
    """Integrate over the levels and spreads of all sets and what they have in common; one set must hold a device."""
    found = _evaluated(*_widest(sets, prior), sets, prior)
    for size in (COARSE, FINE):
        found = _evaluated(*_narrowed(found, *size), sets, prior)
    return found


def _widest(
    sets: Sequence[Sequence[Likelihood]], prior: PopulationPrior
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
    axes = [
        (
            Axis.between(centre - reach, centre + reach, n_level, centre, scale),
            Axis.between(low, high, n_spread, math.log(apart), 1.0),
        )
        for centre, scale, apart in (_apex(*of_set) if of_set.size else untested for of_set in known)
    ]
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
    sets: Sequence[Sequence[Likelihood]],
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


def log_likelihood(group: Sequence[Likelihood], level: FloatArray, log_spread: FloatArray) -> FloatArray:
    """Log likelihood of the devices of a set, their values integrated out, shape (level, log spread)."""
    out = np.zeros((level.size, log_spread.size))
    spread = np.exp(log_spread)
    with np.errstate(divide="ignore"):
        for device in group:
            out += np.log(sum(_masses(device, level, spread)))
    return out


def _masses(device: Likelihood, level: FloatArray, spread: FloatArray) -> Iterator[FloatArray]:
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


def _narrowed(
    found: Integral, n_level: int, n_spread: int, n_hyper: Sequence[int]
) -> tuple[tuple[Axis, ...], list[tuple[Axis, Axis]]]:
    """Lay all axes where the probability was found."""
    joint = found.weights.reshape([axis.n for axis in found.hyper])
    hyper = tuple(
        axis.narrowed(joint.sum(axis=tuple({0, 1, 2, 3} - {i})), n)
        for i, (axis, n) in enumerate(zip(found.hyper, n_hyper, strict=True))
    )
    axes = []
    for one in found.sets:
        cells = cells_of(found, one)
        axes.append((one.level.narrowed(cells.sum(axis=1), n_level), one.spread.narrowed(cells.sum(axis=0), n_spread)))
    return hyper, axes


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
