"""Margins as files: everything as CSV, Excel and JSON, a short table for the terminal."""

import io
import json
import math
import re
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from shj_bayes._util.files import damage_told, replacing, write_text
from shj_bayes.errors import PopulationError
from shj_bayes.margins.row import HIGH, LOW, MIDDLE, Key, Margin
from shj_bayes.margins.sheet import Sheet, pool
from shj_bayes.margins.spread import BETWEEN, COMMON, KNOWN, UNKNOWN
from shj_bayes.margins.virtual_test import TABLE, VirtualTestResult
from shj_bayes.population.hierarchy import ANY_SET, PopulationResult
from shj_bayes.population.results import PopulationRecord, draws_of, fits_of, safe_cell
from shj_bayes.results.codec import from_json
from shj_bayes.results.codec import to_json as codec_json
from shj_bayes.results.store import digest_of, package, put_back, read_arrays, taken_out, write_arrays

Tests = tuple[VirtualTestResult, ...]
SCHEMA = "shj-bayes/margins/1"
STEM = "margins"
HEADS = {"set_name": "set", "degrees": "degrees_of_freedom"}
"""Columns whose name in a file says more than the one in the code."""
WIDTH_ROWS, WIDEST = 200, 60
"""Rows of a workbook that the width of a column is taken from, and most of it in characters."""

EPOCH = (2000, 1, 1, 0, 0, 0)
_CLOCK = re.compile(rb"(?<=W3CDTF\">)[^<]*")  # in the properties of a workbook


def to_table(sheet: Sheet) -> pd.DataFrame:
    """Every margin, one line each; names made safe for spreadsheets."""
    table = pd.DataFrame([vars(row) for row in sheet.rows])
    return table.rename(columns=HEADS).map(safe_cell)


def to_json(sheet: Sheet) -> dict[str, Any]:
    """Content of ``margins.json``; infinite degrees of freedom read "known", what does not apply is null."""
    return {
        "schema": SCHEMA,
        "history": sheet.history,
        "tested": None if sheet.tested is None else asdict(sheet.tested),
        "extrapolated": sheet.extrapolated,
        "warnings": list(sheet.warnings),
        "diagnoses": list(sheet.diagnoses),
        "margins": [_record(row) for row in sheet.rows],
    }


def _record(row: Margin) -> dict[str, Any]:
    record = {HEADS.get(c, c): value for c, value in vars(row).items()}
    if math.isinf(row.degrees):
        record["degrees_of_freedom"] = "known"
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in record.items()}


