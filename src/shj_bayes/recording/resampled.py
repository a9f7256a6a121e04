"""Channels that were interpolated to a higher rate: most of their samples lie on straight lines between a few."""

from dataclasses import dataclass

import numpy as np

from shj_bayes.recording import limits
from shj_bayes.recording.recording import Finding, FloatArray, Recording


@dataclass(frozen=True)
class Resampled:
    """How a channel was interpolated."""

    period: float  # samples from one bend to the next
    share: float  # of the samples that lie on a straight line between their neighbours


def resampled_findings(recording: Recording, n_half: int) -> list[Finding]:
    """Say which channels of a recording of so many half-cycles were interpolated, from what, and what to do."""
    fewest = max(limits.BENDS, limits.BENDS_PER_HALF_CYCLE * n_half)
    channels = {"displacement": recording.displacement_mm, "force": recording.force_kN}
    found = {name: one for name, values in channels.items() if (one := resampled(recording, values, fewest))}
    if not found:
        return []
    one, rate = list(found.values())[-1], recording.rate_Hz
    message = (
        f"{' and '.join(found)}: {one.share:.0%} of the samples lie on straight lines, which bend at every "
        f"{one.period:.3g}th sample: recorded at about {rate / one.period:.3g} Hz and interpolated to {rate:.4g} Hz, "
        f"{one.period:.3g} times as many. Interpolated samples are no evidence, and intervals would come out too "
        f"narrow; give the file as it was recorded, or every {round(one.period)}th row of this one"
    )
    return [Finding("resampled", "warning", message)]


def resampled(recording: Recording, values: FloatArray, fewest: int) -> Resampled | None:
    """Find a channel, shape (n_samples,), that was interpolated linearly, and bends `fewest` times at least.

    What was interpolated bends at the recorded samples alone: at one sample, or where that fell between two, at both in
    the same direction, and always so many samples apart. Noise bends everywhere. Counts of a converter bend to and
    fro, and by no more than a count or two, which is straight here. None where it was not.
    """
    bend = _bends(recording, values)
    bent = np.abs(bend) > _straight(values)
    first = np.flatnonzero(bent & ~np.concatenate([[False], bent[:-1]]))
    last = np.flatnonzero(bent & ~np.concatenate([bent[1:], [False]]))
    if first.size < fewest:
        return None
    sharp = (last - first <= 1) & (bend[first] * bend[last] > 0)
    place = first + (last - first) * np.abs(bend[last]) / (np.abs(bend[first]) + np.abs(bend[last]))
    gaps = np.diff(place)[sharp[:-1] & sharp[1:]]
    if gaps.size < limits.BENDS_AGREE * (first.size - 1):
        return None
    middle = float(np.quantile(gaps, 0.5, method="lower"))
    period = float(np.mean(gaps[np.abs(gaps - middle) <= limits.BEND_WITHIN * middle]))
    steps = np.round(gaps / period)
    agree = (steps > 0) & (np.abs(gaps / period - steps) < limits.BEND_WITHIN)
    enough = np.count_nonzero(agree) >= limits.BENDS_AGREE * (first.size - 1)
    most = float(np.sum(gaps[agree])) > 0.5 * values.size
    return Resampled(period, float(np.mean(~bent[1:-1]))) if enough and most and period > limits.BEND_PERIOD else None


def _bends(recording: Recording, values: FloatArray) -> FloatArray:
    """Twice the distance of each sample from the line between its neighbours; 0 at the ends and beside gaps in time.

    Clocks that are printed with few digits misplace samples, so that of lines over time and over the row counts the
    one that is nearer.
    """
    t, out = recording.time_s, np.zeros(values.size)
    before, after = values[1:-1] - values[:-2], values[2:] - values[1:-1]
    weight = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    by_row, by_time = after - before, 2.0 * (weight * after - (1.0 - weight) * before)
    out[1:-1] = np.where(np.abs(by_row) < np.abs(by_time), by_row, by_time)
    late = np.flatnonzero(recording.restarts[1:]) + 1
    out[late] = out[late - 1] = 0.0
    return out


def _straight(values: FloatArray) -> float:
    """Largest bend that rounding can explain.

    The resolution is the smallest distance of two of the larger values: numbers printed with so many digits are
    rounded most where they are large, by ten times as much on one side of a power of ten.
    """
    size = np.abs(values[:: max(1, values.size // limits.SKETCH_SAMPLES)])
    levels = np.unique(size[size >= np.median(size)])
    steps, fuzz = np.diff(levels), 1e-9 * float(np.ptp(values))
    steps = steps[steps > fuzz]
    return limits.BEND_COUNTS * max(float(np.min(steps)) if steps.size else 0.0, fuzz)
