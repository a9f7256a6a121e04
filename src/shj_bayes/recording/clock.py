"""The clock of a recording: time stamps, rows out of order, clocks that begin again, jitter, gaps."""

import re
from bisect import bisect_left
from collections.abc import Iterable, Sequence
from datetime import date
from itertools import pairwise

import numpy as np

from shj_bayes._util.arrays import BoolArray, FloatArray
from shj_bayes.errors import RecordingError
from shj_bayes.recording import limits
from shj_bayes.recording.recording import Finding


def orderly_rows(time_s: FloatArray, name: str) -> tuple[BoolArray, list[Finding]]:
    """Mark the rows whose times (NaN where there is none) increase, as many as can be kept.

    `RecordingError` where more rows than a small share are out of order: then the clock is broken, not a few rows.
    """
    findings, keep = list[Finding](), np.isfinite(time_s)
    if missing := int(np.count_nonzero(~keep)):
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
    dropped, allowed = times.size - kept.size, f"allowed are {limits.BAD_TIME_SHARE:.0%}"
    broken = dropped > max(3, limits.BAD_TIME_SHARE * times.size)
    if broken and repeats >= 5 * back:
        raise RecordingError(
            f"{name}: time repeats in {repeats} of {times.size} rows ({allowed}); it was printed with too few "
            "digits, or rows are there twice; export more digits and each row once, or give the sampling rate of "
            "the rows with --rate HZ"
        )
    if broken:
        row = int(np.argmax(steps < 0))
        raise RecordingError(
            f"{name}: time jumps back {back} times, first from {times[row]:.6g} s to {times[row + 1]:.6g} s at row "
            f"{row + 2}; {dropped} of {times.size} rows would be lost ({allowed}); export the time of the test anew, "
            "or one file for each run"
        )
    keep[:] = False
    keep[index[kept]] = True
    what = " and ".join([f"repeats {repeats} times"] * (repeats > 0) + [f"jumps back {back} times"] * (back > 0))
    first = times[int(np.flatnonzero(steps <= 0)[0])]
    message = f"time {what}, first after {first:.6g} s; {dropped} rows left out, the fewest that make it increase"
    findings.append(Finding("time-jumps-back" if back else "time-repeats", "repaired", message, dropped))
    return keep, findings


def restarts(time_s: FloatArray, displacement_mm: FloatArray, force_kN: FloatArray) -> list[int]:
    """Rows at which the clock begins again, as where several runs were written into one file; shape (n_rows,).

    Time falls back there to before the middle of the run, and stays back. A clock that falls back while displacement
    and force go on is a counter that overflowed, and is left to `orderly_rows`.
    """
    index, n = np.flatnonzero(np.isfinite(time_s)), limits.MIN_SAMPLES
    times, found, begin = time_s[index], list[int](), 0
    for k in (np.flatnonzero(np.diff(times) < 0) + 1).tolist():
        if min(k - begin, times.size - k) < n:
            continue
        first, last, after = (np.median(times[a : a + n]) for a in (begin, k - n, k))  # single times may be wrong
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


def one_clock(
    time_s: FloatArray, displacement_mm: FloatArray, force_kN: FloatArray, run_rows: Sequence[int]
) -> tuple[FloatArray, list[tuple[float, float]], list[Finding]]:
    """Put all rows on one clock, s; `run_rows` are those at which a run column says that a further run begins.

    Times, shape (n_rows,); the first time of each further run, and what was added to its times; what to say.
    """
    out, cycles, findings = time_s.copy(), list[int](), list[Finding]()
    for a, b in pairwise([0, *run_rows, out.size]):  # a clock goes on over the cycles of each run
        out[a:b], found = going_on(out[a:b], displacement_mm[a:b], force_kN[a:b])
        cycles += [a + row for row in found]
    if cycles:
        message = (
            f"time begins again {len(cycles)} times, first at row {cycles[0] + 1}, while the device moves on: read as "
            "one run, with the usual step between"
        )
        findings.append(Finding("time-cycles", "assumed", message, len(cycles)))
    again = restarts(out, displacement_mm, force_kN)
    rows = sorted({*again, *run_rows})
    if again:
        where = f"at row {again[0] + 1}" if len(again) == 1 else f"{len(again)} times, first at row {again[0] + 1}"
        message = f"time begins again {where}: {len(rows) + 1} runs, put one behind the other"
        findings.append(Finding("time-restarts", "assumed", message, len(again)))
    begins = []
    for a, b in pairwise([*rows, out.size]):
        before, own, shift = out[:a][np.isfinite(out[:a])], out[a:b][np.isfinite(out[a:b])], 0.0
        if before.size > 1 and own.size and own[0] <= before[-1]:
            last = before[-limits.MIN_SAMPLES :]
            step = float(np.median(np.abs(np.diff(last))))
            shift = float(np.median(last)) + last.size * step + limits.RESTART_GAP_STEPS * step - float(own[0])
        out[a:b] += shift
        begins.append((a, shift))
    timed = np.flatnonzero(np.isfinite(out))
    return out, [(float(out[timed[np.searchsorted(timed, row)]]), shift) for row, shift in begins], findings


