"""Text tables to columns of numbers: how the rows are written, what the heads say, what each cell holds."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import lru_cache
from itertools import compress, islice
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from shj_bayes._util.arrays import BoolArray, FloatArray
from shj_bayes.errors import RecordingError
from shj_bayes.recording.clock import Stamps, is_stamp
from shj_bayes.recording.columns import roles_named
from shj_bayes.recording.limits import BLOCK_ROWS, MAX_CELL, MAX_COLUMNS, MAX_NAME, MAX_ROWS, MAX_SPECIAL, MAX_WORDS
from shj_bayes.recording.recording import Finding
from shj_bayes.recording.tables import as_floats, bounded_columns
from shj_bayes.recording.units import factor, role_of

if TYPE_CHECKING:
    import pandas as pd


LOOK = 400  # lines looked at to find the header; exports with longer preambles do not occur
# Groups of three digits; a blank groups only where it does not separate (thin and hard blanks are what typists use).
_GROUPS = {".": ",'\u2019 \u00a0\u202f\u2009", ",": ".'\u2019 \u00a0\u202f\u2009"}
PLAIN = {
    ".": re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eEdD][+-]?[0-9]+)?"),
    ",": re.compile(r"[+-]?([0-9]+,?[0-9]*|,[0-9]+)([eEdD][+-]?[0-9]+)?"),
}
GROUPED = {
    decimal: re.compile(rf"[+-]?[0-9]{{1,3}}([{signs}])[0-9]{{3}}(\1[0-9]{{3}})*([{decimal}][0-9]*)?")
    for decimal, signs in _GROUPS.items()
}
# Separator and decimal sign, the likelier first.
# Decimal commas between commas are told apart by quotes: "0,05","1,23".
_WAYS = (*(("\t", "."), (";", "."), (",", "."), (" ", ".")), *(("\t", ","), (";", ","), (" ", ","), (",", ",")))


class NoNumbersError(RecordingError):
    """Text without rows of numbers; another sheet of the same workbook may have some."""


class Dialect(NamedTuple):
    """How a text table is written."""

    separator: str  # ``","``, ``";"``, tab, or a blank for any run of blanks
    decimal: str  # ".", ",": decimal sign
    first: int  # index of the first line of numbers
    width: int  # number of columns

    def cells(self, line: str, most: int = -1) -> list[str]:
        """Cells of one line; what is beyond `most` of them stays in one."""
        if self.separator == " ":
            parts = line.split(None, most)
        elif line.count('"') % 2 == 0 and '"' in line:
            parts = next(csv.reader([line], delimiter=self.separator))  # a quoted header may hold the separator
            parts = parts if most < 0 else parts[: most + 1]
        else:
            parts = line.split(self.separator, most)
        return [part.strip().strip('"').strip() for part in parts]

    def numbers(self, cells: list[str]) -> int:
        """Count the cells that are numbers."""
        return sum(is_number(cell, self.decimal) for cell in cells)

    def is_row(self, cells: list[str]) -> bool:
        """Whether at least two cells, and half of those that are no time stamps, are numbers."""
        numbers = self.numbers(cells)
        return numbers > 1 and (2 * numbers >= len(cells) or 2 * numbers >= len(cells) - sum(map(is_stamp, cells)))


def is_number(cell: str, decimal: str) -> bool:
    """Whether a cell is a number in the given way of writing, with or without groups of thousands."""
    # Long runs of digits would make the search for groups slow, and no instrument prints them.
    return len(cell) <= MAX_CELL and bool(PLAIN[decimal].fullmatch(cell) or GROUPED[decimal].fullmatch(cell))


@lru_cache(maxsize=8)
def _taken_apart(line: str) -> dict[tuple[str, str], tuple[list[str], bool]]:
    """Cells of a line, no more than a table may have, and whether it is a row of numbers, by the way of writing."""
    cells = {separator: Dialect(separator, ".", 0, 0).cells(line, MAX_COLUMNS + 1) for separator in "\t;, "}
    return {way: (cells[way[0]], Dialect(*way, 0, 0).is_row(cells[way[0]])) for way in _WAYS}


def find_dialect(lines: list[str], name: str) -> Dialect:
    """Separator, decimal sign and first line of numbers, from lines without comments and empty ones.

    It is the first line from which numbers follow, read in the way that makes most cells numbers, then most columns.
    """
    for first in range(min(len(lines), LOOK)):
        ahead = [_taken_apart(line) for line in lines[first : first + 5]]
        best, most = None, (0.0, 0)
        for way in _WAYS:
            rows, numeric = [line[way][0] for line in ahead], [line[way][1] for line in ahead]
            width = len(rows[0])
            if len(rows) > 1 and width == len(rows[1]) + 1 and rows[0][-1][:1].isalpha():
                width -= 1  # a comment behind the first sample, as LabVIEW writes it
            fits = [numeric[0], *(len(row) == width and one for row, one in zip(rows[1:], numeric[1:], strict=True))]
            # Most of the next five lines must be numbers of one width; broken cells may come among the first.
            if not fits[0] or 2 * sum(fits) < len(rows):
                continue
            # A row that begins with a word, and those below it do not, is a label: ``Interval;0.05;0.05``.
            below = [not row[0][:1].isalpha() for row, fit in zip(rows[1:], fits[1:], strict=True) if fit]
            label = rows[0][0]
            if (
                label[:1].isalpha()
                and label.lower() != "nan"
                and not is_stamp(label)
                and 2 * sum(below) >= len(below) > 0
            ):
                continue
            filled = [cell for row in rows for cell in row if cell]
            numbers = sum(is_number(cell, way[1]) for cell in filled)
            score = (round(numbers / max(1, len(filled)), 3), width)
            if score > most:
                best, most = Dialect(*way, first, width), score
        if best is None:
            continue
        width = best.width
        if width > MAX_COLUMNS:
            bounded_columns(best.cells(lines[first]), name)
        sample = [best.cells(line) for line in lines[first : first + 50]]
        while width > 2 and all(len(row) < width or row[width - 1] == "" for row in sample):
            width -= 1  # a column that exists only because every line ends with a separator
        return best._replace(width=width)
    raise NoNumbersError(
        f"{name}: found no rows of two or more numbers; a recording needs time, displacement and force in columns "
        f"separated by comma, semicolon, tab or blanks"
    )


_BRACKETED = re.compile(r"^(?P<name>.*?)[\s_,/]*[(\[{<]\s*(?P<unit>[^()\[\]{}<>]{1,24})\s*[)\]}>]\s*$")
# Bare suffixes that are units; single letters besides (a, d, h, t ...) are part of a name.
_SUFFIXES = {
    *("s", "sec", "ms", "us", "mm", "cm", "m", "um", "\u00b5m", "\u03bcm", "in", "inch", "ft"),
    *("n", "kn", "mn", "lb", "lbs", "lbf", "kip", "kips", "kgf", "tonf"),
}
_TIME_SUFFIXES = {"min", "mins", "h", "hr"}  # behind "time" only: elsewhere min is a minimum
_WEIGHT_SUFFIXES = {"t", "ton", "tons", "tonne", "tonnes", "kg", "tf"}  # behind a force only: t is a time, too
_FORCES = ("force", "load", "kraft", "last")
_OTHER_UNITS = {"v", "mv", "volt", "volts", "mpa", "bar", "c", "%", *_WEIGHT_SUFFIXES}
# degC, V, %, bar, 1/s, m/s^2, N/mm2, \u00b0C ...: a letter or sign and little behind it
_UNIT_LIKE = re.compile(r"(1/)?[^\W\d_%]{0,10}[%\u00b0\u2126\u2030]?[^\W\d_]{0,4}([ */.\u00b7^-]{0,2}[^\W_]{1,6}){0,3}")
_SUFFIXED = re.compile(r"^(?P<name>.+?)\s*[_,/: \-]\s*(?P<unit>[A-Za-z\u00b5\u03bc\"'.]{1,8})$")


def split_header(header: str) -> tuple[str, str | None]:
    """Separate name and unit of a header: ``Displacement (in)``, ``Force [kip]``, ``time_s``, ``Load / kN`` ...

    A unit in brackets is taken as it is, a suffix only when it is a unit of time, length or force; else it is None.
    """
    text = header[:MAX_NAME].strip().strip("\"'").strip()
    if (match := _BRACKETED.match(text)) and match["name"].strip():
        return match["name"].strip(), match["unit"].strip()
    if match := _SUFFIXED.match(text):
        unit = match["unit"].strip(".").lower()
        name = match["name"].lower()
        timed = unit in _TIME_SUFFIXES and "time" in name
        if unit in _SUFFIXES or timed or (unit in _WEIGHT_SUFFIXES and name.endswith(_FORCES)):
            return match["name"].strip(), match["unit"]
    return text, None


def bare_unit(cell: str) -> str:
    """Give the unit of a cell below a header, without its brackets."""
    return cell.strip().strip("()[]{}<>").strip()


def is_unit_row(cells: list[str]) -> bool:
    """Whether a row below the names holds units, bare or in brackets.

    True where every cell is empty, a dash or a usual unit, or, where units of two of these are among them,
    anything that may be a unit of another quantity: a file has channels that nobody needs. Names of two channels are
    none.
    """
    words = [split_header(cell)[0] for cell in cells if len(cell) >= _SHORTEST_NAME]
    if len(set[str]().union(*map(roles_named, words))) > 1:
        return False
    texts = [bare_unit(cell) for cell in cells]
    filled = [text for text in texts if text not in {"", "-", "--"}]
    roles = {text: role_of(text) for text in filled}
    if filled and all(role or text.lower() in _OTHER_UNITS for text, role in roles.items()):
        return True
    return len({role for role in roles.values() if role}) > 1 and all(map(_UNIT_LIKE.fullmatch, filled))


# First cells of rows of names and of units; where a time has no name of its own they stand above its column.
_NAME_LABELS = {"channel name", "channel names", "signal name", "kanalname", "name"}
_UNIT_LABELS = {"unit", "units", "einheit", "einheiten", "y unit label", "unité", "unités"}
_SHORTEST_NAME = 3  # letters of words that may be names of columns and not marks of lost readings
_LABVIEW = ("LabVIEW Measurement", "***End_of_Header")


class Head(NamedTuple):
    """What stands above rows of numbers."""

    names: list[str]  # "" where a column has none
    units: list[str | None]
    written: list[str]  # names and units together, as in the file
    line: int = 0  # of the names or units, counted from 1
    # of a LabVIEW file, of all columns but the first: date and time of the start, first time after it and interval, s
    waves: Sequence[tuple[str, float, float]] = ()


def head_of(above: list[str], dialect: Dialect, line: int = 0) -> Head:
    """Names and units from the lines above the numbers, whichever of them they stand in.

    Names are the row in which most channels are recognised, the lowest of these; units the lowest row of units.
    """
    width = dialect.width
    rows = [cells for cells in (_cells(text, dialect)[:width] for text in above) if len(cells) > 1]
    numbers = [dialect.numbers(cells) for cells in rows]
    # The last row may be the first sample with its readings lost: a number under names, or alone.
    while rows and len(rows[-1]) == width and numbers[-1]:
        if numbers[-1] + rows[-1].count("") < width and (len(rows) < 2 or numbers[-2]):
            break
        rows.pop()
        numbers.pop()
    whole = [len(cells) == width for cells in rows]
    rows = [cells + [""] * (width - len(cells)) for cells in rows]
    is_units = [is_unit_row(_unlabelled(cells)) for cells in rows]
    named = [
        (len(set().union(*(roles_named(split_header(cell)[0]) for cell in cells))), i)
        for i, cells in enumerate(rows)
        if whole[i] and not is_units[i] and not numbers[i] and not any(map(is_stamp, cells))
    ]
    most, names = max(named, default=(0, -1))
    if not most:  # the lowest row, but for that of the units
        full = np.flatnonzero(whole).tolist()
        names = full[-2] if len(full) > 1 and is_units[full[-1]] else full[-1] if full else -1
    labels = rows[names] if names >= 0 else [""] * width
    below: list[str | None] = [None] * width
    for i, cells in enumerate(rows):
        # A row of fewer cells, as beside a word, holds units where it has those of two channels.
        if is_units[i] and i != names and (whole[i] or len({role_of(bare_unit(cell)) for cell in cells} - {None}) > 1):
            below = [bare_unit(cell) or None for cell in _unlabelled(cells)]
    labels = ["Time" if cell.lower() in _NAME_LABELS else cell for cell in labels]
    pairs = [split_header(cell) for cell in labels]
    units = [own or unit for (_, own), unit in zip(pairs, below, strict=True)]
    written = [
        f"{cell} ({unit})" if cell and unit and own is None else cell or "(no name)"
        for cell, (_, own), unit in zip(labels, pairs, units, strict=True)
    ]
    head = Head([name for name, _ in pairs], units, written, line)
    return _with_waves(head, above, dialect) if any(text.startswith(_LABVIEW) for text in above) else head


def _cells(line: str, dialect: Dialect) -> list[str]:
    """Cells of a line; where blanks separate, names of several words may stand further apart, or between tabs."""
    cells = dialect.cells(line)
    if dialect.separator == " " and len(cells) > dialect.width:
        wider = [part.strip().strip('"') for part in re.split(r"\t|\s{2,}", line.strip())]
        return wider if len(wider) == dialect.width else cells
    return cells


def _unlabelled(cells: list[str]) -> list[str]:
    """Cells without words such as Unit before them."""
    return ["" if " ".join(cell.lower().replace("_", " ").split()) in _UNIT_LABELS else cell for cell in cells]


def _with_waves(head: Head, above: list[str], dialect: Dialect) -> Head:
    """Head of a LabVIEW file: ``X_Value`` is a time; beside it stand start and interval of each channel."""
    fields: dict[str, list[str]] = {}
    for text in above:  # what stands last holds for what follows
        cells = dialect.cells(text)
        fields[cells[0].lower()] = [*cells[1:], *[""] * dialect.width][: dialect.width - 1]
    timed = fields.get("x_dimension", ["Time"])[0].lower() in ("", "time")
    units = [
        "s" if timed and name.lower() == "x_value" else unit for name, unit in zip(head.names, head.units, strict=True)
    ]

    def number(cell: str) -> float:
        return float(cell.replace(dialect.decimal, ".")) if PLAIN[dialect.decimal].fullmatch(cell[:MAX_CELL]) else 0.0

    empty = [""] * (dialect.width - 1)
    columns = zip(*(fields.get(key, empty) for key in ("date", "time", "x0", "delta_x")), strict=True)
    waves = [(f"{day} {time}".strip(), number(x0), number(step)) for day, time, x0, step in columns]
    return head._replace(units=units, waves=waves)


def is_head(group: Sequence[str], first: Head, dialect: Dialect) -> bool:
    """Whether lines of words between rows of numbers are a head, and not a remark or a lost reading."""
    known = {name.lower() for name in first.names if name}
    for cells in (_cells(line, dialect) for line in group):
        if len(cells) == dialect.width:
            names = [split_header(cell)[0] for cell in cells]
            known_ones = any(roles_named(name) or name.lower() in known for name in names)
            unlike = len(set(cells)) == len(cells) and min(map(len, cells)) >= _SHORTEST_NAME
            if is_unit_row(_unlabelled(cells)) or known_ones or (unlike and dialect.separator != " "):
                return True
    return False


def in_columns_of(first: Head, own: Head, file: str) -> list[tuple[int, float]]:
    """Place below a later head of each column of the first, -1 where it is missing, and the factor of its unit.

    `RecordingError` with the line where a channel is missing or its unit cannot be brought to that of the first head.
    """
    names, units = own.names, own.units
    if is_unit_row(_unlabelled(names)) and not any(map(roles_named, names)):  # units alone come again
        names, units = first.names, [bare_unit(name) or None for name in names]
    where = f"{file}: the head in line {own.line}"
    apart = "give what follows it as a file of its own"
    if not any(first.names):
        raise RecordingError(f"{where} names columns, of which those above it have no names; write it above them, too")
    left = [(name.lower(), i) for i, name in enumerate(names)]
    places = []
    for name, unit in zip(first.names, first.units, strict=True):
        found = next((one for one in left if one[0] == name.lower()), None)
        if found is None:
            if name and (roles_named(name) or (unit and role_of(unit))):
                raise RecordingError(f"{where} lacks {name!r}, its columns are {', '.join(names)[:200]}; {apart}")
            places.append((-1, 1.0))
            continue
        left.remove(found)
        stated, scale = units[found[1]], 1.0
        if stated is not None and stated != unit:
            said = f"{where} states {name!r} in {stated}, the first head"
            if unit is None:
                raise RecordingError(f"{said} no unit; write the unit into the first head, too")
            role = role_of(stated)
            if role is None or role_of(unit) != role:
                raise RecordingError(f"{said} in {unit}; {apart}")
            scale = factor(stated, role) / factor(unit, role)
        places.append((found[1], scale))
    return places


_EMPTY = {"", "nan", "na", "n/a", "null", "none", "-", "\u2013", "\u2014", "\u2212", "inf", "-inf", "+inf", "#n/a"}
_SUSPECT = re.compile(r"[+-]?[1-9][0-9]{0,2}[.,][0-9]{3}")  # 1.234: one and a bit, or a thousand and some?
_MIN_SUSPECT = 3  # fewer such cells beside whole numbers are chance
_N_LOOKED = 4000  # rows in which they are looked for
_N_STAMPS = 20  # cells of a column that show whether it holds time stamps
_HEAD_GAP = 4  # lines without words, such as dates, that may stand between those of a head
_WORDY = re.compile(r"""[\s"'(\[{<*,;]*[^\W\d_]""")  # how a line begins that may be no row of numbers


