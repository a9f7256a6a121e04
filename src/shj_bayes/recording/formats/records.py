"""JSON files: a list of records, a list of rows, or an object of columns, alone or under one of the keys."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes.errors import RecordingError
from shj_bayes.recording.formats.format import Format
from shj_bayes.recording.headers import split_header
from shj_bayes.recording.limits import MAX_JSON_BYTES
from shj_bayes.recording.recording import Finding, FloatArray
from shj_bayes.recording.tables import Column, Table, as_floats, bounded_columns, left_out

_SHAPES = '[{"time_s": 0, ...}, ...], {"time_s": [0, ...], ...} or [[0, ...], ...]'


def read_records(path: Path, sha256: str) -> Table:
    """Read a table out of JSON; ``units``, an object of column to unit, is read too.

    Single numbers beside the columns can be used in formulas. `RecordingError` if it is too large or holds no table.
    """
    size = path.stat().st_size
    if size > MAX_JSON_BYTES:
        raise RecordingError(
            f"{path.name} has {size / 1024**2:.0f} MiB; of JSON at most {MAX_JSON_BYTES // 1024**2} MiB are read; "
            "export CSV or HDF5, which take a fifth of the room"
        )
    content = json.loads(path.read_bytes(), parse_int=float)
    beside = content if isinstance(content, dict) else {}
    names, lists = _table(content, path.name)
    given = beside.get("units")
    units: dict[str, Any] = given if isinstance(given, dict) else {}
    columns, skipped = list[Column](), list[str]()
    text = 0
    for name, cells in zip(names, lists, strict=True):
        values, words = _numbers(cells)
        if np.any(np.isfinite(values)) or not name:
            plain, unit = split_header(name)
            stated = units.get(name, units.get(plain))
            columns.append(Column(plain or f"#{len(columns) + 1}", values, str(stated) if stated else unit, name))
            text += words
        else:
            skipped.append(name)
    findings = [*left_out(skipped)]
    if text:
        findings.append(Finding("text-cells", "note", f"{text} cells hold words or lists; they count as empty", text))
    if beside.get("simulated") is True or any("simulated" in v.lower() for v in beside.values() if isinstance(v, str)):
        findings.append(Finding("simulated", "note", "the file says that it is simulated, not measured"))
    scalars = {key: value for key, value in beside.items() if isinstance(value, float)}
    return Table(path.name, "json", sha256, tuple(columns), any(names), scalars, tuple(findings))


def _table(content: Any, name: str) -> tuple[list[str], list[list[Any]]]:
    """Names and cells of the columns; of an object also those of the first value that is a table itself."""
    found = _columns(content, name)
    if found is None and isinstance(content, dict):
        found = next((table for value in content.values() if (table := _columns(value, name)) is not None), None)
    if found is None:
        raise RecordingError(f"{name}: found no table of numbers in this JSON; write it as {_SHAPES}")
    return found


def _columns(content: Any, name: str) -> tuple[list[str], list[list[Any]]] | None:
    """Columns of one of the three shapes; None for anything else."""
    if isinstance(content, dict):
        lists = {key: value for key, value in content.items() if isinstance(value, list) and len(value) > 1}
        lists = {key: cells for key, cells in lists.items() if not any(isinstance(c, dict | list) for c in cells)}
        return (bounded_columns(list(lists), name), list(lists.values())) if lists else None
    if not isinstance(content, list) or len(content) < 2:
        return None
    if all(isinstance(record, dict) for record in content):
        keys = bounded_columns(list(dict.fromkeys(key for record in content for key in record)), name)
        return (keys, [[record.get(key) for record in content] for key in keys]) if keys else None
    if all(isinstance(row, list) for row in content):
        names = bounded_columns([""] * max(map(len, content)), name)
        return names, [[row[i] if i < len(row) else None for row in content] for i in range(len(names))]
    return None


def _numbers(cells: list[Any]) -> tuple[FloatArray, int]:
    """Cells as numbers, and how many held something that is none; true and false are 1 and 0."""
    values = [float(cell) if isinstance(cell, float | bool) else np.nan for cell in cells]
    return as_floats(values), sum(not isinstance(cell, float | bool) and cell is not None for cell in cells)


FORMATS = (Format("json", (".json",), read_records),)
