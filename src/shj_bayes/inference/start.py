"""Where the walkers start: the most probable parameters (MAP) and the curvature there."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from shj_bayes.errors import InferenceError
from shj_bayes.inference.coarse import Coarse
from shj_bayes.inference.moments import BY_SUMS
from shj_bayes.inference.problem import Problem
from shj_bayes.inference.shared import Density, Shared, n_threads
from shj_bayes.model.parameters import FloatArray


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


def find_start(problem: Problem, n_polish: int = 3, *, threads: int = 1) -> Start:
    """Search a coarse grid of laws, improve the best few by least squares, climb to the top from each.

    Parameters
    ----------
    problem : Problem
        Posterior to search.
    n_polish : int
        Number of grid points that are improved.
    threads : int
        Points that are evaluated at the same time, 0 for as many as there are processors.

    Returns
    -------
    Start

    Raises
    ------
    InferenceError
        If no parameters give a finite posterior density.
    """
    n = n_threads(threads)
    with ThreadPoolExecutor(n) as pool:
        by_sums = problem.runs if n > 1 and problem.layout.noise in BY_SUMS else ()
        made = pool.map(lambda run: run.moments, by_sums)  # beside the coarse search, which needs none of them
        found = [problem.free(_with_noise(problem, theta)[None])[0] for theta in Coarse(problem).best_laws(n_polish)]
        list(made)
        return polish(Shared(problem, pool, n), found)


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
    best: Start | None = None
    climbed: list[FloatArray] = []
    for candidate in candidates:
        origin = np.clip(candidate, -8.0, 8.0)
        # The same hill: at its top already, or where an earlier climb began. Many samples make a top so narrow that
        # the ends of all least-squares searches, one point to six digits, are some standard deviations from it.
        if best is not None and min(_distance(best, origin, from_) for from_ in (best.free, *climbed)) < 1.0:
            continue
        climbed.append(origin)
        if not np.isfinite(density.log_posterior_free(origin[None])[0]):
            continue
        # In units of the curvature the climb takes a dozen steps; in the parameters' own units it takes ninety.
        root = np.linalg.cholesky(_covariance(density, origin))
        result = minimize(
            _negative_with_gradient,
            np.zeros(origin.size),
            args=(density, origin, root),
            jac=True,
            method="BFGS",
            options={"maxiter": 300, "gtol": 1e-3},
        )
        if np.isfinite(result.fun) and (best is None or -result.fun > best.log_posterior):
            top = origin + root @ result.x
            best = Start(top, _covariance(density, top), -float(result.fun))
    if best is None:
        raise InferenceError("no parameters within the priors give a finite likelihood; look at `shj-bayes check`")
    return best


def _distance(start: Start, z: FloatArray, origin: FloatArray) -> float:
    """Distance of two points in standard deviations at the top."""
    gap = z - origin
    return float(np.sqrt(gap @ np.linalg.solve(start.covariance, gap)))


def _with_noise(problem: Problem, theta: FloatArray) -> FloatArray:
    """Complete a parameter set with sigma and phi read off its residuals."""
    residual = np.concatenate(
        [r.recording.force_kN - problem.modelled_force(theta[None], i)[0] for i, r in enumerate(problem.runs, start=1)]
    )
    out = theta.copy()
    scale = float(np.std(residual))
    for name, value in (
        ("sigma", max(scale, 1e-12)),
        ("phi", float(np.clip(np.corrcoef(residual[:-1], residual[1:])[0, 1], -0.9, 0.9999)) if scale > 0 else 0.0),
    ):
        if name in problem.layout.names:
            out[problem.layout.index(name)] = value
    return out


def _negative_with_gradient(
    u: FloatArray, density: Density, origin: FloatArray, root: FloatArray, step: float = 1e-3
) -> tuple[float, FloatArray]:
    """Negative log posterior at origin + root u and its central-difference gradient, all points in one call."""
    shifts = step * np.vstack([np.zeros(u.size), np.eye(u.size), -np.eye(u.size)])
    value = density.log_posterior_free(origin + (u + shifts) @ root.T)
    if not np.all(np.isfinite(value)):
        return 1e300, np.zeros(u.size)
    gradient = (value[1 : 1 + u.size] - value[1 + u.size :]) / (2 * step)
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
    if not np.all(np.isfinite(hessian)):  # beside the edge of what doubles can hold
        return np.diag(width**2)
    values, vectors = np.linalg.eigh(-(hessian + hessian.T) / 2)
    values = np.maximum(values, 1e-3 * max(values.max(), 1e-3))  # a flat direction starts wide, not infinite
    inverse = (vectors / values) @ vectors.T
    return np.asarray(inverse * np.outer(width, width))
