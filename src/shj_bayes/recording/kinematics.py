"""From measured displacement to what the law needs: half-cycles, turning points and speed."""

import weakref
from dataclasses import replace

import numpy as np

from shj_bayes.errors import RecordingError
from shj_bayes.recording import limits
from shj_bayes.recording.motion import IntArray, Motion, alternating
from shj_bayes.recording.noise import noise_of, resolution_of
from shj_bayes.recording.recording import BoolArray, FloatArray, Recording
from shj_bayes.recording.reversals import first_direction, hysteresis, least_return, place, unfolded
from shj_bayes.recording.smoothing import smooth


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
    count = resolution_of(raw)
    noise = noise_of(raw, count)
    extent = float(np.ptp(raw))
    least = max(limits.MIN_STROKE_MM, 2 * limits.REVERSAL_NOISE * noise)
    if raw.size < 8 or extent < least:
        raise RecordingError(
            f"{recording.source.name}: the displacement moves {extent:.3g} mm in {raw.size} samples "
            f"with {noise:.2g} mm noise; needed are 8 samples and {least:.3g} mm; check column and unit"
        )
    floor = max(limits.REVERSAL_COUNTS * count, limits.REVERSAL_RANGE * extent)
    # The first search only has to find the large half-cycles; what it takes for one narrows the window.
    curve = smooth(time, raw, noise, count, hysteresis(raw, max(limits.REVERSAL_NOISE * noise, 2 * floor)))
    # The second search works on the smoothed curve, so that its threshold may be as low as the noise that is left.
    threshold = max(limits.REVERSAL_NOISE * curve.noise, floor)
    turns = hysteresis(curve.values, threshold)
    turn_s, turn_mm, corners = place(time, raw, curve, turns, noise)
    if corners:  # a window that crosses a corner rounds it, one that ends there sees half as many samples
        way, offset, rounded, rounded_v = unfolded(time, corners)
        straight = smooth(time, way * (raw - rounded) + offset, noise, count, turns)
        x, v = way * (straight.values - offset) + rounded, way * straight.velocity + rounded_v
        curve = replace(straight, values=x, velocity=v)
    start = _boundaries(time, turn_s)
    direction = alternating(start.size - 1, first_direction(curve.values, turns))
    turning = np.concatenate([[curve.values[0]], turn_mm])
    displacement = _between(curve.values, turning, start)
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

    The time at which a noisy displacement turns is known to three standard deviations of the velocity over the
    acceleration, and to one sample. At the reversal Eq. (1) as published jumps by several kN, so such samples would
    tell of the clock, not of the device: with 0.02 mm noise they cost 480 units of log likelihood at 20 Hz.
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
        out |= np.abs(time - moment) <= min(max(spread, step), reach * step)
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


def _boundaries(time: FloatArray, turn_s: FloatArray) -> IntArray:
    """First sample at or after each turning time; every half-cycle keeps at least one sample."""
    start = np.concatenate([[0], np.searchsorted(time, turn_s, side="left"), [time.size]]).astype(np.int64)
    for k in range(1, start.size - 1):
        start[k] = min(max(start[k], start[k - 1] + 1), time.size - (start.size - 1 - k))
    return start


def _between(values: FloatArray, turning: FloatArray, start: IntArray) -> FloatArray:
    """Keep each half-cycle between its turning points: slip against its direction is noise."""
    if turning.size < 2:
        return values
    # The first half-cycle may start with a rest and the last ends nowhere in particular: only their reversal binds.
    away = np.copysign(np.inf, np.diff(turning))
    ends = np.concatenate([-away[:1], turning[1:], -away[-1:]])
    n = np.diff(start)
    return np.clip(values, np.repeat(np.minimum(ends[:-1], ends[1:]), n), np.repeat(np.maximum(ends[:-1], ends[1:]), n))
