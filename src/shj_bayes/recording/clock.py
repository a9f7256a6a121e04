"""The clock of a recording: rows without time, repeats and backward jumps, jitter, gaps."""

from bisect import bisect_left
from itertools import pairwise

import numpy as np

from shj_bayes.errors import RecordingError
from shj_bayes.recording import limits
from shj_bayes.recording.recording import BoolArray, Finding, FloatArray


def orderly_rows(time_s: FloatArray, name: str) -> tuple[BoolArray, list[Finding]]:
    """Mark the rows whose times (NaN where there is none) increase, as many as can be kept.

    `RecordingError` where more rows than a small share are out of order: then the clock is broken, not a few rows.
    """
    findings: list[Finding] = []
    keep = np.isfinite(time_s)
    missing = int(np.count_nonzero(~keep))
    if missing:
        findings.append(Finding("time-missing", "repaired", f"{missing} rows without a time left out", missing))
    index = np.flatnonzero(keep)
    times = time_s[index]
    if times.size < 2:
        raise RecordingError(f"{name}: {times.size} rows have a time; at least 2 are needed; check the time column")
    steps = np.diff(times)
    if np.all(steps > 0):
        return keep, findings
    repeats, back = int(np.count_nonzero(steps == 0)), int(np.count_nonzero(steps < 0))
    kept = longest_increasing(times)
    dropped = times.size - kept.size
    if dropped > max(3, limits.BAD_TIME_SHARE * times.size):
        raise RecordingError(_broken_clock(name, times, steps, repeats, back, dropped))
    keep[:] = False
    keep[index[kept]] = True
    what = " and ".join(
        text for text, n in ((f"repeats {repeats} times", repeats), (f"jumps back {back} times", back)) if n
    )
    first = times[int(np.flatnonzero(steps <= 0)[0])]
    code = "time-jumps-back" if back else "time-repeats"
    message = f"time {what}, first after {first:.6g} s; {dropped} rows left out, the fewest that make it increase"
    findings.append(Finding(code, "repaired", message, dropped))
    return keep, findings


def restarts(time_s: FloatArray, displacement_mm: FloatArray, force_kN: FloatArray) -> list[int]:
    """Rows at which the clock begins again, as where several runs were written into one file; shape (n_rows,).

    Time falls back there to before the middle of the run, and stays back. A clock that falls back while displacement
    and force go on is a counter that overflowed, and is left to `orderly_rows`.
    """
    index = np.flatnonzero(np.isfinite(time_s))
    times = time_s[index]
    found: list[int] = []
    begin = 0
    for k in (np.flatnonzero(np.diff(times) < 0) + 1).tolist():
        if k - begin < limits.MIN_SAMPLES or times.size - k < limits.MIN_SAMPLES:
            continue
        first, last, after = (
            float(np.median(times[a : a + limits.MIN_SAMPLES])) for a in (begin, k - limits.MIN_SAMPLES, k)
        )  # medians, since single times may be wrong
        if after < 0.5 * (first + last) and not _goes_on(displacement_mm, force_kN, int(index[k])):
            found.append(int(index[k]))
            begin = k
    return found


def _goes_on(displacement_mm: FloatArray, force_kN: FloatArray, row: int) -> bool:
    """Whether the device moves through a row as if nothing had happened: same speed, no step of the force."""
    near = slice(max(0, row - 8), row + 8)
    moves, changes = np.diff(displacement_mm[near]), np.diff(force_kN[near])
    middle = row - near.start - 1
    usual = float(np.nanmedian(moves))
    noise = 1.5 * float(np.nanmedian(np.abs(moves - usual)))
    still = abs(usual) <= noise or abs(usual) < 1e-4 * float(np.nanmax(displacement_mm) - np.nanmin(displacement_mm))
    jump = abs(moves[middle] - usual) > 6 * noise + 0.5 * abs(usual)
    step = abs(changes[middle]) > 0.05 * float(np.nanmax(force_kN) - np.nanmin(force_kN))
    return not (still or jump or step)


