"""Posterior of the law with effects, sampled like the base law."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shj_bayes.inference.convergence import Verdict, judge
from shj_bayes.inference.problem import FREE_LIMIT
from shj_bayes.inference.sampler import Plan, run_ensembles
from shj_bayes.inference.start import polish
from shj_bayes.mismatch.evidence import Evidence
from shj_bayes.mismatch.refit import Model, Refit
from shj_bayes.model.noise import Stretches, log_density
from shj_bayes.model.parameters import FloatArray
from shj_bayes.model.priors import Prior, Priors


@dataclass(frozen=True, eq=False)
class AugmentedPosterior:
    """Log posterior of a `Model` with AR(1) noise, in the unbounded space.

    Parameters
    ----------
    evidence : Evidence
        Thinned recordings; phi is the correlation at the thinned rate.
    model : Model
        Base law with effects.
    noise : tuple of Prior
        Priors of sigma (kN) and phi.
    stretches : Stretches
        Which samples count and where the noise restarts.
    """

    evidence: Evidence
    model: Model
    noise: tuple[Prior, Prior]
    stretches: Stretches

    @property
    def names(self) -> tuple[str, ...]:
        """Sampled parameters."""
        return (*self.model.names, "sigma", "phi")

    @property
    def priors(self) -> tuple[Prior, ...]:
        """Their priors."""
        return (*self.model.priors, *self.noise)

    def log_posterior_free(self, z: FloatArray) -> FloatArray:
        """Log posterior density up to a constant, shape (m, d) to (m,)."""
        out = np.full(z.shape[0], -np.inf)
        inside = np.flatnonzero(np.all(np.abs(z) < FREE_LIMIT, axis=1))
        if inside.size == 0:
            return out
        d = len(self.model.names)
        residual = np.stack([self.evidence.force_kN - self.model.force(self.evidence, z[i, :d]) for i in inside])
        sigma, phi = (prior.from_free(z[inside, d + i]) for i, prior in enumerate(self.noise))
        density = log_density("ar1", residual, self.stretches, sigma=sigma, phi=phi)
        prior = np.sum([p.log_density_free(z[inside, i]) for i, p in enumerate(self.priors)], axis=0)
        value = density + prior
        out[inside] = np.where(np.isnan(value), -np.inf, value)
        return out


def augmented_posterior(evidence: Evidence, fit: Refit, priors: Priors) -> AugmentedPosterior:
    """Bind evidence, a fitted model and the noise priors."""
    ends = np.cumsum([h.time_s.size for h in evidence.histories])[:-1]
    stretches = Stretches(evidence.weight > 0, np.concatenate([[0], ends]).astype(np.int64))
    return AugmentedPosterior(evidence, fit.model, (priors.of("sigma"), priors.of("phi")), stretches)


def sample(
    posterior: AugmentedPosterior, fit: Refit, plan: Plan, *, progress: bool = False, threads: int = 0
) -> tuple[dict[str, FloatArray], Verdict]:
    """Sample a posterior with independent emcee ensembles.

    Parameters
    ----------
    posterior : AugmentedPosterior
        What to sample.
    fit : Refit
        Least-squares fit of the same model, where the search for the top starts.
    plan : Plan
        Seed and when to stop.
    progress : bool
        Show a progress bar.
    threads : int
        Ensembles at a time.

    Returns
    -------
    dict of str to array, Verdict
        Draws in natural units by parameter, and whether the sampler converged.
    """
    residual = fit.residual_kN
    scale = float(np.sqrt(float(residual @ residual) / max(int(np.count_nonzero(residual)), 1)))
    phi = float(np.clip(float(residual[:-1] @ residual[1:]) / max(float(residual @ residual), 1e-300), -0.9, 0.99))
    guess = [float(p.to_free(np.asarray(v))) for p, v in zip(posterior.noise, (max(scale, 1e-9), phi), strict=True)]
    start = polish(posterior, [np.concatenate([fit.z, guess])])
    states, figures = run_ensembles(posterior, posterior.names, start, plan, progress=progress, threads=threads)
    flat = np.concatenate([s.chain[figures.n_burn :].reshape(-1, len(posterior.names)) for s in states])
    draws = {n: p.from_free(flat[:, i]) for i, (n, p) in enumerate(zip(posterior.names, posterior.priors, strict=True))}
    return draws, judge(figures)
