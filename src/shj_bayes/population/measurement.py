"""What one device says about one quantity: posterior draws, or a rounded number, turned into a likelihood."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from shj_bayes._util.frozen_arrays import freeze
from shj_bayes.errors import PopulationError
from shj_bayes.population.quantities import FloatArray, Quantity

N_COMPONENTS = 12
"""Normal components that stand for a set of draws (benchmarks/population.py: more changes nothing visible)."""
BANDWIDTH = 0.3
"""Kernel width of those components, in standard deviations; centres shrink so that the variance is kept."""
FEWEST_EFFECTIVE = 25.0
"""Below this effective number of importance draws a device's posterior says too little about its likelihood."""
MANY_DEVICES, NARROW = 30, 0.15
"""Devices of a set from which on its spread is well known, and the part of that spread that counts as narrow."""


@dataclass(frozen=True)
class Likelihood:
    """Likelihood of a device's true value on the pooled scale, integrable against a normal in closed form."""

    # True: constant ``weight`` on adjoining pieces between ``first`` and ``second``. False: normal components with
    # centre ``first``, standard deviation ``second`` and ``weight`` summing to one.
    pieces: bool
    # first to weight: shape (n,): as above, pooled scale
    first: FloatArray
    second: FloatArray
    weight: FloatArray
    effective_draws: float = np.inf  # Kish effective number of importance draws behind it; infinity when it is exact

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


def gathered(group: Sequence[Likelihood]) -> tuple[FloatArray, list[Likelihood]]:
    """Narrow devices of a large set as one lot, whose likelihood needs no sum over devices; the others as they are.

    Beside a spread of the set that is many times as wide, and that many devices fix, nothing of their shape is felt,
    nor how their errors differ (`tests` hold both likelihoods side by side). Normal devices with one error enter by
    their number (0 for a small set), mean, variance of one, and sum of squares about the mean alone.
    """
    if len(group) < MANY_DEVICES:
        return np.zeros(4), list(group)
    centre, sd = np.array([likelihood.centre_and_sd for likelihood in group]).T
    narrow = sd < NARROW * float(np.std(centre, ddof=1))
    if not narrow.any():
        return np.zeros(4), list(group)
    own = centre[narrow]
    lot = (own.size, own.mean(), np.mean(sd[narrow] ** 2), np.sum((own - own.mean()) ** 2))
    return np.array(lot), [likelihood for likelihood, one in zip(group, narrow, strict=True) if not one]


@dataclass(frozen=True)
class Rounded:
    """A printed value that stands for everything which rounds to it.

    The likelihood is the indicator of the interval, which is the same on every scale.
    """

    value: float  # as printed, natural unit
    # lower, upper: what it stands for, natural unit
    lower: float
    upper: float

    def __post_init__(self) -> None:
        """Refuse an empty interval or one that misses its value."""
        if not (np.isfinite([self.lower, self.upper]).all() and self.lower < self.upper):
            raise PopulationError(
                f"a rounded value needs finite bounds with lower < upper; got {self.lower:g} to {self.upper:g}. "
                "Give the rounding step of the table (above zero)"
            )
        if not self.lower <= self.value <= self.upper:
            raise PopulationError(
                f"the printed value {self.value:g} lies outside the interval {self.lower:g} to {self.upper:g} "
                "that it is said to stand for; correct the rounding step"
            )

    @classmethod
    def to_step(cls, value: float, step: float) -> Rounded:
        """Value rounded to a multiple of ``step`` (natural unit): half a step either way."""
        return cls(value, value - 0.5 * step, value + 0.5 * step)

    @classmethod
    def to_decade(cls, value: float, decades: float = 1.0) -> Rounded:
        """Value rounded to a power of ten: half of ``decades`` either way on the logarithm."""
        return cls(value, value * 10.0 ** (-0.5 * decades), value * 10.0 ** (0.5 * decades))

    @classmethod
    def gamma_of_dep(cls, dep: float, step: float) -> Rounded:
        """Interval of gamma = 1/dep, s/mm, for a dep in mm/s rounded to ``step``; refuses one that reaches 0."""
        if abs(dep) <= 0.5 * step:
            raise PopulationError(
                f"dep = {dep:g} mm/s rounded to {step:g} reaches zero, where gamma = 1/dep has no bound; "
                "give gamma itself, or a smaller rounding step"
            )
        ends = 1.0 / (dep + 0.5 * step), 1.0 / (dep - 0.5 * step)
        return cls(1.0 / dep, min(ends), max(ends))

    def point(self, quantity: Quantity) -> float:
        """Return the printed value on the pooled scale."""
        return float(quantity.pool(self.value))

    def likelihood(self, quantity: Quantity) -> Likelihood:
        """Return the indicator of the interval, on the pooled scale."""
        ends = quantity.pool(np.array([self.lower, self.upper]))
        return Likelihood(True, ends[:1], ends[1:], np.ones(1))


