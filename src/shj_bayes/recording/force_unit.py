"""Newton for devices of less than a kilonewton: 0.26 kN is no number that a laboratory reads off its load cell."""

import numpy as np
from numpy.typing import NDArray

SMALL_KN = 1.0


def unit_for(sliding_kN: float) -> tuple[str, float]:
    """Choose the unit in which forces of a device are shown, by its sliding force; and how many of it make a kN."""
    return ("N", 1000.0) if abs(sliding_kN) < SMALL_KN else ("kN", 1.0)


def unit_of(force_kN: NDArray[np.float64]) -> tuple[str, float]:
    """Do so by a recorded force, shape (n,): half of its range without the rare largest is about the sliding force."""
    low, high = np.quantile(force_kN, (0.05, 0.95))
    return unit_for(0.5 * float(high - low))
