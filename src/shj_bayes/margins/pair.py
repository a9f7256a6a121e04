"""A lower and an upper factor on one property."""

from __future__ import annotations

from dataclasses import dataclass

from shj_bayes.errors import PopulationError


@dataclass(frozen=True)
class Bounds:
    """A lower and an upper factor on one property."""

    # low, high: low <= 1 <= high
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
