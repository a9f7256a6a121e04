"""Single samples of a channel: empty cells, held readings, spikes, clipping, standing still."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from shj_bayes._util.arrays import BoolArray, FloatArray, IntArray
from shj_bayes.recording import limits
from shj_bayes.recording.clock import step_spread
from shj_bayes.recording.recording import Finding, noise_of, resolution_of

TOGETHER = 4096  # values looked at in one call


def runs(mask: BoolArray) -> list[tuple[int, int]]:
    """Half-open index ranges over which a mask is True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def complete_rows(x: FloatArray, f: FloatArray, findings: list[Finding]) -> BoolArray:
    """Rows of displacement and force (NaN where empty) to keep: without empty ends, and holes too long to be filled."""
    empty = np.isnan(x) | np.isnan(f)
    keep = np.ones(empty.size, dtype=np.bool_)
    ends = holes = 0
    for a, b in runs(empty):
        if a == 0 or b == empty.size:
            keep[a:b], ends = False, ends + b - a
        elif b - a > limits.FILL_RUN:
            keep[a:b], holes = False, holes + b - a
    if ends:
        findings.append(Finding("empty-ends", "repaired", f"{ends} rows without numbers at the ends left out", ends))
    if holes:
        message = f"{holes} rows left out, in holes of more than {limits.FILL_RUN} rows; each hole is now a gap in time"
        findings.append(Finding("holes", "warning", message, holes))
    return keep


def fill(
    time_s: FloatArray, values: FloatArray, name: str, no_reading: BoolArray, findings: list[Finding]
) -> tuple[FloatArray, BoolArray]:
    """Bridge short runs of cells without a reading (NaN) of a channel by a straight line.

    `no_reading` are those among them that held a number, which has been said. Values without NaN, and which samples are
    no evidence, all of shape (n_samples,).
    """
    filled = np.isnan(values)
    count, empty = int(np.count_nonzero(filled)), int(np.count_nonzero(filled & ~no_reading))
    if count in (0, values.size):
        return values, filled
    if count > limits.BAD_CELL_SHARE * values.size:
        message = (
            f"{name}: {count} cells are empty or no readings ({count / values.size:.2%}); allowed are "
            f"{limits.BAD_CELL_SHARE:.0%}; export the test anew, or take these rows out of the file (steps of time may "
            "differ)"
        )
        findings.append(Finding("empty-cells", "unusable", message, count))
    elif empty:
        share = f"{name}: {empty} empty cells ({empty / values.size:.2%})"
        message = f"{share} bridged by straight lines and not used as evidence"
        findings.append(Finding("empty-cells", "repaired", message, empty))
    return np.where(filled, np.interp(time_s, time_s[~filled], values[~filled]), values), filled


def _equal(values: FloatArray) -> list[tuple[int, int]]:
    """Half-open ranges of rows that hold one value, long enough not to be chance."""
    return [(a, b + 1) for a, b in runs(np.diff(values) == 0.0) if b + 1 - a >= limits.CLIP_RUN]


def _length(ranges: Iterable[tuple[int, int]]) -> int:
    return sum(b - a for a, b in ranges)


