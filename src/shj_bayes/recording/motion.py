"""What the law needs to know of the displacement: half-cycles, turning points and speed."""

import math
import weakref
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from shj_bayes._util.arrays import BoolArray, FloatArray, IntArray, freeze, frozen
from shj_bayes.errors import RecordingError
from shj_bayes.recording import limits
from shj_bayes.recording.recording import Recording, noise_of, resolution_of
from shj_bayes.recording.smoothing import Smooth, hermite, smooth


def alternating(n: int, first: int = 1) -> IntArray:
    """Directions of half-cycles, one after the other, shape (n,): `first`, 1 or -1, then to and fro."""
    return np.where(np.arange(n) % 2 == 0, first, -first)


@dataclass(frozen=True, eq=False)
class Motion:
    """The displacement history that drives the law."""

    # shape (n_samples,): displacement, smoothed with the stated method where it was measured
    displacement_mm: FloatArray
    speed_mm_s: FloatArray  # shape (n_samples,): speed, the absolute value of v, never negative
    # shape (n_half + 1,): half-cycle k holds the samples ``start[k]:start[k+1]``; ``start[0] = 0``, ``start[-1] =
    # n_samples``
    start: IntArray
    # shape (n_half,): displacement at which half-cycle k starts: the first sample's for k = 0, else the reversal's
    # (x_reset)
    turning_mm: FloatArray
    direction: IntArray  # shape (n_half,): +1 where displacement grows in the half-cycle, -1 where it falls
    # shape (n_samples,): samples so near a reversal that the noise hides on which side they lie; no evidence for the
    # law
    unsure: BoolArray | None = None
    # how reversals and speed were found, with the bandwidth in Hz; ``"exact"`` for simulated motion
    method: str = "exact"
    noise_mm: float = 0.0  # estimated displacement noise (standard deviation), mm

    def __post_init__(self) -> None:
        """Copy, check and freeze the arrays."""
        freeze(self, "displacement_mm", "speed_mm_s", "turning_mm")
        freeze(self, "start", "direction", kind=np.int64)
        n = self.displacement_mm.size
        unsure = frozen(np.zeros(n) if self.unsure is None else self.unsure, np.bool_)
        if unsure.shape != (n,):
            raise RecordingError(f"unsure has shape {unsure.shape}; it needs ({n},)")
        object.__setattr__(self, "unsure", unsure)
        n_half = self.turning_mm.size
        if self.speed_mm_s.shape != (n,) or np.any(self.speed_mm_s < 0):
            raise RecordingError("speed_mm_s needs one value, zero or more, for each sample")
        if self.start.shape != (n_half + 1,) or self.start[0] != 0 or self.start[-1] != n:
            raise RecordingError(f"start needs {n_half + 1} indices from 0 to {n}; got {self.start.tolist()[:5]}...")
        if np.any(np.diff(self.start) <= 0) or self.direction.shape != (n_half,):
            raise RecordingError("every half-cycle needs at least one sample and one direction")
        if np.any(np.abs(self.direction) != 1) or np.any(self.direction[1:] == self.direction[:-1]):
            raise RecordingError("directions are +1 or -1 and alternate from one half-cycle to the next")

    @property
    def n_half(self) -> int:
        """Number of half-cycles."""
        return int(self.turning_mm.size)

    @property
    def half_cycle(self) -> IntArray:
        """Index of the half-cycle of each sample, shape (n_samples,)."""
        return np.repeat(np.arange(self.n_half), np.diff(self.start))

    @property
    def stroke_mm(self) -> FloatArray:
        """Distance from where each half-cycle starts to where the next does, or to the end, shape (n_half,), mm."""
        return np.abs(np.diff(self.turning_mm, append=self.displacement_mm[-1]))

    @property
    def peak_mm_s(self) -> FloatArray:
        """Peak speed of each half-cycle, shape (n_half,)."""
        return np.asarray(np.maximum.reduceat(self.speed_mm_s, self.start[:-1]))

    @property
    def travel_mm(self) -> FloatArray:
        """Cumulative distance moved, from turning point to turning point, shape (n_samples,), mm."""
        within = np.abs(self.displacement_mm - self.turning_mm[self.half_cycle])
        return np.asarray(within + np.append(0.0, np.cumsum(self.stroke_mm[:-1]))[self.half_cycle], dtype=np.float64)