def write_margins(sheet: Sheet, folder: Path) -> tuple[Path, ...]:
    """Write ``margins.csv``, ``.xlsx``, ``.json`` and ``margins-devices.csv`` into a folder that exists."""
    table = to_table(sheet)
    paths = tuple(folder / f"{STEM}{ending}" for ending in (".csv", ".xlsx", ".json", "-devices.csv"))
    write_text(paths[0], table.to_csv(index=False, lineterminator="\n"))
    _write_excel(sheet, table, paths[1])
    write_text(paths[2], json.dumps(to_json(sheet), indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    write_text(paths[3], device_table(sheet).to_csv(index=False, lineterminator="\n"))
    return paths


def device_table(sheet: Sheet) -> pd.DataFrame:
    """All design quantities of every tested device and run: predicted by its best model, and measured."""
    rows = [
        (test.set_name, test.name, run, name, TABLE[name][0], *values, TABLE[name][1])
        for test in sheet.tests
        for run, table in enumerate(test.table, start=1)
        for name, values in table.items()
    ]
    heads = ["set", "device", "run", "quantity", "unit", "q05", "q50", "q95", "measured", "meaning"]
    return pd.DataFrame(rows, columns=heads).map(safe_cell)


def _write_excel(sheet: Sheet, table: pd.DataFrame, path: Path) -> None:
    """One page for design, one with every margin (filter it), one with what to mind."""
    notes = pd.DataFrame({"to mind": [*sheet.warnings, *sheet.diagnoses] or ["nothing"]})
    write_workbook(
        {"Design": design_table(sheet).map(safe_cell), "All margins": table, "To mind": notes.map(safe_cell)}, path
    )


def write_workbook(pages: Mapping[str, pd.DataFrame], path: Path) -> None:
    """Write tables whose text is safe as the pages of a workbook; the same tables make the same bytes."""
    from openpyxl import Workbook  # noqa: PLC0415  (margins that stand need not load it)
    from openpyxl.utils import get_column_letter  # noqa: PLC0415

    book = Workbook(write_only=True)  # row by row: half the time of a book that is filled cell by cell
    for name, content in pages.items():
        page = book.create_sheet(name)
        rows = [[*content.columns], *(list(map(_cell, row)) for row in content.itertuples(index=False, name=None))]
        letters = [get_column_letter(number) for number in range(1, len(rows[0]) + 1)]
        page.freeze_panes = "A2"
        page.auto_filter.ref = f"A1:{letters[-1]}{len(rows)}"
        for place, letter in enumerate(letters):
            longest = max(len(str(row[place] or "")) for row in rows[:WIDTH_ROWS])
            page.column_dimensions[letter].width = min(WIDEST, longest + 2)
        for row in rows:
            page.append(row)
    made = io.BytesIO()
    book.save(made)
    with replacing(path) as part, zipfile.ZipFile(made) as old, zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():  # without the time of writing: the same margins, the same bytes
            part_of = _CLOCK.sub(b"2000-01-01T00:00:00Z", old.read(name))
            new.writestr(zipfile.ZipInfo(name, EPOCH), part_of, new.compression)


def _cell(value: Any) -> Any:
    """Value of a cell: what does not apply is empty, and infinity a word, which a workbook has no number for."""
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value


CHOSEN = ("new device", "EN 1990 characteristic", "EN 1990 design", "tolerance 95/95 one-sided")
WAYS = (KNOWN, COMMON, UNKNOWN, BETWEEN)
"""Ways to come by the spread, the one to be shown first."""


def shown(index: Mapping[Key, Margin], name: str, quantity: str, kind: str, side: str) -> Margin | None:
    """Look up a margin, by the first way to come by the spread where there are several."""
    kinds = (kind, *(f"{kind}, {way}" for way in WAYS))
    return next((index[name, quantity, k, side] for k in kinds if (name, quantity, k, side) in index), None)


def degrees_words(degrees: float) -> str:
    """Degrees of freedom of a spread; a dash where there is none, "known" where it was stated."""
    return "-" if math.isnan(degrees) else "known" if math.isinf(degrees) else f"{degrees:.0f}"


def design_table(sheet: Sheet) -> pd.DataFrame:
    """Short table for design: per set and quantity the new device, EN 1990 values and a tolerance limit, low and high.

    A value by testing rests on the first way to come by the spread that there is: stated as known, common to several
    sets, of the set's own devices; between sets for a set never tested.
    """
    index = sheet.by_key
    lines = []
    for name in dict.fromkeys(row.set_name for row in sheet.rows):
        for quantity in dict.fromkeys(row.quantity for row in sheet.rows if row.set_name == name):
            middle = index.get((name, quantity, "new device, 50 %", MIDDLE))
            if middle is None:
                continue
            line: dict[str, Any] = {
                "set": "(all devices)" if name == ANY_SET else name,
                "quantity": quantity,
                "unit": middle.unit,
                "devices": middle.n_devices,
                "middle": middle.value,
            }
            for head in CHOSEN:
                for side, level in ((LOW, "5 %"), (HIGH, "95 %")):
                    law = level if head == CHOSEN[0] else "lognormal"
                    row = shown(index, name, quantity, f"{head}, {law}", side)
                    if row is not None:
                        line[f"{head}, {side}"] = row.value
                        line[f"{head}, clause"] = row.clause
                        if not math.isnan(row.degrees):
                            line[f"{head}, degrees of freedom"] = degrees_words(row.degrees)
            lines.append(line)
    return pd.DataFrame(lines)


def kept_pool(
    path: Path, rests_on: Any, result: PopulationResult, make: Callable[[], Tests], *, progress: bool
) -> tuple[Tests, PopulationResult]:
    """Give virtual tests of devices and their pooled forces: those of a file, where they still hold, or new ones in it.

    Sheets rest on more than devices and history, which is `rests_on`. A file that is damaged is made again.
    """
    wanted = digest_of([package(), result.seed, rests_on])
    try:
        arrays = read_arrays(path, PopulationRecord, None)
        with damage_told(path.name, PopulationError):
            said = json.loads(arrays.pop("said").tobytes())
            if said["rests_on"] == wanted and said["arrays"] == digest_of(arrays):
                tests = from_json(Tests, put_back(said["tests"], arrays))
                fits = fits_of({key: own for key, own in arrays.items() if "/" in key})
                return tests, pool(tests, result, known=fits)
    except PopulationError:  # missing or damaged
        pass
    tests = make()
    design = pool(tests, result, progress=progress)
    arrays = {}
    said = {"rests_on": wanted, "tests": taken_out(codec_json(tests), arrays)}
    arrays |= draws_of(design)
    said["arrays"] = digest_of(arrays)
    write_arrays(arrays | {"said": np.frombuffer(json.dumps(said).encode(), np.uint8)}, path)
    return tests, design