def clipped(values: FloatArray, other: FloatArray) -> BoolArray:
    """Find samples at which a channel stands still at its own extreme while the other moves: it cannot go further.

    Exactly equal runs at the extreme only: a plateau of friction carries noise, a rounded channel has equal runs at
    every level, and a noise-free plateau is approached gradually. Arrays have shape (n_samples,).
    """
    found = np.zeros(values.size, dtype=np.bool_)
    extent, motion = float(np.ptp(values)), float(np.ptp(other))
    if extent <= 0.0 or motion <= 0.0:
        return found
    equal, extremes = _equal(values), (float(values.min()), float(values.max()))
    elsewhere = _length((a, b) for a, b in equal if values[a] not in extremes)
    for level in extremes:
        at = [(a, b) for a, b in equal if values[a] == level]
        there = _length(at)
        if there < max(2 * limits.CLIP_RUN, limits.CLIP_SHARE * values.size) or elsewhere > 0.2 * there:
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
    extremes, least = (force_kN.min(), force_kN.max()), limits.CLIP_MOTION * float(np.ptp(displacement_mm))
    equal = _equal(force_kN)
    long = [(a, b) for a, b in equal if b - a >= limits.STOPPED_RUN and force_kN[a] not in extremes]
    long = [(a, b) for a, b in long if float(np.ptp(displacement_mm[a:b])) > least]
    # A rounded channel, and a plateau without noise, repeat values in every half-cycle.
    held, n = _length(long), force_kN.size
    others = np.count_nonzero(np.diff(force_kN) == 0.0) - (held - len(long))
    noisy = held < limits.STOPPED_SHARE * n and others < limits.STOPPED_EQUAL * n
    if _length(equal) <= 1.2 * held and (len(long) <= limits.STOPS or noisy):
        for a, b in long:
            found[a:b] = True
    return found


class HeldReadings(NamedTuple):
    """Which readings of a channel are new, and how old each was when it was written."""

    period: float  # rows from one reading to the next
    fresh: BoolArray  # shape (n_rows,): True in the row that holds a reading first
    age: FloatArray  # shape (n_fresh,): of the fresh ones, rows, from 0 up to 1

    def at_readings(self, values: FloatArray) -> FloatArray:
        """Give another channel, or the time, shape (n_rows,), at the moments of the readings, shape (n_fresh,)."""
        row = np.flatnonzero(self.fresh)
        before = values[np.maximum(row - 1, 0)]
        return np.where(self.age > 0.0, (1.0 - self.age) * values[row] + self.age * before, values[row])


def held(values: FloatArray) -> HeldReadings | None:
    """Find out whether the readings of a channel, shape (n_rows,), NaN where empty, are held for several rows.

    A channel that changes by many counts between two of its readings does not stand still between them, unless it was
    not read. Where it changes by a few counts it is slow or at rest, and where the rows without a change are few in
    some places and many in others (stick-slip, steps, a perfectly plastic plateau) it is the device that stands still.
    None where it is read in every row.
    """
    known = np.flatnonzero(np.isfinite(values))
    if known.size < limits.MIN_SAMPLES:
        return None
    step = np.append(0.0, np.abs(np.diff(values[known])))
    rows = np.append(0, np.flatnonzero(step))  # the first row is new
    new = values[known[rows]]
    rows = rows[np.append([True, True], new[2:] != new[:-2])[: rows.size]]  # after a dropout the old reading comes back
    count = resolution_of(values[known])
    for least, share, shortest in limits.HELD:
        moves = step[rows] > least * count
        gaps = np.diff(rows)[moves[1:] & moves[:-1]]
        if gaps.size < limits.BENDS:
            continue
        even = gaps <= 2 * np.median(gaps) + 1
        period = float(np.mean(gaps[even]))
        alike = np.mean(even) >= limits.BENDS_AGREE and np.sum(gaps[even]) > share * rows[-1]
        if alike and shortest <= period <= limits.HELD_MOST:
            break
    else:
        return None
    fresh = np.zeros(values.size, dtype=np.bool_)
    fresh[known[rows]] = True
    # A channel with an even clock of its own writes a reading in the first row after it was taken, so that one line of
    # even moments has all rows less than one row behind it; the youngest was taken as its row was written.
    gaps = np.diff(rows)
    number = np.append(0.0, np.cumsum(np.where(gaps <= np.ceil(period), 1.0, np.round(gaps / period))))
    late = rows - np.polyval(np.polyfit(number, rows, 1), number)
    late -= np.percentile(late, 1)
    aged = (late > 0.02) & (late < 1.0) & bool(np.mean(late < 1.05) > 0.99)
    return HeldReadings(period, fresh, np.where(aged, late, 0.0))


