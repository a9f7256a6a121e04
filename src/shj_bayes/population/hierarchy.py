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
from typing import Literal, NamedTuple

import numpy as np
from tqdm import tqdm

from shj_bayes._util.arrays import freeze
from shj_bayes.errors import PopulationError, did_you_mean
from shj_bayes.inference.convergence import ess_bulk, rhat
from shj_bayes.inference.posterior import n_threads
from shj_bayes.population.device import DeviceEstimate, RangeTested, Tags, sets_of
from shj_bayes.population.kernel import log_likelihood_of_set, run_chain
from shj_bayes.population.quantities import (
    DESIGN,
    QUANTITIES,
    FloatArray,
    Likelihood,
    PopulationPrior,
    gathered,
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


N_CHAINS = 4


class Sweeps(NamedTuple):
    """Warm-up sweeps, draws kept per chain, sweeps per draw kept."""

    n_warm: int = 800
    n_keep: int = 2000
    thin: int = 2


_FULL = Sweeps()
_SHORT = Sweeps(600, 500, 6)  # under the other priors only a few quantiles are shown
LONGER = 4
"""Times as many sweeps, for as many draws, where chains have not met."""
MAIN_PRIOR = "default"


def _brief(n_sets: int) -> Sweeps:
    """Sweeps for a few quantiles: the more sets, the more slowly chains meet (two sets need a third of 15)."""
    thin = 2 + n_sets // 5
    return Sweeps(100 * thin, 500, thin)


def _pack(sets: Sequence[Sequence[Likelihood]]) -> tuple[FloatArray, ...]:
    """Lay the likelihoods out in the flat arrays that the sampler reads, narrow devices of large sets as lots."""
    split = [gathered(group) for group in sets]
    devices = [likelihood for _, rest in split for likelihood in rest]
    empty = [np.empty(0)]
    return (
        np.array([lot for lot, _ in split]),
        np.cumsum([0, *(len(rest) for _, rest in split)]).astype(np.int64),
        np.cumsum([0, *(d.weight.size for d in devices)]).astype(np.int64),
        np.array([d.pieces for d in devices], dtype=np.bool_),
        np.concatenate([*(d.first for d in devices), *empty]),
        np.concatenate([*(d.second for d in devices), *empty]),
        np.concatenate([*(d.weight for d in devices), *empty]),
        np.empty(sum(d.weight.size + 1 for d in devices)),
    )


def _start(
    sets: Sequence[Sequence[Likelihood]], prior: PopulationPrior, data: tuple[FloatArray, ...], rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Draw an overdispersed starting point at which every set has a finite likelihood."""
    centres = [np.array([d.centre_and_sd[0] for d in group]) for group in sets]
    level = float(np.mean(np.concatenate(centres)))
    mu = np.array([c.mean() if c.size else level for c in centres])
    log_tau = np.log(prior.spread_median) + rng.normal(0.0, 0.7, mu.size)
    for s, c in enumerate(centres):
        if c.size:
            widest = max(np.ptp(c), *(d.centre_and_sd[1] for d in sets[s]))
            log_tau[s] = max(log_tau[s], np.log(max(0.3 * widest, 1e-300)))
            while not np.isfinite(log_likelihood_of_set(s, mu[s], log_tau[s], *data)):
                log_tau[s] += 0.7
    between = max(float(mu.std()), 0.1 * prior.between_scale) * np.exp(rng.normal(0.0, 0.7))
    hyper = np.array(
        [level, np.log(between), float(log_tau.mean()), np.log(prior.unequal_scale * rng.uniform(0.1, 1.5))]
    )
    return mu, log_tau, hyper


def fit_quantity(
    name: str,
    sets: Sequence[Sequence[Likelihood]],
    prior: PopulationPrior,
    seed: np.random.SeedSequence,
    sweeps: Sweeps = _FULL,
    *,
    workers: int = 1,
) -> QuantityPosterior:
    """Posterior of level and spread of every set, for one quantity: draws of four chains, one after the other.

    A set may hold no device and then rests on the others alone; `PopulationError` if none holds one. The numbers do not
    depend on `workers`, the threads over which the chains are spread.
    """
    if not any(len(group) for group in sets):
        raise PopulationError(f"no device gives {quantity(name).name}; there is nothing to pool")
    data = _pack(sets)

    def one_chain(child: np.random.SeedSequence) -> tuple[FloatArray, ...]:
        rng = np.random.default_rng(child)
        own = (*data[:-1], np.empty_like(data[-1]))  # working memory is not shared
        start = _start(sets, prior, own, rng)
        drawn: tuple[FloatArray, ...] = run_chain(*start, own, prior.packed(), *sweeps, rng)
        return drawn

    with ThreadPoolExecutor(max(1, min(workers, N_CHAINS))) as pool:
        chains = list(pool.map(one_chain, seed.spawn(N_CHAINS)))
    mu, log_tau, hyper = (np.stack([chain[i] for chain in chains]) for i in range(3))
    scalars = np.concatenate([mu, log_tau, hyper], axis=2)
    return QuantityPosterior(
        name=name,
        mu=mu.reshape(-1, mu.shape[2]),
        tau=np.exp(log_tau.reshape(-1, log_tau.shape[2])),
        hyper=np.column_stack([hyper[..., 0].ravel(), np.exp(hyper[..., 1:].reshape(-1, 3))]),
        n_devices=tuple(len(group) for group in sets),
        r_hat=max(rhat(scalars[:, :, i]) for i in range(scalars.shape[2])),
        ess=min(ess_bulk(scalars[:, :, i]) for i in range(scalars.shape[2])),
        n_chains=N_CHAINS,
    )


def fit_population(
    devices: Sequence[DeviceEstimate],
    *,
    seed: int,
    progress: bool = False,
    workers: int = 0,
    brief: bool = False,
) -> PopulationResult:
    """Pool devices, set by set, quantity by quantity, under the default prior and two others of the spread.

    The numbers depend on the devices and the seed, not on `workers`, threads (0 for one per processor). With `brief`
    there are fewer draws, for many quantities of which only a few quantiles are asked: these are then known to about 2
    % of the spread. `PopulationError` if devices contradict each other or give nothing to pool.
    """
    if seed < 0:
        raise PopulationError(f"the seed must be zero or a positive whole number, not {seed}")
    grouped = sets_of(devices)
    threads = n_threads(workers)
    names = [q for q in (*QUANTITIES, *DESIGN) if any(q in device.measurements for device in devices)]
    chosen = {}
    fits: dict[str, dict[str, QuantityPosterior]] = {}
    draws_behind: dict[str, float] = {}
    with tqdm(total=3 * len(names), desc="population", disable=None if progress else True, leave=False) as bar:
        for q in names:
            sets = [[d.measurements[q].likelihood for d in group if q in d.measurements] for group in grouped.values()]
            draws_behind[q] = min(x.effective_draws for group in sets for x in group)
            chosen[q] = population_prior(q)
            for label, prior in {MAIN_PRIOR: chosen[q], **other_priors(chosen[q])}.items():
                sweeps = _brief(len(grouped)) if brief else _FULL if label == MAIN_PRIOR else _SHORT
                fitted = fit_quantity(q, sets, prior, stream(seed, q, label), sweeps, workers=threads)
                if not fitted.converged:  # once more, with longer chains
                    longer = Sweeps(LONGER * sweeps.n_warm, sweeps.n_keep, LONGER * sweeps.thin)
                    fitted = fit_quantity(q, sets, prior, stream(seed, q, label), longer, workers=threads)
                fits.setdefault(label, {})[q] = fitted
                bar.update()
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
        importance_draws=draws_behind,
        seed=seed,
    )
