"""Margins as files: everything as CSV, Excel and JSON, a short table for the terminal."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from shj_bayes._util.files import write_text
from shj_bayes.margins.quantities import TABLE
from shj_bayes.margins.row import COLUMNS, HIGH, LOW, MIDDLE, Margin
from shj_bayes.margins.sheet import Sheet
from shj_bayes.margins.spread import BETWEEN, COMMON, KNOWN, UNKNOWN
from shj_bayes.population.posterior import ANY_SET
from shj_bayes.population.results import safe_cell

SCHEMA = "shj-bayes/margins/1"
STEM = "margins"
HEADS = {"set_name": "set", "degrees": "degrees_of_freedom"}
"""Columns whose name in a file says more than the one in the code."""
Key = tuple[str, str, str, str]


def to_table(sheet: Sheet) -> pd.DataFrame:
    """Every margin, one line each; names made safe for spreadsheets."""
    table = pd.DataFrame([{c: getattr(row, c) for c in COLUMNS} for row in sheet.rows])
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
    record = {HEADS.get(c, c): getattr(row, c) for c in COLUMNS}
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
        (trial.set_name, trial.name, run, name, TABLE[name][0], *values, TABLE[name][1])
        for trial in sheet.trials
        for run, table in enumerate(trial.table, start=1)
        for name, values in table.items()
    ]
    heads = ["set", "device", "run", "quantity", "unit", "q05", "q50", "q95", "measured", "meaning"]
    return pd.DataFrame(rows, columns=heads).map(safe_cell)


def _write_excel(sheet: Sheet, table: pd.DataFrame, path: Path) -> None:
    """One page for design, one with every margin (filter it), one with what to mind."""
    part = path.with_name(f"{path.stem}.part.xlsx")
    notes = [*sheet.warnings, *sheet.diagnoses]
    # Strings are never turned into formulas or links, whatever a set is called.
    with pd.ExcelWriter(part, engine="openpyxl") as book:
        design_table(sheet).map(safe_cell).to_excel(book, sheet_name="Design", index=False)
        table.to_excel(book, sheet_name="All margins", index=False)
        pd.DataFrame({"to mind": notes or ["nothing"]}).map(safe_cell).to_excel(book, sheet_name="To mind", index=False)
        for name in ("Design", "All margins", "To mind"):
            page = book.sheets[name]
            page.freeze_panes = "A2"
            page.auto_filter.ref = page.dimensions
            for column in page.columns:
                longest = max(len(str(cell.value or "")) for cell in column[:200])
                page.column_dimensions[column[0].column_letter].width = min(60, longest + 2)
    part.replace(path)


CHOSEN: tuple[tuple[str, str, str], ...] = (
    ("new device", "new device, 5 %", "new device, 95 %"),
    ("EN 1990 characteristic", "EN 1990 characteristic, lognormal", "EN 1990 characteristic, lognormal"),
    ("EN 1990 design", "EN 1990 design, lognormal", "EN 1990 design, lognormal"),
    ("tolerance 95/95 one-sided", "tolerance 95/95 one-sided, lognormal", "tolerance 95/95 one-sided, lognormal"),
)
WAYS = (KNOWN, COMMON, UNKNOWN, BETWEEN)
"""Ways to come by the spread, the one to be shown first."""


def shown(index: Mapping[Key, Margin], name: str, quantity: str, kind: str, side: str) -> Margin | None:
    """Look up a margin, by the first way to come by the spread where there are several."""
    kinds = (kind, *(f"{kind}, {way}" for way in WAYS))
    return next((index[name, quantity, k, side] for k in kinds if (name, quantity, k, side) in index), None)


def design_table(sheet: Sheet) -> pd.DataFrame:
    """Short table for design: per set and quantity the new device, EN 1990 values and a tolerance limit, low and high.

    Returns
    -------
    pandas.DataFrame
        A value by testing rests on the first way to come by the spread that there is: stated as known, common to
        several sets, of the set's own devices; between sets for a set never tested.
    """
    index = {row.key: row for row in sheet.rows}
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
            for head, low, high in CHOSEN:
                for side, kind in ((LOW, low), (HIGH, high)):
                    row = shown(index, name, quantity, kind, side)
                    if row is not None:
                        line[f"{head}, {side}"] = row.value
                        line[f"{head}, clause"] = row.clause
                        if math.isfinite(row.degrees):
                            line[f"{head}, degrees of freedom"] = row.degrees
            lines.append(line)
    return pd.DataFrame(lines)