def not_readings(
    time_s: FloatArray, displacement_mm: FloatArray, force_kN: FloatArray
) -> tuple[BoolArray, BoolArray, list[int]]:
    """Find what is no reading in two channels, shape (n_rows,), NaN where empty; times increase strictly.

    Cells of displacement and force that are no readings, shape (n_rows,), and the rows after which the displacement
    goes on elsewhere while the force goes on.
    """
    channels = displacement_mm, force_kN
    # A force may well begin and end at 0 with a jump; a displacement does not.
    bad = np.array(
        [_sentinels(channels[0], limits.SPIKE_RANGE, True), _sentinels(channels[1], limits.SPIKE_FORCE, False)]
    )
    jumps: list[int] = []
    # Of points picked off a figure the next may be anywhere.
    rounds = 0 if time_s.size < limits.MIN_SAMPLES or step_spread(time_s) > 1.0 else limits.SPIKE_ROUNDS
    for _ in range(rounds):  # what was found no longer hides the rest
        known = [np.isfinite(values) & ~wrong for values, wrong in zip(channels, bad, strict=True)]
        if min(map(np.count_nonzero, known)) < limits.MIN_SAMPLES:
            break
        x, f = (np.interp(time_s, time_s[good], values[good]) for values, good in zip(channels, known, strict=True))
        course, pull = _Course(time_s, x, limits.SPIKE_RANGE), _Course(time_s, f, limits.SPIKE_FORCE, still=True)
        if not course.is_motion:
            break
        before = np.count_nonzero(bad)
        off_x, jumps = _off_course(course, pull)
        off_f, _ = pull.excursions(~_turning(x, off_x, course.limit))
        bad |= [off_x, off_f]
        for values, wrong in zip(channels, bad, strict=True):  # a dropout to 0 as 0 was passed
            common, count = np.unique(values[wrong], return_counts=True)
            for level in common[count > 1].tolist():
                same = values == level
                if np.count_nonzero(same & ~wrong) <= np.count_nonzero(same & wrong):
                    wrong[same] = True
        if np.count_nonzero(bad) == before:
            break
    return bad[0], bad[1], jumps


