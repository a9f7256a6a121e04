"""Time stamps as loggers print them: dates, clocks and durations, turned into seconds."""

import re
from collections.abc import Iterable
from datetime import date

import numpy as np

from shj_bayes.recording.limits import MAX_CELL, MAX_DATES
from shj_bayes.recording.recording import BoolArray, Finding, FloatArray

# Unit of cells such as 00:01, which may be either; their numbers are those of the first part, so that either
# ``--units time=h`` or ``--units time=min`` is right.
H_MIN_OR_MIN_S = "h:min or min:s"
_DAY = 86400.0
_MONTHS = ("jan", "feb", "mar mär mrz", "apr", "may mai", "jun", "jul", "aug", "sep", "oct okt", "nov", "dec dez")
_STAMP = re.compile(
    r"(?:(?P<days>\d{1,4}) days?,? ?)?"
    r"(?P<date>\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}[-/. ](?:\d{1,2}|[^\W\d_]{3,9}\.?)[-/. ]\d{2,4}"
    r"|[^\W\d_]{3,9}\.? \d{1,2},? \d{4})?(?:(?<=\d)(?:T|,? +|,))?"
    r"(?:(?P<a>\d{1,4}):(?P<b>\d{1,2})(?P<c>:\d{1,2})?(?P<part>[.,:]\d{1,9})?"
    r"(?: ?(?P<half>[AaPp])\.?[Mm]\.?)?(?: ?(?P<zone>Z|[A-Z]{3,4}|[+-]\d{2}:?\d{2}))?)?"
)


def is_stamp(cell: str) -> bool:
    """Whether a cell is a date, a clock or a duration."""
    return bool(cell) and len(cell) <= MAX_CELL and _STAMP.fullmatch(cell) is not None


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
        match = _STAMP.fullmatch(cell) if cell and len(cell) <= MAX_CELL else None
        if match is None:
            return np.nan, -1
        self.first = self.first or cell
        days, day, a, b, c, part, half, zone = match.groups()
        at = -1 if day is None else self.known.setdefault(day, len(self.known))
        if at >= MAX_DATES:
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
        """Days since the earliest date, NaN where there is none; shape (n_rows,).

        Where day and month may be exchanged, in the order that makes the test shortest.
        """
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
        numbers = [_month(part) if part[:1].isalpha() else int(part) for part in parts if part]
        own = "ymd" if len(parts[0]) == 4 else "dmy" if parts[1][:1].isalpha() or "." in text else order
        try:
            year, month, day = (numbers[own.index(one)] for one in "ymd")
            found.append(date(year + (2000 if year < 100 else 0), month, day).toordinal())
        except (ValueError, IndexError):
            return []
    return found


def _month(word: str) -> int:
    """Give the number of a month by its first letters, 0 where it is none."""
    return next((i for i, names in enumerate(_MONTHS, 1) if word.lower()[:3] in names.split()), 0)


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
