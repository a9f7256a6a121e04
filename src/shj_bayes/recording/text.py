"""Text tables: comma, semicolon, tab or blanks; decimal point or comma; any of the usual encodings."""

from __future__ import annotations

import csv
import gzip
import io
import re
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes.errors import RecordingError
from shj_bayes.recording.headers import is_unit_cell, split_header
from shj_bayes.recording.limits import CHUNK_BYTES, MAX_BYTES, MAX_ROWS
from shj_bayes.recording.recording import Finding, FloatArray
from shj_bayes.recording.tables import Column, Table, as_floats

_POINT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?$")
_COMMA = re.compile(r"[+-]?(\d+,?\d*|,\d+)([eEdD][+-]?\d+)?$")
_EMPTY = {"", "nan", "na", "n/a", "null", "none", "-", "inf", "-inf", "+inf", "#n/a"}
_LOOK = 400  # lines looked at to find the header; exports with longer preambles do not occur


# Separator and decimal sign, the likelier first.
_WAYS = (("\t", "."), (";", "."), (",", "."), (" ", "."), ("\t", ","), (";", ","), (" ", ","))


@dataclass(frozen=True)
class Dialect:
    """How a text table is written.

    Parameters
    ----------
    separator : str
        ``","``, ``";"``, tab, or a blank for any run of blanks.
    decimal : {".", ","}
        Decimal sign.
    first : int
        Index of the first line of numbers.
    width : int
        Number of columns.
    """

    separator: str
    decimal: str
    first: int
    width: int

    def cells(self, line: str) -> list[str]:
        """Cells of one line."""
        if self.separator == " ":
            parts = line.split()
        elif '"' in line:
            parts = next(csv.reader([line], delimiter=self.separator))  # a quoted header may hold the separator
        else:
            parts = line.split(self.separator)
        return [part.strip().strip('"').strip() for part in parts]


def read_text(path: Path, sha256: str) -> Table:
    """Read a text table, plain or gzipped.

    Parameters
    ----------
    path : Path
        The file.
    sha256 : str
        Its digest.

    Returns
    -------
    Table
    """
    text, encoding = decode(_bounded_bytes(path), path.name)
    lines = text.splitlines()
    if len(lines) > MAX_ROWS + _LOOK:
        raise RecordingError(f"{path.name} has {len(lines)} lines; allowed are {MAX_ROWS}; export fewer")
    notes = [] if encoding == "utf-8" else [Finding("encoding", "note", f"text read as {encoding}")]
    return table_from_lines(lines, path.name, sha256, "csv", tuple(notes))


def table_from_lines(lines: list[str], name: str, sha256: str, kind: str, notes: tuple[Finding, ...] = ()) -> Table:
    """Find header and numbers in lines of text.

    Parameters
    ----------
    lines : list of str
        All lines; those that start with ``#`` or ``%`` are comments.
    name, sha256, kind : str
        Name, digest and format for the table.
    notes : tuple of Finding
        What was met before.

    Returns
    -------
    Table
    """
    comments = [line for line in lines[:_LOOK] if line.lstrip().startswith(("#", "%"))]
    lines = [line for line in lines if line.strip() and not line.lstrip().startswith(("#", "%"))]
    dialect = find_dialect(lines, name)
    names, units = _header(lines[: dialect.first], dialect)
    if not any(names) and comments:  # numpy and gnuplot write the header as a comment
        names, units = _header([line.lstrip("#% ") for line in comments], dialect)
    values, findings = _numbers(lines[dialect.first :], dialect, names)
    if any("simulated" in line.lower() for line in comments):
        findings.append(Finding("simulated", "note", "the file says that it is simulated, not measured"))
    if dialect.decimal == ",":
        findings.append(Finding("decimal-comma", "assumed", "a comma is read as the decimal sign (0,5 is one half)"))
    columns = tuple(
        Column(label or f"#{i + 1}", values[:, i], unit, f"{label} ({unit})" if unit else label or "(no name)")
        for i, (label, unit) in enumerate(zip(names, units, strict=True))
    )
    return Table(name, kind, sha256, columns, has_header=any(names), findings=(*notes, *findings))


