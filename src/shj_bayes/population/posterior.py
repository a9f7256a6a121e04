"""Values that hold a fitted population: its sets, the draws of every quantity, and what they rest on."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from shj_bayes._util.arrays import freeze
from shj_bayes.errors import PopulationError, did_you_mean
from shj_bayes.population.device import Tags
from shj_bayes.population.priors import PopulationPrior
from shj_bayes.population.quantities import FloatArray
from shj_bayes.population.tested import RangeTested

SCHEMA: Literal["shj-bayes/population/1"] = "shj-bayes/population/1"
ANY_SET = "(any set)"
"""Name of a set that was never tested, like the tested ones."""
LISTED = 12
"""Sets that a refusal lists."""
R_HAT_LIMIT = 1.01
ESS_LIMIT = 400.0
"""Chains have met when R-hat is below and the effective sample size above these (Vehtari et al. 2021)."""


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
    # mu, tau: shape (n_draws, n_sets): level and device-to-device standard deviation of each set; chain after chain
    mu: FloatArray = field(repr=False)
    tau: FloatArray = field(repr=False)
    hyper: FloatArray = field(repr=False)  # shape (n_draws, 4): M, S, tau0, omega
    n_devices: tuple[int, ...]  # devices of each set that give this quantity
    # r_hat, ess: worst rank-normalised split R-hat and smallest bulk effective sample size of all its scalars
    r_hat: float
    ess: float
    n_chains: int  # independent chains

    def __post_init__(self) -> None:
        """Freeze the arrays and check that they belong together."""
        freeze(self, "mu", "tau", "hyper")
        n = len(self.n_devices)
        if self.mu.shape != self.tau.shape or self.mu.shape[1] != n or self.hyper.shape != (self.mu.shape[0], 4):
            raise PopulationError(
                f"draws of {self.name} do not belong together: mu {self.mu.shape}, tau {self.tau.shape}, "
                f"hyper {self.hyper.shape}, {n} sets"
            )

    @property
    def converged(self) -> bool:
        """Whether the chains have met."""
        return self.r_hat < R_HAT_LIMIT and self.ess > ESS_LIMIT

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

    @property
    def converged(self) -> bool:
        """Whether the chains of every quantity have met under the default prior."""
        return all(fit.converged for fit in self.posteriors.values())

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
