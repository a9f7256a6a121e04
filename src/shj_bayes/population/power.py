"""What a sample could have found, and how many devices would decide."""

from __future__ import annotations

import math

from scipy import stats

from shj_bayes.errors import PopulationError

LEVEL, POWER = 0.05, 0.8
MOST = 10_000


def power(shift: float, sd: float, n_a: int, n_b: int, level: float = LEVEL, *, strata: int = 1) -> float:
    """Chance that the two-sided t test of two samples finds a true difference.

    Parameters
    ----------
    shift, sd : float
        True difference and spread between devices of a set, both on the pooled scale (logarithm, or s/mm).
    n_a, n_b : int
        Devices.
    level : float
        Of the test.
    strata : int
        Pairs of sets that the devices are divided over; each takes two degrees of freedom.

    Returns
    -------
    float
        0 where there are too few devices for any test.
    """
    if not (math.isfinite(shift) and math.isfinite(sd) and sd > 0):
        raise PopulationError(f"power needs a finite difference and a spread above zero; got {shift:g} and {sd:g}")
    nu = n_a + n_b - 2 * strata
    if min(n_a, n_b) < 1 or nu < 1:
        return 0.0
    away = abs(shift) / (sd * math.sqrt(1.0 / n_a + 1.0 / n_b))
    limit = float(stats.t.isf(level / 2.0, nu))
    if away > limit + 30.0:  # the distribution function of scipy gives NaN far out, where the answer is 1
        return 1.0
    return float(stats.nct.sf(limit, nu, away) + stats.nct.cdf(-limit, nu, away))


def devices_needed(shift: float, sd: float, wanted: float = POWER, level: float = LEVEL) -> int:
    """Devices in each of two sets for which the power reaches what is wanted; ``MOST`` when more would be needed."""
    low, high = 1, 2
    while power(shift, sd, high, high, level) < wanted:
        low, high = high, 2 * high
        if high > MOST:
            return MOST
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if power(shift, sd, middle, middle, level) >= wanted else (middle, high)
    return high
