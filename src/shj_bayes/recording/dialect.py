"""How a text table is written: separator, decimal sign, header, first line of numbers."""

import csv
import re
from collections import deque
from dataclasses import dataclass, replace

from shj_bayes.errors import RecordingError
from shj_bayes.recording.limits import MAX_CELL, MAX_COLUMNS
from shj_bayes.recording.stamps import is_stamp
from shj_bayes.recording.tables import bounded_columns

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


@dataclass(frozen=True)
class Dialect:
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


def is_number(cell: str, decimal: str) -> bool:
    """Whether a cell is a number in the given way of writing, with or without groups of thousands."""
    # Long runs of digits would make the search for groups slow, and no instrument prints them.
    return len(cell) <= MAX_CELL and bool(PLAIN[decimal].fullmatch(cell) or GROUPED[decimal].fullmatch(cell))


def find_dialect(lines: list[str], name: str) -> Dialect:
    """Separator, decimal sign and first line of numbers, from lines without comments and empty ones.

    It is the first line from which numbers follow, read in the way that makes most cells numbers, then most columns.
    Each line is taken apart once for each separator, and no further than the cells that a table may have.
    """
    ahead: deque[dict[str, tuple[list[str], dict[str, int]]]] = deque()
    for first in range(min(len(lines), LOOK)):
        ahead.extend(map(_taken_apart, lines[first + len(ahead) : first + 5]))
        best, most = None, (0.0, 0)
        for separator, decimal in _WAYS:
            rows = [line[separator][0] for line in ahead]
            width = len(rows[0])
            if len(rows) > 1 and width == len(rows[1]) + 1 and rows[0][-1][:1].isalpha():
                width -= 1  # a comment behind the first sample, as LabVIEW writes it
            fits = [len(line[separator][0]) == width and line[separator][1][decimal] > 0 for line in ahead]
            fits[0] = ahead[0][separator][1][decimal] > 0
            # Most of the next five lines must be numbers of one width; broken cells may come among the first.
            if not fits[0] or sum(fits) < (len(rows) + 1) // 2:
                continue
            if _is_label(rows[0][0], [row[0] for row, fit in zip(rows[1:], fits[1:], strict=True) if fit]):
                continue
            score = (_number_share(rows, decimal), width)
            if score > most:
                best, most = Dialect(separator, decimal, first, width), score
        if best is not None:
            if best.width > MAX_COLUMNS:
                bounded_columns(best.cells(lines[first]), name)
            return _without_empty_tail(best, lines)
        ahead.popleft()
    raise NoNumbersError(
        f"{name}: found no rows of two or more numbers; a recording needs time, displacement and force in columns "
        f"separated by comma, semicolon, tab or blanks"
    )


def _taken_apart(line: str) -> dict[str, tuple[list[str], dict[str, int]]]:
    """Cells of a line by separator, and whether they are numbers by decimal sign."""
    found = {}
    for separator in ("\t", ";", ",", " "):
        cells = Dialect(separator, ".", 0, 0).cells(line, MAX_COLUMNS + 1)
        found[separator] = cells, {sign: numeric_width(cells, sign) for sign in PLAIN}
    return found


def _is_label(cell: str, below: list[str]) -> bool:
    """Whether a row begins with a word and those below it do not: ``Interval;0.05;0.05`` is none of numbers."""
    word = cell[:1].isalpha() and cell.lower() != "nan" and not is_stamp(cell)
    return word and bool(below) and 2 * sum(not one[:1].isalpha() for one in below) >= len(below)


def numeric_width(cells: list[str], decimal: str) -> int:
    """Count the cells if at least two of them, and half of those that are no time stamps, are numbers, else 0."""
    numbers = sum(is_number(cell, decimal) for cell in cells)
    if numbers < 2 or (numbers < len(cells) / 2 and numbers < (len(cells) - sum(map(is_stamp, cells))) / 2):
        return 0
    return len(cells)


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