def _bounded_bytes(path: Path) -> bytes:
    """All bytes of the file, unpacked in pieces so that an overlong archive is stopped early."""
    if path.suffix.lower() != ".gz":
        return path.read_bytes()
    pieces, total = [], 0
    try:
        with gzip.open(path, "rb") as stream:
            while piece := stream.read(CHUNK_BYTES):
                total += len(piece)
                if total > MAX_BYTES:
                    raise RecordingError(
                        f"{path.name} unpacks to more than {MAX_BYTES // 1024**2} MiB; that is no recording; "
                        f"export fewer channels or rows"
                    )
                pieces.append(piece)
    except (OSError, EOFError, zlib.error) as error:
        raise RecordingError(f"{path.name}: the gzip file is damaged ({error}); copy or compress it again") from error
    return b"".join(pieces)


def decode(raw: bytes, name: str) -> tuple[str, str]:
    """Turn bytes into text: UTF-8, UTF-16 by its mark or its zeros, else Latin-1 as Windows writes it.

    Parameters
    ----------
    raw : bytes
        Contents.
    name : str
        For the message.

    Returns
    -------
    text, encoding : str
    """
    head = raw[:4096]
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")):
        encoding = "utf-16"
    elif b"\x00" in head:
        zeros_odd, zeros_even = head[1::2].count(0), head[0::2].count(0)
        if max(zeros_odd, zeros_even) < 0.3 * len(head) / 2:
            raise RecordingError(f"{name} is not text (it holds binary zeros); its ending should say its real format")
        encoding = "utf-16-le" if zeros_odd > zeros_even else "utf-16-be"
    else:
        encoding = "utf-8"
    try:
        return raw.decode(encoding).lstrip("\ufeff"), encoding
    except UnicodeDecodeError:
        return raw.decode("cp1252", errors="replace"), "Latin-1"


def find_dialect(lines: list[str], name: str) -> Dialect:
    """Separator, decimal sign and first line of numbers.

    Parameters
    ----------
    lines : list of str
        Lines without comments and empty ones.
    name : str
        For the message.

    Returns
    -------
    Dialect
        The first line from which numbers follow, read in the way that makes most cells numbers, then most columns.
    """
    for first in range(min(len(lines), _LOOK)):
        best, most = None, (0.0, 0)
        for separator, decimal in _WAYS:
            trial = Dialect(separator, decimal, first, 0)
            rows = [trial.cells(line) for line in lines[first : first + 5]]
            fits = [len(row) == len(rows[0]) and _numeric_width(row, decimal) > 0 for row in rows]
            # Most of the next five lines must be numbers of one width; broken cells may come among the first.
            if not fits[0] or sum(fits) < (len(rows) + 1) // 2:
                continue
            score = (_number_share(rows, decimal), len(rows[0]))
            if score > most:
                best, most = Dialect(separator, decimal, first, len(rows[0])), score
        if best is not None:
            return _without_empty_tail(best, lines)
    raise RecordingError(
        f"{name}: found no rows of two or more numbers; a recording needs time, displacement and force in columns "
        f"separated by comma, semicolon, tab or blanks"
    )


def _without_empty_tail(dialect: Dialect, lines: list[str]) -> Dialect:
    """Drop a column that exists only because every line ends with a separator."""
    sample = [dialect.cells(line) for line in lines[dialect.first : dialect.first + 50]]
    width = dialect.width
    while width > 2 and all(len(row) < width or row[width - 1] == "" for row in sample):
        width -= 1
    return Dialect(dialect.separator, dialect.decimal, dialect.first, width)


def _numeric_width(cells: list[str], decimal: str) -> int:
    """Count the cells if at least two and half of them are numbers and none of the others is a word, else 0."""
    pattern = _POINT if decimal == "." else _COMMA
    numbers = sum(bool(pattern.match(cell)) for cell in cells)
    return len(cells) if numbers >= 2 and numbers >= len(cells) / 2 else 0


