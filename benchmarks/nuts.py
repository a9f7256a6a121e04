"""The device posterior by our sampler and by another one: ``python benchmarks/nuts.py``; needs numpyro (extra "nuts").

The law, the noise and the priors are written a second time, in JAX and numpyro, from the equations; NUTS samples them.
First both log densities are compared at random points, ours with every sample a block of its own and theirs with the
noise as the Kalman filter that NUTS uses (the differences must be one constant) and as one multivariate normal of a run
(the same but for what our recursion leaves out). Then the posteriors are, ours as a fit gives it, in the unbounded
space: means to 0.1 posterior standard deviation, standard deviations to 10 %. Exit status 1 if they differ by more.
"""

from __future__ import annotations

import argparse
import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
from numpy_posterior import around
from numpyro.infer import MCMC, NUTS, init_to_median
from numpyro.infer.util import log_density

from shj_bayes.inference.binning import Run
from shj_bayes.inference.fit import fit
from shj_bayes.inference.likelihood import Likelihood
from shj_bayes.inference.sampler import SamplingPlan
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import Prior, read_priors
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.motion import Block, exact_motion

BLOCKS = (Block(12.0, 0.13, 2), Block(24.0, 0.067, 2))
RATE_HZ = 6.0
LEFT_OUT = 0.2  # nats: what the slow noise remembers of the displacement at the start beyond the first half-cycle
MEAN_LIMIT, SD_LIMIT = 0.1, 0.10  # of the posterior standard deviation; of the standard deviation

jax.config.update("jax_enable_x64", val=True)


def make_runs(seed: int) -> tuple[Run, ...]:
    """Two short runs with the exact motion, so that the law alone is compared and not the smoothing."""
    truth = Truth(gamma=0.01, ratio=0.8, phi=0.0, sigma_slow=0.8, displacement_noise_mm=0.0)
    recordings = simulate_device(truth, seed=seed, rate_Hz=RATE_HZ, blocks=BLOCKS)
    _, motion = exact_motion(BLOCKS, RATE_HZ)
    return tuple(Run(recording, motion) for recording in recordings)


def law_of(prior: Prior) -> Any:
    """Prior of a parameter in numpyro."""
    if prior.law == "normal":
        return dist.Normal(prior.a, prior.b)
    if prior.law == "lognormal":
        return dist.LogNormal(np.log(prior.a), prior.b)
    return dist.Uniform(prior.a, prior.b) if prior.law == "uniform" else dist.LogUniform(prior.a, prior.b)


def saturated(e: Any, capacity: Any, beta: Any) -> Any:
    """Eq. (1) by logarithms, which never overflow: e (1 + |e/Fy|^beta)^(-1/beta)."""
    ratio = jnp.maximum(jnp.abs(e), 1e-12) / capacity
    return e * jnp.exp(-jnp.logaddexp(0.0, beta * jnp.log(ratio)) / beta)


def whitened(column: Any, white: Any, slow: Any, decay: Any) -> Any:
    """Give what is new in each sample beside noise of given variances, in its standard deviations, and their logs."""

    def step(before: Any, value: Any) -> Any:
        state, variance = before
        spread, new = variance + white, value - state
        state = decay * (state + variance / spread * new)
        variance = decay**2 * variance * white / spread + slow * (1 - decay**2)
        return (state, variance), (new / jnp.sqrt(spread), jnp.log(spread))

    return jax.lax.scan(step, (0.0, slow), column)[1]


def log_noise(columns: tuple[Any, Any, Any], white: Any, slow: Any, decay: Any) -> Any:
    """Log density of white and slow noise of given variances, evenly sampled, up to a constant.

    Columns are the residual and what two errors of unit variance add to it, the second one to its first samples only:
    both are integrated out.
    """
    (own, logs), (zero, _), (start, _) = (whitened(column, white, slow, decay) for column in columns)
    n = start.size
    a, b, c = 1 + zero @ zero, zero[:n] @ start, 1 + start @ start
    with_zero, with_start, both = zero @ own, start @ own[:n], a * c - b * b
    left = own @ own - (c * with_zero**2 - 2 * b * with_zero * with_start + a * with_start**2) / both
    return -0.5 * (left + logs.sum() + jnp.log(both))


def columns_of(measured: Any, modelled: Any, zero_kN: float, start_mm: float, around_mm: Any) -> tuple[Any, Any, Any]:
    """Residual, kN, and what one standard deviation of the zero and of the displacement at the start add to it.

    The last one in the first half-cycle, in which `around_mm` is the displacement from the sample before to the one
    after.
    """
    first = modelled[: around_mm.size]
    slope = (jnp.diff(first, prepend=first[:1]) + jnp.diff(first, append=first[-1:])) / around_mm
    return measured - modelled, jnp.full(modelled.size, zero_kN), start_mm * slope


