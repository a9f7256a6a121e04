"""What the force may depend on: each state coordinate with its unit, how it follows from a history, and its words."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import Literal

import numpy as np
from numba import njit

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import ModelError, did_you_mean
from shj_bayes.model.effects.effect import Base
from shj_bayes.model.effects.sliding import passes, slid_m, slid_mm, slid_since_mm
from shj_bayes.model.history import PREFIX, History, Measured

LOW_SPEED = 0.02  # of the peak speed, below which the logarithmic scale of the speed is linear
SHORT_SLIP = 0.01  # of the half stroke, likewise for the distance slid
FIRST_SLID = 0.03  # of the travel in all tests, likewise for it: surfaces bed in within the first strokes
FASTEST = 1.15  # of the peak speed (a 95th percentile)
FELT_MM = 0.1  # slid until a contact has got used to a speed: between clean metal and debris
PAD = 0.2  # of the half stroke: standard deviation of the bell over which passes over a place are counted
STROKES = 60.0  # half strokes slid at peak speed, about the paper's protocol: what heats a device by one unit
# How smooth a curve is before the test: wear and heating are smooth; clamping that changes with time steps, swings or
# wanders.
SMOOTH, EITHER = MappingProxyType({0.5: 1.0}), MappingProxyType({0.15: 0.5, 0.5: 0.5})
SUDDEN = MappingProxyType({0.05: 0.45, 0.15: 0.45, 0.5: 0.1})


@dataclass(frozen=True, eq=False)
class Coordinate:
    """One state of the device that a force may depend on."""

    # id to title: word in files, unit of the values, and words for sentences
    id: str
    unit: str
    title: str
    # ``values(history, base)`` gives the coordinate at the points of a history, in its unit, shape (n,)
    values: Callable[[History, Base], FloatArray]
    # ``reach(history)`` gives the lowest and the highest value that the tests of a device could reach
    reach: Callable[[History], tuple[float, float]]
    # value below which the scale is linear and above which it is logarithmic, as a share of the highest; None for a
    # linear scale
    scale: float | None = None
    # "low", "middle", "high": where a curve over the coordinate is 0: there the base law holds as it is
    zero: str = "low"
    # correlation lengths of the curves, as shares of the range, each with its probability before the test
    lengths: Mapping[float, float] = field(default_factory=lambda: SMOOTH)
    # probability that a curve over it comes again and again: threads and clocks do, wear and heat do not
    repeats: float = 0.0
    # probability that a capacity over it has a curve for push and one for pull: a lever or a band is clamped for one
    sides: float = 0.0
    # how it changes: alike in every "stroke", further from stroke to stroke through the "test", or neither ("else")
    goes: Literal["stroke", "test", "else"] = "test"
    # word of the class over it where it is one of several that differ in a constant, as the time in which heat fades
    group: str = ""
    adds: bool = False  # whether a force that is added may have a curve over it, besides the capacity
    family: str = "slow_change"  # family of the effects that a curve over it belongs to
    memory_mm: float = 0.0  # distance slid over which the capacity follows a curve over it
    symbol: str = "u"  # letter in formulas
    of_base: bool = False  # whether it depends on the base parameters: sliding begins where the elastic branch ends
    measured: bool = False  # whether it is a further channel of the recordings: its unit is that of `History.measured`
    # ``times(history)`` gives what a curve over it is multiplied by at the points of a history, shape (n,); a curve is
    # stated where that is 1. None: a curve over it is not multiplied.
    times: Callable[[History], FloatArray] | None = None

    def share(self, history: History, base: Base) -> FloatArray:
        """Coordinate as a share of its range on its scale, 0 to 1, shape (n,)."""
        return self.share_of(self.values(history, base), history)

    def share_of(self, values: FloatArray, history: History) -> FloatArray:
        """Values in their unit as shares of the range, 0 to 1."""
        low, high = self.reach(history)
        part = (np.asarray(values) - low) / (high - low)
        if self.scale is not None:
            part = np.log1p(np.maximum(part, 0.0) / self.scale) / np.log1p(1.0 / self.scale)
        return np.asarray(np.clip(part, 0.0, 1.0))

    def value_of(self, share: FloatArray, history: History) -> FloatArray:
        """Shares of the range as values in their unit."""
        part = np.asarray(share, dtype=np.float64)
        if self.scale is not None:
            part = self.scale * np.expm1(part * np.log1p(1.0 / self.scale))
        low, high = self.reach(history)
        return np.asarray(low + part * (high - low))

    @property
    def zero_share(self) -> float:
        """Where a curve is 0, as a share of the range."""
        return {"low": 0.0, "middle": 0.5, "high": 1.0}[self.zero]


@njit(cache=True)
def _low_pass(heat: FloatArray, step: FloatArray, tau: float) -> FloatArray:
    """Solve T' + T / tau = P from cold, exactly for heat that comes evenly over each step."""
    out = np.zeros_like(heat)
    for i in range(1, heat.size):
        left = np.exp(-step[i - 1] / tau)
        out[i] = left * out[i - 1] + (1.0 - left) * tau * heat[i] / max(step[i - 1], 1e-12)
    return out


