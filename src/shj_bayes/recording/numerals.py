"""Rows of text to columns of numbers, a block at a time; what is no number is counted and named."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Iterator
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np

from shj_bayes.errors import RecordingError
from shj_bayes.recording.dialect import GROUPED, LOOK, PLAIN, Dialect, numeric_width
from shj_bayes.recording.limits import BLOCK_ROWS, MAX_CELL, MAX_ROWS, MAX_SPECIAL, MAX_WORDS
from shj_bayes.recording.recording import BoolArray, Finding, FloatArray
from shj_bayes.recording.tables import as_floats

if TYPE_CHECKING:
    import pandas as pd

_EMPTY = {"", "nan", "na", "n/a", "null", "none", "-", "inf", "-inf", "+inf", "#n/a"}
_SUSPECT = re.compile(r"[+-]?[1-9][0-9]{0,2}[.,][0-9]{3}")  # 1.234: one and a bit, or a thousand and some?
_MIN_SUSPECT = 3  # fewer such cells beside whole numbers are chance
_N_LOOKED = 4000  # rows in which they are looked for


class _Column:
    """One column as it grows, with a count of what was met that is no number."""

    def __init__(self, decimal: str) -> None:
        self.decimal = decimal
        self.pieces: list[FloatArray] = []
        self.n_rows = self.n_words = self.n_grouped = self.n_other = 0
        self.first = ("", 0)

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
        self.take(np.full(n_rows, np.nan))
        self.n_words += n_rows

    def add(self, raw: pd.Series[Any]) -> None:
        """Take the next block as pandas read it."""
        import pandas as pd  # noqa: PLC0415

        if raw.dtype == object or pd.api.types.is_string_dtype(raw.dtype):
            cells = raw.astype("string").str.strip().str.strip('"').str.strip()
            values, wrong = self._from_text(cells)
        else:
            values = np.array(raw.to_numpy(dtype=np.float64, na_value=np.nan))
            cells, wrong = raw, np.isinf(values)  # 1e400: more than a number can hold
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            self.first = self.first if self.n_words else (str(cells.iloc[row]), self.n_rows + row + 1)
            self.n_words += int(np.count_nonzero(wrong))
        self.take(as_floats(values))

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


def numbers(
    lines: Iterable[str], dialect: Dialect, names: list[str], file: str
) -> tuple[list[FloatArray], list[int], list[Finding]]:
    """Parse rows, from the first line of numbers on, in blocks: memory holds the numbers and one block of text.

    Columns, NaN where there is no number; how many cells of each hold text; findings. `names` (empty where there are
    none) and `file` are for messages. `RecordingError` for too many rows, and where 1.234 may be a thousand.
    """
    columns = [_Column(dialect.decimal) for _ in range(dialect.width)]
    labels = [name or f"#{i + 1}" for i, name in enumerate(names)]
    source, held, findings = iter(lines), list[str](), list[Finding]()
    n_read = n_kept = 0
    while True:
        block = list(islice(source, BLOCK_ROWS))
        if not n_read:
            _refuse_thousands(block, dialect, labels, file)
        n_read += len(block)
        if n_read > MAX_ROWS + LOOK:
            raise RecordingError(f"{file} has more than {MAX_ROWS} rows; allowed are {MAX_ROWS}; export fewer")
        held += block
        if block:  # the last lines are held back: they may be remarks below the numbers
            ready, held = held[:-LOOK], held[-LOOK:]
        else:
            (ready, more), held = _without_notes(held, dialect), []
            findings += more
        if ready:
            n_kept += _parse(ready, dialect, columns)
            _refuse_slow(columns, labels, file)
        if not block:
            break
    n_rows = n_read - sum(f.count for f in findings)
    if n_kept < n_rows:
        lost = n_rows - n_kept
        findings.append(Finding("broken-rows", "repaired", f"{lost} rows with too many cells left out", lost))
    for column, label in zip(columns, labels, strict=True):
        findings += column.findings(label)
    return [column.joined() for column in columns], [column.n_words for column in columns], findings


def _parse(lines: list[str], dialect: Dialect, columns: list[_Column]) -> int:
    """Read one block; the number of rows that came of it."""
    plain = _plain(lines, dialect)
    if plain is not None:
        for column, values in zip(columns, plain, strict=True):
            column.take(values)
        return len(lines)
    import pandas as pd  # noqa: PLC0415  its import takes as long as reading an ordinary recording

    # pandas 3 reads every digit by itself and warns when asked to; pandas 2 has to be asked.
    exact: dict[str, Any] = {} if int(pd.__version__.split(".")[0]) >= 3 else {"float_precision": "round_trip"}
    # A quote that is never closed would join all that follows into one cell.
    lines = [line.replace('"', "") if '"' in line and line.count('"') % 2 else line for line in lines]
    read = [i for i, column in enumerate(columns) if not column.is_text]
    frame = pd.read_csv(
        io.StringIO("\n".join(lines)),
        sep=r"\s+" if dialect.separator == " " else dialect.separator,
        header=None,
        names=list(range(dialect.width)),
        usecols=read,
        index_col=False,
        decimal=dialect.decimal,
        **exact,
        skipinitialspace=True,
        on_bad_lines="skip",
        low_memory=False,
    )
    for i, column in enumerate(columns):
        if i in read:
            column.add(frame[i])
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
    rows = [dialect.cells(line) for line in lines[:: max(1, len(lines) // _N_LOOKED)]]
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
