"""Rows of text to columns of numbers, a block at a time; what is no number is counted and named."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from shj_bayes.errors import RecordingError
from shj_bayes.recording.dialect import GROUPED, LOOK, PLAIN, Dialect, is_number, numeric_width
from shj_bayes.recording.heads import Head, brought, head_of, is_head
from shj_bayes.recording.limits import BLOCK_ROWS, MAX_CELL, MAX_ROWS, MAX_SPECIAL, MAX_WORDS
from shj_bayes.recording.recording import BoolArray, Finding, FloatArray
from shj_bayes.recording.stamps import Stamps, is_stamp
from shj_bayes.recording.tables import as_floats

if TYPE_CHECKING:
    import pandas as pd

_EMPTY = {"", "nan", "na", "n/a", "null", "none", "-", "\u2013", "\u2014", "\u2212", "inf", "-inf", "+inf", "#n/a"}
_SUSPECT = re.compile(r"[+-]?[1-9][0-9]{0,2}[.,][0-9]{3}")  # 1.234: one and a bit, or a thousand and some?
_MIN_SUSPECT = 3  # fewer such cells beside whole numbers are chance
_N_LOOKED = 4000  # rows in which they are looked for
_N_STAMPS = 20  # cells of a column that show whether it holds time stamps
_HEAD_GAP = 4  # lines without words, such as dates, that may stand between those of a head
_WORDY = re.compile(r"""[\s"'(\[{<*,;]*[^\W\d_]""")  # how a line begins that may be none of numbers


class _Column:
    """One column as it grows, with a count of what was met that is no number."""

    def __init__(self, decimal: str) -> None:
        self.decimal = decimal
        self.pieces: list[FloatArray] = []
        self.n_rows = self.n_words = self.n_grouped = self.n_other = 0
        self.first = ("", 0)
        self.stamps: Stamps | None = None

    @property
    def is_text(self) -> bool:
        """Whether so much of it was words that the rest need not be looked at."""
        return self.n_words > MAX_WORDS and 2 * self.n_words > self.n_rows

    def take(self, values: FloatArray) -> None:
        """Take a block of numbers."""
        self.pieces.append(values)
        self.n_rows += values.size

    def skip(self, n_rows: int) -> None:
        """Take a block of words without looking at it."""
        self.lack(n_rows)
        self.n_words += n_rows

    def lack(self, n_rows: int) -> None:
        """Take a block in which the column is missing."""
        if self.stamps is not None:
            self.stamps.add([""] * n_rows)
        self.take(np.full(n_rows, np.nan))

    def add(self, raw: pd.Series[Any], scale: float) -> None:
        """Take the next block as pandas read it, times the factor of its unit."""
        import pandas as pd  # noqa: PLC0415

        if self.stamps is None and not self.n_rows and raw.dtype.kind not in "iuf":
            looked = [str(cell).strip() for cell in raw.dropna().iloc[:_N_STAMPS]]
            self.stamps = Stamps() if 2 * sum(map(is_stamp, looked)) > len(looked) else None
        if self.stamps is not None:
            cells = raw.astype("string").fillna("").str.strip()
            values, wrong = self.stamps.add(cells.tolist())
            wrong &= ~cells.str.lower().isin(_EMPTY).to_numpy(dtype=bool)
        elif raw.dtype == object or pd.api.types.is_string_dtype(raw.dtype):
            cells = raw.astype("string").str.strip().str.strip('"').str.strip()
            values, wrong = self._from_text(cells)
        else:
            values = np.array(raw.to_numpy(dtype=np.float64, na_value=np.nan))
            cells, wrong = raw, np.isinf(values)  # 1e400: more than a number can hold
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            self.first = self.first if self.n_words else (str(cells.iloc[row]), self.n_rows + row + 1)
            self.n_words += int(np.count_nonzero(wrong))
        self.take(as_floats(values * scale if scale != 1.0 else values))

    def _from_text(self, cells: pd.Series[Any]) -> tuple[FloatArray, BoolArray]:
        """Numbers of a block in which some cells are not plain numbers, and which cells hold none."""
        import pandas as pd  # noqa: PLC0415

        plain = cells
        if self.decimal == ",":
            # A point in a file of decimal commas groups thousands, unless the whole column is written with points.
            pointed = cells.str.contains(".", regex=False).fillna(False).astype(bool)
            if pointed.any() and not cells.str.contains(",", regex=False).fillna(False).any():
                self.n_other += int(pointed.sum())
            else:
                plain = cells.mask(pointed).str.replace(",", ".", regex=False)
        values = np.array(pd.to_numeric(plain, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan))
        empty = (cells.isna() | cells.str.lower().isin(_EMPTY)).fillna(True).to_numpy(dtype=bool)
        wrong = ~np.isfinite(values) & ~empty
        texts = cells.to_numpy(dtype=object)
        for row in np.flatnonzero(wrong):
            number = _unusual(str(texts[row]), self.decimal)
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


