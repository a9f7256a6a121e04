"""Samplers for `peers`: each takes our posterior (in blocks for a first look), the numpy one and the start."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import emcee
import numpy as np
from numpy_posterior import NumpyPosterior
from scipy.optimize import minimize
from timing import Counted

from shj_bayes._util.arrays import FloatArray
from shj_bayes.inference.convergence import ESS_LIMIT, RHAT_LIMIT, diagnose_chains
from shj_bayes.inference.fit import evenly_spread, weights_of_all_samples
from shj_bayes.inference.likelihood import Likelihood
from shj_bayes.inference.sampler import SamplingPlan, run_ensembles
from shj_bayes.inference.start import Start, find_start, law_starts, polish

N_CHAINS = 4
N_LAW = 5  # K, Fy, beta, gamma, ratio


@dataclass(frozen=True, eq=False)
class Draws:
    """What a sampler gave: draws (weighted or not), their effective number, and what they cost."""

    chains: FloatArray
    ess: float
    evaluations: int
    note: str = ""
    weights: FloatArray | None = None


def reference(whole: Likelihood, start: Start) -> FloatArray:
    """Draws of a long run of shj-bayes on all samples, shape (n_steps, n_walkers, d)."""
    plan = SamplingPlan(seed=77, n_walkers=60, round_steps=200, max_steps=200)
    states, figures = run_ensembles(whole, whole.model.names, start, plan)
    return np.concatenate([state.chain[figures.n_burn :] for state in states])


def own(first: Likelihood, _peer: NumpyPosterior, _start: Start) -> Draws:
    """Take shj-bayes as `fit` does: search, averaging, proposal, sampling, weights of all samples."""
    posterior, start = find_start(first, threads=0)
    density = Counted(posterior)
    states, figures = run_ensembles(density, posterior.model.names, start, SamplingPlan())
    kept = np.stack([state.chain[figures.n_burn :].reshape(-1, start.free.size) for state in states])
    weights, tail = weights_of_all_samples(posterior, start, kept, threads=0)
    worth = float(weights.mean() ** 2 / np.mean(weights**2))
    chosen = np.take_along_axis(kept, evenly_spread(weights)[:, :, None], axis=1)
    note = f"with the search; {posterior.blocks.used.size} averages; Pareto k {tail:.2f}"
    return Draws(chosen, worth * float(figures.ess_bulk.min()), density.n, note)


def ensembles(mix: Callable[[], list[tuple[emcee.moves.Move, float]]]) -> Callable[..., Draws]:
    """Four emcee ensembles with given moves, run in rounds of 500 steps until they agree."""

    def sample(first: Likelihood, posterior: NumpyPosterior, start: Start) -> Draws:
        d = start.free.size
        root = np.linalg.cholesky(start.covariance)
        samplers, states = [], []
        for seed in range(N_CHAINS):
            random = np.random.RandomState(seed + 1)
            samplers.append(emcee.EnsembleSampler(28, d, posterior, moves=mix()))
            states.append(
                emcee.State(start.free + random.standard_normal((28, d)) @ root.T, random_state=random.get_state())
            )
        while True:
            states = [s.run_mcmc(x, 500, skip_initial_state_check=True) for s, x in zip(samplers, states, strict=True)]
            chains = [s.get_chain() for s in samplers]
            figures = diagnose_chains(first.model.names, chains, np.ones((N_CHAINS, 28)))
            if (figures.ess_bulk.min() >= ESS_LIMIT and figures.rhat.max() < RHAT_LIMIT) or len(chains[0]) >= 4000:
                kept = np.stack([chain[figures.n_burn :] for chain in chains])
                return Draws(kept, float(figures.ess_bulk.min()), posterior.n, f"{len(chains[0])} steps")

    return sample


def laplace_from_our_law(first: Likelihood, posterior: NumpyPosterior, _start: Start) -> Draws:
    """Laplace with importance sampling that starts from the law of our compiled least squares."""
    law = law_starts(first)[0]
    return _laplace(posterior, np.append(law, np.zeros(len(first.model.names) - law.size)))


def laplace_alone(_first: Likelihood, posterior: NumpyPosterior, start: Start) -> Draws:
    """Laplace with importance sampling that starts from the middle of the priors, with nothing of ours."""
    return _laplace(posterior, np.zeros(start.free.size))


def _laplace(posterior: NumpyPosterior, first: FloatArray) -> Draws:
    """Climb by finite differences, then importance draws from a t law at the top."""
    d = first.size

    def fall(z: FloatArray) -> float:
        return min(-posterior(z), 1e12)

    found = minimize(fall, first, method="BFGS", options={"gtol": 1.0})
    top = polish(posterior, [np.asarray(found.x, dtype=np.float64)])
    rng = np.random.default_rng(1)
    root, tail = np.linalg.cholesky(top.covariance), 8.0
    z, log_weight = np.empty((0, d)), np.empty(0)
    while True:
        unit = rng.standard_normal((500, d)) / np.sqrt(rng.chisquare(tail, 500) / tail)[:, None]
        new = top.free + unit @ root.T
        z = np.concatenate([z, new])
        height = posterior.log_posterior_free(new) + 0.5 * (tail + d) * np.log1p(np.sum(unit**2, axis=1) / tail)
        log_weight = np.concatenate([log_weight, height])
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        ess = float(1 / np.sum(weight**2))
        if ess >= ESS_LIMIT or len(z) >= 20_000:
            return Draws(z, ess, posterior.n, "ESS of weights", weight)


def pints_adaptive(first: Likelihood, posterior: NumpyPosterior, start: Start) -> Draws:
    """PINTS' adaptive covariance sampler, four chains."""
    pints: Any = importlib.import_module("pints")
    d = start.free.size

    class Density(pints.LogPDF):  # type: ignore[misc]
        def __call__(self, z: FloatArray) -> float:
            return posterior(z)

        def n_parameters(self) -> int:
            return d

    np.random.seed(1)  # noqa: NPY002 - PINTS draws from the global stream
    root = np.linalg.cholesky(start.covariance)
    begin = [start.free + root @ np.random.standard_normal(d) for _ in range(N_CHAINS)]  # noqa: NPY002
    control = pints.MCMCController(Density(), N_CHAINS, begin, sigma0=start.covariance, method=pints.HaarioBardenetACMC)
    n = 20_000
    control.set_max_iterations(n)
    control.set_log_to_screen(False)
    kept = np.asarray(control.run())[:, n // 5 :]
    figures = diagnose_chains(first.model.names, [c[:, None] for c in kept], np.ones((N_CHAINS, 1)))
    return Draws(kept, float(figures.ess_bulk.min()), posterior.n, f"{n} iterations, R-hat {figures.rhat.max():.3f}")


def nested(_first: Likelihood, posterior: NumpyPosterior, start: Start) -> Draws:
    """Use dynesty with random walks, on a box of ten standard deviations around the top as prior."""
    dynesty: Any = importlib.import_module("dynesty")
    d = start.free.size
    wide = 10 * np.sqrt(np.diag(start.covariance))
    sampler = dynesty.NestedSampler(
        posterior,
        lambda u: start.free + wide * (2 * u - 1),
        d,
        nlive=500,
        sample="rwalk",
        rstate=np.random.default_rng(1),
    )
    sampler.run_nested(dlogz=0.1, print_progress=False)
    result = sampler.results
    weight = np.exp(result.logwt - result.logwt.max())
    weight /= weight.sum()
    return Draws(np.asarray(result.samples), float(1 / np.sum(weight**2)), posterior.n, "ESS of weights", weight)


def transitional(first: Likelihood, posterior: NumpyPosterior, _start: Start) -> Draws:
    """Go from prior to posterior by tempering, as quoFEM's TMCMC does (Ching and Chen 2007), 1000 particles."""
    rng = np.random.default_rng(1)
    n, d = 1000, len(first.model.names)
    z = rng.standard_normal((n, d))  # the prior, in the unbounded space
    low = first.model.laws.log_density(z)
    height = posterior.log_posterior_free(z) - low
    power, stages = 0.0, 0
    while power < 1.0:
        a, b = power, 1.0
        for _ in range(60):  # the next power spreads the weights by as much as they are
            middle = 0.5 * (a + b)
            weight = np.exp((middle - power) * (height - height.max()))
            a, b = (middle, b) if np.std(weight) < np.mean(weight) else (a, middle)
        step = 1.0 if b >= 1.0 - 1e-9 else a
        weight = np.exp((step - power) * (height - height.max()))
        weight /= weight.sum()
        mean = weight @ z
        root = np.linalg.cholesky((z - mean).T @ ((z - mean) * weight[:, None]) + 1e-14 * np.eye(d))
        power, stages = step, stages + 1
        index = rng.choice(n, n, p=weight)
        z, height, low = z[index], height[index], low[index]
        for _ in range(10 if power < 1.0 else 25):
            trial = z + 0.8 * 2.38 / np.sqrt(d) * rng.standard_normal((n, d)) @ root.T
            trial_low = first.model.laws.log_density(trial)
            trial_height = posterior.log_posterior_free(trial) - trial_low
            better = np.log(rng.random(n)) < power * (trial_height - height) + trial_low - low
            z[better], height[better], low[better] = trial[better], trial_height[better], trial_low[better]
    unique = len(np.unique(z[:, 0]))
    return Draws(z, float(unique), posterior.n, f"{stages} stages; ESS: different particles at the end")


def no_u_turn(first: Likelihood, posterior: NumpyPosterior, start: Start) -> Draws:
    """NumPyro's NUTS on the law in JAX, whitened by the curvature at the top; compilation counts."""
    jax: Any = importlib.import_module("jax")
    infer: Any = importlib.import_module("numpyro.infer")
    np_: Any = importlib.import_module("jax.numpy")
    own: Any = importlib.import_module("nuts")
    root = np.linalg.cholesky(start.covariance)
    prior = first.model.laws

    def natural(z: Any) -> Any:
        out = []
        for i, p in enumerate(prior):
            if p.law == "normal":
                out.append(p.a + p.b * z[i])
            elif p.law == "lognormal":
                out.append(p.a * np_.exp(p.b * z[i]))
            else:
                low, high = (np.log(p.a), np.log(p.b)) if p.law == "loguniform" else (p.a, p.b)
                inner = low + (high - low) * jax.scipy.stats.norm.cdf(z[i])
                out.append(np_.exp(inner) if p.law == "loguniform" else inner)
        return out

    def potential(u: Any) -> Any:
        z = start.free + root @ u
        K, Fy, beta, gamma, ratio, white, slow, tau = natural(z)
        decay = np_.exp(-posterior.step_s / tau)
        total = 0.0
        for number, run in enumerate(posterior.runs):
            capacity = Fy * (ratio if number else 1.0)

            def turn(reset: Any, leg: Any, capacity: Any = capacity) -> Any:
                after = own.saturated(K * leg + reset, capacity, beta)
                return after, after

            _, later = jax.lax.scan(turn, run.start_force_kN, np_.asarray(run.legs_mm))
            resets = np_.concatenate([np_.full(1, run.start_force_kN), later])
            half = np.repeat(np.arange(run.lengths.size), run.lengths)
            force = own.saturated(K * run.since_mm + resets[half], capacity, beta) * (1 + gamma * run.speed_mm_s)
            columns = own.columns_of(run.measured_kN, force, run.columns[1, 0], run.start_noise_mm, run.around_mm)
            total -= own.log_noise(columns, white**2, slow**2, decay)
        total += 0.5 * np_.sum(z**2)
        return total

    kernel = infer.NUTS(potential_fn=potential)
    sampler = infer.MCMC(
        kernel, num_warmup=300, num_samples=400, num_chains=N_CHAINS, chain_method="sequential", progress_bar=False
    )
    begin = np.random.default_rng(1).standard_normal((N_CHAINS, start.free.size))
    sampler.run(jax.random.PRNGKey(1), init_params=np_.asarray(begin), extra_fields=("num_steps",))
    kept = start.free + np.asarray(sampler.get_samples(group_by_chain=True)) @ root.T
    figures = diagnose_chains(first.model.names, [c[:, None] for c in kept], np.ones((N_CHAINS, 1)))
    gradients = int(np.asarray(sampler.get_extra_fields()["num_steps"]).sum())
    return Draws(kept, float(figures.ess_bulk.min()), gradients, "evaluations: gradients after warm-up")


SAMPLERS: dict[str, Callable[[Likelihood, NumpyPosterior, Start], Draws]] = {
    "shj-bayes": own,
    "Laplace + importance sampling": laplace_alone,
    "the same, from our least squares": laplace_from_our_law,
    "emcee, differential evolution": ensembles(
        lambda: [(emcee.moves.DEMove(), 0.9), (emcee.moves.DEMove(gamma0=1.0), 0.1)]
    ),
    "emcee, default (stretch)": ensembles(lambda: [(emcee.moves.StretchMove(), 1.0)]),
    "PINTS, adaptive covariance": pints_adaptive,
    "NumPyro, NUTS whitened": no_u_turn,
    "dynesty, random walks": nested,
    "TMCMC as in quoFEM": transitional,
}