@dataclass(frozen=True)
class Block:
    """Consecutive sine cycles of one amplitude and frequency."""

    amplitude_mm: float  # half of the peak-to-peak stroke, mm
    frequency_Hz: float  # frequency, Hz
    n_cycles: int  # full cycles, at least one

    def __post_init__(self) -> None:
        """Refuse blocks that hold no motion."""
        if not (self.amplitude_mm > 0 and self.frequency_Hz > 0 and self.n_cycles >= 1):
            raise RecordingError(f"a block needs amplitude, frequency and cycles above zero; got {self}")

    @property
    def duration_s(self) -> float:
        """Duration, s."""
        return self.n_cycles / self.frequency_Hz


def table_1(last_block_cycles: int = 5) -> tuple[Block, ...]:
    """Blocks of the paper's Table 1.

    It prints 6 cycles for the last block, the text says 5 and a total of 20; 5 is the default.
    """
    if last_block_cycles not in (5, 6):
        raise RecordingError(
            f"the last block of Table 1 has 5 cycles (text) or 6 (table), not {last_block_cycles}; choose 5 or 6"
        )
    amplitudes = (6.0, 12.0, 24.0, 48.0, 72.0, 95.0)
    frequencies = (0.27, 0.13, 0.067, 0.034, 0.022, 0.017)
    cycles = (3, 3, 3, 3, 3, last_block_cycles)
    return tuple(Block(a, f, n) for a, f, n in zip(amplitudes, frequencies, cycles, strict=True))


def exact_motion(blocks: tuple[Block, ...], rate_Hz: float) -> tuple[FloatArray, Motion]:
    """Sample sine blocks, one after the other, with exact turning points and speed: times, s, and the motion.

    Each block starts and ends at zero displacement going up; the rate gives 8 samples in the shortest cycle at least.
    """
    fastest = max(block.frequency_Hz for block in blocks)
    if not 8 * fastest <= rate_Hz <= 1e5:
        raise RecordingError(
            f"rate {rate_Hz} Hz: allowed is {8 * fastest:.3g} Hz (8 samples in the shortest cycle) to 100000 Hz"
        )
    begin = np.concatenate([[0.0], np.cumsum([block.duration_s for block in blocks])])
    time = np.arange(int(np.floor(begin[-1] * rate_Hz)) + 1) / rate_Hz
    index = np.clip(np.searchsorted(begin, time, side="right") - 1, 0, len(blocks) - 1)
    amplitude = np.array([block.amplitude_mm for block in blocks])[index]
    omega = 2 * np.pi * np.array([block.frequency_Hz for block in blocks])[index]
    phase = omega * (time - begin[index])

    turn_time, turn_mm = [], []
    for t0, block in zip(begin, blocks, strict=False):
        quarters = np.arange(1, 4 * block.n_cycles, 2)
        turn_time.append(t0 + quarters / (4 * block.frequency_Hz))
        turn_mm.append(block.amplitude_mm * alternating(quarters.size))
    turning = np.concatenate(turn_mm)
    start = np.concatenate([[0], np.searchsorted(time, np.concatenate(turn_time), side="left"), [time.size]])
    motion = Motion(
        displacement_mm=amplitude * np.sin(phase),
        speed_mm_s=np.abs(amplitude * omega * np.cos(phase)),
        start=start,
        turning_mm=np.concatenate([[0.0], turning]),
        direction=alternating(turning.size + 1),
    )
    return time, motion


NEAR = 0.12  # share of the shorter neighbouring stroke that the local fit spans: a sine within 0.71 rad of its peak
_MIN_POINTS = 9
_MANY_POINTS = 100
_LINE_POINTS, _LEAST_POINTS = 8, 3  # samples on each side of a corner through which lines go where few are near; least
_STRAIGHT = 4.0  # standard deviations of its rounding beyond which samples must be seen to be straight
_TRIES = 15  # evaluations of a fit of lines
_ROUNDER = 9.0  # twice the log likelihood that a rounded corner gains over a sharp one, at least: three deviations
_GOOD = 1.1  # a fit whose residual is not more than this many times the noise is not compared with another
_MAX_POINTS = 400  # the fit thins out more samples than this: its noise is then far below the smoothing's
_AT_REST = 5.0  # standard deviations of a sample from the level of a rest
_STILL = 1e-5  # of the whole stroke: less is no motion, however exact the samples are
_WIDER, _MOST = 4.0, 0.65  # share of what is so many times as near: half of it in a parabola, a quarter at a corner
_WELL_AWAY = 4.0  # of what is near a rest: a motion that begins is followed so far
_MOMENTS = 400  # at which it may begin
_POOR = 1.5  # a fit whose residual is this many times the noise is no smooth peak (a corner or a rest)


