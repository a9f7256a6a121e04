"""The page of the margins."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from shj_bayes.margins.codes.bounds import LBDP, UBDP, kind_of
from shj_bayes.margins.files import card_of, degrees_words, facts_of, shown
from shj_bayes.margins.history import published_factors
from shj_bayes.margins.sheet import CAPACITY, DRIFT, NOMINAL, Sheet
from shj_bayes.margins.spread import DESIGN, HIGH, LOW, MIDDLE, SPREAD, USE, Key, Margin
from shj_bayes.margins.uses import LARGEST, SUM
from shj_bayes.margins.virtual_test import STEP, CyclePoint
from shj_bayes.population.hierarchy import ANY_SET
from shj_bayes.population.predict import LoopBand
from shj_bayes.report.figures.population import loop
from shj_bayes.report.page import write_page
from shj_bayes.report.sets import name_of
from shj_bayes.report.words import digits

MAX_SETS = 16
MOST_POINTS = 7  # amplitudes of a card
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
    NOMINAL,
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
    index, rows = sheet.by_key, []
    factors = (*FACTORS, kind_of(LBDP, importance), kind_of(UBDP, importance), *EQUIVALENTS)
    for name in shown_sets(sheet):
        own = {row.kind: row for row in sheet.rows if row.set_name == name}
        bands = {q: band_words(index, name, q, 100.0 if unit == "%" else 1.0) for q, _, unit in BANDS}
        kinds = {"drift": DRIFT, "capacity": CAPACITY, "phi_o": EQUIVALENTS[-1], "nominal": NOMINAL}
        rows.append(
            {
                "name": name_of(name),
                "n": counted(sheet, name, index.get((name, "least", "new device, 50 %", MIDDLE))),
                **{key: told(own[kind]) for key, kind in kinds.items()},
                "nominal_of": own[NOMINAL].formula,
                "bands": {q: found for q, found in bands.items() if found},
                "factors": [own.get(kind) for kind in factors],
            }
        )
    return rows


def told(margin: Margin, factor: float = 1.0) -> str:
    """Value of a margin, times a factor, with the digits that other draws give as well."""
    return digits(margin.value * factor, margin.monte_carlo_error * factor)


def shown_cards(sheet: Sheet) -> list[dict[str, Any]]:
    """Give the cards as texts: name, what it is, lines, and stiffness and damping over the amplitude."""
    several = (sheet.together or 1) > 1
    return [
        {
            "name": name_of(name),
            "facts": list(facts_of(sheet, name)),
            "lines": [line_words(*line, several=several) for line in card_of(sheet, name)],
            "curve": curve_rows([p for p in sheet.over_amplitude if p.set_name == name]),
        }
        for name in sheet.spoken
    ]


def curve_rows(points: Sequence[CyclePoint]) -> list[list[str]]:
    """Effective stiffness and damping over the amplitude of one set: rows of a head and a cell for each amplitude."""
    runs = [[p for p in points if p.run == run] for run in sorted({p.run for p in points})]
    if not runs:
        return []
    amplitudes = [p.amplitude_mm for p in runs[0]][:: -(len(runs[0]) // MOST_POINTS + 1)][::-1]
    rows = [["slip amplitude, mm", *map(digits, amplitudes)]]
    for run, event in zip(runs, ("first event", "second event", "third event"), strict=False):
        at = [next((p for p in run if abs(p.amplitude_mm / a - 1.0) < STEP - 1.0), None) for a in amplitudes]
        rows.append([f"k_eff, {event}, kN/mm", *(digits(p.stiffness_kN_mm[1]) if p else "" for p in at)])
        rows.append([f"damping, {event}, %", *(digits(100.0 * p.damping[1]) if p else "" for p in at)])
    return rows


def line_words(use: str, clause: str, by_side: Mapping[str, Margin], *, several: bool = False) -> dict[str, Any]:
    """Give a line of a card as texts: use, values, unit, largest error from the draws, clause with what to mind.

    ``main`` is what to use first, of one connection or of `several`; ``own`` what no design code states.
    """
    rows = list(by_side.values())
    values = [told(by_side[side]) if side in by_side else "" for side in (LOW, MIDDLE, HIGH)]
    notes = [clause, *(row.warning for row in rows if row.warning)]
    unit, error = "" if rows[0].unit == "1" else rows[0].unit, max(row.monte_carlo_error for row in rows)
    said = {"use": use, "values": values, "unit": unit, "clause": "; ".join(filter(None, dict.fromkeys(notes)))}
    said["error"] = f"{float(f'{error:.1g}'):g}" if error else ""  # one digit, and 10 in the place of 1e+01
    main = rows[0].kind in (SUM, LARGEST) if several else rows[0].method == DESIGN
    return said | {"main": main, "own": rows[0].method in (DESIGN, USE)}


def band_words(index: Mapping[Key, Margin], name: str, quantity: str, factor: float = 1.0) -> list[str]:
    """5, 50 and 95 % of a new device in one quantity; empty where there is none."""
    keys = [(name, quantity, f"new device, {level} %", side) for level, side in ENDS]
    return [told(index[key], factor) for key in keys] if all(key in index for key in keys) else []


def spread_table(sheet: Sheet) -> dict[str, Any]:
    """Per cent of the smallest plateau and of the largest force by where the width is from.

    ``heads`` are those that a set has (published tables know nothing of the model), twice in the cells of each of the
    ``rows``, one for each tested set.
    """
    own = {(r.set_name, r.quantity, r.kind): r.value for r in sheet.rows if r.method == SPREAD}
    kinds = [kind for kind in SPREADS if any(kind == key[2] for key in own)]
    columns = [(quantity, kind) for quantity in ("least", "most") for kind in kinds]
    rows = []
    for name in tested_sets(sheet.spoken)[:MAX_SETS]:
        cells = [digits(SPREADS[kind][1] * own.get((name, quantity, kind), math.nan)) for quantity, kind in columns]
        rows.append({"name": name_of(name), "cells": cells})
    return {"heads": [SPREADS[kind][0] for kind in kinds], "rows": rows}


def testing_table(sheet: Sheet, quantity: str) -> list[dict[str, Any]]:
    """One row per set: values by testing, low and high, with the spread common to all sets where there is one."""
    index, rows = sheet.by_key, []
    for name in shown_sets(sheet):
        pairs = [[shown(index, name, quantity, kind, side) for side in (LOW, HIGH)] for kind, *_ in TESTED]
        last = next((low for low, _ in reversed(pairs) if low), None)
        rows.append(
            {
                "name": name_of(name),
                "n": counted(sheet, name, last),
                "nu": degrees_words(last.degrees if last else math.nan),
                "cells": [tuple(digits(m.value) if m else "-" for m in pair) for pair in pairs],
                "warning": last.warning if last else "",
            }
        )
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


MAX_PICTURES = 4
FEW_SETS = 6  # so many leave room on two sheets of A4 for wider tables
FAR_SPEED = 300.0
"""Speed of an earthquake's stroke (95 mm at a period of 1.5 to 2 s), mm/s."""
COVERAGE = {2: 0.896, 4: 0.892, 8: 0.896}
"""Simulated coverage of the 90 % band of a new device, by devices per set: decision 0004, typical truth, 500 campaigns;
`python benchmarks/population.py coverage -n 500` prints it again."""


