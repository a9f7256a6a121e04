"""XLSX workbooks: the sheet that holds a recording."""

import re
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.parsers import expat

from shj_bayes.errors import RecordingError, did_you_mean, shown
from shj_bayes.recording import limits
from shj_bayes.recording.columns import candidates
from shj_bayes.recording.formats.text import table_from_lines
from shj_bayes.recording.recording import Finding
from shj_bayes.recording.rows import NoNumbersError
from shj_bayes.recording.tables import Format, Table, grouped
from shj_bayes.recording.units import ROLES

_ENCODINGS = {"utf-8", "us-ascii", "iso-8859-1"}
_SHEET = re.compile(rb"<(?:\w+:)?sheet[\s/>]")
_ROW = re.compile(rb"<(?:\w+:)?(?:row|si)[\s/>]")


def read_excel(path: Path, sheet: str | None) -> Table:
    """Read the sheet of an XLSX workbook that holds a recording, formulas as the values last stored.

    `sheet` names it; else it is the one whose header names most of the channels. Sheets that do so alike and are called
    Run 1, Run 2 ... are runs; others are refused, by their names.
    """
    _bounded(path)
    from openpyxl import load_workbook  # noqa: PLC0415

    book = load_workbook(path, read_only=True, data_only=True, keep_links=False)
    try:
        names = list(book.sheetnames)
        asked = [name for name in names if sheet in (None, name)]
        if sheet is not None and not asked:
            asked = [name for name in names if name.lower() == sheet.strip().lower()][:1]
            if not asked:
                known = f"{did_you_mean(sheet, names)}; sheets are {', '.join(names[:8])}"
                raise RecordingError(f"{path.name}: there is no sheet {sheet!r}{known}")
        tables: dict[str, Table] = {}
        left = [limits.MAX_TABLE_CELLS]
        for name in asked:
            if not hasattr(book[name], "iter_rows"):  # a chart sheet
                continue
            try:  # by way of the text reader, so that both find headers by the same rules
                tables[name] = table_from_lines(_lines(book[name], path.name, left), path.name)
            except NoNumbersError:
                continue
            except RecordingError as error:
                other = f" (sheet {name!r}; another one is read with --sheet NAME)" if len(asked) > 1 else ""
                raise RecordingError(f"{error}{other}") from error
    finally:
        book.close()
    if not tables:
        said = ", ".join(asked[:8])
        raise RecordingError(f"{path.name}: no sheet holds rows of two or more numbers; sheets are {said}")
    return next(iter(tables.values())) if len(names) == 1 else _best(tables, path.name)


def _best(tables: dict[str, Table], book: str) -> Table:
    """Choose the sheet that holds a recording, or put together those that are its runs."""
    claims = {}
    for name, table in tables.items():  # as many rows as a recording has, channels that are named, and named exactly
        found = [candidates(table, role) for role in ROLES]
        long = max(c.values.size for c in table.columns) >= limits.MIN_SAMPLES
        exact = sum(exact and len(columns) == 1 for columns, exact in found)
        claims[name] = long, sum(bool(columns) for columns, _ in found), exact
    best = max(claims.values())
    equal = [name for name, claim in claims.items() if claim == best]
    table = tables[equal[0]]
    if len(equal) > 1 and best[1] >= len(ROLES) - 1:
        columns = [replace(c, group=name) for name in equal for c in tables[name].columns]
        joined, told = grouped(columns, book, "/")
        if not told:
            raise RecordingError(
                f"{book}: sheets {', '.join(equal[:8])} all hold what may be the recording; say which with --sheet, as "
                f"in --sheet {equal[0]!r}"
            )
        notes = dict.fromkeys(finding for name in equal for finding in tables[name].findings)
        return replace(table, columns=joined, findings=(*notes, *told))
    others = [name for name in tables if name not in equal]
    besides = f"; not read: {', '.join(others[:8])}" if others else ""
    why = "whose header names the channels" if best[1] else "the first with numbers"
    note = Finding("sheet", "assumed", f"sheet {equal[0]!r} is read, {why}{besides}; --sheet NAME takes another")
    return replace(table, findings=(*table.findings, note))


