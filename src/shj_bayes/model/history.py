"""What physical effects may depend on: position, slip since reversal, travel, time, speed, block, further channels."""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from shj_bayes._util.arrays import FloatArray, IntArray, freeze, frozen
from shj_bayes.errors import ModelError
from shj_bayes.model.law import NEAR_TURNING, ROWS, SLOWING, course_of, fill_between
from shj_bayes.recording.motion import Motion
from shj_bayes.recording.smoothing import Channel

Way = tuple[FloatArray, IntArray]
STANDING = 0.01  # of the peak speed; below the slowest blocks of a test at several speeds

RECALLED = 32  # arrays that a history keeps of what was worked out of it
DELAYED = 12  # histories of a moment ago that it keeps: a filter has six, and as many while its delay is changed
FEW = 40  # samples of an earlier run over each half stroke that is moved: for what it left behind

PREFIX = "measured_"  # before the name of a channel, so that no name is that of another coordinate


@dataclass(frozen=True, eq=False)
class Measured:
    """A further channel in one run."""

    unit: str  # as its header says; empty where none did
    time_s: FloatArray  # shape (n,): time since the first sample of the run, ascending, s
    values: FloatArray  # shape (n,): in its unit, without noise; straight lines lie between them
    # low, high: least and largest value in all runs
    low: float
    high: float
    reference: float  # median over all runs: what the channel is taken to be where nothing is known of it

    def __post_init__(self) -> None:
        """Refuse a channel without a range."""
        freeze(self, "time_s", "values")
        if not (self.time_s.size == self.values.size > 0 and self.low < self.high):
            raise ModelError("a channel needs times, as many values, and a range above zero")

    def at(self, time_s: FloatArray) -> FloatArray:
        """Values at times since the first sample of the run, s."""
        return np.asarray(np.interp(time_s, self.time_s, self.values))

    def held(self, value: float) -> Measured:
        """Give the same channel, on the same scale, at one value all the time."""
        return replace(self, time_s=np.zeros(1), values=np.full(1, value))


