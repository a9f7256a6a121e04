"""Measurement noise: how it is drawn and how likely a residual is, written as a pair.

``sigma`` is the standard deviation of the noise itself (of its Gaussian core for Student-t innovations), not of the
innovations, so that it means the same for every model.
A *stretch* is a run of consecutive used samples; the noise restarts from its stationary law at the start of each.

======================  ==================================================================================
independent             r_t ~ N(0, sigma^2)
ar1 (exact, default)    r_0 ~ N(0, sigma^2),  r_t = phi r_(t-1) + sigma sqrt(1 - phi^2) z_t,  z ~ N(0, 1)
student                 the same recursion with z ~ t_nu, and r_0 ~ sigma t_nu (conditional on its first value)
======================  ==================================================================================
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.special import gammaln

from shj_bayes.errors import ModelError
from shj_bayes.model.parameters import NOISE_PARAMETERS, FloatArray

_LOG_2PI = math.log(2 * math.pi)


@dataclass(frozen=True, eq=False)
class Stretches:
    """Which samples are evidence and which of them follow directly on another one.

    Parameters
    ----------
    used : array of bool, shape (n,)
        Samples that count.
    breaks : array of int
        Samples before which the noise restarts (gaps in time, starts of runs).
    """

    used: NDArray[np.bool_]
    breaks: NDArray[np.int64]

    @cached_property
    def kind(self) -> NDArray[np.int8]:
        """For each sample 0 unused, 1 first of a stretch, 2 follows its predecessor; shape (n,)."""
        follows = np.concatenate([[False], self.used[:-1]])
        follows[self.breaks[self.breaks < self.used.size]] = False
        return np.where(self.used, np.where(follows, 2, 1), 0).astype(np.int8)

    @cached_property
    def first(self) -> FloatArray:
        """1 for the first sample of each stretch, else 0."""
        return np.asarray(self.kind == 1, dtype=np.float64)

    @cached_property
    def follows(self) -> FloatArray:
        """1 for samples that follow their predecessor, else 0."""
        return np.asarray(self.kind == 2, dtype=np.float64)

    @cached_property
    def n_used(self) -> int:
        """Number of samples that count."""
        return int(np.count_nonzero(self.kind))

    @cached_property
    def n_follow(self) -> int:
        """Number of samples that follow their predecessor."""
        return int(np.count_nonzero(self.kind == 2))


def simulate_noise(
    model: str, stretches: Stretches, rng: np.random.Generator, *, sigma: float, phi: float = 0.0, nu: float = np.inf
) -> FloatArray:
    """Draw one noise series.

    Parameters
    ----------
    model : {"independent", "ar1", "student"}
        Noise model.
    stretches : Stretches
        Where it restarts; unused samples are drawn too, as part of the stretch they lie in.
    rng : numpy.random.Generator
        Source of randomness.
    sigma : float
        Scale, kN.
    phi : float
        Lag-one correlation, -1 to 1.
    nu : float
        Degrees of freedom (``student`` only).

    Returns
    -------
    array, shape (n,)
        Noise, kN.
    """
    _check(model, sigma, phi, nu)
    n = stretches.used.size
    z = rng.standard_t(nu, n) if model == "student" else rng.standard_normal(n)
    if model == "independent":
        return np.asarray(sigma * z)
    first = np.zeros(n, dtype=np.bool_)
    first[0] = True
    first[stretches.breaks[stretches.breaks < n]] = True
    return np.asarray(_recurse(z, first, sigma, phi))


def log_density(model: str, residual: FloatArray, stretches: Stretches, **parameters: FloatArray) -> FloatArray:
    """Log density of many residual series under as many noise parameter sets.

    Parameters
    ----------
    model : {"independent", "ar1", "student"}
        Noise model.
    residual : array, shape (m, n)
        Measured minus modelled force, kN.
    stretches : Stretches
        Which samples count and where the noise restarts.
    **parameters : array, shape (m,)
        ``sigma`` (kN), ``phi`` and ``nu`` as the model needs them.

    Returns
    -------
    array, shape (m,)
        Natural-log density; the density is that of the used samples only.
    """
    sigma = parameters["sigma"]
    phi = parameters.get("phi", np.zeros_like(sigma))
    if model == "student":
        nu = parameters["nu"]
        body = _student_sums(residual, stretches.kind, sigma, phi, nu)
        constant = gammaln((nu + 1) / 2) - gammaln(nu / 2) - 0.5 * np.log(nu * math.pi)
        return np.asarray(body + stretches.n_used * constant - _log_scales(stretches, sigma, phi))
    if model == "independent":
        phi = np.zeros_like(sigma)
    first, innovation = _square_sums(residual, stretches.first, stretches.follows, phi)
    quadratic = first / sigma**2 + innovation / (sigma**2 * (1 - phi**2))
    return np.asarray(-0.5 * (quadratic + stretches.n_used * _LOG_2PI) - _log_scales(stretches, sigma, phi))


def log_density_terms(
    model: str, residual: FloatArray, stretches: Stretches, *, sigma: float, phi: float = 0.0, nu: float = np.inf
) -> FloatArray:
    """Log density of each sample given the one before it, shape (n,); 0 where unused. Sums to `log_density`."""
    before = np.concatenate([[0.0], residual[:-1]])
    follows = stretches.kind == 2
    phi = 0.0 if model == "independent" else phi
    mean = np.where(follows, phi * before, 0.0)
    scale = np.where(follows, sigma * math.sqrt(1 - phi**2), sigma)
    z = (residual - mean) / scale
    if model == "student":
        constant = gammaln((nu + 1) / 2) - gammaln(nu / 2) - 0.5 * math.log(nu * math.pi)
        terms = constant - 0.5 * (nu + 1) * np.log1p(z**2 / nu) - np.log(scale)
    else:
        terms = -0.5 * (z**2 + _LOG_2PI) - np.log(scale)
    return np.where(stretches.used, terms, 0.0)


def _check(model: str, sigma: float, phi: float, nu: float) -> None:
    if model not in NOISE_PARAMETERS:
        raise ModelError(f"noise model '{model}' is not known; choose one of {', '.join(NOISE_PARAMETERS)}")
    if not sigma > 0:
        raise ModelError(f"sigma = {sigma:g} kN: allowed is above 0 kN")
    if not -1 < phi < 1:
        raise ModelError(f"phi = {phi:g}: allowed is above -1 and below 1")
    if not nu > 0:
        raise ModelError(f"nu = {nu:g}: allowed is above 0")


def _log_scales(stretches: Stretches, sigma: FloatArray, phi: FloatArray) -> FloatArray:
    """Sum of the log scales of all used samples, shape (m,)."""
    return np.asarray(stretches.n_used * np.log(sigma) + 0.5 * stretches.n_follow * np.log1p(-(phi**2)))


@njit(cache=True, error_model="numpy")
def _recurse(z, first, sigma, phi):  # type: ignore[no-untyped-def]
    """AR(1) series from innovations."""
    out = np.empty(z.size)
    scale = sigma * math.sqrt(1.0 - phi * phi)
    for i in range(z.size):
        out[i] = sigma * z[i] if first[i] else phi * out[i - 1] + scale * z[i]
    return out


@njit(nogil=True, error_model="numpy", fastmath={"reassoc", "contract"})
def _squares_of_row(r, before, weight_first, weight_follow, phi):  # type: ignore[no-untyped-def]
    """Sum the squares of first residuals and of innovations of one series."""
    first = 0.0
    innovation = 0.0
    for i in range(r.size):
        d = r[i] - phi * before[i]
        first += weight_first[i] * r[i] * r[i]
        innovation += weight_follow[i] * d * d
    return first, innovation


@njit(cache=True, nogil=True, error_model="numpy")
def _square_sums(residual, weight_first, weight_follow, phi):  # type: ignore[no-untyped-def]
    m = residual.shape[0]
    first = np.empty(m)
    innovation = np.empty(m)
    for j in range(m):
        r = residual[j]
        first[j], innovation[j] = _squares_of_row(r[1:], r[:-1], weight_first[1:], weight_follow[1:], phi[j])
        first[j] += weight_first[0] * r[0] * r[0]
    return first, innovation


@njit(cache=True, nogil=True, error_model="numpy")
def _student_sums(residual, kind, sigma, phi, nu):  # type: ignore[no-untyped-def]
    """Sum of -(nu+1)/2 log(1 + z^2/nu) over used samples, for each series."""
    m, n = residual.shape
    out = np.zeros(m)
    for j in range(m):
        scale = sigma[j] * math.sqrt(1.0 - phi[j] * phi[j])
        total = 0.0
        for i in range(n):
            if kind[i] == 1:
                z = residual[j, i] / sigma[j]
            elif kind[i] == 2:
                z = (residual[j, i] - phi[j] * residual[j, i - 1]) / scale
            else:
                continue
            total += math.log1p(z * z / nu[j])
        out[j] = -0.5 * (nu[j] + 1.0) * total
    return out