@dataclass(frozen=True)
class RoundedRatio:
    """The quotient of two rounded values, each uniform inside its own interval."""

    # numerator, denominator: for the ratio: sliding force of the second and of the first run, kN
    numerator: Rounded
    denominator: Rounded

    def point(self, quantity: Quantity) -> float:
        """Return the quotient of the printed values on the pooled scale."""
        return float(quantity.pool(self.numerator.value / self.denominator.value))

    def likelihood(self, quantity: Quantity) -> Likelihood:
        """Density of the log quotient, constant on six equal pieces (error far below the rounding itself).

        With n uniform on [a, b] and d on [c, e], the density of log(n/d) = u is, up to a constant,
        e^u times the integral of d over the d that keep d e^u inside [a, b].
        """
        if not quantity.logarithmic:
            raise PopulationError(f"a quotient of rounded values needs a logarithmic scale, not {quantity.name}")
        a, b = float(quantity.pool(self.numerator.lower)), float(quantity.pool(self.numerator.upper))
        c, e = float(quantity.pool(self.denominator.lower)), float(quantity.pool(self.denominator.upper))
        edges = np.linspace(a - e, b - c, 7)
        middle = 0.5 * (edges[:-1] + edges[1:])
        low, high = np.exp(np.maximum(c, a - middle)), np.exp(np.minimum(e, b - middle))
        density = np.exp(middle) * 0.5 * np.maximum(high**2 - low**2, 0.0)
        return Likelihood(True, edges[:-1], edges[1:], density / density.max())