class _Course:
    """Changes of a channel, shape (n_rows,), from row to row, apart from its own course."""

    def __init__(self, time_s: FloatArray, values: FloatArray, share: float, *, still: bool = False) -> None:
        """Let less than a `share` of the range pass; a force, which is `still`, has to come back for itself."""
        self.values, self.still, step = values, still, np.diff(values)
        lasted = np.diff(time_s) / np.median(np.diff(time_s))
        self.apart = lasted > limits.GAP_STEPS
        step[self.apart] = 0.0
        # The displacement moves on while it is not read.
        self.trend = np.zeros(step.size) if still else _median_of_7(step)
        self.base = values - np.append(0.0, np.cumsum(self.trend))  # the course taken off
        # Clocks that are printed with few digits misplace samples: of changes by row and by time the less unusual one.
        by_row, by_time = _outside(step), _outside(step / np.maximum(lasted, 0.5))
        self.excess = np.where(np.abs(by_row) < np.abs(by_time), by_row, by_time)
        self.excess[self.apart] = 0.0
        self.core = float(np.diff(np.percentile(values, [2, 98]))[0])
        # The median of the changes alone: what is no reading must not count as noise, nor does it in a rounded channel.
        self.noise = max(noise_of(values, 0.0), resolution_of(values) / float(np.sqrt(12.0)))
        self.limit = max(limits.SPIKE_NOISE * self.noise, share * self.core)
        bend = np.abs(np.diff(step, prepend=step[0]))
        some = np.flatnonzero(np.abs(self.excess) > self.limit)
        # A low quantile over more rows where much is wrong: each row that is no reading bends the channel three times.
        usual = np.minimum(_near(bend, 50, 7, some), 2.5 * _near(bend, 35, 15, some))
        self.least = np.full(step.size, self.limit)
        self.least[some] = np.maximum(limits.SPIKE_USUAL * usual, self.limit)
        self.big = np.flatnonzero(np.abs(self.excess) > self.least)

    @property
    def is_motion(self) -> bool:
        """Whether the ordinary changes make up the motion: where it goes in steps or pulses, a jump says nothing."""
        step = np.diff(self.values)
        step[self.big] = self.trend[self.big]
        return float(np.ptp(np.cumsum(step))) > 0.5 * self.core > 0.0

    def excursions(self, plain: BoolArray, leaves: BoolArray | None = None) -> tuple[BoolArray, list[int]]:
        """Find the rows between a jump away and one back, and the jumps that belong to none.

        At changes that are `plain`, or where the other channel `leaves` its course too and the rows hold one value. The
        shortest ones first, so that a jump that is missing does not exchange what is on and off the course.
        """
        off, big, base, size = np.zeros(self.values.size, dtype=np.bool_), self.big, self.base, np.abs(self.excess)
        pairs = []
        for further in range(1, limits.FILL_RUN + 1):
            first, last = big[:-further], big[further:]
            least = np.maximum(self.limit, limits.SPIKE_RETURN * np.minimum(size[first], size[last]))
            back = np.abs(base[last + 1] - base[first]) <= least
            pairs.append(np.column_stack([first, last])[back & (last - first <= limits.FILL_RUN)])
        found, left = np.concatenate(pairs), set(big.tolist())
        calm = np.pad(size <= self.limit, 1, constant_values=True)
        for a, b in found[np.argsort(found[:, 1] - found[:, 0], kind="stable")].tolist():
            rows = slice(a + 1, b + 1)
            # All rows between two changes are off the course: those of a force, which may ring, in full.
            sides, share = (base[[a, b + 1]], 1.0) if self.still else (base[[a]], 0.5)
            away = np.min(np.abs(base[rows] - sides[:, None])) > share * self.limit
            if not {a, b} <= left or off[rows].any() or not away:
                continue
            left -= set(big[np.searchsorted(big, a) : np.searchsorted(big, b) + 1].tolist())
            dead = leaves is not None and leaves[a] and leaves[b] and np.ptp(self.values[rows]) == 0.0
            # A course that goes to and fro on both sides rings.
            off[rows] = (plain[a : b + 1].all() or dead) and (calm[a] or calm[b + 2])
        return off, sorted(left)


def _off_course(course: _Course, pull: _Course) -> tuple[BoolArray, list[int]]:
    """Rows at which the displacement is no reading, and changes from which it does not come back."""
    goes_on = np.abs(pull.excess) <= pull.limit
    leaves = np.zeros(goes_on.size, dtype=np.bool_)
    leaves[pull.big] = True
    off, alone = course.excursions(goes_on, leaves)
    n, excess, least, gone = off.size, np.abs(course.excess), course.least, set[int]()
    for k in (k for k in alone if goes_on[k]):
        if k < limits.FILL_RUN:  # what is before the first jump, or behind the last, has one jump only
            off[: k + 1] = True
        elif n - 1 - k <= limits.FILL_RUN:
            off[k + 1 :] = True
        # A jump beyond doubt, with an ordinary course before and after it.
        elif excess[k] > limits.JUMP * least[k] and excess[[k - 2, k - 1, k + 1, k + 2]].max() <= least[k]:
            gone.add(k)
    # So are changes that are many times as large as nearly all others where the channel moves.
    size = np.abs(np.diff(course.values))
    moving = size[size > max(3.0 * course.noise, 1e-3 * course.core)]
    if moving.size >= limits.MIN_SAMPLES:
        most = max(limits.JUMP_SPEED * float(np.percentile(moving, 95)), limits.JUMP_RANGE * course.core)
        gone |= set(np.flatnonzero((size > most) & ~course.apart & goes_on).tolist())
    return off, sorted(gone)


