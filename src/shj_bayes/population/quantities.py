"""Quantities that are pooled from device to device: scale, assumed spread, and what one device says of each."""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from shj_bayes._util.arrays import FloatArray, freeze
from shj_bayes.errors import PopulationError
from shj_bayes.model.parameters import base_of

Band = tuple[float, float, float]
LEVELS = (0.05, 0.5, 0.95)
BATCHES = 10
"""Parts of the draws, one behind the other, whose quantiles tell how well that of all draws is known."""
_FARTHEST = 300.0  # heavy tails of a spread that no data limit; keeps products of two quantities finite


def band_of(values: FloatArray) -> Band:
    """5, 50 and 95 % of draws."""
    return Ordered(values).band


class Ordered:
    """Draws, put in order once for all quantiles that are asked of them."""

    def __init__(self, draws: FloatArray) -> None:
        """Take draws, shape (n,)."""
        self._draws = draws

    @cached_property
    def _in_order(self) -> FloatArray:
        return np.sort(self._draws)

    @cached_property
    def _parts(self) -> FloatArray:
        return np.sort(self._draws[: self._draws.size // BATCHES * BATCHES].reshape(BATCHES, -1), axis=1)

    def quantile(self, level: float) -> float:
        """Give a quantile, interpolated as `np.quantile` does."""
        last = self._in_order[-1]  # where what is no number is put
        return math.nan if math.isnan(last) else float(_at_share(self._in_order, level))

    def with_error(self, level: float) -> tuple[float, float]:
        """Give a quantile, and its standard error from the number of draws (batch means)."""
        spread = np.std(_at_share(self._parts, level), ddof=1) if self._parts.size else 0.0
        return self.quantile(level), float(spread / np.sqrt(BATCHES))

    @property
    def band(self) -> Band:
        """5, 50 and 95 %."""
        low, middle, high = map(self.quantile, LEVELS)
        return low, middle, high


def _at_share(values: FloatArray, level: float) -> FloatArray:
    """Value below which a share of others lie, along the last axis, which is in order."""
    place = (values.shape[-1] - 1) * level
    before = math.floor(place)
    share, low, high = place - before, values[..., before], values[..., min(before + 1, values.shape[-1] - 1)]
    step = high - low
    return np.asarray(high - step * (1.0 - share) if share >= 0.5 else low + step * share)


def spaced(n: int, rng: np.random.Generator) -> FloatArray:
    """Draw numbers between 0 and 1, one in each n-th part, in any order (of several: a Latin hypercube)."""
    return np.asarray((rng.permutation(n) + rng.random(n)) / n)


def stream(seed: int, *labels: str) -> np.random.SeedSequence:
    """Return the stream of chance that belongs to some labels, whatever else is drawn."""
    return np.random.SeedSequence([seed, *(zlib.crc32(label.encode()) for label in labels)])


@dataclass(frozen=True)
class Quantity:
    """One pooled quantity."""

    name: str  # word of the interface: K, Fy, beta, gamma or ratio; with a run number behind it where a run has its own
    unit: str  # natural unit
    logarithmic: bool  # True when the logarithm is pooled (the quantity is positive), False when the value itself is

    def pool(self, natural: FloatArray | float) -> FloatArray:
        """Natural values on the pooled scale; `PopulationError` where one is not finite or has no logarithm."""
        values = np.asarray(natural, dtype=np.float64)
        if not np.all(np.isfinite(values)) or (self.logarithmic and np.any(values <= 0)):
            bound = "finite and above zero" if self.logarithmic else "finite"
            raise PopulationError(
                f"{self.name} [{self.unit}] must be {bound}; got values from {np.min(values):g} to "
                f"{np.max(values):g}. Correct the device's estimate or leave {self.name} out of it"
            )
        return np.log(values) if self.logarithmic else values

    def natural(self, pooled: FloatArray | float) -> FloatArray:
        """Values on the pooled scale in natural units; logarithms beyond +-300 are held there."""
        values = np.asarray(pooled, dtype=np.float64)
        return np.exp(np.clip(values, -_FARTHEST, _FARTHEST)) if self.logarithmic else values


_OF_ALL_RUNS = (
    Quantity("K", "kN/mm", True),  # initial stiffness
    Quantity("Fy", "kN", True),  # sliding force of the first run
    Quantity("ratio", "1", True),  # sliding force of the second run over that of the first
    Quantity("gamma", "s/mm", False),  # relative change of force per unit of speed; 0 means none
    Quantity("beta", "1", True),  # sharpness of the transition to sliding
)
LATER_RUNS = range(3, 10)  # a device has up to nine runs
QUANTITIES: dict[str, Quantity] = {q.name: q for q in _OF_ALL_RUNS} | {
    name: replace(q, name=name)
    for run in (2, *LATER_RUNS)
    for q in _OF_ALL_RUNS
    if q.name != "Fy" and (q.name, run) != ("ratio", 2)
    for name in (f"{q.name}_{run}",)
}
"""The ratio is pooled as its logarithm, not its logit: nothing in friction forbids a second run above the first
(bedding-in), log Fy of the second run then stays a plain sum, and a ratio rounded to 1 stays finite."""


LEAST, MOST = "least", "most"
LOWEST, HIGHEST = "lowest", "highest"
THIRD_CYCLE = "third"
_OF_A_TEST = (
    Quantity(LEAST, "kN", True),  # smallest plateau force of the first run
    Quantity(MOST, "kN", True),  # largest force of the first run
    Quantity("plateau", "kN", True),  # mean plateau force of the first run
    Quantity(THIRD_CYCLE, "kN", True),  # force of the third cycle of the first run
    Quantity("energy", "kJ", True),  # energy of a cycle of the largest amplitude, first run
)
_OF_ALL_TESTS = (
    Quantity(LOWEST, "kN", True),  # smallest plateau force of all runs
    Quantity(HIGHEST, "kN", True),  # largest force of all runs
)
DESIGN: dict[str, Quantity] = {q.name: q for q in (*_OF_ALL_TESTS, *_OF_A_TEST)} | {
    name: replace(q, name=name)
    for run in (2, *LATER_RUNS)
    for q in _OF_A_TEST
    if q.name != THIRD_CYCLE
    for name in (f"{q.name}_{run}",)
}
"""Read off the force of a test, real or virtual; their logarithms are pooled."""


def quantity(name: str) -> Quantity:
    """Look up a pooled quantity by its name; `PopulationError` where there is none."""
    if name not in QUANTITIES and name not in DESIGN:
        hint = "; dep is never pooled, give gamma = 1/dep" if name == "dep" else ""
        raise PopulationError(
            f"{name!r} is not a pooled quantity; these are: {', '.join(q.name for q in _OF_ALL_RUNS)}{hint}"
        )
    return QUANTITIES[name] if name in QUANTITIES else DESIGN[name]


@dataclass(frozen=True)
class PopulationPrior:
    """Prior of the hierarchy of one quantity, on its pooled scale.

    device ~ Normal(mu_set, tau_set), mu_set ~ Normal(M, S), log tau_set ~ Normal(log tau0, omega).
    """

    # centre, centre_sd: M ~ Normal(centre, centre_sd)
    centre: float
    centre_sd: float
    between_scale: float  # S ~ half Student-t with 4 degrees of freedom and this scale
    spread_median: float  # median of tau0, the typical spread between devices of one set
    # tau0 is log-normal with this standard deviation of the logarithm; 0 means half-Cauchy with median (and scale)
    # ``spread_median`` instead
    spread_log_sd: float
    unequal_scale: float  # omega ~ half-normal with this scale: how much the spread may differ from set to set
    source: str  # where the numbers come from

    def __post_init__(self) -> None:
        """Refuse scales that are not above zero."""
        scales = (self.centre_sd, self.between_scale, self.spread_median, self.unequal_scale)
        if not (np.isfinite([self.centre, *scales]).all() and min(scales) > 0 and self.spread_log_sd >= 0):
            raise PopulationError(f"every scale of a population prior must be finite and above zero; got {self}")


_SPREAD = (
    "spread of one set: median 0.2 of the value (FEMA P-695 rates the dispersion of test data from 0.10, superior, to "
    "0.50, poor; geometric middle 0.22) with a factor of 7 either way, which reaches from what rounding alone makes "
    "(0.03) to more than the value itself; "
    "unequal spread: half-normal 1, so that sets may differ by factors of 3 and more; "
)
_PRIORS = {
    "K": PopulationPrior(np.log(20.0), 3.0, 1.0, 0.2, 2.0, 1.0, _SPREAD + "level: 20 kN/mm, a factor 20 either way"),
    "Fy": PopulationPrior(
        np.log(80.0), 3.0, 1.0, 0.2, 2.0, 1.0, _SPREAD + "level: 80 kN (two M16 8.8 bolts), a factor 20"
    ),
    "ratio": PopulationPrior(
        0.0, 1.0, 0.5, 0.2, 2.0, 1.0, _SPREAD + "level: 1 (no change between runs), a factor e either way"
    ),
    "gamma": PopulationPrior(
        0.0,
        0.05,
        0.03,
        0.01,
        2.0,
        1.0,
        "level symmetric about 0, 0.05 s/mm (half the force at 10 mm/s); spread of one set: median 0.01 s/mm, a tenth "
        "of the force at 10 mm/s, with a factor of 7 either way",
    ),
    "energy": PopulationPrior(
        np.log(15.0), 3.0, 1.0, 0.2, 2.0, 1.0, _SPREAD + "level: 15 kJ (80 kN over a cycle of 48 mm), a factor 20"
    ),
    "beta": PopulationPrior(np.log(20.0), 2.0, 1.0, 0.3, 2.0, 1.0, "level: 20, a factor 7 either way; spread 0.3"),
}


def population_prior(name: str) -> PopulationPrior:
    """Return the default prior of one quantity."""
    quantity(name)
    base = base_of(name)
    return _PRIORS[base if base in _PRIORS else "Fy"]  # all forces read off a test are sliding forces


ASSUMED = {
    "alike": "if all sets are held to spread nearly alike",
    "free": "if the spread is left to the devices alone",
}
"""What `other_priors` assume, in words."""


def other_priors(prior: PopulationPrior) -> dict[str, PopulationPrior]:
    """Return the two other priors of the spread that every answer is shown under.

    ``alike``: all sets spread nearly alike (omega half-normal 0.25), so that no set is believed to be tight because its
    few devices happen to agree. ``free``: typical spread half-Cauchy with twice the median (Gelman 2006) and omega
    twice as free, so that the data alone limit it.
    """
    return {
        "alike": replace(
            prior, unequal_scale=0.25 * prior.unequal_scale, source="sets spread nearly alike; " + prior.source
        ),
        "free": replace(
            prior,
            spread_median=2.0 * prior.spread_median,
            spread_log_sd=0.0,
            unequal_scale=2.0 * prior.unequal_scale,
            source="typical spread half-Cauchy with twice the median (Gelman 2006); " + prior.source,
        ),
    }


N_COMPONENTS = 12
"""Normal components that stand for a set of draws (benchmarks/population.py: more changes nothing visible)."""
BANDWIDTH = 0.3
"""Kernel width of those components, in standard deviations; centres shrink so that the variance is kept."""
FEWEST_EFFECTIVE = 25.0
"""Below this effective number of importance draws a device's posterior says too little about its likelihood."""


@dataclass(frozen=True)
class QuantityLikelihood:
    """What a device says of one quantity: likelihood of its true value, integrable against a normal in closed form."""

    # True: constant ``weight`` on adjoining pieces between ``first`` and ``second``. False: normal components with
    # centre ``first``, standard deviation ``second`` and ``weight`` summing to one.
    pieces: bool
    # first to weight: shape (n,): as above, pooled scale
    first: FloatArray
    second: FloatArray
    weight: FloatArray
    effective_draws: float = np.inf  # Kish effective number of importance draws behind it; infinity when it is exact
    point: float = np.nan  # its middle, pooled scale; NaN where none is told

    def __post_init__(self) -> None:
        """Freeze the arrays; pieces must adjoin."""
        freeze(self, "first", "second", "weight")
        if self.pieces and not np.array_equal(self.first[1:], self.second[:-1]):
            raise PopulationError("the pieces of a likelihood must adjoin, each starting where the one before ends")

    @cached_property
    def centre_and_sd(self) -> tuple[float, float]:
        """Mean and standard deviation of the normalised likelihood, pooled scale."""
        if self.pieces:
            mass = self.weight * (self.second - self.first)
            centre, variance = 0.5 * (self.first + self.second), (self.second - self.first) ** 2 / 12.0
        else:
            mass, centre, variance = self.weight, self.first, self.second**2
        mass = mass / mass.sum()
        mean = float(np.sum(mass * centre))
        return mean, float(np.sqrt(np.sum(mass * (variance + (centre - mean) ** 2))))


Printed = tuple[float, float, float]
"""A printed value, and the lower and upper end of what rounds to it, natural unit.

The likelihood is the indicator of the interval, which is the same on every scale.
"""


def to_step(value: float, step: float) -> Printed:
    """Value rounded to a multiple of ``step`` (natural unit): half a step either way."""
    return value, value - 0.5 * _above_zero(step), value + 0.5 * step


def to_decade(value: float, decades: float = 1.0) -> Printed:
    """Value rounded to a power of ten: half of ``decades`` either way on the logarithm."""
    return value, value * 10.0 ** (-0.5 * _above_zero(decades)), value * 10.0 ** (0.5 * decades)


def gamma_of_dep(dep: float, step: float) -> Printed:
    """Interval of gamma = 1/dep, s/mm, for a dep in mm/s rounded to ``step``; refuses one that reaches 0."""
    if abs(dep) <= 0.5 * _above_zero(step):
        raise PopulationError(
            f"dep = {dep:g} mm/s rounded to {step:g} reaches zero, where gamma = 1/dep has no bound; "
            "give gamma itself, or a smaller rounding step"
        )
    return 1.0 / dep, 1.0 / (dep + 0.5 * step), 1.0 / (dep - 0.5 * step)


def _above_zero(step: float) -> float:
    if not 0 < step < math.inf:
        raise PopulationError(f"the rounding step of a printed value must be above zero; got {step:g}")
    return step


def rounded(name: str, printed: Printed) -> QuantityLikelihood:
    """Likelihood of a quantity of which a rounded value was printed."""
    point, low, high = quantity(name).pool(np.array(printed))
    return QuantityLikelihood(True, np.array([low]), np.array([high]), np.ones(1), point=float(point))


def ratio_of(second: Printed, first: Printed) -> QuantityLikelihood:
    """Ratio of two rounded forces, each uniform inside its own interval.

    With n uniform on [a, b] and d on [c, e] the density of log(n/d) = u is, up to a constant, e^u times the integral of
    d over the d that keep d e^u inside [a, b]. It is made constant on six equal pieces (error far below the rounding).
    """
    pool = quantity("ratio").pool
    a, b, c, e = (float(pool(x)) for x in (*second[1:], *first[1:]))
    edges = np.linspace(a - e, b - c, 7)
    middle = 0.5 * (edges[:-1] + edges[1:])
    low, high = np.exp(np.maximum(c, a - middle)), np.exp(np.minimum(e, b - middle))
    density = np.exp(middle) * 0.5 * np.maximum(high**2 - low**2, 0.0)
    point = float(pool(second[0] / first[0]))
    return QuantityLikelihood(True, edges[:-1], edges[1:], density / density.max(), point=point)


def weighted(name: str, values: FloatArray, log_prior: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Draws of a quantity on its pooled scale, and their importance weights 1/prior, which sum to one."""
    if values.ndim != 1 or values.size < 4 * N_COMPONENTS:
        raise PopulationError(
            f"posterior draws must be one column of at least {4 * N_COMPONENTS}; got shape {values.shape}. "
            "Run the fit of that device longer"
        )
    if log_prior.shape != values.shape:
        raise PopulationError(
            f"log prior has shape {log_prior.shape}, the draws {values.shape}; give one log density per draw"
        )
    pooled = quantity(name).pool(values)
    if not np.all(np.isfinite(log_prior)):
        raise PopulationError(
            f"the prior density of {name} must be finite at every posterior draw; it is not. "
            "Check that the prior given is the one the device was fitted with"
        )
    weight = np.exp(np.min(log_prior) - log_prior)
    return pooled, weight / weight.sum()


def of_draws(name: str, values: FloatArray, log_prior: FloatArray) -> QuantityLikelihood:
    """Turn draws of a single-device posterior into a likelihood, by the prior under which they were made.

    The likelihood follows by weighting each draw with 1/prior (Hogg, Myers and Bovy 2010, eq. 9). The weighted draws
    are then summarised by a few normal components, equal in mass, that keep their mean and variance, so that the sum
    over draws stays finite and smooth when the spread of the population is smaller than the gaps between draws.

    `values` are equally weighted draws in natural units, shape (n,); `log_prior` is the log density at the draws *on
    the pooled scale* (for K: the density of log K), up to a constant. `PopulationError` if the prior dominates so far
    that hardly any draw carries the weight.
    """
    pooled, weight = weighted(name, values, log_prior)
    effective = float(1.0 / np.sum(weight**2))
    if effective < FEWEST_EFFECTIVE:
        raise PopulationError(
            f"{name}: only {effective:.0f} of {pooled.size} draws carry weight once the prior is divided "
            f"out ({FEWEST_EFFECTIVE:.0f} are needed): the prior, not the recording, shaped this posterior. "
            "Refit that device under a wider prior or leave this quantity out of it"
        )
    mean = float(np.sum(weight * pooled))
    variance = float(np.sum(weight * (pooled - mean) ** 2))
    if variance <= 0:
        raise PopulationError(f"all posterior draws of {name} are equal; that is not a posterior")
    order = np.argsort(pooled, kind="stable")
    pooled, weight = pooled[order], weight[order]
    up_to = np.cumsum(weight)
    group = np.minimum((up_to * N_COMPONENTS).astype(np.int64), N_COMPONENTS - 1)
    mass = np.bincount(group, weight, N_COMPONENTS)
    held = mass > 0
    safe = np.where(held, mass, 1.0)
    centre = np.bincount(group, weight * pooled, N_COMPONENTS) / safe
    within = np.bincount(group, weight * (pooled - centre[group]) ** 2, N_COMPONENTS) / safe
    keep = np.sqrt(1.0 - BANDWIDTH**2)
    shrunk = mean + keep * (centre - mean)
    sd = np.sqrt(keep**2 * within + BANDWIDTH**2 * variance)
    point = float(pooled[np.searchsorted(up_to, 0.5)])
    return QuantityLikelihood(False, shrunk[held], sd[held], mass[held] / mass.sum(), effective, point)