def longest_increasing(values: FloatArray) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Find the indices of a longest strictly increasing subsequence (no NaN): one odd time costs one row."""
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
    """Jitter, gaps and an unlikely duration of strictly increasing times; the displacement moves in gaps."""
    steps, spread, findings = np.diff(time_s), step_spread(time_s), list[Finding]()
    median, duration = float(np.median(steps)), float(time_s[-1] - time_s[0])
    if spread > limits.JITTER_SHARE:
        message = f"time steps vary by {spread:.0%} of their median {1e3 * median:.4g} ms"
        findings.append(Finding("jitter", "note", f"{message}; each sample keeps its own time"))
    gaps = np.flatnonzero(steps > limits.GAP_STEPS * median)
    if gaps.size:
        worst = int(gaps[np.argmax(steps[gaps])])
        moved = float(np.max(np.abs(np.diff(displacement_mm)[gaps])))
        share = moved / max(float(np.ptp(displacement_mm)), 1e-300)
        loud = gaps.size > max(1, limits.MANY_GAPS_SHARE * steps.size) or share > 0.1
        message = (
            f"{gaps.size} gap{'s' if gaps.size > 1 else ''} in time, the longest {steps[worst]:.4g} s at "
            f"{time_s[worst]:.6g} s (step {median:.4g} s), with up to {moved:.3g} mm moved; noise and smoothing "
            "restart after each"
        )
        findings.append(Finding("gaps", "warning" if loud else "note", message, int(gaps.size)))
    if duration > limits.MAX_DURATION_S:
        message = f"the recording lasts {duration:.4g} s, over a week; is the time in ms? Then use --units time=ms"
        findings.append(Finding("time-unit", "warning", message))
    return findings


# Unit of cells such as 00:01, which may be either; their numbers are those of the first part, so that either
# ``--units time=h`` or ``--units time=min`` is right.
H_MIN_OR_MIN_S = "h:min or min:s"
_DAY = 86400.0
_MONTHS = ("jan", "feb", "mar mär mrz", "apr", "may mai", "jun", "jul", "aug", "sep", "oct okt", "nov", "dec dez")
_MONTH_OF = {word: i for i, words in enumerate(_MONTHS, start=1) for word in words.split()}
_STAMP = re.compile(
    r"(?:(?P<days>\d{1,4}) days?,? ?)?"
    r"(?P<date>\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}[-/. ](?:\d{1,2}|[^\W\d_]{3,9}\.?)[-/. ]\d{2,4}"
    r"|[^\W\d_]{3,9}\.? \d{1,2},? \d{4})?(?:(?<=\d)(?:T|,? +|,))?"
    r"(?:(?P<a>\d{1,4}):(?P<b>\d{1,2})(?P<c>:\d{1,2})?(?P<part>[.,:]\d{1,9})?"
    r"(?: ?(?P<half>[AaPp])\.?[Mm]\.?)?(?: ?(?P<zone>Z|[A-Z]{3,4}|[+-]\d{2}:?\d{2}))?)?"
)


def is_stamp(cell: str) -> bool:
    """Whether a cell is a date, a clock or a duration."""
    return bool(cell) and len(cell) <= limits.MAX_CELL and _STAMP.fullmatch(cell) is not None


class Stamps:
    """A column of time stamps as it grows."""

    def __init__(self) -> None:
        self.seconds: list[FloatArray] = []  # of the day or of the duration; of a:b alone those of minutes and seconds
        self.dates: list[np.ndarray[tuple[int], np.dtype[np.int32]]] = []  # which date; -1 where there is none
        self.known: dict[str, int] = {}
        self.n_pairs = self.n_parts = self.n_clocks = 0  # a:b, a:b.c and all with a clock
        self.first = ""

    def add(self, cells: Iterable[str]) -> tuple[FloatArray, BoolArray]:
        """Take a block of cells; zeros where there is a stamp, NaN elsewhere, and which cells are neither nor empty."""
        read = [self._read(cell) for cell in cells]
        self.seconds.append(np.array([seconds for seconds, _ in read], dtype=np.float64))
        self.dates.append(np.array([day for _, day in read], dtype=np.int32))
        none = np.isnan(self.seconds[-1])
        return np.where(none, np.nan, 0.0), none

    def _read(self, cell: str) -> tuple[float, int]:
        """Seconds of one cell, and which date it has."""
        match = _STAMP.fullmatch(cell) if cell and len(cell) <= limits.MAX_CELL else None
        if match is None:
            return np.nan, -1
        self.first = self.first or cell
        days, day, a, b, c, part, half, zone = match.groups()
        at = -1 if day is None else self.known.setdefault(day, len(self.known))
        if at >= limits.MAX_DATES:
            return np.nan, -1
        if a is None:
            return (0.0 if at >= 0 else np.nan), at
        self.n_clocks += 1
        fraction = float(f"0.{part[1:]}") if part else 0.0
        if c is None and part is not None:  # 59:00.050
            self.n_parts += 1
            return 60.0 * int(a) + int(b) + fraction, at
        if c is None and at < 0 and half is None:
            self.n_pairs += 1
            return 60.0 * int(a) + int(b), at
        hours = int(a) if half is None else int(a) % 12 + 12 * (half in "pP")
        shift = 0.0
        if zone and zone[0] in "+-":
            shift = (int(zone[1:3]) * 3600.0 + int(zone[-2:]) * 60.0) * (1 if zone[0] == "+" else -1)
        whole = int(days or 0) * _DAY + hours * 3600.0 + int(b) * 60.0 + (int(c[1:]) if c else 0) + fraction
        return whole - shift, at

    def days(self) -> FloatArray:
        """Days since the earliest date, NaN where there is none; day and month in the order of the shortest test."""
        which = np.concatenate(self.dates)
        found = [numbers for order in ("ymd", "dmy", "mdy") if (numbers := _ordinals(self.known, order))]
        if not found:
            return np.full(which.size, np.nan)
        best = min(found, key=lambda numbers: max(numbers) - min(numbers))
        table = np.array([*best, np.nan]) - min(best)
        return np.asarray(table[which], dtype=np.float64)

    def absolute(self) -> FloatArray:
        """Seconds since the earliest date, or of the day where there are no dates; shape (n_rows,)."""
        return np.concatenate(self.seconds) + _DAY * np.nan_to_num(self.days())

    def joined(self, label: str, header: str, dates: "Stamps | None") -> tuple[FloatArray, str, list[Finding]]:
        """All of the column in one unit, the unit, and what to say; `dates` is a column of dates beside it."""
        seconds, unit = np.concatenate(self.seconds), "s"
        say = f"column {label} holds time stamps such as {self.first[:40]!r}"
        findings = [Finding("time-stamps", "note", f"{say}; read as seconds since the first")]
        if self.n_pairs and not self.n_parts and not re.search(r"m:s|min:s", header.lower()):
            return seconds / 60.0, "h" if re.search(r"h:m", header.lower()) else H_MIN_OR_MIN_S, []
        if self.n_parts or self.n_pairs:
            findings.append(Finding("time-minutes", "assumed", f"{say}; read as minutes and seconds"))
        days = (dates or self).days()
        if np.isfinite(days).any():
            seconds = seconds + _DAY * days
        else:
            seconds, passed = _unwrapped(seconds, 3600.0 if self.n_parts or self.n_pairs else _DAY)
            if passed:
                message = f"{say}, which begin again {passed} times where a clock does; read as going on"
                findings.append(Finding("time-wraps", "assumed", message, passed))
        known = seconds[np.isfinite(seconds)]
        return seconds - (known[0] if known.size else 0.0), unit, findings


def _ordinals(texts: Iterable[str], order: str) -> list[int]:
    """Numbers of the days of dates read in one order of day, month and year; none where one of them is no date so."""
    found = []
    for text in texts:
        parts = re.split(r"[-/., ]+", text)
        if parts[0][:1].isalpha():
            parts = [parts[1], parts[0], parts[2]]  # May 3, 2024
        numbers = [_MONTH_OF.get(part.lower()[:3], 0) if part[:1].isalpha() else int(part) for part in parts if part]
        own = "ymd" if len(parts[0]) == 4 else "dmy" if parts[1][:1].isalpha() or "." in text else order
        try:
            year, month, day = (numbers[own.index(one)] for one in "ymd")
            found.append(date(year + (2000 if year < 100 else 0), month, day).toordinal())
        except (ValueError, IndexError):
            return []
    return found


def _unwrapped(seconds: FloatArray, period: float) -> tuple[FloatArray, int]:
    """Let a clock without dates go on where it passes midnight, noon or the full hour; how often it did."""
    index = np.flatnonzero(np.isfinite(seconds))
    steps = np.diff(seconds[index])
    added = np.zeros(steps.size)
    # A clock of 12 hours falls back by 12, and one of 24 by 24; a test that begins again falls back by its duration.
    for fall in (period, 0.5 * period) if period == _DAY else (period,):
        added[np.abs(steps + fall) < 0.01 * fall] = fall
    out = seconds.copy()
    out[index[1:]] += np.cumsum(added)
    return out, int(np.count_nonzero(added))
