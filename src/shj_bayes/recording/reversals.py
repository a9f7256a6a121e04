"""Reversals of a noisy displacement: found by hysteresis, placed by a local fit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from shj_bayes.recording import limits
from shj_bayes.recording.polynomial import hermite
from shj_bayes.recording.recording import FloatArray

if TYPE_CHECKING:
    from shj_bayes.recording.smoothing import Smooth


NEAR = 0.12  # share of the shorter neighbouring stroke that the local fit spans: a sine within 0.71 rad of its peak
_MIN_POINTS = 9
_MANY_POINTS = 100
_MAX_POINTS = 400  # the fit thins out more samples than this: its noise is then far below the smoothing's
_AT_REST = 5.0  # standard deviations of a sample from the level of a rest
_STILL = 1e-5  # of the whole stroke: less is no motion, however exact the samples are
_MOST = 0.5  # share of the samples near an extreme that stand still when it is a rest
_WELL_AWAY = 4.0  # of what is near a rest: a motion that begins is followed so far
_MOMENTS = 400  # at which it may begin
_POOR = 1.5  # a fit whose residual is this many times the noise is no smooth peak (a corner or a rest)


def least_return(values: FloatArray, noise: float) -> float:
    """Give the return that counts as a reversal in a channel, shape (n_samples,), with a noise of that sd."""
    return max(limits.REVERSAL_NOISE * noise, limits.REVERSAL_RANGE * float(np.ptp(values)))


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


def first_direction(values: FloatArray, turns: list[int]) -> int:
    """Direction of the first half-cycle of a displacement, shape (n_samples,): +1 when it grows."""
    end = turns[0] if turns else values.size - 1
    return 1 if values[end] >= values[0] else -1


def place(
    time_s: FloatArray, raw: FloatArray, curve: Smooth, turns: list[int], noise: float
) -> tuple[FloatArray, FloatArray]:
    """Give every reversal, an index into the smoothed displacement, its turning time and turning displacement.

    A quartic in time is fitted around each extreme, over an eighth of the shorter neighbouring stroke. Where it does
    not fit, or there is a corner, there may be a rest, whose level is the median of its samples and which ends when the
    motion back begins; else a corner or the smoothed curve gives time and displacement, between the samples too.
    `noise` is the standard deviation of one raw sample.
    """
    smoothed, kinks_s = curve.values, curve.kinks_s
    times, places = np.empty(len(turns)), np.empty(len(turns))
    edges = [0, *turns, raw.size - 1]
    for k, index in enumerate(turns):
        before, after = edges[k], edges[k + 2]
        lo, hi = _neighbourhood(smoothed, before, index, after)
        peak = bool(smoothed[index] > smoothed[before])
        around = lo, index, hi
        if np.any((kinks_s > time_s[lo]) & (kinks_s < time_s[hi])):
            found = _rest(time_s, raw, smoothed, around, noise) or _corner(
                time_s, raw, smoothed, around, noise, kinks_s
            )
        else:
            found = _quartic(time_s, raw, lo, hi, noise, peak) or _rest(time_s, raw, smoothed, around, noise)
        times[k], places[k] = found or _between_samples(time_s, smoothed, curve.velocity, around, peak)
    return times, places


def _neighbourhood(smoothed: FloatArray, before: int, index: int, after: int) -> tuple[int, int]:
    """Find the samples on both sides of an extreme that lie within a share of the shorter stroke of it."""
    reach = NEAR * min(abs(smoothed[index] - smoothed[before]), abs(smoothed[index] - smoothed[after]))
    left = np.flatnonzero(np.abs(smoothed[before : index + 1] - smoothed[index]) > reach)
    right = np.flatnonzero(np.abs(smoothed[index : after + 1] - smoothed[index]) > reach)
    lo = before + int(left[-1]) + 1 if left.size else before
    hi = index + int(right[0]) - 1 if right.size else after
    return lo, max(hi, index)


def degree_for(n: int) -> int:
    """Degree of the polynomial through n samples around a reversal: what a quartic misses of a sine shows in many."""
    return 4 if n < _MANY_POINTS else 6


def _quartic(
    time_s: FloatArray, raw: FloatArray, lo: int, hi: int, noise: float, peak: bool
) -> tuple[float, float] | None:
    """Extreme of a quartic (of degree six, where there are many) through samples lo..hi; None when it does not fit."""
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
    return float(middle + span * top), float(np.polyval(coefficients, top))


def _rest(
    time_s: FloatArray, raw: FloatArray, smoothed: FloatArray, around: tuple[int, int, int], noise: float
) -> tuple[float, float] | None:
    """End and level of a rest; None when the samples near the extreme are few.

    The smoothed extreme of a long rest is that of its noise, several standard deviations beyond where the device stood.
    """
    lo, index, hi = around
    level = float(smoothed[index])
    near = max(_AT_REST * noise, _STILL * float(np.ptp(raw)))
    for _ in range(3):
        away = np.flatnonzero(np.abs(smoothed[lo : hi + 1] - level) > near) + lo
        first = int(away[away < index][-1]) + 1 if np.any(away < index) else lo
        last = int(away[away > index][0]) - 1 if np.any(away > index) else hi
        level = float(np.median(raw[first : last + 1]))
    if last - first + 1 < _MIN_POINTS or last - first < _MOST * (hi - lo):
        return None
    return _departure(time_s, raw, (first, last, hi), level, near), level


def _departure(time_s: FloatArray, raw: FloatArray, rest: tuple[int, int, int], level: float, near: float) -> float:
    """When the motion back begins, s: its distance from the rest grows with the time or with its square, from 0.

    The moment at which one of these fits best, by least squares. A smoothed displacement leaves a rest before the
    device does, and stays within the noise of the rest for long where the device leaves slowly.
    """
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
    """Extreme of the cubic through the smoothed positions and velocities next to the extreme sample.

    At nine samples a half-cycle the extreme sample itself is up to 1.4 % of the amplitude short of the turning point.
    """
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
    return _meeting(time_s, raw, lo, hi, float(close[-1])) or (float(close[-1]), float(smoothed[index]))


def _meeting(time_s: FloatArray, raw: FloatArray, lo: int, hi: int, corner: float) -> tuple[float, float] | None:
    """Where the straight lines before and after a corner meet; None when they do not meet there."""
    split = int(np.searchsorted(time_s, corner))
    gap = float(time_s[min(split + 1, time_s.size - 1)] - time_s[split - 1])
    if split - lo < 4 or hi - split < 4:
        return None
    left = np.polyfit(time_s[lo : split - 1] - corner, raw[lo : split - 1], 1)
    right = np.polyfit(time_s[split + 2 : hi + 1] - corner, raw[split + 2 : hi + 1], 1)
    if np.sign(left[0]) == np.sign(right[0]) or left[0] == right[0]:
        return None
    after = float((right[1] - left[1]) / (left[0] - right[0]))
    return (corner + after, float(np.polyval(left, after))) if abs(after) <= 2 * gap else None
