"""What the user asks of the margins: the cycle, the nominal force, the class, a spread known beforehand."""

import math
from dataclasses import dataclass
from pathlib import Path

from shj_bayes.errors import PopulationError


@dataclass(frozen=True)
class Request:
    """What the user asked for."""

    # amplitude_mm, speed_mm_s: of a sine; the largest tested where the other one is given
    amplitude_mm: float | None = None
    speed_mm_s: float | None = None
    # its cycles, 3 where not given. Without any of the three, and without a history, the tests themselves.
    cycles: int | None = None
    history: Path | None = None  # file of a displacement (mm) over time (s)
    extrapolate: bool = False  # speed, travel and time beyond what was tested may be spoken of
    importance: str = "II"  # "I", "II", "III": importance class of the structure, for EN 15129
    # nominal sliding force for phi, phi_o and the bounds; that of a typical device of the set where not given
    nominal_kN: float | None = None
    sets: tuple[str, ...] = ()  # sets that the sheet is drawn up for; all where empty
    # coefficient of variation of the sliding force between devices of a set, known from other sources than these tests
    # (EN 1990 "V known")
    v_known: float | None = None
    v_reason: str = ""  # where it is known from; printed beside every value that rests on it

    def __post_init__(self) -> None:
        """Refuse a nominal force that is none, and a known spread without a reason."""
        for value, unit in ((self.amplitude_mm, "mm"), (self.speed_mm_s, "mm/s"), (self.cycles, "cycles")):
            if value is not None and not (math.isfinite(value) and value > 0):
                raise PopulationError(f"amplitude, speed and cycles must be above zero; got {value:g} {unit}")
        if self.history is not None and (self.amplitude_mm, self.speed_mm_s, self.cycles) != (None, None, None):
            raise PopulationError("give a history or amplitude, speed and cycles of a sine, not both")
        if self.nominal_kN is not None and not (math.isfinite(self.nominal_kN) and self.nominal_kN > 0):
            raise PopulationError(f"a nominal sliding force must be above zero; got {self.nominal_kN:g} kN")
        if self.v_known is not None and not 0 < self.v_known < 1:
            raise PopulationError(f"a known coefficient of variation must lie between 0 and 1; got {self.v_known:g}")
        if (self.v_known is None) != (not self.v_reason.strip()):
            raise PopulationError(
                "a coefficient of variation taken as known needs the reason, and a reason needs the value: give "
                '--v-known 0.06 --v-reason "factory control of 300 devices"; without both, V counts as unknown'
            )


PLAIN = Request()