@dataclass(frozen=True, eq=False)
class History:
    """One run of a device as the effects see it; all arrays have shape (n_samples,) and are read-only."""

    run: int  # number of the run, 1 for the first
    motion: Motion  # half-cycles, turning points, displacement and speed
    time_s: FloatArray  # time since the run's first sample, s
    position_mm: FloatArray  # displacement from the middle of the stroke, mm
    direction: FloatArray  # +1 while displacement grows, -1 while it falls
    slip_mm: FloatArray  # distance moved since the last reversal, mm
    travel_m: FloatArray  # distance moved since the first sample of the first run, m
    amplitude_mm: FloatArray  # half the stroke of the half-cycle, mm
    acceleration_mm_s2: FloatArray  # second derivative of the displacement, mm/s^2
    rest_s: FloatArray  # time spent near standstill around the last reversal, s
    half_stroke_mm: float  # largest distance from the middle of the stroke in all runs, mm
    peak_speed_mm_s: float  # 95th percentile of the speed in all runs, mm/s
    n_runs: int  # number of runs of the device
    # begun_s, tested_s: testing time before this run began, and of all runs together, s
    begun_s: float
    tested_s: float
    tested_m: float  # distance moved in all runs together, m
    before: History | None = None  # the run before this one, at some of its samples
    # samples on the way to the turning points that lie between those of this history: rows as `ROWS`, and where
    # those of each half-cycle begin. None goes on from the last two samples of each half-cycle.
    near_turns: Way | None = None
    # further channels by coordinate: functions of `time_s`, which fewer or other samples leave as they are
    measured: Mapping[str, Measured] = field(default_factory=dict)
    passing: bool = False  # whether the motion hangs on parameters, so that nothing large is kept of it
    # recalled, late: arrays that followed from it, for `recall`; what `delayed` made of it, by the delay, s
    recalled: dict[Hashable, FloatArray] = field(init=False, repr=False, default_factory=dict)
    late: dict[float, tuple[History, IntArray] | None] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        n = self.motion.displacement_mm.size
        for name in ARRAYS:
            values = frozen(getattr(self, name))
            if values.shape != (n,):
                raise ModelError(f"{name} has shape {values.shape}; it needs ({n},)")
            object.__setattr__(self, name, values)

    def held(self, values: Mapping[str, float]) -> History:
        """Give the same motion with its further channels at given values, by coordinate; others at their references."""
        measured = {name: one.held(values.get(name, one.reference)) for name, one in self.measured.items()}
        return replace(self, measured=measured)

    @property
    def speed_mm_s(self) -> FloatArray:
        """Speed, mm/s."""
        return self.motion.speed_mm_s

    @property
    def turned_at(self) -> FloatArray:
        """Where the run began, turned and ended: distances from the middle of the stroke, shape (n_half + 1,), mm."""
        middle = self.motion.displacement_mm[-1] - self.position_mm[-1]
        return np.asarray(np.append(self.motion.turning_mm, self.motion.displacement_mm[-1]) - middle)

    @property
    def earlier(self) -> tuple[FloatArray, ...]:
        """Where earlier runs began, turned and ended, one array as `turned_at` a run."""
        return () if self.before is None else (*self.before.earlier, self.before.turned_at)

    def recall(self, key: Hashable, make: Callable[[], FloatArray]) -> FloatArray:
        """Give what follows from this history alone, worked out once: a model is asked for many parameters."""
        if key not in self.recalled:
            if len(self.recalled) >= RECALLED:
                self.recalled.clear()
            self.recalled[key] = make()
        return self.recalled[key]

    def reduced(self, rows: FloatArray, start: IntArray, kept: IntArray | None = None) -> History:
        """Give the history at fewer points, which need not be samples.

        `rows`, shape (9, n), are channels there in the order of `ROWS`, `start` is where in them each half-cycle
        begins, and the last ends; `kept` are samples of this history that are among the points.
        """
        way, begins = self.way
        whole = self.motion
        left_out = np.setdiff1d(_near_turning(whole), np.zeros(0, dtype=np.int64) if kept is None else kept)
        half = np.concatenate([np.repeat(np.arange(whole.n_half), np.diff(begins)), whole.half_cycle[left_out]])
        both = np.concatenate([way, self.rows[:, left_out]], axis=1)
        order = np.lexsort((both[0], half))
        turns = (frozen(both[:, order]), np.searchsorted(half[order], np.arange(whole.n_half + 1)))
        middle = whole.displacement_mm[0] - self.position_mm[0]
        motion = Motion(rows[1], rows[2], start, whole.turning_mm, whole.direction)
        return replace(self, motion=motion, near_turns=turns, position_mm=rows[1] - middle, **_channels(rows))

    @cached_property
    def course(self) -> FloatArray:
        """Polynomials over time between the samples, so that few samples do; see `course_of`."""
        velocity = self.direction * self.speed_mm_s
        x = self.motion.displacement_mm
        return course_of(self.time_s, x, velocity, self.travel_m, self.acceleration_mm_s2)

    @property
    def rows(self) -> FloatArray:
        """All channels, in the order of `ROWS`, shape (9, n_samples)."""
        of_motion = (self.motion.displacement_mm, self.motion.speed_mm_s)
        return np.stack([self.time_s, *of_motion, *(getattr(self, name) for name in ROWS[3:])])

    @cached_property
    def way(self) -> Way:
        """Samples between those of this history, on the way to each turning point.

        What friction is at a turning point sets the force of the whole half-cycle behind it. The motion slows down
        evenly from the last sample but one on.
        """
        if self.near_turns is not None:
            return self.near_turns
        motion, share = self.motion, np.array(SLOWING)
        base = np.maximum(motion.start[1:-1] - 2, motion.start[:-2])
        out = np.repeat(self.rows[:, base, None], share.size, axis=2)
        end, x = motion.turning_mm[1:, None], motion.displacement_mm[base, None]
        turns = turn_s(self)
        out[0] = turns[:, None] - share * (turns - self.time_s[base])[:, None]
        out[1] = end - share**2 * (end - x)
        out[2] *= share
        out[4] = np.abs(out[1] - motion.turning_mm[:-1, None])
        out[5] += 1e-3 * np.abs(out[1] - x)
        begins = share.size * np.append(np.arange(motion.n_half), motion.n_half - 1)
        return frozen(out.reshape(len(ROWS), -1)), begins

    @cached_property
    def turned(self) -> tuple[History, IntArray]:
        """History with the samples of `way`, and which of its samples are those of this one."""
        return _with_way(self, 0.0, self.motion.start)

    @property
    def normal_position(self) -> FloatArray:
        """Position as a share of the half stroke, -1 to 1."""
        return np.asarray(self.position_mm / self.half_stroke_mm)


