"""Single samples of a channel: empty cells, clipping, standing still."""

import numpy as np

from shj_bayes.recording import limits
from shj_bayes.recording.recording import BoolArray, Finding, FloatArray


def runs(mask: BoolArray) -> list[tuple[int, int]]:
    """Half-open index ranges over which a mask is True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def complete_rows(channels: tuple[FloatArray, FloatArray]) -> tuple[BoolArray, list[Finding]]:
    """Rows of displacement and force (NaN where empty) to keep: without empty ends, and holes too long to be filled."""
    empty = np.isnan(channels[0]) | np.isnan(channels[1])
    keep = np.ones(empty.size, dtype=np.bool_)
    ends = holes = 0
    for a, b in runs(empty):
        if a == 0 or b == empty.size:
            keep[a:b], ends = False, ends + b - a
        elif b - a > limits.FILL_RUN:
            keep[a:b], holes = False, holes + b - a
    findings = []
    if ends:
        findings.append(Finding("empty-ends", "repaired", f"{ends} rows without numbers at the ends left out", ends))
    if holes:
        message = f"{holes} rows left out, in holes of more than {limits.FILL_RUN} rows; each hole is now a gap in time"
        findings.append(Finding("holes", "warning", message, holes))
    return keep, findings


def fill(
    time_s: FloatArray, values: FloatArray, name: str, no_reading: BoolArray
) -> tuple[FloatArray, BoolArray, list[Finding]]:
    """Bridge short runs of cells without a reading (NaN) of a channel by a straight line.

    `no_reading` are those among them that held a number, which has been said. Values without NaN, which samples are no
    evidence, all of shape (n_samples,), and findings.
    """
    filled = np.isnan(values)
    count, empty = int(np.count_nonzero(filled)), int(np.count_nonzero(filled & ~no_reading))
    if count in (0, values.size):
        return values, filled, []
    bridged = np.where(filled, np.interp(time_s, time_s[~filled], values[~filled]), values)
    share = count / values.size
    if share > limits.BAD_CELL_SHARE:
        message = (
            f"{name}: {count} cells are empty or no readings ({share:.2%}); allowed are {limits.BAD_CELL_SHARE:.0%}; "
            "export the test anew, or take these rows out of the file (steps of time may differ)"
        )
        return bridged, filled, [Finding("empty-cells", "unusable", message, count)]
    message = (
        f"{name}: {empty} empty cells ({empty / values.size:.2%}) bridged by straight lines and not used as evidence"
    )
    return bridged, filled, [Finding("empty-cells", "repaired", message, empty)] if empty else []


def clipped(values: FloatArray, other: FloatArray) -> BoolArray:
    """Find samples at which a channel stands still at its own extreme while the other moves: it cannot go further.

    Exactly equal runs at the extreme only: a plateau of friction carries noise, a rounded channel has equal runs at
    every level, and a noise-free plateau is approached gradually. Arrays have shape (n_samples,).
    """
    found = np.zeros(values.size, dtype=np.bool_)
    extent, motion = float(np.ptp(values)), float(np.ptp(other))
    if extent <= 0.0 or motion <= 0.0:
        return found
    equal = [(a, b + 1) for a, b in runs(np.diff(values) == 0.0) if b + 1 - a >= limits.CLIP_RUN]
    for level in (float(values.min()), float(values.max())):
        at = [(a, b) for a, b in equal if values[a] == level]
        there, elsewhere = sum(b - a for a, b in at), sum(b - a for a, b in equal) - sum(b - a for a, b in at)
        opposite = sum(b - a for a, b in equal if values[a] in (values.min(), values.max()) and values[a] != level)
        if there < max(2 * limits.CLIP_RUN, limits.CLIP_SHARE * values.size) or elsewhere - opposite > 0.2 * there:
            continue
        entry = [abs(values[a] - values[a - 1]) / extent for a, _ in at if a > 0]
        moved = sum(float(np.ptp(other[a:b])) for a, b in at) / len(at)
        if entry and float(np.median(entry)) > 1e-4 and moved > limits.CLIP_MOTION * motion:
            found |= values == level
    return found


def stopped(force_kN: FloatArray, displacement_mm: FloatArray) -> BoolArray:
    """Find samples at which the force holds one value while the device moves: its channel has stopped.

    Long runs of exactly equal values within the range, in a channel that hardly repeats a value elsewhere. Arrays have
    shape (n_samples,).
    """
    found = np.zeros(force_kN.size, dtype=np.bool_)
    extremes, motion = (force_kN.min(), force_kN.max()), float(np.ptp(displacement_mm))
    equal = [(a, b + 1) for a, b in runs(np.diff(force_kN) == 0.0) if b + 1 - a >= limits.CLIP_RUN]
    long = [
        (a, b)
        for a, b in equal
        if b - a >= limits.STOPPED_RUN
        and force_kN[a] not in extremes
        and float(np.ptp(displacement_mm[a:b])) > limits.CLIP_MOTION * motion
    ]
    # A rounded channel, and a plateau without noise, repeat values in every half-cycle.
    if sum(b - a for a, b in equal) > 1.2 * sum(b - a for a, b in long) or len(long) > limits.STOPS:
        return found
    for a, b in long:
        found[a:b] = True
    return found