class TextColumn:
    """One column as it grows, with a count of what was met that is no number."""

    def __init__(self, decimal: str) -> None:
        self.decimal = decimal
        self.pieces: list[FloatArray] = []
        self.n_rows = self.n_words = self.n_grouped = self.n_other = 0
        self.first = ("", 0)
        self.stamps: Stamps | None = None  # of a column of time stamps, whose values are no numbers

    @property
    def is_text(self) -> bool:
        """Whether so much of it was words that the rest need not be looked at."""
        return self.n_words > MAX_WORDS and 2 * self.n_words > self.n_rows

    def take(self, values: FloatArray) -> None:
        """Take a block of numbers."""
        self.pieces.append(values)
        self.n_rows += values.size

    def lack(self, n_rows: int, n_words: int = 0) -> None:
        """Take a block in which the column is missing, or holds `n_words` cells that are not looked at."""
        if self.stamps is not None:
            self.stamps.add([""] * n_rows)
        self.take(np.full(n_rows, np.nan))
        self.n_words += n_words

    def add(self, raw: pd.Series[Any], scale: float) -> None:
        """Take the next block as pandas read it, times the factor of its unit."""
        if self.stamps is None and not self.n_rows and raw.dtype.kind not in "iuf":
            looked = [str(cell).strip() for cell in raw.dropna().iloc[:_N_STAMPS]]
            self.stamps = Stamps() if 2 * sum(map(is_stamp, looked)) > len(looked) else None
        cells = raw
        if self.stamps is None and raw.dtype.kind in "iufb":
            values = np.array(raw.to_numpy(dtype=np.float64, na_value=np.nan))
            wrong = np.isinf(values)  # 1e400: more than a number can hold
        else:
            cells = raw.astype("string").fillna("").str.strip().str.strip('"').str.strip()
            values, wrong = self._from_text(cells) if self.stamps is None else self.stamps.add(cells.tolist())
            wrong &= ~cells.str.lower().isin(_EMPTY).to_numpy(dtype=bool)
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            self.first = self.first if self.n_words else (str(cells.iloc[row]), self.n_rows + row + 1)
            self.n_words += int(np.count_nonzero(wrong))
        self.take(as_floats(values * scale))

    def _from_text(self, cells: pd.Series[Any]) -> tuple[FloatArray, BoolArray]:
        """Numbers of a block in which some cells are not plain numbers, and which cells hold none."""
        import pandas as pd  # noqa: PLC0415

        plain = cells
        if self.decimal == ",":
            # A point in a file of decimal commas groups thousands, unless the whole column is written with points.
            pointed = cells.str.contains(".", regex=False)
            if pointed.any() and not cells.str.contains(",", regex=False).any():
                self.n_other += int(pointed.sum())
            else:
                plain = cells.mask(pointed).str.replace(",", ".", regex=False)
        values = np.array(pd.to_numeric(plain, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan))
        wrong, texts = ~np.isfinite(values), cells.tolist()
        for row in np.flatnonzero(wrong).tolist():
            number = _unusual(texts[row], self.decimal)
            if number is not None:
                values[row], wrong[row] = number, False
                self.n_grouped += 1
        return values, wrong

    def joined(self) -> FloatArray:
        """Give the whole column; the pieces are freed."""
        pieces, self.pieces = self.pieces, []
        return np.concatenate(pieces) if pieces else np.zeros(0)

    def findings(self, name: str) -> Iterator[Finding]:
        """Say what was met in the column."""
        if self.n_words:
            text, row = self.first
            message = f"column {name}: {self.n_words} cells hold text, the first is {text[:20]!r} in row {row}"
            yield Finding("text-cells", "note", f"{message} of the numbers", self.n_words)
        if self.n_grouped:
            message = f"column {name}: {self.n_grouped} cells are read with groups of thousands or D exponents"
            yield Finding("thousands", "assumed", f"{message} (1 234,5 and 1'234.5 are about twelve hundred)")
        if self.n_other:
            message = f"column {name} is written with a decimal point although the file has decimal commas"
            yield Finding("mixed-decimals", "assumed", f"{message}; read so")