@dataclass(frozen=True, eq=False)
class TableNumbers:
    """What the rows of a text table hold."""

    values: list[FloatArray]  # of each column, shape (n_rows,); NaN where there is no number
    n_words: list[int]  # cells of each that hold text
    stamps: list[Stamps | None]  # of columns of time stamps, whose values are no numbers
    heads: list[tuple[int, Head]]  # heads that come again, with the row that follows
    findings: list[Finding]


def numbers(
    lines: Iterable[str], dialect: Dialect, head: Head, file: str, line_of: Callable[[int], int]
) -> TableNumbers:
    """Parse rows, from the first line of numbers on, in blocks: memory holds the numbers and one block of text.

    A head that comes again is read, and what follows it brought to the columns and units of the first. `line_of` gives
    the number in the file of a line. `RecordingError` for too many rows, for a head that cannot be brought to the
    first, and where 1.234 may be a thousand.
    """
    reader = _Reader(dialect, head, file, line_of)
    source, held, findings = iter(lines), list[str](), list[Finding]()
    n_read = 0
    while True:
        block = list(islice(source, BLOCK_ROWS))
        if not n_read:
            _refuse_thousands(block, dialect, reader.labels, file)
        n_read += len(block)
        if n_read > MAX_ROWS + LOOK:
            raise RecordingError(f"{file} has more than {MAX_ROWS} rows; allowed are {MAX_ROWS}; export fewer")
        held += block
        if block:  # the last lines are held back: they may be remarks below the numbers, or a head
            end = max(0, len(held) - LOOK)
            while end and len(held) - end < 2 * LOOK and _WORDY.match(held[end - 1]):
                end -= 1
            ready, held = held[:end], held[end:]
        else:
            (ready, more), held = _without_notes(held, reader.layout.dialect), []
            findings += more
        if ready:
            reader.take(ready)
        if not block:
            break
    findings += reader.findings()
    columns = reader.columns
    return TableNumbers(
        [column.joined() for column in columns],
        [column.n_words for column in columns],
        [column.stamps for column in columns],
        reader.heads,
        findings,
    )


@dataclass(frozen=True)
class _Layout:
    """How the rows below a head are read."""

    dialect: Dialect
    places: list[tuple[int, float]]  # of each column of the first head: where it stands, -1 nowhere; factor of its unit


