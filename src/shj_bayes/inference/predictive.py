"""What the posterior predicts: loops with and without noise, energy per cycle, and likelihood per half-cycle."""

from __future__ import annotations

import numpy as np

from shj_bayes.inference.problem import Problem
from shj_bayes.model.noise import log_density_terms, simulate_noise
from shj_bayes.model.parameters import FloatArray


def modelled_force(problem: Problem, theta: FloatArray) -> FloatArray:
    """Force of all runs one after the other, without noise.

    Parameters
    ----------
    problem : Problem
        Recordings and law.
    theta : array, shape (m, d)
        Parameters in natural units.

    Returns
    -------
    array, shape (m, n_samples of all runs)
        Force, kN.
    """
    return np.concatenate([problem.modelled_force(theta, run) for run in range(1, len(problem.runs) + 1)], axis=1)


def add_noise(problem: Problem, theta: FloatArray, force: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Force as it would be measured: one noise series for each parameter set, shape as `force`, kN."""
    out = force.copy()
    noise = problem.layout.noise_parameters(theta)
    for j in range(theta.shape[0]):
        own = {name: float(values[j]) for name, values in noise.items()}
        series = [simulate_noise(problem.layout.noise, run.stretches, rng, **own) for run in problem.runs]
        out[j] += np.concatenate(series)
    return out


def log_likelihood_of_half_cycles(problem: Problem, theta: FloatArray) -> FloatArray:
    """Log likelihood summed over each half-cycle, given the samples before it.

    Parameters
    ----------
    problem : Problem
        Recordings, law and noise.
    theta : array, shape (m, d)
        Parameters in natural units.

    Returns
    -------
    array, shape (m, n_half of all runs)
        The terms add up to the log likelihood. Neighbouring half-cycles share the noise correlation across their
        border, so they are nearly, not exactly, independent.
    """
    noise = problem.layout.noise_parameters(theta)
    rows = []
    for number, run in enumerate(problem.runs, start=1):
        residual = run.recording.force_kN - problem.modelled_force(theta, number)
        terms = np.stack(
            [
                log_density_terms(
                    problem.layout.noise, residual[j], run.stretches, **{n: float(v[j]) for n, v in noise.items()}
                )
                for j in range(theta.shape[0])
            ]
        )
        rows.append(np.add.reduceat(terms, run.motion.start[:-1], axis=1))
    return np.concatenate(rows, axis=1)