def least_return(values: FloatArray, noise: float) -> float:
    """Give the return that counts as a reversal in a channel, shape (n_samples,), with a noise of that sd."""
    return max(limits.REVERSAL_NOISE * noise, limits.REVERSAL_RANGE * float(np.ptp(values)))


_STRETCH = 32  # candidates that are looked at together


def hysteresis(values: FloatArray, threshold: float) -> list[int]:
    """Find reversals: inner samples that are extremes from which a signal came back by more than a threshold.

    Smaller movements back and forth, in the signal's unit, are no reversal.
    """
    step = np.sign(np.diff(values))
    moving = np.flatnonzero(step)
    if moving.size == 0:
        return []
    change = np.flatnonzero(np.diff(step[moving]))
    candidates = np.concatenate([[0], moving[change] + 1, [values.size - 1]])
    # Of a stretch that moves by less than the threshold only its extremes count.
    size = candidates.size // _STRETCH * _STRETCH
    rows = values[candidates[:size]].reshape(-1, _STRETCH)
    keep = np.ones(candidates.size, dtype=np.bool_)
    keep[:size] = np.repeat(np.ptp(rows, axis=1) > threshold, _STRETCH)
    for extreme in (rows.argmax(axis=1), rows.argmin(axis=1)):
        keep[np.arange(0, size, _STRETCH) + extreme] = True
    candidates = candidates[keep]
    found: list[int] = []
    low = high = int(candidates[0])
    direction = 0
    for index, value in zip(candidates.tolist(), values[candidates].tolist(), strict=True):
        if value > values[high]:
            high = index
        if value < values[low]:
            low = index
        if direction >= 0 and values[high] - value > threshold:
            if direction > 0:
                found.append(high)
            direction, low = -1, index
            high = index
        elif direction <= 0 and value - values[low] > threshold:
            if direction < 0:
                found.append(low)
            direction, high = 1, index
            low = index
    return found


