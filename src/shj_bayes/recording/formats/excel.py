"""XLSX workbooks: the first sheet that holds a table of numbers."""

import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.parsers import expat

from shj_bayes.errors import RecordingError
from shj_bayes.recording.dialect import NoNumbersError
from shj_bayes.recording.formats.format import Format
from shj_bayes.recording.formats.text import table_from_lines
from shj_bayes.recording.limits import CHUNK_BYTES, MAX_BYTES, MAX_COLUMNS, MAX_PARTS, MAX_RATIO, MAX_SHEET_ROWS
from shj_bayes.recording.recording import Finding
from shj_bayes.recording.tables import Table


def read_excel(path: Path, sha256: str) -> Table:
    """Read an XLSX workbook, formulas as the values last stored; `sha256` is its digest."""
    _bounded(path)
    from openpyxl import load_workbook  # noqa: PLC0415

    book = load_workbook(path, read_only=True, data_only=True, keep_links=False)
    try:
        names = list(book.sheetnames)
        for name in names:
            sheet = book[name]
            if not hasattr(sheet, "iter_rows"):  # a chart sheet
                continue
            try:  # by way of the text reader, so that both find headers by the same rules
                table = table_from_lines(_lines(sheet), path.name, sha256, "xlsx")
            except NoNumbersError:
                continue
            note = Finding("sheet", "assumed", f"sheet {name!r} is read, the first with numbers of {len(names)}")
            return table if len(names) == 1 else replace(table, findings=(*table.findings, note))
    finally:
        book.close()
    raise RecordingError(f"{path.name}: no sheet holds rows of two or more numbers; sheets are {', '.join(names[:8])}")


def _bounded(path: Path) -> None:
    """Look at the zip directory, and at the head of every part, before anything is unpacked whole."""
    size = path.stat().st_size
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            total = sum(entry.file_size for entry in entries)
            if total > MAX_BYTES:
                raise RecordingError(
                    f"{path.name} unpacks to {total / 1024**2:.0f} MiB; "
                    f"allowed are {MAX_BYTES // 1024**2} MiB; save one sheet as CSV"
                )
            if total > MAX_RATIO * size + CHUNK_BYTES or len(entries) > MAX_PARTS:
                raise RecordingError(
                    f"{path.name} has {len(entries)} parts that unpack to {total / size:.0f} times its size; allowed "
                    f"are {MAX_PARTS} parts and {MAX_RATIO} times; that is no workbook; save one sheet as CSV"
                )
            for entry in entries:
                if entry.filename.lower().endswith((".xml", ".rels", ".vml")):
                    _refuse_doctype(archive, entry, path.name)
    except zipfile.BadZipFile as error:
        raise RecordingError(f"{path.name} is not an XLSX workbook ({error}); save it again as .xlsx") from error


def _refuse_doctype(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, name: str) -> None:
    """Refuse a part with a document type: only there can entities be declared, and no workbook has one.

    Expat reads up to the first element, so the encoding and comments before it cannot hide anything.
    """
    parser = expat.ParserCreate()
    found: list[str] = []
    parser.StartDoctypeDeclHandler = lambda *_: found.append("doctype")
    parser.StartElementHandler = lambda *_: found.append("element")
    with archive.open(entry) as stream:
        try:
            while not found and (piece := stream.read(4096)):
                parser.Parse(piece)
        except expat.ExpatError:
            pass  # broken XML; openpyxl says so, and may not need this part at all
    if found[:1] == ["doctype"]:
        raise RecordingError(
            f"{name}: its part {entry.filename} declares a document type, which no workbook has and which can make "
            "a reader run for ever; save it again as .xlsx"
        )


def _lines(sheet: Any) -> Iterator[str]:
    """Rows of a sheet as lines of text, without the empty ones.

    A sheet can claim a cell in its last row; openpyxl then hands out one and the same empty row a million times.
    """
    last: Any = None
    for row in sheet.iter_rows(max_row=MAX_SHEET_ROWS, max_col=MAX_COLUMNS, values_only=True):
        if row is last:
            continue
        last = row
        filled = [i for i, cell in enumerate(row) if cell is not None]
        if filled:
            yield "\t".join(_cell(cell) for cell in row[: filled[-1] + 1])


def _cell(value: object) -> str:
    """One cell as text without separators; repr keeps every digit of a number."""
    if value is None:
        return ""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return repr(float(value))
    return " ".join(str(value).split())


FORMATS = (Format("xlsx", (".xlsx",), read_excel),)
