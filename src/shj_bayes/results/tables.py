"""Tables as files: CSV, and pages of a workbook, with text that no spreadsheet takes for a formula."""

import csv
import io
import math
import re
import unicodedata
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from html import escape
from pathlib import Path
from typing import Any, Self

from shj_bayes._util.files import replacing

WIDTH_ROWS, WIDEST = 200, 60
"""Rows of a workbook that the width of a column is taken from, and most of it in characters."""
LONGEST = 32_767  # characters of a cell
TEXTS = 2**16  # that are kept as they are written: most stand in many cells
EPOCH = (2000, 1, 1, 0, 0, 0)
_CLOCK = re.compile(rb"(?<=W3CDTF\">)[^<]*")  # in the properties of a workbook
_CELLS = re.compile(rb"<sheetData ?(/>|></sheetData>)")
_NO_CELL = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")  # signs that XML has no place for


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

    The library makes all of it but the cells, for which it takes ten times as long.
    """
    from openpyxl import Workbook  # noqa: PLC0415  (margins that stand need not load it)
    from openpyxl.utils import get_column_letter  # noqa: PLC0415

    book, cells = Workbook(write_only=True), {}
    for number, (name, table) in enumerate(pages.items(), start=1):
        page = book.create_sheet(name)
        rows = [table.heads, *table.rows]
        letters = [get_column_letter(place) for place in range(1, len(table.heads) + 1)]
        page.freeze_panes = "A2"
        page.auto_filter.ref = f"A1:{letters[-1]}{len(rows)}"
        for place, letter in enumerate(letters):
            longest = max(len(str(row[place] or "")) for row in rows[:WIDTH_ROWS])
            page.column_dimensions[letter].width = min(WIDEST, longest + 2)
        cells[f"xl/worksheets/sheet{number}.xml"] = _cells(rows, letters)
    made = io.BytesIO()
    book.save(made)
    with replacing(path) as part, zipfile.ZipFile(made) as old, zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            content = old.read(name)
            if name in cells:
                begin, end = _CELLS.search(content).span()  # type: ignore[union-attr]
                content = content[:begin] + cells[name] + content[end:]
            elif name == "docProps/core.xml":  # without the time of writing: the same margins, the same bytes
                content = _CLOCK.sub(b"2000-01-01T00:00:00Z", content)
            new.writestr(zipfile.ZipInfo(name, EPOCH), content, new.compression)


def _cells(rows: Sequence[Sequence[Any]], letters: Sequence[str]) -> bytes:
    """Cells of a page as a workbook holds them: numbers to 16 digits, texts where they stand."""
    lines = []
    for number, row in enumerate(rows, start=1):
        own = "".join(
            f'<c r="{letter}{number}" {_content(cell)}'
            for letter, cell in zip(letters, row, strict=True)
            if cell is not None
        )
        lines.append(f'<row r="{number}">{own}</row>')
    return f"<sheetData>{''.join(lines)}</sheetData>".encode("utf-8", "replace")


def _content(cell: Any) -> str:
    """Kind and content of a cell, up to its end."""
    if isinstance(cell, str):
        return _text(cell)
    return f't="b"><v>{cell:d}</v></c>' if isinstance(cell, bool) else f't="n"><v>{cell:.16g}</v></c>'


@lru_cache(TEXTS)
def _text(cell: str) -> str:
    if not cell:
        return 't="inlineStr" />'
    text = _NO_CELL.sub("", cell[:LONGEST])
    kept = ' xml:space="preserve"' if text.strip() not in ("", text) else ""
    return f't="inlineStr"><is><t{kept}>{escape(text, quote=False)}</t></is></c>'