class Corner(NamedTuple):
    """Two straight lines that meet at a reversal, rounded as by an actuator: a triangle convolved with a Gaussian."""

    meets_s: float
    meets_mm: float
    slopes: tuple[float, float]  # before and after, mm/s
    rounding_s: float  # standard deviation of the Gaussian
    residual: float  # of the samples about it, mm

    def rounded(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """By how much rounding moves displacement (mm) and velocity (mm/s) at given times."""
        half_jump = 0.5 * (self.slopes[1] - self.slopes[0])
        level, slope = rounding(time_s - self.meets_s, self.rounding_s)
        return half_jump * level, half_jump * slope

    def turns(self) -> tuple[float, float]:
        """Time and displacement of the extreme."""
        from scipy.special import erfinv  # noqa: PLC0415  (most recordings have no corners)

        before, after = self.slopes
        later = self.rounding_s * math.sqrt(2.0) * float(erfinv((before + after) / (before - after)))
        line = self.meets_mm + (before if later < 0 else after) * later
        moment = self.meets_s + later
        return moment, line + float(self.rounded(np.array([moment]))[0][0])


def rounding(time_s: FloatArray, sd_s: float) -> tuple[FloatArray, FloatArray]:
    """Give what convolving ``abs(t)`` with a Gaussian of a standard deviation adds to it, and to its slope."""
    if sd_s <= 0:
        return np.zeros_like(time_s), np.zeros_like(time_s)
    from scipy.special import erf  # noqa: PLC0415  (most recordings have no corners)

    u = time_s / (sd_s * math.sqrt(2.0))
    slope = erf(u)
    return time_s * slope + sd_s * math.sqrt(2 / math.pi) * np.exp(-(u**2)) - np.abs(time_s), slope - np.sign(time_s)


def place(
    time_s: FloatArray, raw: FloatArray, curve: Smooth, turns: list[int], noise: float
) -> tuple[FloatArray, FloatArray, list[Corner]]:
    """Give every reversal, an index into the smoothed displacement, its time and displacement; and those with a corner.

    A quartic in time is fitted around each extreme, over an eighth of the shorter neighbouring stroke, and two straight
    lines that meet; the one that fits better counts. Where neither fits there may be a rest, whose level is the median
    of its samples and which ends when the motion back begins; else a corner or the smoothed curve gives time and
    displacement, between the samples too. `noise` is the standard deviation of one raw sample.
    """
    smoothed, kinks_s = curve.values, curve.kinks_s
    times, places, corners = np.empty(len(turns)), np.empty(len(turns)), []
    edges = [0, *turns, raw.size - 1]
    for k, index in enumerate(turns):
        before, after, top = edges[k], edges[k + 2], smoothed[index]
        # The samples on both sides that lie within a share of the shorter stroke of the extreme.
        reach = NEAR * min(abs(top - smoothed[before]), abs(top - smoothed[after]))
        left = np.flatnonzero(np.abs(smoothed[before : index + 1] - top) > reach)
        right = np.flatnonzero(np.abs(smoothed[index : after + 1] - top) > reach)
        lo = before + int(left[-1]) + 1 if left.size else before
        hi = max(index + int(right[0]) - 1 if right.size else after, index)
        peak = bool(top > smoothed[before])
        around = lo, index, hi
        at_kink = bool(np.any((kinks_s > time_s[lo]) & (kinks_s < time_s[hi])))
        rest = _rest(time_s, raw, smoothed, around, noise) if at_kink else None
        smooth_top = None if at_kink else _quartic(time_s, raw, lo, hi, noise, peak)
        fits = smooth_top is not None and smooth_top[2] < _GOOD * noise + _STILL * float(np.ptp(raw))
        lines = None if rest or fits else _lines(time_s, raw, (before, *around, after), noise)
        if lines and (smooth_top is None or lines.residual < smooth_top[2]):
            corners.append(lines)
            times[k], places[k] = lines.turns()
            continue
        found = rest or (smooth_top and smooth_top[:2])
        if at_kink:
            found = found or _corner(time_s, raw, smoothed, around, noise, kinks_s)
        else:
            found = found or _rest(time_s, raw, smoothed, around, noise)
        times[k], places[k] = found or _between_samples(time_s, smoothed, curve.velocity, around, peak)
    return times, places, corners


def unfolded(time_s: FloatArray, corners: list[Corner]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Direction, offset, and what rounding did to displacement and velocity, each at n samples, in mm and mm/s.

    ``direction * (displacement - rounded) + offset`` is reflected at each corner, so that a triangle is a straight
    line, which a smoothing window may cross.
    """
    passed = np.searchsorted([corner.meets_s for corner in corners], time_s, side="right")
    direction = 1.0 - 2.0 * (np.arange(len(corners) + 1) % 2)
    jump = -np.diff(direction) * np.array([corner.meets_mm for corner in corners])
    level, slope = np.zeros_like(time_s), np.zeros_like(time_s)
    for corner in corners:
        reach = _STRAIGHT * corner.rounding_s
        near = slice(*np.searchsorted(time_s, [corner.meets_s - reach, corner.meets_s + reach]).tolist())
        moved = corner.rounded(time_s[near])
        level[near] += moved[0]
        slope[near] += moved[1]
    offset = np.append(0.0, np.cumsum(jump))
    return np.asarray(direction[passed]), np.asarray(offset[passed]), level, slope


def degree_for(n: int) -> int:
    """Degree of the polynomial through n samples around a reversal: what a quartic misses of a sine shows in many."""
    return 4 if n < _MANY_POINTS else 6


def _quartic(
    time_s: FloatArray, raw: FloatArray, lo: int, hi: int, noise: float, peak: bool
) -> tuple[float, float, float] | None:
    """Extreme of a quartic through samples lo..hi, and its residual, mm; None when it does not fit."""
    if hi - lo + 1 < _MIN_POINTS:
        return None
    together = max(1, (hi - lo + 1) // _MAX_POINTS)  # means of neighbours: a few hundred points hold all samples
    whole = slice(lo, lo + (hi - lo + 1) // together * together)
    t, x = (values[whole].reshape(-1, together).mean(axis=1) for values in (time_s, raw))
    middle, span = 0.5 * (t[0] + t[-1]), 0.5 * (t[-1] - t[0])
    u = (t - middle) / span
    matrix = np.vander(u, 1 + degree_for(hi - lo + 1))
    coefficients = np.linalg.lstsq(matrix, x, rcond=None)[0]
    residual = float(np.sqrt(np.sum((x - matrix @ coefficients) ** 2) / (x.size - matrix.shape[1])))
    if residual > _POOR * noise / np.sqrt(together) + 1e-3 * float(np.ptp(x)):
        return None
    fine = np.linspace(-1.0, 1.0, 401)
    curve = np.polyval(coefficients, fine)
    best = int(np.argmax(curve) if peak else np.argmin(curve))
    if best in (0, fine.size - 1):
        return None
    slope, bend = np.polyder(coefficients), np.polyder(coefficients, 2)
    top = fine[best]
    for _ in range(3):  # at 1 kHz the grid is twenty samples wide, and a sample on the wrong side is off by the jump
        step = np.polyval(slope, top) / np.polyval(bend, top)
        top = np.clip(top - step, fine[best - 1], fine[best + 1]) if np.isfinite(step) else top
    return float(middle + span * top), float(np.polyval(coefficients, top)), residual * float(np.sqrt(together))


def _rest(
    time_s: FloatArray, raw: FloatArray, smoothed: FloatArray, around: tuple[int, int, int], noise: float
) -> tuple[float, float] | None:
    """End and level of a rest, whose smoothed extreme is that of its noise; None when samples near it are few."""
    lo, index, hi = around
    level = float(smoothed[index])
    near = max(_AT_REST * noise, _STILL * float(np.ptp(raw)))
    padded = np.pad(raw[lo : hi + 1], 1, mode="edge")
    steady = np.median([padded[:-2], padded[1:-1], padded[2:]], axis=0)  # one sample beyond the noise is none
    for _ in range(3):
        away = np.flatnonzero(np.abs(steady - level) > near) + lo
        first = int(away[away < index][-1]) + 1 if np.any(away < index) else lo
        last = int(away[away > index][0]) - 1 if np.any(away > index) else hi
        level = float(np.median(raw[first : last + 1]))
    beyond = np.flatnonzero(np.abs(steady - level) > _WIDER * near) + lo
    begins, ends = int(beyond[beyond < index].max(initial=lo)), int(beyond[beyond > index].min(initial=hi))
    if last - first + 1 < _MIN_POINTS or last - first < _MOST * (ends - begins):
        return None
    return _departure(time_s, raw, (first, last, hi), level, near), level


def _departure(time_s: FloatArray, raw: FloatArray, rest: tuple[int, int, int], level: float, near: float) -> float:
    """When the motion back begins, s: where a distance that grows with the time or its square fits best, from 0."""
    first, last, hi = rest
    gone = np.flatnonzero(np.abs(raw[last : hi + 1] - level) > _WELL_AWAY * near)
    end = min(hi, last + max(int(gone[0]) if gone.size else hi - last, _MIN_POINTS))
    moves = end - last + 1
    if moves < _MIN_POINTS:
        return float(time_s[last])
    begin = max(first, last - 2 * moves)
    some = slice(begin, end + 1, 1 + (end - begin) // (4 * _MAX_POINTS))
    t, distance = time_s[some], (raw[some] - level) * np.sign(raw[end] - level)
    moments = np.linspace(t[0], time_s[min(last + moves // 2, end - 2)], _MOMENTS)
    along = np.maximum(t - moments[:, None], 0.0)
    evenly, faster = (np.maximum(way @ distance, 0.0) ** 2 / np.sum(way**2, axis=1) for way in (along, along**2))
    # A motor cannot jump to a speed: only where its way says so, beyond the noise, does it seem to.
    gain = evenly if evenly.max() > faster.max() + near**2 else faster
    return float(moments[np.argmax(gain)])


def _between_samples(
    time_s: FloatArray, smoothed: FloatArray, velocity: FloatArray, around: tuple[int, int, int], peak: bool
) -> tuple[float, float]:
    """Extreme of the cubic through the smoothed neighbours; at nine samples a half-cycle it is 1.4 % beyond them."""
    lo, index, hi = around
    near = slice(max(lo, index - 1), min(hi, index + 1) + 1)
    if near.stop - near.start < 2:
        return float(time_s[index]), float(smoothed[index])
    fine = np.linspace(time_s[near.start], time_s[near.stop - 1], 201)
    curve, _ = hermite(time_s[near], smoothed[near], velocity[near], fine)
    best = int(np.argmax(curve) if peak else np.argmin(curve))
    return float(fine[best]), float(curve[best])


def _corner(
    time_s: FloatArray,
    raw: FloatArray,
    smoothed: FloatArray,
    around: tuple[int, int, int],
    noise: float,
    kinks_s: FloatArray,
) -> tuple[float, float] | None:
    """Place the turning point at a corner or after a rest between two; None when no corner is at the extreme."""
    lo, index, hi = around
    near = kinks_s[(kinks_s >= time_s[lo]) & (kinks_s <= time_s[hi])]
    level = np.interp(near, time_s, smoothed)
    close = near[np.abs(level - smoothed[index]) <= max(5 * noise, 1e-3 * float(np.ptp(raw)))]
    if close.size == 0:
        return None
    rest = (time_s >= close[0]) & (time_s <= close[-1])
    if np.count_nonzero(rest) >= _MIN_POINTS:
        return float(close[-1]), float(np.median(raw[rest]))
    return float(close[-1]), float(smoothed[index])


def _lines(time_s: FloatArray, raw: FloatArray, around: tuple[int, int, int, int, int], noise: float) -> Corner | None:
    """Two straight lines that meet at an extreme, rounded or not; None where they do not fit.

    `around` are the neighbouring reversals, outermost, the samples near the extreme, and the extreme.
    """
    from scipy.optimize import least_squares  # noqa: PLC0415  (most recordings have no corners)

    # Of few samples lines go on to more, since a line is as straight farther away; not to the next, rounded reversals.
    before, lo, index, hi, after = around
    lo = min(lo, max(before + (before > 0), index - _LINE_POINTS))
    hi = max(hi, min(after - (after < raw.size - 1), index + _LINE_POINTS))
    if min(index - lo, hi - index) < _LEAST_POINTS:
        return None
    some = slice(lo, hi + 1, 1 + (hi - lo) // _MANY_POINTS)
    t, x = time_s[some] - time_s[index], raw[some]
    step, end = float(np.median(np.diff(t))), np.array([t[0], t[-1]])
    level, height = float(raw[index]), float(np.ptp(x))
    slopes = (x[[0, -1]] - level) / end
    if slopes[0] * slopes[1] >= 0:
        return None

    def misfit(z: FloatArray) -> FloatArray:
        meet, corner, one, other, sd = (*z, 0.0)[:5]
        bend = 0.5 * (other - one) * rounding(t - meet, abs(sd))[0]
        return np.asarray((corner + np.where(t < meet, one, other) * (t - meet) + bend - x) / height)

    begin, scale = np.array([0.0, level, *slopes]), np.array([step, height, *np.abs(slopes)])
    best = least_squares(misfit, begin, x_scale=scale, max_nfev=_TRIES)
    rounded = least_squares(misfit, np.append(best.x, 0.5 * step), x_scale=np.append(scale, step), max_nfev=_TRIES)
    gained = t.size * np.log(max(best.cost, 1e-300) / max(rounded.cost, 1e-300))
    if gained > _ROUNDER and _STRAIGHT * abs(rounded.x[4]) < min(-end[0], end[1]):
        best = rounded
    meet, corner, one, other, sd = (*best.x, 0.0)[:5]
    residual = height * float(np.sqrt(2 * best.cost / max(t.size - best.x.size, 1)))
    if residual > _POOR * noise + 1e-3 * height or one * other >= 0 or abs(meet) > 2 * step:
        return None
    return Corner(float(time_s[index]) + meet, corner, (one, other), abs(sd), residual)


def motion_of(recording: Recording) -> Motion:
    """Half-cycles, turning points, smoothed displacement and speed of a measured recording.

    The displacement may be noisy, rounded by an encoder, unevenly sampled, and may rest or have corners.
    `RecordingError` if it does not move beyond its own noise.
    """
    # The checks ask first and the fit asks again, of a recording that differs in its findings alone.
    key = (id(recording.time_s), id(recording.displacement_mm))
    if key in _FOUND:
        return _FOUND[key]
    motion = _motion(recording)
    _FOUND[key] = motion
    for array in (recording.time_s, recording.displacement_mm):  # frozen, so a motion holds as long as both are there
        weakref.finalize(array, _FOUND.pop, key, None)
    return motion


_FOUND: dict[tuple[int, int], Motion] = {}


def _motion(recording: Recording) -> Motion:
    """Find the motion of a recording that was not asked about before."""
    time, raw = recording.time_s, recording.displacement_mm
    resolution = resolution_of(raw)
    noise = noise_of(raw, resolution)
    extent = float(np.ptp(raw))
    least = max(limits.MIN_STROKE_MM, 2 * limits.REVERSAL_NOISE * noise)
    if raw.size < 8 or extent < least:
        raise RecordingError(
            f"{recording.source.name}: the displacement moves {extent:.3g} mm in {raw.size} samples "
            f"with {noise:.2g} mm noise; needed are 8 samples and {least:.3g} mm; check column and unit"
        )
    floor = max(limits.REVERSAL_COUNTS * resolution, limits.REVERSAL_RANGE * extent)
    # The first search only has to find the large half-cycles; what it takes for one narrows the window.
    curve = smooth(time, raw, noise, resolution, hysteresis(raw, max(limits.REVERSAL_NOISE * noise, 2 * floor)))
    # The second search works on the smoothed curve, so that its threshold may be as low as the noise that is left.
    threshold = max(limits.REVERSAL_NOISE * curve.noise, floor)
    turns = hysteresis(curve.values, threshold)
    turn_s, turn_mm, corners = place(time, raw, curve, turns, noise)
    if corners:  # a window that crosses a corner rounds it, one that ends there sees half as many samples
        way, offset, rounded, rounded_v = unfolded(time, corners)
        straight = smooth(time, way * (raw - rounded) + offset, noise, resolution, turns)
        x, v = way * (straight.values - offset) + rounded, way * straight.velocity + rounded_v
        curve = straight._replace(values=x, velocity=v)
    start = np.concatenate([[0], np.searchsorted(time, turn_s, side="left"), [time.size]]).astype(np.int64)
    for k in range(1, start.size - 1):  # every half-cycle keeps at least one sample
        start[k] = min(max(start[k], start[k - 1] + 1), time.size - (start.size - 1 - k))
    grows = curve.values[turns[0] if turns else -1] >= curve.values[0]
    direction = alternating(start.size - 1, 1 if grows else -1)
    turning, displacement = np.concatenate([[curve.values[0]], turn_mm]), curve.values
    if turns:
        # Each half-cycle stays between its turning points: slip against its direction is noise. The first may start
        # with a rest and the last ends nowhere in particular: only their reversal binds.
        away = np.copysign(np.inf, np.diff(turning))
        ends = np.concatenate([-away[:1], turning[1:], -away[-1:]])
        low, high = np.minimum(ends[:-1], ends[1:]), np.maximum(ends[:-1], ends[1:])
        n_samples = np.diff(start)
        displacement = np.clip(displacement, np.repeat(low, n_samples), np.repeat(high, n_samples))
    along = np.repeat(direction, np.diff(start))
    # Speed against the half-cycle is noise at rest; cut at zero it biases |v| half as much as the absolute value.
    speed = np.maximum(along * curve.velocity, 0.0)
    half_s, band = curve.half_width_s, curve.bandwidth_Hz
    kinks = curve.kinks_s.size
    across = f", not across {kinks} corner{'s' if kinks > 1 else ''}" if kinks else ""
    placed = f"placed by a quartic, {len(corners)} where lines meet" if corners else "placed by a quartic"
    method = (
        f"local quintic over {2 * half_s[0]:.3g} s (fastest half-cycle) to {2 * half_s[1]:.3g} s (slowest){across}; "
        f"speed -3 dB at {band[1]:.3g} to {band[0]:.3g} Hz; "
        f"reversals by {threshold:.3g} mm hysteresis, {placed}"
    )
    unsure = _unsure(time, turn_s, start, curve.velocity_sd, along * curve.velocity)
    motion = Motion(displacement, speed, start, turning, direction, unsure=unsure, method=method, noise_mm=noise)
    for first, last in blind_stretches(recording, motion):
        unsure[first:last] = True
    return replace(motion, unsure=unsure)


def _unsure(
    time: FloatArray, turn_s: FloatArray, start: IntArray, velocity_sd: FloatArray, along: FloatArray
) -> BoolArray:
    """Mark samples of which it is not known on which side of a reversal they lie.

    The time of a turn is known to three standard deviations of the velocity over the acceleration, and to one sample.
    There Eq. (1) as published jumps: with 0.02 mm noise such samples cost 480 units of log likelihood at 20 Hz.
    """
    step = float(np.median(np.diff(time)))
    out = np.zeros(time.size, dtype=np.bool_)
    for k, moment in enumerate(turn_s, start=1):
        i = int(start[k])
        reach = max(int(np.ceil(limits.UNSURE_SHARE * min(i - start[k - 1], start[k + 1] - i))), 1)
        before, after = max(i - reach, int(start[k - 1])), min(i + reach, time.size - 1)
        # The faster of both sides: a rest before the reversal does not blur the moment at which the motion goes on.
        rise = max(
            abs(along[after]) / (time[after] - moment + step), abs(along[before]) / (moment - time[before] + step)
        )
        spread = limits.UNSURE_SD * float(velocity_sd[i]) / max(rise, 1e-12)
        width = min(max(spread, step), reach * step)
        near = slice(*np.searchsorted(time, [moment - 2 * width, moment + 2 * width]).tolist())
        out[near] |= np.abs(time[near] - moment) <= width
    return out


def blind_stretches(recording: Recording, motion: Motion) -> list[tuple[int, int]]:
    """Find the samples, from one up to another, before which the device may have turned unseen in a gap in time.

    The law goes on from the last reversal, and where that lies in a gap its force is wrong until the device has slid a
    whole half-cycle: up to the second reversal that was seen, such samples would tell of the gap, not of the device.
    A device that did not move in a gap rested. It went straight on where the largest speed of the recording took it no
    farther, or where it moved the same way before, in and after the gap and either that is too short for a half-cycle
    (to turn unseen and be on the same way again takes a whole one) or it moved as far as its speeds before and after
    say, to `GAP_WAY`.
    """
    time, x, start = recording.time_s, recording.displacement_mm, motion.start
    gaps = np.flatnonzero(recording.restarts[1:])
    least = least_return(x, motion.noise_mm)
    moved, lasted = x[gaps + 1] - x[gaps], time[gaps + 1] - time[gaps]
    spare = float(np.max(motion.speed_mm_s)) * lasted - np.abs(moved)
    way = motion.direction[motion.half_cycle]
    same = (way[gaps] == way[gaps + 1]) & (way[gaps] == np.sign(moved))
    short = lasted < float(np.min(np.diff(time[start[1:-1]]), initial=recording.duration_s))
    even = 0.5 * lasted * (motion.speed_mm_s[gaps] + motion.speed_mm_s[gaps + 1])
    on = same & (short | (np.abs(np.abs(moved) - even) < limits.GAP_WAY * np.abs(moved) + least))
    stretches = []
    for before in gaps[(np.abs(moved) > least) & (spare > 2 * least) & ~on].tolist():
        later = start[1:-1][start[1:-1] > before + 1]
        # A turn at the edge itself is what the gap looks like, not a reversal that was seen.
        later = later[np.cumsum(np.abs(x[later] - x[before + 1]) > least) > 0]
        stretches.append((before + 1, int(later[1]) if later.size > 1 else time.size))
    return stretches


SAME_SPEED = 0.2  # peak speeds within this share of one another count as one


def one_peak_speed(peaks_mm_s: FloatArray) -> float | None:
    """Give the common peak speed, mm/s, of cycles when all have the same (prying then looks like speed), else None."""
    if peaks_mm_s.size == 0:
        return None
    middle = float(np.median(peaks_mm_s))
    # A cycle or two may be started or stopped by hand; 90 % must agree.
    alike = float(np.mean(np.abs(peaks_mm_s - middle) <= SAME_SPEED * middle))
    return middle if alike >= 0.9 else None
