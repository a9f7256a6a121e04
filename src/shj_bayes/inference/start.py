"""Where the walkers start: the most probable parameters (MAP) and the curvature there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Protocol

import numpy as np
from scipy.optimize import minimize

from shj_bayes.errors import InferenceError
from shj_bayes.inference.problem import Problem
from shj_bayes.model.parameters import FloatArray

CHUNK = 16  # parameter sets evaluated in one call while searching


class Density(Protocol):
    """What a search or a sampler needs: a log density of many points at once."""

    def log_posterior_free(self, z: FloatArray) -> FloatArray:
        """Log density of points of shape (m, d), shape (m,)."""
        ...


@dataclass(frozen=True, eq=False)
class Start:
    """Most probable point and a Gaussian around it.

    Parameters
    ----------
    free : array, shape (d,)
        MAP in the unbounded space.
    covariance : array, shape (d, d)
        Inverse of the negative Hessian there.
    log_posterior : float
        Log posterior density there (unbounded space).
    """

    free: FloatArray
    covariance: FloatArray
    log_posterior: float


def find_start(problem: Problem, n_polish: int = 3) -> Start:
    """Search a coarse grid of laws, polish the best few, return the best of all.

    Parameters
    ----------
    problem : Problem
        Posterior to search.
    n_polish : int
        Number of grid points that are polished.

    Returns
    -------
    Start

    Raises
    ------
    InferenceError
        If no parameters give a finite posterior density.
    """
    candidates = [problem.free(theta[None])[0] for theta in _coarse_candidates(problem)[:n_polish]]
    return polish(problem, candidates)


def polish(density: Density, candidates: Sequence[FloatArray]) -> Start:
    """Climb from each candidate to the top of the density; return the highest, with the curvature there.

    Parameters
    ----------
    density : Density
        Log density in the unbounded space.
    candidates : sequence of array, shape (d,)
        Where to start.

    Returns
    -------
    Start

    Raises
    ------
    InferenceError
        If no candidate has a finite density.
    """
    best: tuple[float, FloatArray] | None = None
    for candidate in candidates:
        z = np.clip(candidate, -8.0, 8.0)
        result = minimize(
            _negative_with_gradient, z, args=(density,), jac=True, method="BFGS", options={"maxiter": 300}
        )
        if np.isfinite(result.fun) and (best is None or result.fun < best[0]):
            best = (float(result.fun), result.x)
    if best is None:
        raise InferenceError("no parameters within the priors give a finite likelihood; look at `shj-bayes check`")
    return Start(best[1], _covariance(density, best[1]), -best[0])


def _coarse_candidates(problem: Problem) -> list[FloatArray]:
    """List laws on a coarse grid, best least squares first, with sigma and phi from their residuals."""
    run = problem.runs[0]
    peak = [float(np.percentile(np.abs(r.recording.force_kN), 97)) for r in problem.runs]
    stroke = float(np.ptp(run.motion.displacement_mm))
    speed = float(np.percentile(run.motion.speed_mm_s, 95))
    if not (peak[0] > 0 and stroke > 0 and speed > 0):
        raise InferenceError(
            f"nothing to fit: largest force {peak[0]:.3g} kN, stroke {stroke:.3g} mm, speed "
            f"{speed:.3g} mm/s; all must be above 0"
        )
    names = problem.layout.names
    fixed = {name: peak[run_of(name) - 1] / peak[0] for name in names if name.startswith("ratio")}
    rows = []
    for share, knee, beta, effect in product(
        (0.5, 0.7, 0.85, 1.0), (3, 8, 20, 60, 200), (3.0, 12.0, 80.0), (-0.2, 0.0, 0.25)
    ):
        values = {"K": knee * peak[0] / stroke, "Fy": share * peak[0], "beta": beta, "gamma": effect / speed}
        values |= {"sigma": 1.0, "phi": 0.0, "nu": 10.0} | fixed
        rows.append([values.get(name, values.get(name.partition("_")[0], 0.0)) for name in names])
    theta = np.array(rows)
    scores = np.concatenate([_sum_of_squares(problem, theta[i : i + CHUNK]) for i in range(0, len(theta), CHUNK)])
    return [_with_noise(problem, theta[i]) for i in np.argsort(scores, kind="stable")]


def run_of(name: str) -> int:
    """Run number that a per-run parameter belongs to."""
    return 2 if name == "ratio" else int(name.partition("_")[2] or 1)


def _residuals(problem: Problem, theta: FloatArray) -> list[FloatArray]:
    return [r.recording.force_kN - problem.modelled_force(theta, i) for i, r in enumerate(problem.runs, start=1)]


def _sum_of_squares(problem: Problem, theta: FloatArray) -> FloatArray:
    return np.asarray(sum(np.sum(residual**2, axis=1) for residual in _residuals(problem, theta)))


def _with_noise(problem: Problem, theta: FloatArray) -> FloatArray:
    """Complete a parameter set with sigma and phi read off its residuals."""
    residual = np.concatenate([r[0] for r in _residuals(problem, theta[None])])
    out = theta.copy()
    scale = float(np.std(residual))
    for name, value in (
        ("sigma", max(scale, 1e-12)),
        ("phi", float(np.clip(np.corrcoef(residual[:-1], residual[1:])[0, 1], -0.9, 0.9999)) if scale > 0 else 0.0),
    ):
        if name in problem.layout.names:
            out[problem.layout.index(name)] = value
    return out


def _negative_with_gradient(z: FloatArray, density: Density, step: float = 1e-5) -> tuple[float, FloatArray]:
    """Negative log posterior and its central-difference gradient, all points in one call."""
    shifts = step * np.vstack([np.zeros(z.size), np.eye(z.size), -np.eye(z.size)])
    value = density.log_posterior_free(z + shifts)
    if not np.all(np.isfinite(value)):
        return 1e300, np.zeros(z.size)
    gradient = (value[1 : 1 + z.size] - value[1 + z.size :]) / (2 * step)
    return -float(value[0]), -gradient


def _covariance(density: Density, z: FloatArray) -> FloatArray:
    """Inverse of the negative Hessian, by differences of about half a posterior standard deviation."""
    d = z.size
    top = float(density.log_posterior_free(z[None])[0])
    width = np.full(d, 1e-4)
    for _ in range(3):  # find the scale on which the log density falls by about 1/8
        both = density.log_posterior_free(z + np.vstack([np.diag(width), -np.diag(width)]))
        fall = np.maximum(2 * top - both[:d] - both[d:], 1e-10)
        width = np.clip(width * np.sqrt(0.25 / fall), 1e-7, 0.5)
    pairs = [(i, j) for i in range(d) for j in range(i, d)]
    points = [
        z + s * width * np.eye(d)[i] + t * width * np.eye(d)[j] for i, j in pairs for s in (1, -1) for t in (1, -1)
    ]
    value = density.log_posterior_free(np.array(points)).reshape(-1, 4)
    hessian = np.zeros((d, d))
    for (i, j), (pp, pm, mp, mm) in zip(pairs, value, strict=True):
        hessian[i, j] = hessian[j, i] = (pp - pm - mp + mm) / 4
    values, vectors = np.linalg.eigh(-(hessian + hessian.T) / 2)
    values = np.maximum(values, 1e-3 * max(values.max(), 1e-3))  # a flat direction starts wide, not infinite
    inverse = (vectors / values) @ vectors.T
    return np.asarray(inverse * np.outer(width, width))
