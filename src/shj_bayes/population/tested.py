"""What the devices of a population were tested at: the range outside which nothing is said."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from shj_bayes.errors import PopulationError


@dataclass(frozen=True)
class RangeTested:
    """Range of amplitudes and speeds that every device of a population went through."""

    # smallest_mm, largest_mm: amplitudes (half strokes), mm
    smallest_mm: float
    largest_mm: float
    # slowest_mm_s, fastest_mm_s: smallest and largest peak speed of a cycle, mm/s; within a stroke every speed from 0
    # to the peak occurs
    slowest_mm_s: float
    fastest_mm_s: float
    # reversal rule of the law that the devices were fitted with ("published" or "continuous")
    variant: str = "published"
    source: str = ""  # where the range comes from

    def __post_init__(self) -> None:
        """Refuse ranges that are empty or not finite."""
        numbers = (self.smallest_mm, self.largest_mm, self.slowest_mm_s, self.fastest_mm_s)
        ordered = 0 < self.smallest_mm <= self.largest_mm and 0 < self.slowest_mm_s <= self.fastest_mm_s
        if not (np.isfinite(numbers).all() and ordered):
            raise PopulationError(
                f"tested range {self.smallest_mm:g} to {self.largest_mm:g} mm, {self.slowest_mm_s:g} to "
                f"{self.fastest_mm_s:g} mm/s: every number must be above zero and the first no larger than the second"
            )

    @property
    def one_speed(self) -> bool:
        """Whether all cycles had nearly the same peak speed, so that speed and position cannot be told apart."""
        return self.fastest_mm_s < 1.5 * self.slowest_mm_s

    def holds_speed(self, speed_mm_s: float) -> bool:
        """Whether sliding at that speed happened in the tests."""
        return 0 < speed_mm_s <= 1.01 * self.fastest_mm_s


PUBLISHED = RangeTested(5.94, 95.0, 9.8, 10.25, "published", "Table 1 of the paper")
"""Six amplitudes at nearly one peak speed: 2 pi f A is 9.80 to 10.25 mm/s in every block."""


def common(ranges: Sequence[RangeTested]) -> RangeTested | None:
    """Range that all devices went through; None where there is none.

    The rule is the smaller of the upper ends: a force at a speed that only some devices saw would rest on fewer
    devices than the sheet says.
    """
    if not ranges:
        return None
    low = max(r.smallest_mm for r in ranges), max(r.slowest_mm_s for r in ranges)
    high = min(r.largest_mm for r in ranges), min(r.fastest_mm_s for r in ranges)
    variants = {r.variant for r in ranges}
    if low[0] > high[0] or len(variants) > 1:
        return None
    return RangeTested(low[0], high[0], min(low[1], high[1]), high[1], variants.pop(), "the recordings of every device")
