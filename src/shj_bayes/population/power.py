"""What a sample can find, and how many devices would decide: assurance at the edge of practical equivalence.

A difference at that edge is the smallest that matters, so it is what a test is planned for; the difference that was
seen is not (planning for it promises most where chance was kind). The spread between devices is not known either: the
power is averaged over its posterior (assurance; O'Hagan, Stevens and Campbell 2005), not taken at one value of it.
"""

import math

import numpy as np
from scipy.special import chdtri, ndtr, stdtrit

from shj_bayes.errors import PopulationError
from shj_bayes.population.quantities import FloatArray

LEVEL, POWER = 0.05, 0.8
MOST = 10_000
N_SPREADS = 200
"""Quantiles of the posterior of the spread that stand for it."""
_SHARE, _WEIGHT = np.polynomial.legendre.leggauss(200)
_SHARE, _WEIGHT = 0.5 * (_SHARE + 1.0), 0.5 * _WEIGHT


def assurance(shift: float, sds: FloatArray | float, n_a: int, n_b: int, *, strata: int = 1) -> float:
    """Power of the two-sided t test of two samples at `LEVEL`, averaged over what is known of the spread.

    `sds` are equally probable values of the spread between devices of a set, pooled scale as the true difference
    `shift`. The devices are divided over `strata` pairs of sets; each takes two degrees of freedom. 0 where there are
    too few devices for any t test. The noncentral t is integrated over the estimate of the spread, because the
    distribution function of scipy gives NaN far out.
    """
    sds = np.atleast_1d(np.asarray(sds, dtype=np.float64))
    if not (math.isfinite(shift) and np.all(np.isfinite(sds)) and np.all(sds > 0)):
        raise PopulationError(
            f"power needs a finite difference and a spread above zero; got {shift:g} and {np.min(sds):g}"
        )
    nu = n_a + n_b - 2 * strata
    if min(n_a, n_b) < 1 or nu < 1:
        return 0.0
    away = np.abs(shift) / (sds * math.sqrt(1.0 / n_a + 1.0 / n_b))
    limit = -float(stdtrit(nu, LEVEL / 2.0)) * np.sqrt(chdtri(nu, _SHARE) / nu)
    found = ndtr(away[:, None] - limit) + ndtr(-away[:, None] - limit)
    return float(np.mean(found @ _WEIGHT))


def devices_needed(shift: float, sds: FloatArray | float, *, strata: int = 1) -> int:
    """Devices on each side for which the `assurance` reaches `POWER`; `MOST` when more would be needed."""

    def found(n: int) -> float:
        return assurance(shift, sds, n, n, strata=strata)

    low, high = strata, 2 * strata
    while found(high) < POWER:
        low, high = high, 2 * high
        if high > MOST:
            return MOST
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if found(middle) >= POWER else (middle, high)
    return high


def representative(draws: FloatArray) -> FloatArray:
    """Equally probable values that stand for many draws."""
    return np.asarray(np.quantile(draws, (np.arange(N_SPREADS) + 0.5) / N_SPREADS))