def going_on(time_s: FloatArray, displacement_mm: FloatArray, force_kN: FloatArray) -> tuple[FloatArray, list[int]]:
    """Let a clock go on that begins again with each cycle of one run; shape (n_rows,).

    Times, and the rows at which they began again at their own first value while the device moved on. The first sample
    of a cycle that is the last of the one before has no time.
    """
    index = np.flatnonzero(np.isfinite(time_s))
    times = time_s[index]
    steps = np.diff(times)
    if not np.any(steps > 0):
        return time_s, []
    step = float(np.median(steps[steps > 0]))
    falls = np.flatnonzero((steps < -0.5 * limits.CYCLE_ROWS * step) & (np.abs(times[1:] - times[0]) < 1.5 * step)) + 1
    if not falls.size or falls.size > min(limits.MAX_CYCLES, times.size // limits.CYCLE_ROWS):
        return time_s, []
    x, f = displacement_mm[index], force_kN[index]
    # A time that falls back for a row or two, and goes on from where it was, begins no cycle.
    near = 2.0 * limits.CYCLE_ROWS * step
    falls = falls[[float(np.median(times[k : k + limits.CYCLE_ROWS])) - times[k] < near for k in falls]]
    found = [int(k) for k in falls if _in_cycle(x, f, int(k))]
    out, edges = times.copy(), [*(int(k) for k in falls), times.size]
    for a, b in pairwise(edges):
        if a in found:
            doubled = x[a] == x[a - 1] and f[a] == f[a - 1]
            out[a:b] += out[a - 1] + (0.0 if doubled else step) - times[a]
            if doubled:
                out[a] = np.nan
    moved = time_s.copy()
    moved[index] = out
    return moved, [int(index[k]) for k in found]


def _in_cycle(x: FloatArray, f: FloatArray, row: int) -> bool:
    """Whether neither channel jumps at a row, and the device is not at rest where it began, as at the end of a run."""
    near = slice(max(0, row - limits.CYCLE_ROWS), row + limits.CYCLE_ROWS)
    at = row - near.start - 1
    for values in (x, f):
        moves = np.abs(np.diff(values[near]))
        extent = float(np.nanmax(values) - np.nanmin(values))
        usual = float(np.nanmax(np.delete(moves, at), initial=0.0))
        if not moves[at] <= max(2.0 * usual, limits.CYCLE_JUMP * extent):
            return False
    extent = float(np.nanmax(x) - np.nanmin(x))
    at_home = abs(x[row] - x[0]) < limits.REST_HOME * extent
    sides = (x[max(0, row - limits.CYCLE_ROWS) : row], x[row : row + limits.CYCLE_ROWS])
    still = min(abs(float(side[-1] - side[0])) for side in sides) < limits.CYCLE_STILL * extent
    return not (at_home and still)


def follow_on(time_s: FloatArray, rows: list[int]) -> tuple[FloatArray, list[float]]:
    """Put runs behind one another on one clock; `rows` are the first of each run after the first.

    Times, shape (n_rows,), s, and what was added to those of each run after the first; 0 where its clock goes on.
    """
    out, shifts = time_s.copy(), list[float]()
    for a, b in pairwise([*rows, time_s.size]):
        before, own = out[:a][np.isfinite(out[:a])], out[a:b][np.isfinite(out[a:b])]
        if before.size < 2 or own.size < 1:
            shifts.append(0.0)
            continue
        last = before[-limits.MIN_SAMPLES :]
        step = float(np.median(np.abs(np.diff(last))))
        end = float(np.median(last)) + last.size * step
        shifts.append(0.0 if own[0] > before[-1] else end + limits.RESTART_GAP_STEPS * step - float(own[0]))
        out[a:b] += shifts[-1]
    return out, shifts


def _broken_clock(name: str, times: FloatArray, steps: FloatArray, repeats: int, back: int, dropped: int) -> str:
    """Say which kind of broken clock it is and what to do."""
    allowed = f"allowed are {limits.BAD_TIME_SHARE:.0%}"
    if repeats >= back * 5:
        return (
            f"{name}: time repeats in {repeats} of {times.size} rows ({allowed}); it was printed with too few digits, "
            "or rows are there twice; export more digits and each row once, or give the sampling rate of the rows with "
            "--rate HZ"
        )
    row = int(np.flatnonzero(steps < 0)[0])
    return (
        f"{name}: time jumps back {back} times, first from {times[row]:.6g} s to {times[row + 1]:.6g} s at row "
        f"{row + 2}; {dropped} of {times.size} rows would be lost ({allowed}); export the time of the test anew, or "
        "one file for each run"
    )


def longest_increasing(values: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Find the indices of a longest strictly increasing subsequence of values without NaN, shape (n,).

    A single time that is far too large costs one row, not all that follow it.
    """
    tails: list[float] = []
    at: list[int] = []
    previous = np.full(values.size, -1, dtype=np.int64)
    for i, value in enumerate(values.tolist()):
        k = bisect_left(tails, value)
        if k == len(tails):
            tails.append(value)
            at.append(i)
        else:
            tails[k], at[k] = value, i
        previous[i] = at[k - 1] if k else -1
    chain = [at[-1]]
    while previous[chain[-1]] >= 0:
        chain.append(int(previous[chain[-1]]))
    return np.array(chain[::-1], dtype=np.int64)


def step_spread(time_s: FloatArray) -> float:
    """Range of the steps of time, without the smallest and largest twentieth, over their median."""
    low, median, high = np.percentile(np.diff(time_s), [5, 50, 95])
    return float((high - low) / median)


def clock_findings(time_s: FloatArray, displacement_mm: FloatArray) -> list[Finding]:
    """Jitter, gaps and an unlikely duration of strictly increasing times; nothing is changed.

    The displacement says how far the device moved in a gap.
    """
    steps = np.diff(time_s)
    median = float(np.median(steps))
    findings: list[Finding] = []
    spread = step_spread(time_s)
    if spread > limits.JITTER_SHARE:
        message = (
            f"time steps vary by {spread:.0%} of their median {1e3 * median:.4g} ms; each sample keeps its own time"
        )
        findings.append(Finding("jitter", "note", message))
    gaps = np.flatnonzero(steps > limits.GAP_STEPS * median)
    if gaps.size:
        worst = int(gaps[np.argmax(steps[gaps])])
        moved = float(np.max(np.abs(np.diff(displacement_mm)[gaps])))
        share = moved / max(float(np.ptp(displacement_mm)), 1e-300)
        loud = gaps.size > max(1, limits.MANY_GAPS_SHARE * steps.size) or share > 0.1
        plural = "s" if gaps.size > 1 else ""
        message = (
            f"{gaps.size} gap{plural} in time, the longest {steps[worst]:.4g} s at {time_s[worst]:.6g} s "
            f"(step {median:.4g} s), with up to {moved:.3g} mm moved; noise and smoothing restart after each"
        )
        findings.append(Finding("gaps", "warning" if loud else "note", message, int(gaps.size)))
    if time_s[-1] - time_s[0] > limits.MAX_DURATION_S:
        duration = time_s[-1] - time_s[0]
        message = f"the recording lasts {duration:.4g} s, over a week; is the time in ms? Then use --units time=ms"
        findings.append(Finding("time-unit", "warning", message))
    return findings