@dataclass(frozen=True)
class PosteriorDraws:
    """Draws of a single-device posterior, with the prior under which they were made.

    The likelihood follows by weighting each draw with 1/prior (Hogg, Myers and Bovy 2010, eq. 9); the weighted draws
    are then summarised by a few normal components that keep their mean and variance, so that the sum
    over draws stays finite and smooth when the spread of the population is smaller than the gaps between draws.
    """

    values: FloatArray  # shape (n,): draws in natural units, equally weighted
    # shape (n,): log density of the single-device prior at the draws, *on the pooled scale* (for K: the density of log
    # K), up to a constant. A callable is given the pooled values.
    log_prior: FloatArray | Callable[[FloatArray], FloatArray] = field(repr=False)

    def __post_init__(self) -> None:
        """Refuse too few draws or a prior that does not belong to them."""
        freeze(self, "values")
        if self.values.ndim != 1 or self.values.size < 4 * N_COMPONENTS:
            raise PopulationError(
                f"posterior draws must be one column of at least {4 * N_COMPONENTS}; got shape {self.values.shape}. "
                "Run the fit of that device longer"
            )
        if not callable(self.log_prior):
            freeze(self, "log_prior")
            if np.shape(self.log_prior) != self.values.shape:
                raise PopulationError(
                    f"log prior has shape {np.shape(self.log_prior)}, the draws {self.values.shape}; "
                    "give one log density per draw"
                )

    def weighted(self, quantity: Quantity) -> tuple[FloatArray, FloatArray]:
        """Draws on the pooled scale and their importance weights, which sum to one."""
        pooled = quantity.pool(self.values)
        log_prior = self.log_prior(pooled) if callable(self.log_prior) else self.log_prior
        log_weight = -np.asarray(log_prior, dtype=np.float64)
        if log_weight.shape != pooled.shape or not np.all(np.isfinite(log_weight)):
            raise PopulationError(
                f"the prior density of {quantity.name} must be finite at every posterior draw; it is not. "
                "Check that the prior given is the one the device was fitted with"
            )
        weight = np.exp(log_weight - log_weight.max())
        return pooled, weight / weight.sum()

    def point(self, quantity: Quantity) -> float:
        """Median of the likelihood on the pooled scale."""
        pooled, weight = self.weighted(quantity)
        order = np.argsort(pooled)
        return float(pooled[order][np.searchsorted(np.cumsum(weight[order]), 0.5)])

    def likelihood(self, quantity: Quantity) -> Likelihood:
        """Fit normal components through the weighted draws, equal in mass, mean and variance preserved.

        Raises
        ------
        PopulationError
            If the prior dominates so far that hardly any draw carries the weight.
        """
        pooled, weight = self.weighted(quantity)
        effective = float(1.0 / np.sum(weight**2))
        if effective < FEWEST_EFFECTIVE:
            raise PopulationError(
                f"{quantity.name}: only {effective:.0f} of {pooled.size} draws carry weight once the prior is divided "
                f"out ({FEWEST_EFFECTIVE:.0f} are needed): the prior, not the recording, shaped this posterior. "
                "Refit that device under a wider prior or leave this quantity out of it"
            )
        mean = float(np.sum(weight * pooled))
        variance = float(np.sum(weight * (pooled - mean) ** 2))
        if variance <= 0:
            raise PopulationError(f"all posterior draws of {quantity.name} are equal; that is not a posterior")
        order = np.argsort(pooled, kind="stable")
        group = np.minimum((np.cumsum(weight[order]) * N_COMPONENTS).astype(np.int64), N_COMPONENTS - 1)
        mass = np.bincount(group, weight[order], N_COMPONENTS)
        held = mass > 0
        safe = np.where(held, mass, 1.0)
        centre = np.bincount(group, weight[order] * pooled[order], N_COMPONENTS) / safe
        within = np.bincount(group, weight[order] * (pooled[order] - centre[group]) ** 2, N_COMPONENTS) / safe
        keep = np.sqrt(1.0 - BANDWIDTH**2)
        shrunk = mean + keep * (centre - mean)
        sd = np.sqrt(keep**2 * within + BANDWIDTH**2 * variance)
        return Likelihood(False, shrunk[held], sd[held], mass[held] / mass.sum(), effective)

    def condensed(self, quantity: Quantity) -> Condensed:
        """Give what a population needs of the draws: some hundred bytes, where the draws of a device are a megabyte."""
        return Condensed(self.point(quantity), self.likelihood(quantity))


@dataclass(frozen=True)
class Condensed:
    """The likelihood of a posterior whose draws are not kept."""

    value: float  # median of the likelihood, pooled scale
    kept: Likelihood  # the likelihood

    def point(self, _quantity: Quantity) -> float:
        """Return the median on the pooled scale."""
        return self.value

    def likelihood(self, _quantity: Quantity) -> Likelihood:
        """Return the likelihood."""
        return self.kept


@dataclass(frozen=True)
class Stated:
    """A value with its standard deviation, as a report gives it."""

    # mean, sd: natural unit
    mean: float
    sd: float

    def __post_init__(self) -> None:
        """Refuse a spread that is not above zero."""
        if not (np.isfinite([self.mean, self.sd]).all() and self.sd > 0):
            raise PopulationError(f"a stated value needs a finite mean and a spread above zero; got {self}")

    def point(self, quantity: Quantity) -> float:
        """Return the mean on the pooled scale."""
        return float(quantity.pool(self.mean))

    def likelihood(self, quantity: Quantity) -> Likelihood:
        """Return a normal on the pooled scale; for a logarithm the spread is sd/mean (first order)."""
        sd = self.sd / self.mean if quantity.logarithmic else self.sd
        return Likelihood(False, np.array([self.point(quantity)]), np.array([sd]), np.ones(1))


Measurement = Rounded | RoundedRatio | PosteriorDraws | Condensed | Stated