def _outside(step: FloatArray) -> FloatArray:
    """By how much a change is outside both of its neighbours: 0 in what speeds up or slows down, and at the ends."""
    before, after = np.append(step[0], step[:-1]), np.append(step[1:], step[-1])
    return np.asarray(step - np.clip(step, np.minimum(before, after), np.maximum(before, after)))


def _median_of_7(values: FloatArray) -> FloatArray:
    """Median of each value and three on both sides; beyond the ends the last value stays."""
    windows = sliding_window_view(np.pad(values, 3, mode="edge"), 7)
    parts = [windows[first : first + TOGETHER] for first in range(0, values.size, TOGETHER)]
    return np.concatenate([np.partition(part, 3, axis=1)[:, 3] for part in parts])


def _near(sizes: FloatArray, percent: float, reach: int, at: IntArray) -> FloatArray:
    """Percentile over so many values on both sides of each, the largest of those near some places."""
    windows, around = sliding_window_view(sizes, 2 * reach + 1), np.arange(-reach, reach + 1)
    k, out = int((2 * reach + 1) * percent / 100), [np.empty(0)]
    for some in np.array_split(at, -(-at.size // TOGETHER) or 1):
        middle = np.clip(some[:, None] + around, reach, sizes.size - 1 - reach) - reach
        inner, place = np.unique(middle, return_inverse=True)
        found = np.partition(windows[inner], k, axis=1)[:, k]
        out.append(found[place.reshape(-1, around.size)].max(axis=1))
    return np.concatenate(out)


def _turning(x: FloatArray, off: BoolArray, limit: float) -> BoolArray:
    """Mark the changes beside which the displacement, where it was read, turns: a force may go and come back there."""
    index, reach = np.arange(x.size), 3
    way = np.pad(np.interp(index, index[~off], x[~off]), reach, mode="edge")
    behind, ahead = way[reach:-reach] - way[: -2 * reach], way[2 * reach :] - way[reach:-reach]
    turns = (ahead * behind < 0) & (np.minimum(np.abs(ahead), np.abs(behind)) > 0.3 * limit)
    return np.asarray(turns[1:] | turns[:-1])


def _sentinels(values: FloatArray, share: float, ends: bool) -> BoolArray:
    """Mark values far outside all others, and exactly 0 (with `ends`, there too), that are left by jumps back."""
    bad = np.zeros(values.size, dtype=np.bool_)
    known = np.isfinite(values)
    if np.count_nonzero(known) < limits.MIN_SAMPLES:
        return bad
    low, middle, high = np.percentile(values[known], [35, 50, 65])
    away = np.abs(values - middle)
    far = known & (away > limits.FAR * max(2.0 * float(np.median(away[known])), high - low))
    common, count = np.unique(values[far], return_counts=True)
    for level in [*common[np.argsort(-count)][: limits.SENTINELS].tolist(), 0.0]:
        at = np.flatnonzero(known & ~bad)
        left = values[at]
        here = left == level
        if not 0 < np.count_nonzero(here) <= 0.5 * at.size:
            continue
        touched = here[1:] | here[:-1]
        usual = 0.0 if touched.all() else 1.5 * float(np.percentile(np.abs(np.diff(left))[~touched], 99))
        core = float(np.diff(np.percentile(left[~here], [2, 98]))[0])
        first, last = np.transpose(runs(here))
        before, after = left[np.maximum(first - 1, 0)], left[np.minimum(last, at.size - 1)]
        if ends or level != 0.0:
            before, after = np.where(first == 0, after, before), np.where(last == at.size, before, after)
        jump = np.minimum(np.abs(before - level), np.abs(after - level))
        back = np.abs(after - before) <= 0.5 * jump + usual * (last - first)
        gone = (jump > max(usual, share * core)) & back
        bad[at[here]] = np.repeat(gone, last - first)
    return bad