def _bounded(path: Path) -> None:
    """Look at the zip directory, and at the head of every part, before anything is unpacked whole."""
    size = path.stat().st_size
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
            total = sum(entry.file_size for entry in entries)
            if total > limits.MAX_BYTES:
                raise RecordingError(
                    f"{path.name} unpacks to {total / 1024**2:.0f} MiB; "
                    f"allowed are {limits.MAX_BYTES // 1024**2} MiB; save one sheet as CSV"
                )
            if total > limits.MAX_RATIO * size + limits.CHUNK_BYTES or len(entries) > limits.MAX_PARTS:
                raise RecordingError(
                    f"{path.name} has {len(entries)} parts that unpack to {total / size:.0f} times its size; allowed "
                    f"are {limits.MAX_PARTS} parts and {limits.MAX_RATIO} times; that is no workbook; save one sheet "
                    "as CSV"
                )
            sheets = 0
            for entry in entries:
                if entry.filename.lower().endswith((".xml", ".rels", ".vml")):
                    _refuse_doctype(archive, entry, path.name)
                    sheets += _looked_through(archive, entry, path.name)
            if sheets > limits.MAX_SHEETS:
                raise RecordingError(
                    f"{path.name} names more than {limits.MAX_SHEETS} sheets; save the one that holds the recording "
                    "as CSV"
                )
    except zipfile.BadZipFile as error:
        raise RecordingError(f"{path.name} is not an XLSX workbook ({error}); save it again as .xlsx") from error


def _refuse_doctype(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, name: str) -> None:
    """Refuse a part with a document type: only there can entities be declared, and no workbook has one.

    Expat reads up to the first element, so comments before it cannot hide anything. A part in another encoding than
    those of workbooks is refused as well, since its rows could not be counted.
    """
    parser = expat.ParserCreate()
    found, encodings = list[str](), list[str]()
    parser.StartDoctypeDeclHandler = lambda *_: found.append("doctype")
    parser.StartElementHandler = lambda *_: found.append("element")
    parser.XmlDeclHandler = lambda _, encoding, __: encodings.append((encoding or "utf-8").lower())
    with archive.open(entry) as stream:
        try:
            while not found and (piece := stream.read(4096)):
                if b"\x00" in piece:
                    encodings.append("UTF-16")
                parser.Parse(piece)
        except expat.ExpatError:
            pass  # broken XML; openpyxl says so, and may not need this part at all
    if found[:1] == ["doctype"]:
        raise RecordingError(
            f"{name}: its part {entry.filename} declares a document type, which no workbook has and which can make "
            "a reader run for ever; save it again as .xlsx"
        )
    if other := set(encodings) - _ENCODINGS:
        raise RecordingError(
            f"{name}: its part {entry.filename} is written in {shown(min(other))}; allowed are "
            f"{', '.join(sorted(_ENCODINGS))}; save it again as .xlsx"
        )


def _looked_through(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, name: str) -> int:
    """Refuse a part with a longer row or text than any sheet has, which a reader builds whole; count its sheets."""
    sheets, since = 0, 0
    with archive.open(entry) as stream:
        while piece := stream.read(limits.CHUNK_BYTES):
            sheets += len(_SHEET.findall(piece))
            starts = [match.start() for match in _ROW.finditer(piece)]
            edges = [-since, *starts, len(piece)]
            longest = max(b - a for a, b in pairwise(edges))
            since = len(piece) - edges[-2]
            if longest > limits.MAX_ROW_BYTES:
                raise RecordingError(
                    f"{name}: its part {entry.filename} has a row or text of more than "
                    f"{limits.MAX_ROW_BYTES // 1024**2} MiB; that is no recording; save one sheet as CSV"
                )
    return sheets


def _lines(sheet: Any, book: str, left: list[int]) -> Iterator[list[str]]:
    """Rows of a sheet as lines of text, each a block of its own; `left` counts down the cells that may be read."""
    last: Any = None
    for row in sheet.iter_rows(max_row=limits.MAX_SHEET_ROWS, max_col=limits.MAX_COLUMNS, values_only=True):
        if row is last:  # a sheet that claims a cell in its last row gives the same empty row a million times
            continue
        last = row
        left[0] -= len(row)
        if left[0] < 0:
            raise RecordingError(f"{book}: more than {limits.MAX_TABLE_CELLS} cells; save the recording alone, as CSV")
        filled = [i for i, cell in enumerate(row) if cell is not None]
        if filled:
            yield ["\t".join(_cell(cell) for cell in row[: filled[-1] + 1])]


def _cell(value: object) -> str:
    """One cell as text without separators; repr keeps every digit of a number."""
    if value is None:
        return ""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return repr(float(value))
    return " ".join(str(value)[: limits.MAX_NAME].split())  # one long text may stand in every cell


FORMATS = (Format("xlsx", (".xlsx",), read_excel, sheets=True),)
