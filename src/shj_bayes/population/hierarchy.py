"""The partially pooled model of a population of sets: level and spread of each set learn from all sets.

For every quantity on its pooled scale::

    device value ~ Normal(mu_set, tau_set)
    mu_set       ~ Normal(M, S)
    log tau_set  ~ Normal(log tau0, omega)

so that sets may differ in level and in spread, and a set of one or two devices borrows both, at the price that
the data themselves set (S and omega). Quantities are pooled independently of each other: correlation between
K, Fy, ratio and gamma of one device is not modelled. Device values are integrated out in closed form, for rounded
values as well as for posterior draws (docs/decisions/0004-population.md).
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from tqdm import tqdm

from shj_bayes._util.arrays import freeze
from shj_bayes.errors import PopulationError, did_you_mean
from shj_bayes.inference.posterior import n_threads
from shj_bayes.population.device import DeviceEstimate, RangeTested, Tags, sets_of
from shj_bayes.population.grid import drawn, integrate
from shj_bayes.population.quantities import (
    ASSUMED,
    DESIGN,
    QUANTITIES,
    FloatArray,
    Likelihood,
    PopulationPrior,
    other_priors,
    population_prior,
    quantity,
    stream,
)

SCHEMA: Literal["shj-bayes/population/1"] = "shj-bayes/population/1"
ANY_SET = "(any set)"
"""Name of a set that was never tested, like the tested ones."""
LISTED = 12
"""Sets that a refusal lists."""
MAIN_PRIOR = "default"
N_DRAWS, FEWER_DRAWS = 8000, 4000
"""Draws under the default prior; and under the others, or of many quantities of which only quantiles are asked."""


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
    sets: Sequence[Sequence[Likelihood]],
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
    sets = {
        q: [[d.measurements[q].likelihood for d in group if q in d.measurements] for group in grouped.values()]
        for q in names
    }
    chosen = {q: population_prior(q) for q in names}
    priors = {q: {MAIN_PRIOR: prior, **other_priors(prior)} for q, prior in chosen.items()}

    def one(task: tuple[str, str]) -> QuantityPosterior:
        label, q = task
        few = brief or label != MAIN_PRIOR
        return fit_quantity(q, sets[q], priors[q][label], stream(seed, q, label), FEWER_DRAWS if few else N_DRAWS)

    fits = {label: dict(of_prior) for label, of_prior in (known or {}).items()}
    tasks = [(label, q) for label in (MAIN_PRIOR, *ASSUMED) for q in names if q not in fits.get(label, {})]
    with ThreadPoolExecutor(n_threads(0)) as threads:
        done = tqdm(threads.map(one, tasks), "population", len(tasks), disable=None if progress else True, leave=False)
        for (label, q), fitted in zip(tasks, done, strict=True):
            fits.setdefault(label, {})[q] = fitted
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
