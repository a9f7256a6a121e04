"""The numbers of a designer's sheet, chosen from all margins and written as text. Nothing is drawn here."""

import math
from collections.abc import Sequence
from typing import Any

from shj_bayes.margins.codes.en15129 import kind_of
from shj_bayes.margins.files import shown
from shj_bayes.margins.row import HIGH, LOW, MIDDLE, SPREAD, Margin
from shj_bayes.margins.sheet import CAPACITY, DRIFT, Sheet
from shj_bayes.population.posterior import ANY_SET
from shj_bayes.report.sets import name_of
from shj_bayes.report.words import digits

MAX_SETS = 16
BANDS = (
    ("least", "smallest plateau, first run", "kN"),
    ("most", "largest force, first run", "kN"),
    ("least_2", "smallest plateau, second run", "kN"),
    ("degradation", "loss from run to run", "%"),
    ("K", "K", "kN/mm"),
    ("energy", "energy of a cycle, first run", "kJ"),
)
TESTED = (
    ("EN 1990 characteristic, lognormal", "X_k", "EN 1990 D7.2"),
    ("EN 1990 design, lognormal", "X_d", "EN 1990 D7.3"),
    ("tolerance 95/75 one-sided, lognormal", "95/75", "ISO 16269-6"),
    ("tolerance 95/95 one-sided, lognormal", "95/95", "ISO 16269-6"),
    ("tolerance 90/95 two-sided, lognormal", "90/95 both", "ISO 16269-6"),
)
FACTORS = (
    "nominal sliding force",
    "lambda_spec,min",
    "lambda_spec,max",
    "lambda_test,min",
    "lambda_test,max",
    "lambda_ae,min",
    "lambda_ae,max",
    "lambda_min with the floor for dampers",
    "lambda_max with the floor for dampers",
    "ASCE 7 lower bound force",
    "ASCE 7 upper bound force",
)
EQUIVALENTS = ("phi equivalent, first run", "phi equivalent, after a first earthquake", "phi_o equivalent")
ENDS = ((5, LOW), (50, MIDDLE), (95, HIGH))
SPREADS = {  # kind of a margin: heading, factor
    "device to device": ("device to device", 100.0),
    "within a device": ("within a device", 100.0),
    "model, V_delta": ("model", 100.0),
    "model, b": ("measured / predicted", 1.0),
}


def set_table(sheet: Sheet, importance: str) -> list[dict[str, Any]]:
    """One row per set: the numbers for design, bands of a new device, and factors for a class of EN 15129."""
    index = sheet.by_key
    factors = (*FACTORS, kind_of("LBDP", importance), kind_of("UBDP", importance), *EQUIVALENTS)
    rows = []
    for name in shown_sets(sheet):
        own = {row.kind: row for row in sheet.rows if row.set_name == name}
        bands = {}
        for quantity, _, unit in BANDS:
            keys = ((name, quantity, f"new device, {level} %", side) for level, side in ENDS)
            found = [index[key].value * (100.0 if unit == "%" else 1.0) for key in keys if key in index]
            if len(found) == len(ENDS):
                bands[quantity] = found
        typical = index.get((name, "least", "new device, 50 %", MIDDLE))
        rows.append(
            {
                "name": name_of(name),
                "n": counted(sheet, name, typical),
                "drift": own[DRIFT].value,
                "capacity": own[CAPACITY].value,
                "phi_o": own[EQUIVALENTS[-1]].value,
                "bands": bands,
                "factors": [own.get(kind) for kind in factors],
            }
        )
    return rows


def spread_table(sheet: Sheet) -> dict[str, Any]:
    """Per cent of the smallest plateau and of the largest force by where the width is from.

    ``heads`` are those that a set has (published tables know nothing of the model), twice in the cells of each of the
    ``rows``, one for each tested set.
    """
    own = {(r.set_name, r.quantity, r.kind): r.value for r in sheet.rows if r.method == SPREAD}
    kinds = [kind for kind in SPREADS if any(kind == key[2] for key in own)]
    rows = [
        {
            "name": name_of(name),
            "cells": [
                digits(SPREADS[kind][1] * own.get((name, quantity, kind), math.nan))
                for quantity in ("least", "most")
                for kind in kinds
            ],
        }
        for name in tested_sets(sheet.spoken)[:MAX_SETS]
    ]
    return {"heads": [SPREADS[kind][0] for kind in kinds], "rows": rows}


def testing_table(sheet: Sheet, quantity: str) -> list[dict[str, Any]]:
    """One row per set: values by testing, low and high, with the spread common to all sets where there is one."""
    index = sheet.by_key
    rows = []
    for name in shown_sets(sheet):
        cells, degrees, n = [], math.nan, counted(sheet, name, None)
        for kind, _, _ in TESTED:
            pair = [shown(index, name, quantity, kind, side) for side in (LOW, HIGH)]
            cells.append(tuple(digits(m.value) if m else "-" for m in pair))
            if pair[0]:
                degrees, n = pair[0].degrees, counted(sheet, name, pair[0])
        nu = f"{degrees:.0f}" if math.isfinite(degrees) else "-"
        rows.append({"name": name_of(name), "n": n, "nu": nu, "cells": cells})
    return rows


def counted(sheet: Sheet, name: str, row: Margin | None) -> str:
    """How many devices a margin of a set rests on; of a set never tested, how many sets."""
    if name == ANY_SET:
        return f"{sheet.n_sets} sets"
    return str(row.n_devices if row else 0)


def shown_sets(sheet: Sheet) -> list[str]:
    """Choose the sets on the page: the first sixteen, and the set never tested where it is told of."""
    return [*tested_sets(sheet.spoken)[:MAX_SETS], *(name for name in sheet.spoken if name == ANY_SET)]


def tested_sets(names: Sequence[str]) -> list[str]:
    """Choose the sets that were tested."""
    return [name for name in names if name != ANY_SET]