def _unusual(cell: str, decimal: str) -> float | None:
    """Read groups of thousands and Fortran exponents; None when the cell holds no number."""
    if not is_number(cell, decimal):
        return None
    grouped = GROUPED[decimal].fullmatch(cell)
    cell = (
        cell.lower().replace("d", "e")
        if PLAIN[decimal].fullmatch(cell) or not grouped
        else cell.replace(grouped[1], "")
    )
    value = float(cell.replace(decimal, "."))
    return value if np.isfinite(value) else None


class TextRows:
    """Columns as they grow out of the rows of a text table, and the heads that come again among them."""

    def __init__(self, dialect: Dialect, head: Head, file: str, line_of: Callable[[int], int]) -> None:
        """`line_of` gives the number in the file of a line."""
        self.head, self.file, self.line_of, self.dialect = head, file, line_of, dialect
        self.columns = [TextColumn(dialect.decimal) for _ in range(dialect.width)]
        self.labels = [name or f"#{i + 1}" for i, name in enumerate(head.names)]
        # where each column of the first head stands in the rows now, -1 nowhere, and the factor of its unit
        self.places = [(i, 1.0) for i in range(dialect.width)]
        self.at = dialect.first  # line at which what is taken next begins
        self.heads: list[tuple[int, Head]] = []  # heads that come again, with the row that follows
        self.moved: list[Head] = []  # those that are not the same as the first
        self.n_rows = self.n_kept = self.n_remarks = 0
        self.remark = ""
        self.labelled = False  # whether lines that begin with a word are no rows of numbers
        self.below: list[str] = []  # lines below the numbers

    def read(self, lines: Iterable[str]) -> None:
        """Parse rows, from the first line of numbers on, in blocks: memory holds the numbers and one block of text.

        A head that comes again is read, and what follows it brought to the columns and units of the first.
        `RecordingError` for too many rows, for a head that cannot be brought to the first, and where 1.234 may be a
        thousand.
        """
        source, held, n_read = iter(lines), list[str](), 0
        while block := list(islice(source, BLOCK_ROWS)):
            if not n_read:
                self._refuse_thousands(block)
                self.labelled = not _is_word(self.dialect.cells(block[0])[0])
            n_read += len(block)
            if n_read > MAX_ROWS + LOOK:
                raise RecordingError(f"{self.file} has more than {MAX_ROWS} rows; allowed are {MAX_ROWS}; export fewer")
            held += block
            end = max(0, len(held) - LOOK)  # the last lines are held back: they may be remarks, or a head
            while end and len(held) - end < 2 * LOOK and _WORDY.match(held[end - 1]):
                end -= 1
            if end:
                self._take(held[:end])
                held = held[end:]
        # Some machines print remarks below the numbers.
        end = len(held)
        while end > 1 and end > len(held) - LOOK and not self.dialect.is_row(self.dialect.cells(held[end - 1])):
            end -= 1
        self.below = held[end:]
        self._take(held[:end])

    def _take(self, lines: list[str]) -> None:
        """Take the next lines."""
        plain, begin = _plain(lines, self.dialect), 0
        for a, b in [*(self._groups(lines) if plain is None else []), (len(lines), len(lines))]:
            if a > begin:
                self._rows(lines[begin:a], plain)
            if b > a:
                self._change_head(lines[a:b], lines[b] if b < len(lines) else "", self.at + a)
            begin = b
        self.at += len(lines)

    def _groups(self, lines: list[str]) -> list[tuple[int, int]]:
        """Half-open ranges of lines that are no rows.

        Lines without numbers between two of them belong to them, and where rows do not begin with words those beside
        them that do (``Delta_X  0.05  0.05``).
        """
        found: list[tuple[int, int, bool]] = []
        for i, line in enumerate(lines):
            if not _WORDY.match(line):
                continue
            cells = self.dialect.cells(line)
            # A row may begin with a word all the same: it holds a number, among as many cells, or lost readings alone.
            whole = len(cells) == self.dialect.width or self.dialect.is_row(cells)
            is_row = whole if self.dialect.numbers(cells) else all(cell.lower() in _EMPTY for cell in cells)
            if is_row and not (self.labelled and _is_word(cells[0])):
                continue
            between = lines[found[-1][1] : i] if found else []
            near = found and len(between) < _HEAD_GAP
            if near and not any(self.dialect.is_row(self.dialect.cells(one)) for one in between):
                found[-1] = (found[-1][0], i + 1, not is_row or found[-1][2])
            else:
                found.append((i, i + 1, not is_row))
        return [(a, b) for a, b, no_row in found if no_row]

    def _change_head(self, group: list[str], row: str, at: int) -> None:
        """Read lines of words between the rows; `row` is that which follows, `at` the first of them."""
        width = len(self.dialect.cells(row)) or self.dialect.width
        own = self.dialect._replace(width=width)
        if is_head(group, self.head, own):
            named = next((i for i, line in enumerate(group) if len(own.cells(line)) == width), 0)
            head = head_of(group, own, self.line_of(at + named))
            self.dialect, self.places = own, in_columns_of(self.head, head, self.file)
            self.heads.append((self.n_kept, head))
            if self.places != [(i, 1.0) for i in range(len(self.places))]:
                self.moved.append(head)
            return
        whole = [len(self.dialect.cells(line)) == self.dialect.width for line in group]
        if lost := list(compress(group, whole)):  # rows of lost readings
            self._rows(lost)
        remarks = [line for line, is_whole in zip(group, whole, strict=True) if not is_whole]
        self.remark = self.remark or next((line.strip() for line in remarks), "")
        self.n_remarks += len(remarks)
        if self.n_remarks > max(MAX_WORDS, self.n_rows):
            raise RecordingError(
                f"{self.file}: more than {MAX_WORDS} lines between the rows hold words; export the numbers alone"
            )

    def _rows(self, lines: list[str], plain: list[FloatArray] | None = None) -> None:
        """Take rows; `plain` are their numbers where these were easy to read."""
        self.n_rows += len(lines)
        plain = plain or _plain(lines, self.dialect)
        if plain is None:
            self._slowly(lines)
        else:
            self.n_kept += len(lines)
            for column, (place, scale) in zip(self.columns, self.places, strict=True):
                if place < 0:
                    column.lack(len(lines))
                else:
                    column.take(plain[place] if scale == 1.0 else plain[place] * scale)
        words = [label for label, column in zip(self.labels, self.columns, strict=True) if column.is_text]
        if len(words) > len(self.columns) - 2:
            raise RecordingError(
                f"{self.file}: more than {MAX_WORDS} cells of column {words[0]} hold text, and fewer than two columns "
                "hold numbers; export the recording as numbers"
            )
        if sum(column.n_grouped for column in self.columns) > MAX_SPECIAL:
            raise RecordingError(
                f"{self.file}: more than {MAX_SPECIAL} numbers have groups of thousands or D exponents; export it as "
                "plain numbers, such as 1234.5"
            )

    def _slowly(self, lines: list[str]) -> None:
        """Take rows of which some cells are no plain numbers."""
        import pandas as pd  # noqa: PLC0415  its import takes as long as reading an ordinary recording

        # pandas 3 reads every digit by itself and warns when asked to; pandas 2 has to be asked.
        exact: dict[str, Any] = {} if int(pd.__version__.split(".")[0]) >= 3 else {"float_precision": "round_trip"}
        # A quote that is never closed would join all that follows into one cell.
        lines = [line.replace('"', "") if line.count('"') % 2 else line for line in lines]
        places = list(zip(self.columns, self.places, strict=True))
        read = sorted(place for column, (place, _) in places if place >= 0 and not column.is_text)
        frame = pd.read_csv(
            io.StringIO("\n".join(lines)),
            sep=r"\s+" if self.dialect.separator == " " else self.dialect.separator,
            header=None,
            names=list(range(self.dialect.width)),
            usecols=read,
            index_col=False,
            decimal=self.dialect.decimal,
            **exact,
            skipinitialspace=True,
            on_bad_lines="skip",
            low_memory=False,
        )
        for column, (place, scale) in places:
            if place in read:
                column.add(frame[place], scale)
            else:
                column.lack(len(frame), len(frame) if place >= 0 else 0)
        self.n_kept += len(frame)

    def _refuse_thousands(self, lines: list[str]) -> None:
        """Refuse a column of 998 and 1,002: whether that is a thousand or about one cannot be seen, and matters."""
        suspected: dict[int, list[str]] = {i: [] for i in range(len(self.labels))}
        for line in lines[:: max(1, len(lines) // _N_LOOKED)]:
            row = self.dialect.cells(line)
            for i, cell in enumerate(row) if self.dialect.is_row(row) else ():
                if _is_marked(cell) and not _SUSPECT.fullmatch(cell):
                    suspected.pop(i, None)
                elif i in suspected:
                    suspected[i].append(cell)
            if not suspected:  # as in nearly all files, after a few rows
                return
        for i, cells in suspected.items():
            marked = [cell for cell in cells if _is_marked(cell)]
            bare = [cell for cell in cells if re.fullmatch(r"[+-]?[0-9]{3}", cell)]
            alike = len({cell.lstrip("+-")[-4] for cell in marked}) == 1
            if len(marked) >= _MIN_SUSPECT and bare and alike and self.dialect.decimal in marked[0]:
                both = f"column {self.labels[i]} holds both {bare[0]} and {marked[0]}"
                raise RecordingError(
                    f"{self.file}: {both}, so {marked[0]} may be a thousand or about one; export without groups of "
                    "thousands"
                )

    def findings(self) -> Iterator[Finding]:
        """Say what was met below and between the rows, and in the columns."""
        if n := len(self.below):
            yield Finding("notes", "note", f"{n} lines below the numbers left out ({self.below[0].strip()[:40]!r})", n)
        if self.heads:
            message = f"the head comes again {len(self.heads)} times, first in line {self.heads[0][1].line}"
            yield Finding("heads", "note", f"{message}; the rows below all of them are read as one table")
        if self.moved:
            head = self.moved[0]
            message = f"the head in line {head.line} has other columns or units: {', '.join(head.written)[:200]}"
            yield Finding("head-changes", "repaired", f"{message}; brought to those of the first", len(self.moved))
        if self.n_remarks:
            message = f"{self.n_remarks} lines of words between the rows left out ({self.remark[:40]!r})"
            yield Finding("notes", "note", message, self.n_remarks)
        if lost := self.n_rows - self.n_kept:
            yield Finding("broken-rows", "repaired", f"{lost} rows with too many cells left out", lost)
        for column, label in zip(self.columns, self.labels, strict=True):
            yield from column.findings(label)


def _is_marked(cell: str) -> bool:
    return "." in cell or "," in cell


def _is_word(cell: str) -> bool:
    return cell[:1].isalpha() and cell.lower() not in _EMPTY


def _plain(lines: list[str], dialect: Dialect) -> list[FloatArray] | None:
    """Columns of a block of which every cell is a plain number; None where one is not."""
    if dialect.decimal == "," and dialect.separator != ",":
        if any("." in line for line in lines):
            return None
        lines = [line.replace(",", ".") for line in lines]
    try:
        # comments=None: numpy's own would cut a row short at a sign that it takes for a comment
        table = np.loadtxt(
            lines, delimiter=None if dialect.separator == " " else dialect.separator, comments=None, ndmin=2
        )
    except (ValueError, OverflowError):  # words, empty cells, rows of another length
        return None
    # Empty lines are passed over; what is no finite number is told apart by the slower reader.
    if table.shape != (len(lines), dialect.width) or not np.isfinite(table).all():
        return None
    return [np.ascontiguousarray(column) for column in table.T]
