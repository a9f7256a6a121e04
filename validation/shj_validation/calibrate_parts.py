"""Ranks, and the draws of the calibration's part `margins`: a new device; see `calibrate.py`, which runs it."""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.population.hierarchy import fit_quantity
from shj_bayes.population.quantities import PopulationPrior, QuantityLikelihood, population_prior
from shj_bayes.results.fit import Trust

N_RANKS = 99  # nearly independent posterior draws for each rank


def ranks_of(posterior: Mapping[str, FloatArray], values: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """Rank of each true value among nearly independent draws, and the share of all draws below it."""
    ranks: dict[str, int] = {}
    below: dict[str, float] = {}
    for name, draws in posterior.items():
        thinned = draws[np.linspace(0, draws.size - 1, N_RANKS).astype(int)]
        ranks[name] = int(np.count_nonzero(thinned < values[name]))
        below[name] = float(np.mean(draws < values[name]))
    return {"ranks": ranks, "below": below}


def draw_margins(number: int, seed: int, *, n_sets: int, n_devices: int, sd: float) -> dict[str, Any]:
    """Draw a population of Fy from the population prior, measure some devices of each set, and predict the next one.

    Parameters
    ----------
    number, seed : int
        Same number and seed, same draw.
    n_sets, n_devices : int
        Sets, and tested devices of each.
    sd : float
        Standard deviation with which log Fy of a device is measured.

    Returns
    -------
    dict
        As for `calibrate.draw`: a new device of the first set and of a set never tested, level and spread of the first
        set, and the spread between sets; all on the logarithmic scale.
    """
    begin = time.perf_counter()
    rng = np.random.default_rng([seed, number, 2])
    prior = population_prior("Fy")
    level, between, typical, unequal = _hyper(prior, rng)
    mu, tau = rng.normal(level, between, n_sets), typical * np.exp(unequal * rng.standard_normal(n_sets))
    devices = rng.normal(mu[:, None], tau[:, None], (n_sets, n_devices))
    measured = devices + sd * rng.standard_normal(devices.shape)
    sets = [[QuantityLikelihood(False, np.array([m]), np.array([sd]), np.ones(1)) for m in row] for row in measured]
    fit = fit_quantity("Fy", sets, prior, np.random.SeedSequence([seed, number]))
    draws, truth = {}, {}
    for name, index in (("new device", 0), ("device of a set never tested", None)):
        mean, spread = fit.level_and_spread(index, rng)
        draws[name] = mean + spread * rng.standard_normal(mean.size)
        own = (mu[0], tau[0]) if index is not None else (rng.normal(level, between), typical)
        width = own[1] if index is not None else typical * np.exp(unequal * rng.standard_normal())
        truth[name] = float(rng.normal(own[0], width))
    draws |= {"level": fit.mu[:, 0], "spread": fit.tau[:, 0], "between sets": fit.hyper[:, 1]}
    truth |= {"level": float(mu[0]), "spread": float(tau[0]), "between sets": between}
    record = {"number": number, "truth": truth, "verdict": Trust.RELIABLE, **ranks_of(draws, truth)}
    return record | {"seconds": time.perf_counter() - begin}


def _hyper(prior: PopulationPrior, rng: np.random.Generator) -> tuple[float, float, float, float]:
    """Draw M, S, tau0 and omega from their priors, as `PopulationPrior` states them."""
    level = rng.normal(prior.centre, prior.centre_sd)
    between = prior.between_scale * abs(rng.standard_t(4))
    typical = prior.spread_median * np.exp(prior.spread_log_sd * rng.standard_normal())
    return float(level), float(between), float(typical), float(prior.unequal_scale * abs(rng.standard_normal()))