def _number_share(rows: list[list[str]], decimal: str) -> float:
    """Share of the cells that are numbers, empty cells left out."""
    pattern = _POINT if decimal == "." else _COMMA
    cells = [cell for row in rows for cell in row if cell]
    return round(sum(bool(pattern.match(cell)) for cell in cells) / max(1, len(cells)), 3)


def _header(above: list[str], dialect: Dialect) -> tuple[list[str], list[str | None]]:
    """Names and units from the lines above the numbers."""
    rows = [cells for cells in (dialect.cells(line)[: dialect.width] for line in above) if len(cells) == dialect.width]
    if not rows:
        return [""] * dialect.width, [None] * dialect.width
    unit_row: list[str | None] = [None] * dialect.width
    if len(rows) > 1 and all(is_unit_cell(cell) for cell in rows[-1]) and any(rows[-1]):
        unit_row = [cell.strip("()[]{}<>").strip() or None for cell in rows.pop()]
    pairs = [split_header(cell) for cell in rows[-1]]
    return [name for name, _ in pairs], [unit or below for (_, unit), below in zip(pairs, unit_row, strict=True)]


def _numbers(lines: list[str], dialect: Dialect, names: list[str]) -> tuple[FloatArray, list[Finding]]:
    """Parse the rows with pandas; count and name what is no number; drop notes at the end."""
    import pandas as pd  # noqa: PLC0415

    lines, findings = _without_notes(lines, dialect)
    # pandas 3 reads every digit by itself and warns when asked to; pandas 2 has to be asked.
    exact: dict[str, Any] = {} if int(pd.__version__.split(".")[0]) >= 3 else {"float_precision": "round_trip"}
    frame = pd.read_csv(
        io.StringIO("\n".join(lines)),
        sep=r"\s+" if dialect.separator == " " else dialect.separator,
        header=None,
        names=list(range(dialect.width)),
        usecols=list(range(dialect.width)),
        index_col=False,
        decimal=dialect.decimal,
        **exact,
        skipinitialspace=True,
        on_bad_lines="skip",
        low_memory=False,
    )
    if len(frame) < len(lines):
        findings.append(
            Finding(
                "broken-rows",
                "repaired",
                f"{len(lines) - len(frame)} rows with too many cells left out",
                len(lines) - len(frame),
            )
        )
    columns = []
    for i in range(dialect.width):
        raw = frame[i]
        if raw.dtype == object or pd.api.types.is_string_dtype(raw.dtype):
            as_text = raw.astype("string").str.strip()
            if dialect.decimal == ",":
                as_text = as_text.str.replace(",", ".", regex=False)
            numbers = pd.to_numeric(as_text, errors="coerce")
            words = numbers.isna() & as_text.notna() & ~as_text.str.lower().isin(_EMPTY).fillna(True)
            if bool(words.any()):
                row = int(np.flatnonzero(words.to_numpy())[0])
                findings.append(_text_cell(names[i] or f"#{i + 1}", int(words.sum()), row, str(raw.iloc[row])))
            raw = numbers.astype("float64")
        columns.append(as_floats(raw.to_numpy(dtype=np.float64, na_value=np.nan)))
    return np.column_stack(columns), findings


def _text_cell(name: str, count: int, row: int, shown: str) -> Finding:
    """Describe the cells that hold words."""
    return Finding(
        "text-cells",
        "note",
        f"column {name}: {count} cells hold text, the first is {shown[:20]!r} in row {row + 1} of the numbers",
        count,
    )


def _without_notes(lines: list[str], dialect: Dialect) -> tuple[list[str], list[Finding]]:
    """Leave out the remarks that some machines print below the numbers."""
    end = len(lines)
    while end > 1 and end > len(lines) - _LOOK and _numeric_width(dialect.cells(lines[end - 1]), dialect.decimal) == 0:
        end -= 1
    left_out = len(lines) - end
    if left_out == 0:
        return lines, []
    text = lines[end].strip()[:40]
    return lines[:end], [Finding("notes", "note", f"{left_out} lines below the numbers left out ({text!r})", left_out)]