def render_margins(
    folder: Path,
    sheet: Sheet,
    loops: Sequence[LoopBand] = (),
    *,
    name: str,
    importance: str,
    simulated: bool = False,
) -> Path:
    """Write ``margins.html``: the sheet that was drawn up for an importance class of the structure.

    `loops`, bands of the loop of a new device, are drawn where the sheet has room, that is for few sets.
    """
    few = len(shown_sets(sheet)) <= FEW_SETS
    content: dict[str, Any] = {
        "name": name,
        "simulated": simulated,
        "sets": set_table(sheet, importance),
        "spreads": spread_table(sheet),
        "quantities": BANDS,
        "tests": TESTED,
        "testing": [
            {"title": "first run", "rows": testing_table(sheet, "least")},
            {"title": "after a first earthquake (second run)", "rows": testing_table(sheet, "least_2")},
        ],
        "importance": importance,
        "left_out": max(0, len(tested_sets(sheet.spoken)) - MAX_SETS),
        "never": ANY_SET,
        "few": few,
        "far": published_factors(FAR_SPEED),
        "coverage": ", ".join(f"{100 * c:.1f} % with {n}" for n, c in COVERAGE.items()),
        "sheet": sheet,
        "told": told,
        "extrapolated": extrapolated_words(sheet),
        "holds": sheet.holds,
        "cards": shown_cards(sheet) if few else [],
        "loops": _pictures(loops),
    }
    return write_page(folder, "margins.html", content)


def extrapolated_words(sheet: Sheet) -> str:
    """Say what to know of numbers that no test stands behind; empty where all was tested."""
    if not sheet.extrapolated:
        return ""
    laws = next(test.laws for test in sheet.tests if len(test.laws) > 1)
    said = (
        "No device was tested in this. The two numbers are the outermost of laws that agree with the tests and stay "
        f"bounded ({', '.join(laws)}); nobody knows which of them, if any, holds. They are no values for design: test "
        "at that speed, travel or time."
    )
    said += f" Code values are {sheet.withheld}." if sheet.withheld else ""
    return f"{said} {sheet.lifts}." if sheet.lifts else said


def _pictures(loops: Sequence[LoopBand]) -> dict[str, str]:
    """Loop bands of the tested sets, as far as two pages have room for them."""
    names = list(dict.fromkeys(band.set_name for band in loops if band.set_name != ANY_SET))
    if len(names) > MAX_PICTURES:
        return {}
    return {name: loop([band for band in loops if band.set_name == name]) for name in names}
