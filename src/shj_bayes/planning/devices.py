"""How many further devices until the force that 95 % of devices exceed is known."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, nct, norm

from shj_bayes.errors import PlanError

FRACTILE = 0.05
WITHIN = 0.05  # of the force: half of the 90 % interval
ASSURANCE = 0.8
MOST = 500


@dataclass(frozen=True)
class FurtherRow:
    """Further devices, and half the width of what is then known: expected, and kept with `ASSURANCE`."""

    n_further: int
    half_width_expected: float
    half_width_assured: float


@dataclass(frozen=True)
class Further:
    """Devices needed."""

    n_tested: int  # devices tested so far
    force_kN: float  # estimate of the force that 95 % of devices exceed
    spread: float  # standard deviation of the logarithm of the force between devices
    half_width_now: float  # half of the 90 % interval of that force now, as a share of it
    n_further: int | None  # further devices; None where more than `MOST` would be needed
    table: tuple[FurtherRow, ...]


def further_devices(forces_kN: Sequence[float], errors: Sequence[float]) -> Further:
    """Plan further devices for a lognormal population; `PlanError` for fewer than two: one says nothing of the spread.

    The half width of the interval of a fractile is that of the noncentral t distribution (Owen 1963, factors for
    tolerance limits) times the spread; what the spread will turn out to be has the chi-square law of the devices tested
    so far. `errors` are standard deviations of the logarithm with which each force is known.
    """
    n = len(forces_kN)
    if n < 2:
        raise PlanError(
            f"{n} device given; --question force needs the folders of two or more devices of a set: one says nothing "
            "of how much devices differ"
        )
    logs = np.log(np.asarray(forces_kN, dtype=np.float64))
    spread = max(float(logs.std(ddof=1)), float(np.sqrt(np.mean(np.square(errors)))), 1e-4)
    likely = [spread * math.sqrt((n - 1) / float(chi2.ppf(q, n - 1))) for q in (0.5, 1.0 - ASSURANCE)]
    rows, needed = [], None
    for more in range(MOST + 1):
        unit = half_width(n + more)
        if needed is None and more and unit * likely[1] <= WITHIN:
            needed = more
        if more in (1, 2, 3, 5, 8, 12, 20, 35, 60, 100) or more == needed:
            rows.append(FurtherRow(more, unit * likely[0], unit * likely[1]))
        if needed is not None and more > 2 * needed:
            break
    force = math.exp(float(logs.mean()) + float(norm.ppf(FRACTILE)) * spread)
    now = half_width(n) * spread
    return Further(n, force, spread, now, 0 if now <= WITHIN and n > 2 else needed, tuple(rows))


def half_width(n: int) -> float:
    """Half of the 90 % interval of the 5 % fractile of a normal sample, in standard deviations of the sample."""
    away = -float(norm.ppf(FRACTILE)) * math.sqrt(n)
    low, high = (float(nct.ppf(q, n - 1, away)) for q in (0.05, 0.95))
    return (high - low) / (2.0 * math.sqrt(n))
