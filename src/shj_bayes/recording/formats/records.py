"""JSON files: records, rows or columns, alone or under one of the keys, as pandas writes them, and a record a line."""

import json
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import RecordingError, shown
from shj_bayes.recording.limits import MAX_BRACKETS, MAX_CELL, MAX_JSON_BYTES, MAX_TABLE_CELLS
from shj_bayes.recording.recording import Column, Finding
from shj_bayes.recording.rows import PLAIN, split_header
from shj_bayes.recording.tables import Format, Table, as_floats, bounded_columns, left_out

_SHAPES = '[{"time_s": 0, ...}, ...], {"time_s": [0, ...], ...} or [[0, ...], ...]'
_INDEX = "index"  # of the rows, as pandas writes it
_Cells = list[tuple[str, list[Any]]]  # names and cells of columns


def read_records(path: Path) -> Table:
    """Read a table out of JSON; ``units``, an object of column to unit, is read too.

    Single numbers beside the columns can be used in formulas. `RecordingError` if it is too large or holds no table.
    """
    size = path.stat().st_size
    if size > MAX_JSON_BYTES:
        raise RecordingError(
            f"{path.name} has {size / 1024**2:.0f} MiB; of JSON at most {MAX_JSON_BYTES // 1024**2} MiB are read; "
            "export CSV or HDF5, which take a fifth of the room"
        )
    content = _parsed(path)
    beside = content if isinstance(content, dict) else {}
    table = _columns(content, path.name)
    if table is None:  # of an object also those of the first value that is a table itself
        table = next((found for value in beside.values() if (found := _columns(value, path.name)) is not None), None)
    if table is None:
        raise RecordingError(f"{path.name}: found no table of numbers in this JSON; write it as {_SHAPES}")
    given = beside.get("units")
    units: dict[str, Any] = given if isinstance(given, dict) else {}
    columns, skipped = list[Column](), list[str]()
    text = 0
    for name, cells in table:
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
    return Table(path.name, tuple(columns), any(name for name, _ in table), scalars, tuple(findings))


def _parsed(path: Path) -> Any:
    """Content of a file, or the list of its lines, each of which is one value; bounded before it is built."""
    raw = path.read_bytes()
    if raw.count(b",") > MAX_TABLE_CELLS or raw.count(b"[") + raw.count(b"{") > MAX_BRACKETS:
        raise RecordingError(
            f"{path.name} holds more than {MAX_TABLE_CELLS} values or {MAX_BRACKETS} rows; export CSV or HDF5"
        )

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found = dict(pairs)
        if len(found) < len(pairs):
            counts = Counter(key for key, _ in pairs)
            raise RecordingError(
                f"{path.name}: the name {shown(counts.most_common(1)[0][0])} stands twice in one object, and nothing "
                "tells which of the two counts; export each column under a name of its own"
            )
        return found

    parse = partial(json.loads, parse_int=float, object_pairs_hook=once)
    try:
        return parse(raw)
    except json.JSONDecodeError as error:
        lines = [line for line in raw.splitlines() if line.strip()]
        try:  # a document in the first line alone: a record in each
            first = parse(lines[0]) if len(lines) > 1 else None
        except json.JSONDecodeError:
            first = None
        if first is None:
            raise error from None
        return [first, *map(parse, lines[1:])]


def _columns(content: Any, name: str) -> _Cells | None:
    """Columns of one of the shapes, without an index that only counts the rows; None for anything else."""

    def counts(cells: list[Any]) -> bool:
        return cells[0] in (0.0, 1.0) and all(cell == cells[0] + i for i, cell in enumerate(cells))

    found = _shape(content, name)
    return None if found is None else [(key, cells) for key, cells in found if key != _INDEX or not counts(cells)]


def _shape(content: Any, name: str) -> _Cells | None:
    """Columns of one of the shapes."""
    if isinstance(content, dict):
        return _of_object(content, name)
    if not isinstance(content, list) or len(content) < 2:
        return None
    if all(isinstance(record, dict) for record in content):
        keys = _bounded(list(dict.fromkeys(key for record in content for key in record)), len(content), name)
        return [(key, [record.get(key) for record in content]) for key in keys] or None
    if all(isinstance(row, list) for row in content):
        names = _bounded([""] * max(map(len, content)), len(content), name)
        return [(key, [row[i] if i < len(row) else None for row in content]) for i, key in enumerate(names)]
    return None


def _of_object(content: dict[str, Any], name: str) -> _Cells | None:
    """Columns under their names, or names and rows apart, or by the index."""
    names, rows, index = content.get("columns"), content.get("data"), content.get(_INDEX)
    if isinstance(names, list) and isinstance(rows, list) and all(isinstance(key, str) for key in names):
        found = _shape(rows, name) if all(isinstance(row, list) for row in rows) else None
        if found is not None and len(found) == len(names):
            counted = [(_INDEX, index)] if isinstance(index, list) and len(index) == len(rows) else []
            return [*((key, cells) for key, (_, cells) in zip(names, found, strict=True)), *counted]
    if (found := _by_index(content, name)) is not None:
        return found
    lists = [(key, value) for key, value in content.items() if isinstance(value, list) and len(value) > 1]
    lists = [(key, cells) for key, cells in lists if not any(isinstance(c, dict | list) for c in cells)]
    bounded_columns([key for key, _ in lists], name)
    return lists or None


def _by_index(content: dict[str, Any], name: str) -> _Cells | None:
    """Rows, or columns beside anything else, that are objects by the index, whose names are numbers."""
    nests = {key: value for key, value in content.items() if isinstance(value, dict) and len(value) > 1}
    columns = {key: value for key, value in nests.items() if all(map(_is_number, value))}
    if not columns and 1 < len(nests) == len(content) and all(map(_is_number, nests)):
        found = _shape(list(nests.values()), name)
        return None if found is None else [*found, (_INDEX, list(map(float, nests)))]
    if len(columns) < 2:
        return None
    index = list(dict.fromkeys(key for value in columns.values() for key in value))
    _bounded([*columns, _INDEX], len(index), name)
    cells = ((key, [value.get(at) for at in index]) for key, value in columns.items())
    return [*cells, (_INDEX, list(map(float, index)))]


def _is_number(text: str) -> bool:
    """Whether an index is a number."""
    return len(text) <= MAX_CELL and PLAIN["."].fullmatch(text) is not None and "d" not in text.lower()


def _bounded(names: list[str], n_rows: int, name: str) -> list[str]:
    """Refuse a table that is too wide, or would be mostly empty cells, before they are laid out."""
    if len(bounded_columns(names, name)) * n_rows > MAX_TABLE_CELLS:
        raise RecordingError(
            f"{name}: {n_rows} rows and {len(names)} columns; allowed are {MAX_TABLE_CELLS} cells; export fewer, or CSV"
        )
    return names


def _numbers(cells: list[Any]) -> tuple[FloatArray, int]:
    """Cells as numbers, and how many held something that is none; true and false are 1 and 0."""
    values = [float(cell) if isinstance(cell, float | bool) else np.nan for cell in cells]
    return as_floats(values), sum(not isinstance(cell, float | bool) and cell is not None for cell in cells)


FORMATS = (Format("json", (".json", ".jsonl", ".ndjson"), read_records),)
