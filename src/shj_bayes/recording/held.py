"""A channel slower than the table: each of its readings stands in several rows, and is new in the first of them."""

from dataclasses import dataclass

import numpy as np

from shj_bayes.recording import limits
from shj_bayes.recording.motion import IntArray
from shj_bayes.recording.noise import resolution_of
from shj_bayes.recording.recording import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class HeldReadings:
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
    period = next((p for kind in limits.HELD if (p := _period(rows, step[rows], count, *kind))), None)
    if period is None:
        return None
    fresh = np.zeros(values.size, dtype=np.bool_)
    fresh[known[rows]] = True
    return HeldReadings(period, fresh, _ages(rows.astype(np.float64), period))


def _period(
    rows: IntArray, steps: FloatArray, count: float, least: float, share: float, shortest: float
) -> float | None:
    """Rows from one reading to the next, where both differ by so many counts from those before; None if unlike.

    In at least a `share` of all rows, and at least the `shortest`.
    """
    moves = steps > least * count
    gaps = np.diff(rows)[moves[1:] & moves[:-1]]
    if gaps.size < limits.BENDS:
        return None
    even = gaps <= 2 * np.median(gaps) + 1
    period = float(np.mean(gaps[even]))
    alike = np.mean(even) >= limits.BENDS_AGREE and np.sum(gaps[even]) > share * rows[-1]
    return period if alike and shortest <= period <= limits.HELD_MOST else None


def _ages(rows: FloatArray, period: float) -> FloatArray:
    """Age of each reading in the row that holds it first, rows, where the channel has an even clock of its own; else 0.

    A reading is written in the first row after it was taken, so that one line of even moments has all rows less than
    one row behind it; the youngest was taken as its row was written.
    """
    gaps = np.diff(rows)
    number = np.append(0.0, np.cumsum(np.where(gaps <= np.ceil(period), 1.0, np.round(gaps / period))))
    late = rows - np.polyval(np.polyfit(number, rows, 1), number)
    late -= np.percentile(late, 1)
    even = np.mean(late < 1.05) > 0.99
    return np.where((late > 0.02) & (late < 1.0), late, 0.0) if even else np.zeros(rows.size)
