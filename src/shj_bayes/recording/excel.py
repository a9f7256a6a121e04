"""XLSX workbooks: the first sheet that holds a table of numbers."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

from shj_bayes.errors import RecordingError
from shj_bayes.recording.limits import MAX_BYTES, MAX_COLUMNS, MAX_ROWS
from shj_bayes.recording.recording import Finding
from shj_bayes.recording.tables import Table


def read_excel(path: Path, sha256: str) -> Table:
    """Read an XLSX workbook.

    Parameters
    ----------
    path : Path
        The workbook; formulas are read as the values last stored.
    sha256 : str
        Its digest.

    Returns
    -------
    Table
    """
    _bounded(path)
    from openpyxl import load_workbook  # noqa: PLC0415

    book = load_workbook(path, read_only=True, data_only=True, keep_links=False)
    try:
        names = list(book.sheetnames)
        for name in names:
            sheet = book[name]
            if not hasattr(sheet, "iter_rows"):  # a chart sheet
                continue
            table = _from_rows(_rows(sheet, path.name), path.name, sha256)
            if table is not None:
                return _with_sheet_note(table, name, names)
    finally:
        book.close()
    raise RecordingError(f"{path.name}: no sheet holds rows of two or more numbers; sheets are {', '.join(names[:8])}")


def _bounded(path: Path) -> None:
    """Look at the zip directory before anything is unpacked."""
    try:
        with zipfile.ZipFile(path) as archive:
            total = sum(entry.file_size for entry in archive.infolist())
    except zipfile.BadZipFile as error:
        raise RecordingError(f"{path.name} is not an XLSX workbook ({error}); save it again as .xlsx") from error
    if total > MAX_BYTES:
        raise RecordingError(
            f"{path.name} unpacks to {total / 1024**2:.0f} MiB; "
            f"allowed are {MAX_BYTES // 1024**2} MiB; save one sheet as CSV"
        )


def _rows(sheet: Any, name: str) -> list[list[object]]:
    """Cells of a sheet up to the bounds, without the empty rows."""
    rows: list[list[object]] = []
    for row in sheet.iter_rows(max_col=MAX_COLUMNS, values_only=True):
        filled = [i for i, cell in enumerate(row) if cell is not None]
        if filled:
            rows.append(list(row[: filled[-1] + 1]))
        if len(rows) > MAX_ROWS:
            raise RecordingError(f"{name} has more than {MAX_ROWS} rows; export fewer")
    return rows


def _from_rows(rows: list[list[object]], name: str, sha256: str) -> Table | None:
    """Table of a sheet by way of the text reader, so that both find headers by the same rules."""
    from shj_bayes.recording.text import table_from_lines  # noqa: PLC0415

    lines = ["\t".join(_cell(cell) for cell in row) for row in rows]
    try:
        return table_from_lines(lines, name, sha256, "xlsx")
    except RecordingError:
        return None


def _cell(value: object) -> str:
    """One cell as text without separators; repr keeps every digit of a number."""
    if value is None:
        return ""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return repr(float(value))
    return str(value).replace("\t", " ").replace("\n", " ")


def _with_sheet_note(table: Table, used: str, names: list[str]) -> Table:
    """Say which of several sheets was read."""
    if len(names) == 1:
        return table
    note = Finding("sheet", "assumed", f"sheet {used!r} is read, the first with numbers of {len(names)}")
    return Table(
        table.name, table.format, table.sha256, table.columns, table.has_header, table.scalars, (*table.findings, note)
    )
