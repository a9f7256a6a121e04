"""Draws of two parts of the calibration: a new device (`margins`), and the law with three effects (`effects`).

See `calibrate.py`, which runs them and says what the ranks mean.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from shj_bayes.inference.problem import Run
from shj_bayes.mismatch.posterior import augmented_posterior, sample

from shj_bayes.errors import ShjError
from shj_bayes.inference.sampler import Plan
from shj_bayes.mismatch.evidence import Evidence, evidence_of
from shj_bayes.mismatch.refit import Refit, extend_starts, make_model, refit
from shj_bayes.model.effects.catalogue import catalogue
from shj_bayes.model.noise import Stretches, simulate_noise
from shj_bayes.model.priors import read_priors
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.population.hierarchy import fit_quantity
from shj_bayes.population.measurement import Likelihood
from shj_bayes.population.priors import PopulationPrior, population_prior
from shj_bayes.recording.protocol import exact_motion, table_1

Floats = NDArray[np.float64]
N_RANKS = 99  # nearly independent posterior draws for each rank
CATALOGUE = catalogue()
EFFECTS = ("slack", "asymmetry", "wear")  # fitted in this order, as the search of a diagnosis adds one after the other
DEFAULTS: dict[str, dict[str, Any]] = {
    "effects": {"rate_Hz": 2.5, "max_steps": 1000},
    "margins": {"n_sets": 5, "n_devices": 2, "sd": 0.02},
}


def ranks_of(posterior: Mapping[str, Floats], values: Mapping[str, float]) -> dict[str, dict[str, Any]]:
    """Rank of each true value among nearly independent draws, and the share of all draws below it."""
    ranks: dict[str, int] = {}
    below: dict[str, float] = {}
    for name, draws in posterior.items():
        thinned = draws[np.linspace(0, draws.size - 1, N_RANKS).astype(int)]
        ranks[name] = int(np.count_nonzero(thinned < values[name]))
        below[name] = float(np.mean(draws < values[name]))
    return {"ranks": ranks, "below": below}


def draw_effects(number: int, seed: int, *, rate_Hz: float, max_steps: int) -> dict[str, Any]:
    """Make a device with slack, asymmetry and wear drawn from their priors, and sample the law with the three.

    The motion is exact and the noise is AR(1), so that the model is the truth; what is tested is the posterior and its
    sampling, started from least squares as a diagnosis does.

    Parameters
    ----------
    number, seed : int
        Same number and seed, same draw.
    rate_Hz : float
        Sampling rate, Hz.
    max_steps : int
        Steps after which to stop.

    Returns
    -------
    dict
        As for `calibrate.draw`.
    """
    begin = time.perf_counter()
    rng = np.random.default_rng([seed, number, 3])
    priors = read_priors("afc")
    effects = tuple(CATALOGUE[name] for name in EFFECTS)
    model = make_model(priors, 2, effects)
    values = {n: float(p.distribution.rvs(random_state=rng)) for n, p in zip(model.names, model.priors, strict=True)}
    noise = {name: float(priors.of(name).distribution.rvs(random_state=rng)) for name in ("sigma", "phi")}
    record: dict[str, Any] = {"number": number, "truth": values | noise}
    try:
        evidence = _blank(rate_Hz)
        z = np.array([float(p.to_free(np.asarray(values[n]))) for n, p in zip(model.names, model.priors, strict=True)])
        clean = model.force(evidence, z)
        n = clean.size // 2
        stretches = Stretches(np.ones(n, dtype=np.bool_), np.zeros(1, dtype=np.int64))
        wander = [simulate_noise("ar1", stretches, rng, **noise) for _ in range(2)]
        evidence = replace(evidence, force_kN=clean + np.concatenate(wander))
        fit = _searched(evidence)
        plan = Plan(seed=int(rng.integers(2**31)), max_steps=max_steps)
        draws, verdict = sample(augmented_posterior(evidence, fit, priors), fit, plan, threads=1)
    except ShjError as error:
        return record | {"error": str(error), "seconds": time.perf_counter() - begin}
    ranked = ranks_of(draws, record["truth"])
    return record | {"verdict": verdict.word, **ranked, "seconds": time.perf_counter() - begin}


def _blank(rate_Hz: float) -> Evidence:
    """Two runs of Table 1 with their exact motion; the force is to be put in."""
    motion = exact_motion(table_1(), rate_Hz)[1]
    truth = Truth(displacement_noise_mm=0.0, sigma=0.0)
    runs = [Run(recording, motion) for recording in simulate_device(truth, seed=1, rate_Hz=rate_Hz)]
    evidence = evidence_of(runs)
    assert evidence.stride == 1
    return replace(evidence, start_force_kN=(0.0, 0.0))


def _searched(evidence: Evidence) -> Refit:
    """Least squares with one effect after the other, each from the starts that it states."""
    priors = read_priors("afc")
    peak = float(np.percentile(np.abs(evidence.force_kN), 97))
    model = make_model(priors, 2, ())
    law = {"Fy": peak, "gamma": 0.0, "ratio": 1.0}
    starts = []
    for stiffness in (5.0, 15.0, 40.0):
        given = {"K": stiffness, "beta": 10.0, **law}
        starts.append(
            np.array([float(p.to_free(np.asarray(given[n]))) for n, p in zip(model.names, model.priors, strict=True)])
        )
    fit = refit(evidence, model, starts)
    for k, name in enumerate(EFFECTS, start=1):
        model = make_model(priors, 2, tuple(CATALOGUE[e] for e in EFFECTS[:k]))
        fit = refit(evidence, model, extend_starts(fit, model, CATALOGUE[name]), sigma_kN=fit.rmse_kN)
    return fit


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
    sets = [[Likelihood(False, np.array([m]), np.array([sd]), np.ones(1)) for m in row] for row in measured]
    fit = fit_quantity("Fy", sets, prior, np.random.SeedSequence([seed, number]), n_warm=500, n_keep=800, thin=2)
    draws, truth = {}, {}
    for name, index in (("new device", 0), ("device of a set never tested", None)):
        mean, spread = fit.level_and_spread(index, rng)
        draws[name] = mean + spread * rng.standard_normal(mean.size)
        own = (mu[0], tau[0]) if index is not None else (rng.normal(level, between), typical)
        width = own[1] if index is not None else typical * np.exp(unequal * rng.standard_normal())
        truth[name] = float(rng.normal(own[0], width))
    draws |= {"level": fit.mu[:, 0], "spread": fit.tau[:, 0], "between sets": fit.hyper[:, 1]}
    truth |= {"level": float(mu[0]), "spread": float(tau[0]), "between sets": between}
    verdict = "reliable" if fit.converged else "tentative"
    record = {"number": number, "truth": truth, "verdict": verdict, **ranks_of(draws, truth)}
    return record | {"seconds": time.perf_counter() - begin}


def _hyper(prior: PopulationPrior, rng: np.random.Generator) -> tuple[float, float, float, float]:
    """Draw M, S, tau0 and omega from their priors, as `PopulationPrior` states them."""
    level = rng.normal(prior.centre, prior.centre_sd)
    between = prior.between_scale * abs(rng.standard_t(4))
    typical = prior.spread_median * np.exp(prior.spread_log_sd * rng.standard_normal())
    return float(level), float(between), float(typical), float(prior.unequal_scale * abs(rng.standard_normal()))