class _Reader:
    """Columns as they grow, and the heads that are met."""

    def __init__(self, dialect: Dialect, head: Head, file: str, line_of: Callable[[int], int]) -> None:
        self.head, self.file, self.line_of = head, file, line_of
        self.columns = [_Column(dialect.decimal) for _ in range(dialect.width)]
        self.labels = [name or f"#{i + 1}" for i, name in enumerate(head.names)]
        self.layout = _Layout(dialect, [(i, 1.0) for i in range(dialect.width)])
        self.at = dialect.first  # line at which what is taken next begins
        self.heads: list[tuple[int, Head]] = []
        self.moved: list[Head] = []  # heads that are not the same as the first
        self.n_rows = self.n_kept = self.n_remarks = 0
        self.remark = ""
        self.labelled = False  # whether lines that begin with a word are none of numbers

    def take(self, lines: list[str]) -> None:
        """Take the next lines."""
        plain = _plain(lines, self.layout.dialect)
        if not self.n_rows:
            self.labelled = not _is_word(self.layout.dialect.cells(lines[0])[0])
        groups = [] if plain is not None else _groups(lines, self.layout.dialect, self.labelled)
        begin = 0
        for a, b in [*groups, (len(lines), len(lines))]:
            if a > begin:
                self._rows(lines[begin:a], plain)
            if b > a:
                self._turn(lines[a:b], lines[b] if b < len(lines) else "", self.at + a)
            begin = b
        self.at += len(lines)

    def _rows(self, lines: list[str], plain: list[FloatArray] | None) -> None:
        """Take rows; `plain` are their numbers where these were easy to read."""
        self.n_rows += len(lines)
        self.n_kept += _parse(lines, plain, self.layout, self.columns)
        _refuse_slow(self.columns, self.labels, self.file)

    def _turn(self, group: list[str], row: str, at: int) -> None:
        """Read lines of words between the rows; `row` is that which follows, `at` the first of them."""
        dialect = self.layout.dialect
        width = len(dialect.cells(row)) or dialect.width
        own = replace(dialect, width=width)
        if not is_head(group, self.head, own):
            lost = [line for line in group if len(dialect.cells(line)) == dialect.width]  # rows of lost readings
            if lost:
                self._rows(lost, None)
            if len(lost) < len(group):
                remark = next(line for line in group if len(dialect.cells(line)) != dialect.width)
                self.remark = self.remark or remark.strip()
            self.n_remarks += len(group) - len(lost)
            if self.n_remarks > max(MAX_WORDS, self.n_rows):
                raise RecordingError(
                    f"{self.file}: more than {MAX_WORDS} lines between the rows hold words; export the numbers alone"
                )
            return
        named = next((i for i, line in enumerate(group) if len(own.cells(line)) == width), 0)
        head = head_of(group, own, self.line_of(at + named))
        places = brought(self.head, head, self.file)
        self.heads.append((self.n_kept, head))
        if places != [(i, 1.0) for i in range(len(places))]:
            self.moved.append(head)
        self.layout = _Layout(own, places)

    def findings(self) -> Iterator[Finding]:
        """Say what was met between the rows and in the columns."""
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
        if self.n_kept < self.n_rows:
            lost = self.n_rows - self.n_kept
            yield Finding("broken-rows", "repaired", f"{lost} rows with too many cells left out", lost)
        for column, label in zip(self.columns, self.labels, strict=True):
            yield from column.findings(label)


def _groups(lines: list[str], dialect: Dialect, labels: bool) -> list[tuple[int, int]]:
    """Half-open ranges of lines that are no rows.

    Lines without numbers between two of them belong to them, and where rows do not begin with words, `labels`, those
    beside them that do (``Delta_X  0.05  0.05``).
    """
    found: list[tuple[int, int, bool]] = []
    for i, line in enumerate(lines):
        if not _WORDY.match(line):
            continue
        cells = dialect.cells(line)
        no_row = not _is_row(cells, dialect)
        if not no_row and not (labels and _is_word(cells[0])):
            continue
        near = found and i - found[-1][1] < _HEAD_GAP
        if near and not any(numeric_width(dialect.cells(one), dialect.decimal) for one in lines[found[-1][1] : i]):
            found[-1] = (found[-1][0], i + 1, no_row or found[-1][2])
        else:
            found.append((i, i + 1, no_row))
    return [(a, b) for a, b, no_row in found if no_row]


def _is_row(cells: list[str], dialect: Dialect) -> bool:
    """Whether a line that begins with a word is a row all the same: it holds a number, among as many cells."""
    n_numbers = sum(is_number(cell, dialect.decimal) for cell in cells)
    if n_numbers == 0:
        return all(cell.lower() in _EMPTY for cell in cells)
    return len(cells) == dialect.width or numeric_width(cells, dialect.decimal) > 0


def _is_word(cell: str) -> bool:
    return cell[:1].isalpha() and cell.lower() not in _EMPTY


