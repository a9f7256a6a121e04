"""What the posterior predicts: the force of all runs, without noise and as it would be measured."""

from __future__ import annotations

import numpy as np

from shj_bayes.inference.posterior import Posterior
from shj_bayes.model.noise.filter import simulate
from shj_bayes.model.parameters import FloatArray


def modelled_force(posterior: Posterior, theta: FloatArray) -> FloatArray:
    """Force of all runs one after the other, without noise, at all samples.

    Parameters
    ----------
    posterior : Posterior
        Recordings and model.
    theta : array, shape (m, d)
        Parameters in natural units.

    Returns
    -------
    array, shape (m, n_samples of all runs)
        Force, kN.
    """
    return np.concatenate([posterior.modelled_force(theta, run) for run in range(1, len(posterior.runs) + 1)], axis=1)


def add_noise(posterior: Posterior, theta: FloatArray, force: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Force as it would be measured: one noise series for each parameter set, shape as `force`, kN."""
    out = force.copy()
    noise = posterior.model.noise_values(theta)
    for j in range(theta.shape[0]):
        own = {name: float(values[j]) for name, values in noise.items()}
        series = [
            simulate(posterior.model.noise, own, run.recording.time_s, run.recording.restarts, rng)
            for run in posterior.runs
        ]
        out[j] += np.concatenate(series)
    return out
