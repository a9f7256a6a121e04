"""Tables as files: CSV, and pages of a workbook, with text that no spreadsheet takes for a formula."""

import csv
import io
import math
import re
import unicodedata
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Self
from xml.sax.saxutils import escape

from shj_bayes._util.files import replacing

WIDTH_ROWS, WIDEST = 200, 60
"""Rows of a workbook that the width of a column is taken from, and most of it in characters."""
TEXTS = 2**16  # that are kept as they are written: most stand in many cells
EPOCH = (2000, 1, 1, 0, 0, 0)
_NOT_IN_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f]")
_ROWS = re.compile(rb"<sheetData\s*/>|<sheetData></sheetData>")
_CLOCK = re.compile(rb"(?<=W3CDTF\">)[^<]*")  # in the properties of a workbook


class Cells:
    """Rows of cells under heads: texts, numbers and truth values, and None for none.

    Attributes
    ----------
    heads : tuple of str
    rows : list of list
        What does not apply is None, and infinity a word, which a workbook has no number for.
    """

    def __init__(self, heads: Iterable[str], rows: Iterable[Iterable[Any]]) -> None:
        """Take cells as they are, with NaN and texts that a spreadsheet would run."""
        self.heads = tuple(heads)
        self.rows = [list(map(safe_cell, row)) for row in rows]

    @classmethod
    def of(cls, records: Sequence[Mapping[str, Any]], heads: Iterable[str] = ()) -> Self:
        """Table of records, under heads in the order in which the records have them where none are given."""
        heads = tuple(heads) or tuple(dict.fromkeys(key for record in records for key in record))
        return cls(heads, ([record.get(head) for head in heads] for record in records))

    def to_csv(self) -> str:
        """Table as CSV; a cell of none is empty."""
        made = io.StringIO()
        written = csv.writer(made, lineterminator="\n")
        written.writerows([self.heads, *self.rows])
        return made.getvalue()


def safe_cell(value: Any) -> Any:
    """Cell of a file: a text that a spreadsheet would run as a formula has an apostrophe before it."""
    if isinstance(value, str):
        return _safe(value)
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value


@lru_cache(TEXTS)
def _safe(text: str) -> str:
    first = unicodedata.normalize("NFKC", text.lstrip()[:1])  # full-width and small signs as the plain ones
    runs = text.startswith(("\t", "\r")) or first in ("=", "+", "-", "@", "\u2212")
    return "'" + text if runs else text


def write_workbook(pages: Mapping[str, Cells], path: Path) -> None:
    """Write tables as the pages of a workbook; the same tables make the same bytes.

    The rows are written here, in the frame that openpyxl makes: cell by cell it takes most of the time of a command.
    """
    from openpyxl import Workbook  # noqa: PLC0415  (margins that stand need not load it)
    from openpyxl.utils import get_column_letter  # noqa: PLC0415

    book, rows_of = Workbook(write_only=True), {}
    for number, (name, table) in enumerate(pages.items(), start=1):
        page = book.create_sheet(name)
        rows = [table.heads, *table.rows]
        letters = [get_column_letter(place) for place in range(1, len(table.heads) + 1)]
        page.freeze_panes = "A2"
        page.auto_filter.ref = f"A1:{letters[-1]}{len(rows)}"
        for place, letter in enumerate(letters):
            longest = max(len(str(row[place] or "")) for row in rows[:WIDTH_ROWS])
            page.column_dimensions[letter].width = min(WIDEST, longest + 2)
        text = []
        for n, row in enumerate(rows, start=1):
            filled = ((a, cell) for a, cell in zip(letters, row, strict=True) if cell is not None)
            cells = "".join(f'<c r="{a}{n}" {_cell(cell)}</c>' for a, cell in filled)
            text.append(f'<row r="{n}">{cells}</row>')
        rows_of[f"xl/worksheets/sheet{number}.xml"] = f"<sheetData>{''.join(text)}</sheetData>".encode()
    made = io.BytesIO()
    book.save(made)
    with replacing(path) as part, zipfile.ZipFile(made) as old, zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():  # without the time of writing: the same margins, the same bytes
            frame = _CLOCK.sub(b"2000-01-01T00:00:00Z", old.read(name))
            before, *after = _ROWS.split(frame)
            new.writestr(
                zipfile.ZipInfo(name, EPOCH), rows_of.get(name, b"").join([before, *after]), zipfile.ZIP_DEFLATED
            )


def _cell(value: Any) -> str:
    """Write a cell of a workbook, from its kind on."""
    if isinstance(value, bool):
        return f't="b"><v>{int(value)}</v>'
    if isinstance(value, int | float):
        return f't="n"><v>{value}</v>'
    return _text_cell(str(value))


@lru_cache(TEXTS)
def _text_cell(text: str) -> str:
    return f't="inlineStr"><is><t xml:space="preserve">{escape(_NOT_IN_XML.sub("", text))}</t></is>'