def _parse(lines: list[str], plain: list[FloatArray] | None, layout: _Layout, columns: list[_Column]) -> int:
    """Read rows; `plain` are their numbers where that was easy. The number of rows that came of it."""
    dialect, places = layout.dialect, layout.places
    plain = plain if plain is not None else _plain(lines, dialect)
    if plain is not None:
        for column, (place, scale) in zip(columns, places, strict=True):
            if place < 0:
                column.lack(len(lines))
            else:
                column.take(plain[place] if scale == 1.0 else plain[place] * scale)
        return len(lines)
    import pandas as pd  # noqa: PLC0415  its import takes as long as reading an ordinary recording

    # pandas 3 reads every digit by itself and warns when asked to; pandas 2 has to be asked.
    exact: dict[str, Any] = {} if int(pd.__version__.split(".")[0]) >= 3 else {"float_precision": "round_trip"}
    # A quote that is never closed would join all that follows into one cell.
    lines = [line.replace('"', "") if '"' in line and line.count('"') % 2 else line for line in lines]
    read = [place for column, (place, _) in zip(columns, places, strict=True) if place >= 0 and not column.is_text]
    frame = pd.read_csv(
        io.StringIO("\n".join(lines)),
        sep=r"\s+" if dialect.separator == " " else dialect.separator,
        header=None,
        names=list(range(dialect.width)),
        usecols=sorted(read),
        index_col=False,
        decimal=dialect.decimal,
        **exact,
        skipinitialspace=True,
        on_bad_lines="skip",
        low_memory=False,
    )
    for column, (place, scale) in zip(columns, places, strict=True):
        if place in read:
            column.add(frame[place], scale)
        elif place < 0:
            column.lack(len(frame))
        else:
            column.skip(len(frame))
    return len(frame)


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


def _refuse_slow(columns: list[_Column], labels: list[str], file: str) -> None:
    """Refuse, before it takes minutes, what is mostly words or is written in a way that is slow to read."""
    words = [label for label, column in zip(labels, columns, strict=True) if column.is_text]
    if len(words) > len(columns) - 2:
        raise RecordingError(
            f"{file}: more than {MAX_WORDS} cells of column {words[0]} hold text, and fewer than two columns hold "
            f"numbers; export the recording as numbers"
        )
    special = sum(column.n_grouped for column in columns)
    if special > MAX_SPECIAL:
        raise RecordingError(
            f"{file}: more than {MAX_SPECIAL} numbers have groups of thousands or D exponents; export it as plain "
            f"numbers, such as 1234.5"
        )


def _unusual(cell: str, decimal: str) -> float | None:
    """Read groups of thousands and Fortran exponents; None when the cell holds no number."""
    if len(cell) > MAX_CELL:
        return None
    if PLAIN[decimal].fullmatch(cell):
        cell = cell.lower().replace("d", "e")
    elif match := GROUPED[decimal].fullmatch(cell):
        cell = cell.replace(match[1], "")
    else:
        return None
    value = float(cell.replace(",", ".") if decimal == "," else cell)
    return value if np.isfinite(value) else None


def _refuse_thousands(lines: list[str], dialect: Dialect, labels: list[str], file: str) -> None:
    """Refuse a column of 998 and 1,002: whether that is a thousand or about one cannot be seen, and matters."""
    looked = (dialect.cells(line) for line in lines[:: max(1, len(lines) // _N_LOOKED)])
    rows = [cells for cells in looked if numeric_width(cells, dialect.decimal)]
    for i, label in enumerate(labels):
        cells = [row[i] for row in rows if len(row) > i and row[i]]
        marked = [cell for cell in cells if "." in cell or "," in cell]
        if len(marked) < _MIN_SUSPECT or len(marked) == len(cells) or not all(map(_SUSPECT.fullmatch, marked)):
            continue
        bare = [cell for cell in cells if re.fullmatch(r"[+-]?[0-9]{3}", cell)]
        if bare and len({cell.lstrip("+-")[-4] for cell in marked}) == 1 and dialect.decimal in marked[0]:
            raise RecordingError(
                f"{file}: column {label} holds both {bare[0]} and {marked[0]}, so {marked[0]} may be a thousand or "
                f"about one; export without groups of thousands"
            )


def _without_notes(lines: list[str], dialect: Dialect) -> tuple[list[str], list[Finding]]:
    """Leave out the remarks that some machines print below the numbers, at most `LOOK` lines; a note says how many."""
    end = len(lines)
    while end > 1 and end > len(lines) - LOOK and numeric_width(dialect.cells(lines[end - 1]), dialect.decimal) == 0:
        end -= 1
    left_out = len(lines) - end
    if left_out == 0:
        return lines, []
    text = lines[end].strip()[:40]
    return lines[:end], [Finding("notes", "note", f"{left_out} lines below the numbers left out ({text!r})", left_out)]
