"""Property modification factors of ASCE/SEI 7: specification, testing, environment, and the two bounds."""

from __future__ import annotations

from dataclasses import dataclass

from shj_bayes.errors import PopulationError

ADJUSTMENT = 0.75
"""Share of the environmental factor that is taken: not all extremes happen at once."""
FLOORS = {"damper": (0.85, 1.2), "isolator": (0.60, 1.8)}
"""Least spread of (lower, upper) that must be assumed; isolators: unless prototypes are tested full scale."""


@dataclass(frozen=True)
class Bounds:
    """A lower and an upper factor on one property.

    Parameters
    ----------
    low, high : float
        low <= 1 <= high.
    """

    low: float
    high: float

    def __post_init__(self) -> None:
        """Refuse factors on the wrong side of 1."""
        if not 0 < self.low <= 1 <= self.high:
            raise PopulationError(
                f"property modification factors must hold 0 < lower <= 1 <= upper; got {self.low:g} and {self.high:g}"
            )

    @classmethod
    def around(cls, *factors: float) -> Bounds:
        """Narrowest bounds that hold 1 and all factors given."""
        return cls(min(1.0, *factors), max(1.0, *factors))


NONE = Bounds(1.0, 1.0)


def modification(environment: Bounds, testing: Bounds, specification: Bounds) -> Bounds:
    """Lambda = [1 + 0.75 (lambda_ae - 1)] lambda_test lambda_spec, for either bound."""
    return Bounds(
        (1.0 - ADJUSTMENT * (1.0 - environment.low)) * testing.low * specification.low,
        (1.0 + ADJUSTMENT * (environment.high - 1.0)) * testing.high * specification.high,
    )


def with_floor(bounds: Bounds, device: str = "damper") -> Bounds:
    """Bounds no narrower than the standard's least spread for that kind of device."""
    low, high = FLOORS[device]
    return Bounds(min(bounds.low, low), max(bounds.high, high))