def thinned(history: History, keep: IntArray) -> History:
    """History at some of its samples, of which each half-cycle has one at least."""
    return history.reduced(history.rows[:, keep], np.searchsorted(keep, history.motion.start), keep)


def on_scales_of(history: History, tested: History, position_mm: FloatArray) -> History:
    """Give the same motion with the scales that a device's parameters and curves are stated on: those of its tests.

    `tested` is any run of them, `position_mm` the distance from the middle of their stroke. Further channels, of
    which the motion says nothing, stand at their references.
    """
    scales = {name: getattr(tested, name) for name in SCALES}
    return replace(history, position_mm=position_mm, measured=tested.held({}).measured, **scales)


def turn_s(history: History) -> FloatArray:
    """Time at which each half-cycle but the first begins, between its first sample and the one before, s."""
    if history.near_turns is not None:  # as the whole recording has it
        rows, begins = history.near_turns
        return np.asarray(rows[0, begins[1:-1] - 1])
    first = history.motion.start[1:-1]
    before, after = history.speed_mm_s[first - 1], history.speed_mm_s[first]
    step = history.time_s[first] - history.time_s[first - 1]
    # At constant acceleration; after a rest the half-cycle begins when the motion does.
    rested = before < STANDING * history.peak_speed_mm_s
    share = np.where(rested, 1.0, before / np.maximum(before + after, 1e-300))
    return np.asarray(history.time_s[first - 1] + share * step)


ARRAYS = ("time_s", "position_mm", *ROWS[3:])
SCALES = ("half_stroke_mm", "peak_speed_mm_s", "n_runs", "tested_s", "tested_m")


def coordinate_of(name: str) -> str:
    """Word of the coordinate that a channel of some name is."""
    return PREFIX + re.sub(r"\W+", "_", name.lower()).strip("_")


def measured_in(runs: Sequence[Sequence[Channel]]) -> tuple[Mapping[str, Measured], ...]:
    """Further channels of each run of a device (the same ones in each), by coordinate.

    Those that have one value throughout are left out.
    """
    out: list[dict[str, Measured]] = [{} for _ in runs]
    for name in [channel.name for channel in runs[0]] if runs else ():
        own = [next(channel for channel in run if channel.name == name) for run in runs]
        every = np.concatenate([channel.values for channel in own])
        low, high, middle = float(every.min()), float(every.max()), float(np.median(every))
        if low < high:
            for run, channel in zip(out, own, strict=True):
                run[coordinate_of(name)] = Measured(channel.unit, channel.time_s, channel.values, low, high, middle)
    return tuple(out)


def histories(
    times_s: Sequence[FloatArray], motions: Sequence[Motion], measured: Sequence[Mapping[str, Measured]] = ()
) -> tuple[History, ...]:
    """Histories of the consecutive runs of one device, from times (s), motion and further channels of each.

    Without `measured` there are no further channels.
    """
    further = measured or ({},) * len(motions)
    low = min(float(m.displacement_mm.min()) for m in motions)
    high = max(float(m.displacement_mm.max()) for m in motions)
    middle, half_stroke = (low + high) / 2, (high - low) / 2
    # A device that is tested around zero keeps zero as its middle: noise must not shift the slot.
    if abs(middle) < 0.02 * half_stroke:
        middle = 0.0
    peak = max(float(np.percentile(m.speed_mm_s, 95)) for m in motions)
    tested = float(sum(time[-1] - time[0] for time in times_s))
    travelled = float(sum(m.travel_mm[-1] for m in motions)) / 1000
    out: list[History] = []
    before, begun = 0.0, 0.0
    for run, (time, motion, own) in enumerate(zip(times_s, motions, further, strict=True), start=1):
        index = motion.half_cycle
        sign = motion.direction[index].astype(np.float64)
        stroke = motion.stroke_mm
        if motion.n_half > 2:  # the first half-cycle starts mid-stroke: its block is that of the next one
            stroke[0], stroke[-1] = max(stroke[0], stroke[1]), max(stroke[-1], stroke[-2])
        travel = motion.travel_mm / 1000
        out.append(
            History(
                run=run,
                motion=motion,
                time_s=time - time[0],
                position_mm=motion.displacement_mm - middle,
                direction=sign,
                slip_mm=np.abs(motion.displacement_mm - motion.turning_mm[index]),
                travel_m=before + travel,
                amplitude_mm=stroke[index] / 2,
                acceleration_mm_s2=np.gradient(sign * motion.speed_mm_s, time),
                rest_s=_rest(time, motion, peak)[index],
                half_stroke_mm=half_stroke,
                peak_speed_mm_s=peak,
                n_runs=len(motions),
                begun_s=begun,
                tested_s=tested,
                tested_m=travelled,
                before=_few(out[-1]) if out else None,
                measured=own,
            )
        )
        begun += float(time[-1] - time[0])
        before += float(travel[-1])
    return tuple(out)