def model(posterior: Likelihood, dense: bool = False) -> None:
    """Law, noise and priors of a device, as a numpyro program."""
    names = ("K", "Fy", "beta", "gamma", "ratio", "sigma_white", "sigma_slow", "tau_slow")
    p = {name: numpyro.sample(name, law_of(posterior.model.priors.of(name))) for name in names}
    for number, (run, part) in enumerate(zip(posterior.runs, posterior.blocks, strict=True), start=1):
        motion, measured = run.motion, jnp.asarray(run.recording.force_kN)
        capacity = p["Fy"] * (p["ratio"] if number == 2 else 1.0)
        reset, pieces = run.start_force_kN, []
        for k in range(motion.n_half):
            rows = slice(int(motion.start[k]), int(motion.start[k + 1]))
            ahead = motion.displacement_mm[rows] - motion.turning_mm[k]
            pieces.append(saturated(p["K"] * ahead + reset, capacity, p["beta"]))
            if k + 1 < motion.n_half:
                stroke = motion.turning_mm[k + 1] - motion.turning_mm[k]
                reset = saturated(p["K"] * stroke + reset, capacity, p["beta"])
        modelled = jnp.concatenate(pieces) * (1 + p["gamma"] * motion.speed_mm_s)
        around_mm = around(motion.displacement_mm[: motion.start[1]])
        zero_kN, time = part.timing.zero_noise_kN, run.recording.time_s
        columns = columns_of(measured, modelled, zero_kN, run.start_noise_mm, around_mm)
        white, slow = p["sigma_white"] ** 2, p["sigma_slow"] ** 2
        if dense:
            memory = jnp.exp(-np.abs(time[:, None] - time) / p["tau_slow"])
            zero, start = columns[1], jnp.pad(columns[2], (0, time.size - columns[2].size))
            noise = slow * memory + white * jnp.eye(time.size) + jnp.outer(zero, zero) + jnp.outer(start, start)
            law = dist.MultivariateNormal(modelled, noise)
            numpyro.sample(f"force {number}", law, obs=measured)
        else:
            decay = jnp.exp(-(time[1] - time[0]) / p["tau_slow"])
            numpyro.factor(f"force {number}", log_noise(columns, white, slow, decay))


def same_density(whole: Likelihood, theta: np.ndarray[Any, Any], dense: bool) -> float:
    """Largest departure from a constant of the difference of both log densities at parameter sets, shape (m, d)."""
    theirs = [
        log_density(model, (whole, dense), {}, dict(zip(whole.model.names, row, strict=True)))[0]
        for row in theta.tolist()
    ]
    laws = whole.model.laws
    prior = np.sum([law.distribution.logpdf(theta[:, i]) for i, law in enumerate(laws)], axis=0)
    return float(np.ptp(np.asarray(theirs) - whole.log_likelihood(theta) - prior))


def main() -> int:
    """Sample both ways and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--draws", type=int, default=4000, help="of each chain (4000)")
    parser.add_argument("--warmup", type=int, default=1000, help="steps of each chain that are left out (1000)")
    parser.add_argument("--chains", type=int, default=4, help="NUTS chains (4)")
    asked = parser.parse_args()
    ours = fit(make_runs(asked.seed), DeviceModel(2, read_priors("afc")), plan=SamplingPlan(seed=asked.seed))
    posterior = ours.likelihood
    draws = np.stack([ours.data["posterior"][name].to_numpy().ravel() for name in posterior.model.names], axis=1)
    middle = posterior.model.laws.unbounded(draws.mean(axis=0)[None])[0]
    whole = posterior.refined(middle, longest_s=0.0).with_noise_at_rest(0.0)
    some = draws[:: draws.shape[0] // 20]
    apart, exact = same_density(whole, some, dense=False), same_density(whole, some, dense=True)
    print(f"log densities differ by one constant to {apart:.1e} at 20 points")
    print(f"and from the multivariate normal to {exact:.1e}; our fit is {ours.verdict.word}")
    sampler = MCMC(
        NUTS(model, dense_mass=True, target_accept_prob=0.9, init_strategy=init_to_median),
        num_warmup=asked.warmup,
        num_samples=asked.draws,
        num_chains=asked.chains,
        chain_method="sequential",
        progress_bar=False,
    )
    sampler.run(jax.random.PRNGKey(asked.seed), posterior)
    samples = sampler.get_samples()
    theirs = np.stack([np.asarray(samples[name]) for name in posterior.model.names], axis=1)
    diverging = int(np.sum(sampler.get_extra_fields().get("diverging", np.zeros(1))))
    good = apart < 1e-6 and exact < LEFT_OUT
    print(f"{'':12}{'our mean':>12}{'NUTS mean':>12}{'apart, sd':>11}{'our sd':>11}{'NUTS sd':>11}{'ratio':>8}")
    unbounded = (posterior.model.laws.unbounded(draws), posterior.model.laws.unbounded(theirs))
    for i, name in enumerate(posterior.model.names):
        own, other = (z[:, i] for z in unbounded)
        shift, ratio = (own.mean() - other.mean()) / other.std(), own.std() / other.std()
        good &= bool(abs(shift) < MEAN_LIMIT and abs(ratio - 1) < SD_LIMIT)
        means, sds = ([f(draws[:, i]), f(theirs[:, i])] for f in (np.mean, np.std))
        print(f"{name:12}{means[0]:12.5g}{means[1]:12.5g}{shift:11.3f}{sds[0]:11.4g}{sds[1]:11.4g}{ratio:8.3f}")
    print(f"{diverging} divergent steps; {'they agree' if good else 'THEY DIFFER'}")
    return int(not good)


if __name__ == "__main__":
    sys.exit(main())
