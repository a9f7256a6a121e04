"""How a text table is written: separator, decimal sign, header, first line of numbers."""

import csv
import re
from dataclasses import dataclass, replace

from shj_bayes.errors import RecordingError
from shj_bayes.recording.headers import bare_unit, is_unit_row, split_header
from shj_bayes.recording.limits import MAX_CELL

LOOK = 400  # lines looked at to find the header; exports with longer preambles do not occur
# Groups of three digits; a blank groups only where it does not separate (thin and hard blanks are what typists use).
_GROUPS = {".": ",'\u2019 \u00a0\u202f", ",": ".'\u2019 \u00a0\u202f"}
PLAIN = {
    ".": re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eEdD][+-]?[0-9]+)?"),
    ",": re.compile(r"[+-]?([0-9]+,?[0-9]*|,[0-9]+)([eEdD][+-]?[0-9]+)?"),
}
GROUPED = {
    decimal: re.compile(rf"[+-]?[0-9]{{1,3}}([{signs}])[0-9]{{3}}(\1[0-9]{{3}})*([{decimal}][0-9]*)?")
    for decimal, signs in _GROUPS.items()
}
# Separator and decimal sign, the likelier first.
_WAYS = (("\t", "."), (";", "."), (",", "."), (" ", "."), ("\t", ","), (";", ","), (" ", ","))


class NoNumbersError(RecordingError):
    """Text without rows of numbers; another sheet of the same workbook may have some."""


@dataclass(frozen=True)
class Dialect:
    """How a text table is written."""

    separator: str  # ``","``, ``";"``, tab, or a blank for any run of blanks
    decimal: str  # ".", ",": decimal sign
    first: int  # index of the first line of numbers
    width: int  # number of columns

    def cells(self, line: str) -> list[str]:
        """Cells of one line."""
        if self.separator == " ":
            parts = line.split()
        elif line.count('"') % 2 == 0 and '"' in line:
            parts = next(csv.reader([line], delimiter=self.separator))  # a quoted header may hold the separator
        else:
            parts = line.split(self.separator)
        return [part.strip().strip('"').strip() for part in parts]


def is_number(cell: str, decimal: str) -> bool:
    """Whether a cell is a number in the given way of writing, with or without groups of thousands."""
    # Long runs of digits would make the search for groups slow, and no instrument prints them.
    return len(cell) <= MAX_CELL and bool(PLAIN[decimal].fullmatch(cell) or GROUPED[decimal].fullmatch(cell))


def find_dialect(lines: list[str], name: str) -> Dialect:
    """Separator, decimal sign and first line of numbers, from lines without comments and empty ones.

    It is the first line from which numbers follow, read in the way that makes most cells numbers, then most columns.
    """
    for first in range(min(len(lines), LOOK)):
        best, most = None, (0.0, 0)
        for separator, decimal in _WAYS:
            trial = Dialect(separator, decimal, first, 0)
            rows = [trial.cells(line) for line in lines[first : first + 5]]
            fits = [len(row) == len(rows[0]) and numeric_width(row, decimal) > 0 for row in rows]
            # Most of the next five lines must be numbers of one width; broken cells may come among the first.
            if not fits[0] or sum(fits) < (len(rows) + 1) // 2:
                continue
            score = (_number_share(rows, decimal), len(rows[0]))
            if score > most:
                best, most = Dialect(separator, decimal, first, len(rows[0])), score
        if best is not None:
            return _without_empty_tail(best, lines)
    raise NoNumbersError(
        f"{name}: found no rows of two or more numbers; a recording needs time, displacement and force in columns "
        f"separated by comma, semicolon, tab or blanks"
    )


def header_of(above: list[str], dialect: Dialect) -> tuple[list[str], list[str | None], list[str]]:
    """Names, units and headers as written, from the lines above the numbers."""
    rows = [cells for cells in (dialect.cells(line)[: dialect.width] for line in above) if len(cells) == dialect.width]
    while rows and _damaged(rows, dialect.decimal):
        rows.pop()
    if not rows:
        return [""] * dialect.width, [None] * dialect.width, ["(no name)"] * dialect.width
    unit_row: list[str | None] = [None] * dialect.width
    if len(rows) > 1 and is_unit_row(rows[-1]):
        unit_row = [bare_unit(cell) or None for cell in rows.pop()]
    pairs = [split_header(cell) for cell in rows[-1]]
    units = [unit or below for (_, unit), below in zip(pairs, unit_row, strict=True)]
    written = [
        f"{cell} ({unit})" if unit and own is None else cell or "(no name)"
        for cell, (_, own), unit in zip(rows[-1], pairs, units, strict=True)
    ]
    return [name for name, _ in pairs], units, written


def _damaged(rows: list[list[str]], decimal: str) -> bool:
    """Whether the last row is no header but the first sample with its readings lost: a number under names, or alone."""
    numbers = [any(is_number(cell, decimal) for cell in cells) for cells in rows]
    alone = all(cell == "" or is_number(cell, decimal) for cell in rows[-1])
    return numbers[-1] and (alone or (len(rows) > 1 and not numbers[-2]))


def numeric_width(cells: list[str], decimal: str) -> int:
    """Count the cells if at least two and half of them are numbers and none of the others is a word, else 0."""
    numbers = sum(is_number(cell, decimal) for cell in cells)
    return len(cells) if numbers >= 2 and numbers >= len(cells) / 2 else 0


def _without_empty_tail(dialect: Dialect, lines: list[str]) -> Dialect:
    """Drop a column that exists only because every line ends with a separator."""
    sample = [dialect.cells(line) for line in lines[dialect.first : dialect.first + 50]]
    width = dialect.width
    while width > 2 and all(len(row) < width or row[width - 1] == "" for row in sample):
        width -= 1
    return replace(dialect, width=width)


def _number_share(rows: list[list[str]], decimal: str) -> float:
    """Share of the cells that are numbers, empty cells left out."""
    cells = [cell for row in rows for cell in row if cell]
    return round(sum(is_number(cell, decimal) for cell in cells) / max(1, len(cells)), 3)
