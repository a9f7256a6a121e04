"""Upper and lower bound design properties of EN 15129, with the combination factors of EN 1998-2 Annex J."""

from __future__ import annotations

from collections.abc import Sequence

from shj_bayes.errors import PopulationError
from shj_bayes.margins.asce7 import Bounds

COMBINATION = {"III": 0.90, "II": 0.70, "I": 0.60}
"""psi_fi by importance class of the structure."""
INFLUENCES = ("f1 ageing", "f2 temperature", "f3 contamination", "f4 cumulative travel")


def combined(factor: float, importance: str = "II") -> float:
    """lambda_fi = 1 + (lambda_extreme,fi - 1) psi_fi, for an upper or a lower extreme."""
    if importance not in COMBINATION:
        raise PopulationError(f"importance class {importance!r} is not known; choose I, II or III")
    return 1.0 + (factor - 1.0) * COMBINATION[importance]


def bound_factors(influences: Sequence[Bounds], importance: str = "II") -> Bounds:
    """Product of the combined factors of all influences, lower and upper."""
    low = high = 1.0
    for bounds in influences:
        low *= combined(bounds.low, importance)
        high *= combined(bounds.high, importance)
    return Bounds(low, high)