def delayed(history: History, lag_s: float) -> tuple[History, IntArray] | None:
    """`History.turned` of the moment `lag_s` ago (or to come); None where that leaves a half-cycle without samples."""
    known = history.late
    if lag_s not in known:
        time = history.time_s
        start = np.concatenate([[0], np.searchsorted(time - lag_s, turn_s(history)), [time.size]]).astype(np.int64)
        late = None if np.any(np.diff(start) <= 0) else _with_way(history, lag_s, start)
        if len(known) >= DELAYED:  # most parameters of a model leave the delay as it is
            known.clear()
        known[lag_s] = late
    return known[lag_s]


def _with_way(history: History, lag_s: float, start: IntArray) -> tuple[History, IntArray]:
    """Make the history of a moment ago, with its half-cycles from `start` on, and say where its samples are."""
    motion, (way, begins) = history.motion, history.way
    first = motion.start[:-1]
    of_half = motion.direction, motion.turning_mm, history.amplitude_mm[first], history.rest_s[first]
    rows, own = np.empty((len(ROWS), start[-1] + way.shape[1])), np.empty(start[-1], dtype=np.int64)
    fill_between(rows, own, history.time_s, lag_s, start, of_half, history.course, (way, begins))
    position = rows[1] - (motion.displacement_mm[0] - history.position_mm[0])
    for array in (rows, position):  # so that nobody copies them
        array.setflags(write=False)
    moved = Motion(rows[1], rows[2], start + begins, motion.turning_mm, motion.direction)
    own_channels = {"position_mm": position, **_channels(rows)}
    return replace(history, motion=moved, near_turns=None, passing=lag_s != 0.0, **own_channels), own


def _few(history: History) -> History:
    """Thin a history to `FEW` samples over each half stroke that is moved, and the ends of each half-cycle."""
    start = history.motion.start
    step = np.floor(1000.0 * history.travel_m / history.half_stroke_mm * FEW)
    kept = np.flatnonzero(np.diff(step, append=np.inf))
    return thinned(history, np.unique(np.concatenate([kept, start[:-1], start[1:] - 1])))


def _channels(rows: FloatArray) -> dict[str, Any]:
    """Channels of a history by name, but for those of its motion, from rows in the order of `ROWS`."""
    return {name: row for name, row in zip(ROWS, rows, strict=True) if name in ARRAYS}


def _near_turning(motion: Motion) -> IntArray:
    """Find the samples at the distances `NEAR_TURNING` before each turning point, and the last two before it."""
    near = np.asarray(NEAR_TURNING) * 0.5 * float(np.ptp(motion.displacement_mm))
    out = [np.zeros(0, dtype=np.int64)]
    for a, b, end in zip(motion.start[:-2], motion.start[1:-1], motion.turning_mm[1:], strict=True):
        to_go = np.minimum.accumulate(np.abs(end - motion.displacement_mm[a:b]))
        out.append(np.maximum(np.append(b - 1 - np.searchsorted(to_go[::-1], near), (b - 2, b - 1)), a))
    return np.unique(np.concatenate(out))


def _rest(time: FloatArray, motion: Motion, peak: float) -> FloatArray:
    """Time near standstill around the start of each half-cycle, shape (n_half,), s."""
    step = np.append(np.diff(time), 0.0)
    slow = np.concatenate([[0.0], np.cumsum(np.where(motion.speed_mm_s < STANDING * peak, step, 0.0))])
    # From mid-stroke to mid-stroke, counted in displacement: half of the samples of a half-cycle may lie in one pause.
    half = motion.half_cycle
    passed = np.abs(motion.displacement_mm - motion.turning_mm[half]) >= motion.stroke_mm[half] / 2
    middle = [a + int(np.argmax(passed[a:b])) for a, b in zip(motion.start[:-1], motion.start[1:], strict=True)]
    edges = np.concatenate([[0], middle])
    return np.asarray(slow[edges[1:]] - slow[edges[:-1]])
