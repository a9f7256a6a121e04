"""The force that a new device delivers in the test: smallest plateau and largest force, run by run and of all runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shj_bayes.errors import PopulationError
from shj_bayes.margins.outermost import DEFAULT, Newcomers, outer
from shj_bayes.margins.row import HIGH, LOW
from shj_bayes.model.parameters import base_of
from shj_bayes.population.quantities import HIGHEST, LEAST, LOWEST, MOST, THIRD_CYCLE

FORCES = (LOWEST, HIGHEST, LEAST, MOST, "plateau", THIRD_CYCLE)
"""Forces that the bounds of all runs must hold, of every run."""


@dataclass(frozen=True)
class Bounds:
    """A lower and an upper factor on one property."""

    low: float  # at most 1
    high: float  # at least 1

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


@dataclass(frozen=True)
class Delivered:
    """Force of a new device of one set, kN."""

    # third_low to third_high: 5, 50 and 95 % of the third cycle of the first run
    third_low: float
    third: float
    third_high: float
    first_low: float  # 5 % of the smallest plateau of the first run
    later_low: float | None  # the same of the later runs; None without any
    # low, high: 5 % of the smallest plateau and 95 % of the largest force of all runs
    low: float
    high: float
    typical: Bounds  # smallest plateau and largest force of a typical device over its third cycle
    ratio: float | None  # second run over first of a typical device, mean plateau

    @property
    def words(self) -> str:
        """What the force does in the test, of a typical device."""
        said = (
            f"smallest plateau {self.typical.low:.3f} and largest force {self.typical.high:.3f} of the third cycle of "
            "the first run"
        )
        return said + ("; no second run" if self.ratio is None else f"; second run / first {self.ratio:.3f}")


def delivered(devices: Newcomers, own: int) -> Delivered:
    """Bound the force of a new device; with few devices of its own (`own`) by the outermost prior of the spread."""

    def bound(side: str, *names: str) -> float:
        level, pick = (0.05, min) if side == LOW else (0.95, max)
        return pick(
            outer({label: float(np.quantile(d.draws[name], level)) for label, d in devices.items()}, side, own)
            for name in names
        )

    main = devices[DEFAULT].draws
    later = tuple(n for n in main if n.startswith(f"{LEAST}_"))
    # Each quantity is pooled by itself: with few devices chance may put a band inside one that it must hold.
    forces = tuple(n for n in main if base_of(n) in FORCES)
    third = main[THIRD_CYCLE]
    moved = [float(np.median(main[name]) / np.median(third)) for name in (LOWEST, HIGHEST)]
    return Delivered(
        third_low=bound(LOW, THIRD_CYCLE),
        third=float(np.median(third)),
        third_high=bound(HIGH, THIRD_CYCLE),
        first_low=bound(LOW, LEAST),
        later_low=bound(LOW, *later) if later else None,
        low=bound(LOW, *forces),
        high=bound(HIGH, *forces),
        typical=Bounds.around(*moved),
        ratio=float(np.median(main["ratio"])) if "ratio" in main else None,
    )