def _heat(cooling: float) -> Callable[[History, Base], FloatArray]:
    """Heat state that fades with a time constant, in units of sliding `STROKES` half strokes at the full force."""

    def values(history: History, base: Base) -> FloatArray:
        heat = base.Fy / base.Fy_first * slid_since_mm(history, base) / (STROKES * history.half_stroke_mm)
        tau = cooling * STROKES * history.half_stroke_mm / history.peak_speed_mm_s
        return np.asarray(_low_pass(heat, np.diff(history.time_s), tau))

    return values


def _heat_reach(cooling: float, history: History) -> tuple[float, float]:
    """Heat state that sliding at full speed and force ends at."""
    return 0.0, min(cooling, 1.0)


def _acceleration_reach(history: History) -> tuple[float, float]:
    largest = 2.0 * history.peak_speed_mm_s**2 / history.half_stroke_mm
    return -largest, largest


TRAVEL = Coordinate(
    "travel",
    "m",
    "the distance slid",
    slid_m,
    lambda h: (0.0, h.tested_m),
    scale=FIRST_SLID,
    lengths=MappingProxyType({0.15: 0.2, 0.5: 0.8}),
    symbol="s",
    of_base=True,
)
TIME = Coordinate(
    "time",
    "s",
    "the time",
    lambda h, b: h.begun_s + h.time_s,
    lambda h: (0.0, h.tested_s),
    lengths=SUDDEN,
    repeats=0.2,
    sides=0.2,
    adds=True,
    symbol="t",
)
SPEED = Coordinate(
    "speed",
    "mm/s",
    "the speed",
    lambda h, b: h.speed_mm_s,
    lambda h: (0.0, FASTEST * h.peak_speed_mm_s),
    scale=LOW_SPEED / FASTEST,
    lengths=EITHER,
    goes="stroke",
    family="low_speed",
    symbol="|v|",
)
ALL = (
    Coordinate(
        "position",
        "mm",
        "the position",
        lambda h, b: h.position_mm,
        lambda h: (-h.half_stroke_mm, h.half_stroke_mm),
        zero="middle",
        lengths=MappingProxyType({0.05: 0.2, 0.15: 0.4, 0.5: 0.4}),
        repeats=0.2,
        goes="else",
        adds=True,
        family="odd_in_position",
        symbol="x",
    ),
    Coordinate(
        "distance",
        "mm",
        "the distance from mid-stroke",
        lambda h, b: np.abs(h.position_mm),
        lambda h: (0.0, h.half_stroke_mm),
        lengths=MappingProxyType({0.15: 0.3, 0.5: 0.7}),
        goes="else",
        family="even_in_position",
        symbol="|x|",
    ),
    TRAVEL,
    # A coating that is worn through late does so within a small part of the travel.
    replace(TRAVEL, id="late_travel", group="travel", scale=None, lengths=SUDDEN),
    # A film of debris grows as the device slides, and makes the friction depend on speed more or less.
    replace(
        TRAVEL,
        id="speed_by_travel",
        title="the distance slid, at peak speed",
        lengths=EITHER,
        goes="stroke",
        family="low_speed",
        times=lambda h: h.speed_mm_s / h.peak_speed_mm_s,
    ),
    TIME,
    # In no class of its own; a bolt that relaxes does most of it soon after it was tightened.
    replace(TIME, id="early_time", scale=FIRST_SLID, lengths=SMOOTH, repeats=0.0, sides=0.0, adds=False),
    *(
        Coordinate(
            f"heat{i}",
            "1",
            f"the heat state (cooling in {c:g} times the time that {STROKES:g} half strokes take)",
            _heat(c),
            partial(_heat_reach, c),
            group="heat",
            of_base=True,
        )
        for i, c in enumerate((0.03, 0.1, 0.3, 1.0), start=1)
    ),
    Coordinate(
        "amplitude",
        "mm",
        "the amplitude",
        lambda h, b: h.amplitude_mm,
        lambda h: (0.0, h.half_stroke_mm),
        zero="high",
        symbol="A",
    ),
    Coordinate(
        "slip",
        "mm",
        "the distance slid since the reversal",
        slid_mm,
        lambda h: (0.0, 2.0 * h.half_stroke_mm),
        scale=SHORT_SLIP / 2.0,
        zero="high",
        lengths=EITHER,
        goes="stroke",
        family="start_of_stroke",
        symbol="d",
        of_base=True,
    ),
    SPEED,
    replace(
        SPEED,
        id="speed_felt",
        title=f"the speed (felt over {FELT_MM:g} mm of sliding)",
        group="speed",
        memory_mm=FELT_MM,
    ),
    Coordinate(
        "acceleration",
        "mm/s^2",
        "the acceleration along the motion",
        lambda h, b: h.direction * h.acceleration_mm_s2,
        _acceleration_reach,
        zero="middle",
        family="odd_in_position",
        goes="stroke",
    ),
    Coordinate(
        "passes",
        "1",
        "the number of passes over the place",
        partial(passes, width=PAD),
        lambda h: (0.0, 1000.0 * h.tested_m / h.half_stroke_mm),
        symbol="n",
        of_base=True,
    ),
)


