"""Design assisted by testing: characteristic and design values of EN 1990 Annex D, D7.2 and D7.3.

The factors are those of the predictive distribution of one more device under a vague prior (the basis of Tables D1
and D2), computed instead of looked up: the printed tables round and, at n = 20, truncate.
"""

from __future__ import annotations

import math

from scipy import stats

from shj_bayes.errors import PopulationError

CHARACTERISTIC = 0.05
"""Fractile of a characteristic value, Table D1."""
DESIGN = 0.001
"""Fractile of a design value taken straight from tests, Table D2 (alpha_R beta = 0.8 x 3.8 = 3.04)."""
FEWEST = {CHARACTERISTIC: 3, DESIGN: 4}
"""Fewest devices for which Tables D1 and D2 give a factor with the coefficient of variation unknown."""


def factor_known(n: int, fractile: float = CHARACTERISTIC) -> float:
    """k_n, k_d,n with the coefficient of variation known beforehand: z sqrt(1 + 1/n)."""
    _check(n, math.inf)
    return float(stats.norm.isf(fractile) * math.sqrt(1.0 + 1.0 / n))


def factor_unknown(n: int, fractile: float = CHARACTERISTIC, degrees: float | None = None) -> float:
    """k_n, k_d,n with the coefficient of variation taken from tests: t(degrees) sqrt(1 + 1/n).

    Parameters
    ----------
    n : int
        Devices behind the mean.
    fractile : float
        0.05 for a characteristic value, 0.001 for a design value.
    degrees : float, optional
        Degrees of freedom of the spread; n - 1 from the same devices (Tables D1 and D2), more when it is pooled
        over several sets.
    """
    nu = n - 1 if degrees is None else degrees
    _check(n, nu)
    return float(stats.t.isf(fractile, nu) * math.sqrt(1.0 + 1.0 / n))


def normal_value(mean: float, variation: float, factor: float, side: int = -1) -> float:
    """M (1 -+ k V); side -1 is the low value, +1 the high one."""
    return mean * (1.0 + side * factor * variation)


def lognormal_value(mean_log: float, sd_log: float, factor: float, side: int = -1) -> float:
    """exp(m_y -+ k s_y); side -1 is the low value, +1 the high one."""
    return math.exp(mean_log + side * factor * sd_log)


def sd_of_log(variation: float) -> float:
    """s_y = sqrt(ln(1 + V^2)) of a coefficient of variation known beforehand."""
    return math.sqrt(math.log1p(variation**2))


def variation_of_log(sd_log: float) -> float:
    """V = sqrt(exp(s_y^2) - 1) of a standard deviation of the logarithm."""
    return math.sqrt(math.expm1(sd_log**2))


def _check(n: int, degrees: float) -> None:
    if n < 1 or degrees < 1:
        raise PopulationError(
            f"EN 1990 Annex D needs a device for the mean and two for the spread; got {n} with {degrees:g} degrees of "
            "freedom. Test more, or take the spread of several sets together"
        )
