"""Displacement histories on a fine grid: the paper's Table 1, an improved test, and others that laboratories run."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter1d

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import ModelError
from shj_bayes.recording.motion import hysteresis, table_1

# Fastest that each protocol moves, mm/s; bounds gamma and the earthquake that is held out. All but the first two begin
# to move with the first reading.
PEAK_SPEED_MM_S = {
    "paper": 10.25,
    "improved": 42.0,
    "triangles": 10.0,
    "ramps with rests": 5.0,
    "two speeds": 20.0,
    "three speeds": 30.0,
    "mixed amplitudes": 10.25,
    "earthquake": 20.0,
    "partial cycles": 10.0,
    "ten half-cycles": 10.0,
}
EARLIER = ("paper", "improved")  # all that the earlier kind of proof draws
EASE_S = 0.3  # a controller eases from one block into the next
CORNER_S = 0.1  # an actuator rounds the corners of a triangle
REST_S = 2.0  # recorded before the first block
LEAST_MM = 0.5  # between two reversals of the earthquake
REACH_MM = 90.0  # of the earthquake
# half stroke mm, peak speed mm/s, cycles, seconds of rest at the first positive end of the stroke
IMPROVED: tuple[tuple[float, float, int, float], ...] = (
    (6.0, 10.0, 3, 0.0),
    (24.0, 10.0, 3, 0.0),
    (95.0, 10.0, 2, 60.0),
    (24.0, 2.0, 1, 0.0),
    (24.0, 40.0, 4, 0.0),
    (48.0, 10.0, 2, 180.0),
    (72.0, 20.0, 2, 0.0),
    (95.0, 40.0, 3, 0.0),
    (24.0, 10.0, 2, 10.0),
    (6.0, 10.0, 2, 0.0),
)
TRIANGLES = ((6.0, 10.0, 3), (12.0, 10.0, 3), (24.0, 10.0, 3), (48.0, 5.0, 2), (95.0, 10.0, 2), (24.0, 2.0, 1))
RAMPS = ((12.0, 5.0, 2, 5.0), (24.0, 5.0, 2, 20.0), (48.0, 5.0, 2, 20.0), (95.0, 5.0, 1, 60.0), (24.0, 1.0, 1, 5.0))
TWO_SPEEDS = tuple((a, v, n, 0.0) for a in (12.0, 24.0, 72.0) for v, n in ((4.0, 2), (20.0, 3)))
THREE_SPEEDS = tuple((a, v, n, 0.0) for a in (12.0, 24.0, 48.0) for v, n in ((2.5, 1), (10.0, 2), (30.0, 3)))
PARTIAL_MM = (14.0, 30.0)  # half strokes about an offset
OFFSETS_MM = (30.0, 55.0)
HALF_CYCLES_MM = (40.0, 90.0)  # half stroke of a test of two runs of five half-cycles


@dataclass(frozen=True, eq=False)
class Course:
    """Displacement of one run on a fine grid.

    Parameters
    ----------
    time_s : array, shape (n,)
        Times, evenly spaced from 0, s.
    x_mm : array, shape (n,)
        Displacement, mm.
    every : int
        Every how many fine samples the recorder takes one.
    """

    time_s: FloatArray
    x_mm: FloatArray
    every: int

    @property
    def dt_s(self) -> float:
        """Step of the fine grid, s."""
        return float(self.time_s[1] - self.time_s[0])

    @property
    def v_mm_s(self) -> FloatArray:
        """Velocity, mm/s."""
        return np.asarray(np.gradient(self.x_mm, self.dt_s))


def course(
    protocol: str,
    rate_Hz: float,
    fine: int,
    rng: np.random.Generator | None = None,
    speed: float = 10.0,
    within_mm: tuple[float, float] = (-REACH_MM, REACH_MM),
) -> Course:
    """Lay out a protocol.

    Parameters
    ----------
    protocol : str
        One of `PEAK_SPEED_MM_S`: ``paper`` (Table 1), ``improved`` (several speeds, rests and return blocks),
        ``mixed amplitudes`` (the blocks of Table 1, shuffled), ``earthquake`` (a band-limited random motion), ``partial
        cycles`` (about an offset to one side), ``ten half-cycles`` (in two runs, one half stroke) ...
    rate_Hz : float
        Sampling rate of the recording, Hz.
    fine : int
        Fine steps between two samples of the recording.
    rng : numpy.random.Generator, optional
        Chance of the last four.
    speed : float
        Peak speed of the earthquake, mm/s.
    within_mm : (float, float)
        Where the earthquake stays, mm.

    Returns
    -------
    Course
    """
    dt = 1.0 / (rate_Hz * fine)
    rng = rng or np.random.default_rng(0)
    table = [(b.amplitude_mm, 2 * np.pi * b.amplitude_mm * b.frequency_Hz, b.n_cycles, 0.0) for b in table_1()]
    if protocol == "paper":
        x = _blocks(table, dt)
    elif protocol == "improved":
        x = _blocks(list(IMPROVED), dt)
    elif protocol == "earthquake":
        x = _earthquake(rng, speed, dt, within_mm)
    elif protocol == "two speeds":
        x = _blocks(list(TWO_SPEEDS), dt, rest_s=0.0)
    elif protocol == "three speeds":
        x = _blocks(list(THREE_SPEEDS), dt, rest_s=0.0)
    elif protocol == "mixed amplitudes":
        x = _blocks([table[i] for i in rng.permutation(len(table))], dt, rest_s=0.0)
    elif protocol == "triangles":
        x = _ramps([(a, v, n, 0.0) for a, v, n in TRIANGLES], dt)
    elif protocol == "ramps with rests":
        x = _ramps(list(RAMPS), dt)
    elif protocol == "partial cycles":
        x = _partial(rng, dt)
    elif protocol == "ten half-cycles":
        x = _blocks([(float(rng.uniform(*HALF_CYCLES_MM)), peak_speed(protocol), 2.5, 0.0)], dt, rest_s=0.0)
    else:
        raise ModelError(f"protocol '{protocol}' is not known; choose one of {', '.join(PEAK_SPEED_MM_S)}")
    return Course(np.arange(x.size, dtype=np.float64) * dt, x, fine)


@cache
def duration(protocol: str) -> float:
    """About how long one run of a protocol takes, s."""
    return float(course(protocol, 10.0, 2, speed=peak_speed(protocol)).time_s[-1])


def peak_speed(protocol: str) -> float:
    """Fastest that a protocol moves, mm/s."""
    return PEAK_SPEED_MM_S[protocol]


def _blocks(table: Sequence[tuple[float, float, float, float]], dt: float, rest_s: float = REST_S) -> FloatArray:
    """Blocks one after another, eased where the speed changes from one to the next."""
    parts = [np.zeros(round(rest_s / dt)), *(_sine(*block, dt) for block in table)]
    x = np.concatenate(parts)
    smooth = gaussian_filter1d(x, EASE_S / dt, mode="nearest")
    ends = np.concatenate([[0.0], np.cumsum([part.size for part in parts])]) * dt
    time = np.arange(x.size) * dt
    share = np.max([np.exp(-(((time - end) / (3 * EASE_S)) ** 4)) for end in ends], axis=0)
    eased = x + share * (smooth - x)
    return np.asarray(eased - eased[0])


def _ramps(table: list[tuple[float, float, int, float]], dt: float) -> FloatArray:
    """Constant speed from end to end, with a rest at each end, from and to zero; corners are rounded."""
    knots = [(0.0, 0.0)]
    for amplitude, speed, cycles, rest in table:
        for end in (*(amplitude, -amplitude) * cycles, 0.0):
            at, before = knots[-1]
            there = at + abs(end - before) / speed
            knots += [(there, end), (there + rest, end)] if rest and end else [(there, end)]
    times, places = np.array(knots).T
    sharp = np.interp(np.arange(int(times[-1] / dt)) * dt, times, places)
    x = gaussian_filter1d(sharp, CORNER_S / dt, mode="nearest")
    return np.asarray(x - x[0])


def _sine(amplitude: float, speed: float, cycles: float, rest: float, dt: float) -> FloatArray:
    """Sine cycles from and to zero, with a rest at the first positive end of the stroke."""
    duration = cycles * 2 * np.pi * amplitude / speed
    moving = np.arange(int(duration / dt)) * dt
    x = amplitude * np.sin(speed / amplitude * moving)
    if not rest:
        return np.asarray(x)
    # The motion goes on behind the peak: going back to it would be a reversal, at which Eq. (1) as published jumps.
    behind = int(np.pi / 2 * amplitude / speed / dt) + 1
    return np.concatenate([x[:behind], np.full(round(rest / dt), amplitude), x[behind:]])


def _partial(rng: np.random.Generator, dt: float) -> FloatArray:
    """Ramp to an offset, cycle about it with growing strokes, and again about a larger or smaller one; corners rounded.

    All on one side of the middle, as a brace does that has been left off centre.
    """
    side, speed = float(rng.choice([-1.0, 1.0])), peak_speed("partial cycles")
    knots, pace = [(0.0, 0.0)], 2.0 / np.pi * speed  # mean speed of a sine
    for offset in side * rng.permutation(OFFSETS_MM):
        for reach in PARTIAL_MM:
            for end in (*(offset + reach, offset - reach) * 3, offset):
                at, before = knots[-1]
                knots.append((at + abs(end - before) / pace, float(end)))
    times, places = np.array(knots).T
    time = np.arange(int(times[-1] / dt)) * dt
    after = np.clip(np.searchsorted(times, time, side="right"), 1, times.size - 1)
    share = (time - times[after - 1]) / (times[after] - times[after - 1])
    x = places[after - 1] + (places[after] - places[after - 1]) * 0.5 * (1.0 - np.cos(np.pi * share))
    smooth = gaussian_filter1d(x, CORNER_S / dt, mode="nearest")
    return np.asarray(smooth - smooth[0])


def _earthquake(rng: np.random.Generator, speed: float, dt: float, within_mm: tuple[float, float]) -> FloatArray:
    """Random motion that swells and fades, 12 times its longest period, with a peak speed and within two places.

    Motions that turn back by less than `LEAST_MM` are drawn again: no recorder sees such a reversal, and Eq. (1) as
    published loses the force of a whole branch at each. It begins at zero, and swells about the middle of both places.
    """
    middle, reach = 0.5 * (within_mm[0] + within_mm[1]), 0.5 * (within_mm[1] - within_mm[0])
    longest = 2 * np.pi * 60.0 / speed
    time = np.arange(int(12 * longest / dt)) * dt
    swell = np.interp(time / time[-1], [0.0, 0.15, 0.5, 1.0], [0.0, 1.0, 0.8, 0.35])
    there = middle * 0.5 * (1.0 - np.cos(np.pi * np.clip(time / longest, 0.0, 1.0)))
    while True:
        x = np.zeros(time.size)
        for k in range(24):
            frequency = (0.6 + 2.4 * k / 23) / longest
            x += np.sin(2 * np.pi * frequency * time + rng.uniform(0, 2 * np.pi)) / (0.4 + frequency * longest) ** 1.5
        x *= swell
        x *= speed / np.abs(np.gradient(x, dt)).max()
        x *= min(1.0, reach / np.abs(x).max())
        moved = x + there if middle else x
        if np.abs(np.diff(moved[hysteresis(moved, 0.0)])).min() > LEAST_MM:
            return np.asarray(moved)