def coordinates() -> dict[str, Coordinate]:
    """All coordinates by id."""
    return {one.id: one for one in ALL}


def coordinates_of(word: str) -> tuple[Coordinate, ...]:
    """Coordinates of the table over which a class of a word has its curves: those of a group, or the one of that id."""
    return tuple(one for one in ALL if word in (one.id, one.group))


def coordinate_named(word: str) -> Coordinate:
    """Coordinate of a word (`ModelError` where there is none): of the table, or a further channel.

    The unit and range of a further channel are known to the history.
    """
    known = coordinates()
    if word.startswith(PREFIX) and len(word) > len(PREFIX):
        return Coordinate(
            word,
            "",
            f"the measured {word.removeprefix(PREFIX).replace('_', ' ')}",
            lambda h, b: _measured(h, word).at(h.time_s),
            lambda h: (_measured(h, word).low, _measured(h, word).high),
            zero="middle",
            goes="else",
            measured=True,
        )
    if word not in known:
        raise ModelError(f"'{word}' is not a coordinate; known are {', '.join(known)}{did_you_mean(word, known)}")
    return known[word]


def _measured(history: History, word: str) -> Measured:
    """Further channel of a history; `ModelError` where the recording has none of that name."""
    if word not in history.measured:
        name = word.removeprefix(PREFIX)
        raise ModelError(
            f"the force is said to follow the channel '{name}', but run {history.run} has no such channel, or one that "
            f"cannot serve (diagnose says why); name its column with --columns {name}=..."
        )
    return history.measured[word]
