"""The numbers of a designer's sheet, chosen from all margins and written as text. Nothing is drawn here."""

from __future__ import annotations

import math
from typing import Any

from shj_bayes.margins.files import shown
from shj_bayes.margins.row import HIGH, LOW, MIDDLE, Margin
from shj_bayes.margins.sheet import Sheet
from shj_bayes.population.posterior import ANY_SET
from shj_bayes.population.predict import sets_suffice
from shj_bayes.report.sets import name_of

MAX_SETS = 16
BANDS = (
    ("Fy", "Fy, first run", "kN"),
    ("Fy_second", "Fy, second run", "kN"),
    ("degradation", "loss of Fy", "%"),
    ("K", "K", "kN/mm"),
    ("energy", "energy of a cycle, first run", "kJ"),
    ("force", "force at mid-stroke, first run", "kN"),
)
TESTED = (
    ("EN 1990 characteristic, lognormal", "X_k", "EN 1990 D7.2"),
    ("EN 1990 design, lognormal", "X_d", "EN 1990 D7.3"),
    ("tolerance 95/75 one-sided, lognormal", "95/75", "ISO 16269-6"),
    ("tolerance 95/95 one-sided, lognormal", "95/95", "ISO 16269-6"),
    ("tolerance 90/95 two-sided, lognormal", "90/95 both", "ISO 16269-6"),
)
FACTORS = (
    ("nominal sliding force", MIDDLE),
    ("lambda_spec,min", LOW),
    ("lambda_spec,max", HIGH),
    ("lambda_test,min", LOW),
    ("lambda_test,max", HIGH),
    ("lambda_ae,min", LOW),
    ("lambda_ae,max", HIGH),
    ("lambda_min with the floor for dampers", LOW),
    ("lambda_max with the floor for dampers", HIGH),
    ("ASCE 7 lower bound force", LOW),
    ("ASCE 7 upper bound force", HIGH),
    ("EN 15129 LBDP", LOW),
    ("EN 15129 UBDP", HIGH),
    ("phi equivalent, first run", LOW),
    ("phi equivalent, after a first earthquake", LOW),
    ("phi_o equivalent", HIGH),
)
Index = dict[tuple[str, str, str, str], Margin]


def digits(value: float) -> str:
    """Three digits, whole numbers from 100 on; a dash where a number cannot be given."""
    if not math.isfinite(value):
        return "-"
    if abs(value) >= 1e4:
        return f"{value:.1e}"
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def band_table(sheet: Sheet) -> list[dict[str, Any]]:
    """One row per set: middle and 5 to 95 % of a new device in every quantity."""
    index = _index(sheet)
    rows = []
    for name in shown_sets(sheet):
        cells = {}
        for quantity, _, unit in BANDS:
            found = [
                index.get((name, quantity, f"new device, {level} %", side))
                for level, side in ((5, LOW), (50, MIDDLE), (95, HIGH))
            ]
            if all(found):
                scale = 100.0 if unit == "%" else 1.0
                low, middle, high = (digits(scale * m.value) for m in found if m)
                alone = [scale * m.without_diagnosis for m in found if m]
                beside = f"{digits(alone[0])} to {digits(alone[2])}" if math.isfinite(alone[0]) else ""
                cells[quantity] = {"middle": middle, "range": f"{low} to {high}", "alone": beside}
        rows.append({"name": name_of(name), "n": _devices(index, name), "cells": cells})
    return rows


def testing_table(sheet: Sheet, quantity: str) -> list[dict[str, Any]]:
    """One row per set: values by testing, low and high, with the spread common to all sets where there is one."""
    index = _index(sheet)
    rows = []
    for name in shown_sets(sheet):
        cells, degrees, n = [], math.nan, 0
        for kind, _, _ in TESTED:
            pair = [shown(index, name, quantity, kind, side) for side in (LOW, HIGH)]
            cells.append(tuple(digits(m.value) if m else "-" for m in pair))
            if pair[0]:
                degrees, n = pair[0].degrees, pair[0].n_devices
        nu = f"{degrees:.0f}" if math.isfinite(degrees) else "-"
        rows.append({"name": name_of(name), "n": n, "nu": nu, "cells": cells})
    return rows


def factor_table(sheet: Sheet) -> list[dict[str, Any]]:
    """One row per set: factors on the nominal sliding force and the bounds they give."""
    index = _index(sheet)
    rows = []
    for name in shown_sets(sheet):
        own = {row.kind.partition(", importance")[0]: row for row in sheet.rows if row.set_name == name}
        cells = [(digits(own[kind].value), own[kind].warning) if kind in own else ("-", "") for kind, _ in FACTORS]
        age = own.get("lambda_ae,max")
        rows.append(
            {"name": name_of(name), "n": _devices(index, name), "cells": cells, "age": age.inputs if age else ""}
        )
    return rows


def shown_sets(sheet: Sheet) -> list[str]:
    """Choose the sets on the sheet: the first sixteen, and the set never tested where enough were tested to say so."""
    names = list(dict.fromkeys(row.set_name for row in sheet.rows))
    tested = tested_sets(sheet)
    untested = [name for name in names if name == ANY_SET and sets_suffice(len(tested))]
    return [*tested[:MAX_SETS], *untested]


def tested_sets(sheet: Sheet) -> list[str]:
    """Names of the sets that were tested."""
    return [name for name in dict.fromkeys(row.set_name for row in sheet.rows) if name != ANY_SET]


def importance_of(sheet: Sheet) -> str:
    """Read the importance class that EN 15129 rows were drawn up for."""
    kind = next((row.kind for row in sheet.rows if row.kind.startswith("EN 15129")), "")
    return kind.rpartition(" ")[2]


def _index(sheet: Sheet) -> Index:
    return {row.key: row for row in sheet.rows}


def _devices(index: Index, name: str) -> int:
    row = index.get((name, "Fy", "new device, 50 %", MIDDLE))
    return row.n_devices if row else 0
