"""Margins as files: everything as CSV, Excel and JSON, a short table for the terminal, and one card a set."""

import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np

from shj_bayes._util.files import damage_told, write_text
from shj_bayes.errors import PopulationError
from shj_bayes.margins import uses
from shj_bayes.margins.codes.bounds import COMBINATION, LBDP, UBDP, kind_of
from shj_bayes.margins.sheet import CAPACITY, DRIFT, NOMINAL, Sheet, pool
from shj_bayes.margins.spread import FACTORS, HIGH, LOW, MIDDLE, V_BETWEEN, V_COMMON, V_KNOWN, V_UNKNOWN, Key, Margin
from shj_bayes.margins.virtual_test import CyclePoint, VirtualTestResult
from shj_bayes.population.device import RangeTested
from shj_bayes.population.hierarchy import ANY_SET, PopulationResult
from shj_bayes.population.quantities import HIGHEST, LOWEST
from shj_bayes.population.readings import TABLE
from shj_bayes.population.results import PopulationRecord, draws_of, fits_of
from shj_bayes.results import codec
from shj_bayes.results.campaign import Connection
from shj_bayes.results.store import digest_of, package, packed, put_back, read_arrays, taken_out, unpacked, write_arrays
from shj_bayes.results.tables import Cells, write_workbook

WAYS = (V_KNOWN, V_COMMON, V_UNKNOWN, V_BETWEEN)
"""Ways to come by the spread, the one to be shown first."""
SIDES = (LOW, MIDDLE, HIGH)
ASCE, FLOOR = "ASCE 7", "with the floor for dampers"
CHARACTERISTIC, X_D = "EN 1990 characteristic, lognormal", "EN 1990 design, lognormal"
STIFFNESS = tuple(f"new device, {level} %" for level in (5, 50, 95))  # the same kinds as of any quantity; here of K
PRODUCTION = "within 15 %: EN 15129, ASCE 7 18.6"
LINES = (
    # use, clause or what the values are, kinds of the lower, typical and upper value
    ("all events: use these two", "smallest plateau; largest force", DRIFT, "", CAPACITY),
    ("first event alone", "the same of the first run", uses.FIRST, "", uses.FIRST),
    ("second event", "the same of the later runs", uses.LATER, "", uses.LATER),
    ("all connections together", "sum: storey drift; base shear", uses.SUM, "", uses.SUM),
    ("largest of all connections", "members beside any of them", "", "", uses.LARGEST),
    ("with the tightening tolerance", "one connection", uses.TIGHTENED, "", uses.TIGHTENED),
    ("per bolt and sliding surface", "", uses.PER_BOLT, uses.PER_BOLT, uses.PER_BOLT),
    ("effective friction coefficient", "of the clamping stated", uses.FRICTION, uses.FRICTION, uses.FRICTION),
    ("bolts for the force wanted", "in proportion to those tested", uses.WANTED_BOLTS, "", ""),
    ("clamping of one bolt for it", "as tested, if their proof load allows", uses.WANTED_CLAMPING, "", ""),
    ("force with the bolts for it", "in proportion", "", "", uses.WANTED_CAPACITY),
    ("moment at the joint", "force x lever arm", uses.MOMENT, uses.MOMENT, uses.MOMENT),
    ("storey force of one brace", "force x cos angle", uses.STOREY, uses.STOREY, uses.STOREY),
    ("nominal", "", "", NOMINAL, ""),
    ("ASCE 7: two analyses", "18.2.4; ageing in it", f"{ASCE} lower bound force", "", f"{ASCE} upper bound force"),
    ("ASCE 7: lambda on nominal", "18.2.4.5", f"lambda_min {FLOOR}", "", f"lambda_max {FLOOR}"),
    ("EN 15129: LBDP, UBDP", "EN 1998-2 Annex J; ageing in it", LBDP, "", UBDP),
    ("NZ: phi, phi_o on nominal", "", "phi equivalent, first run", "", "phi_o equivalent"),
    ("NZ: phi, second event", "", "phi equivalent, after a first earthquake", "", ""),
    ("EN 1990: X_k", "D7.2; divide the lower one by gamma_m", CHARACTERISTIC, "", CHARACTERISTIC),
    ("EN 1990: X_d from tests", "D7.3; no gamma_m to follow", X_D, "", X_D),
    ("share accepted, one device", f"of good ones {PRODUCTION}", uses.PASSES, "", ""),
    ("share accepted, all connections", f"of good deliveries {PRODUCTION}", uses.BATCH_PASSES, "", ""),
    ("initial stiffness", "", *STIFFNESS),
)
Tests = tuple[VirtualTestResult, ...]
SCHEMA: Literal["shj-bayes/margins/1"] = "shj-bayes/margins/1"
STEM = "margins"


@dataclass(frozen=True, kw_only=True)
class CardEntry:
    """A line of the card of a set: a use, and the values that serve it."""

    set: str
    use: str
    low: float | None
    middle: float | None
    high: float | None
    unit: str
    clause: str
    formula: str
    warning: str


@dataclass(frozen=True, kw_only=True)
class MarginsRecord(codec.Stored, file="margins.json", command="shj-bayes margins"):
    """Content of ``margins.json``."""

    schema: Literal["shj-bayes/margins/1"] = SCHEMA
    history: str
    tested: RangeTested | None
    extrapolated: bool
    reliability: float
    facts: Mapping[str, Mapping[str, str]]
    cards: tuple[CardEntry, ...]
    warnings: tuple[str, ...]
    diagnoses: tuple[str, ...]
    margins: tuple[Margin, ...]  # what cannot be given, or does not apply, is null
    over_amplitude: tuple[CyclePoint, ...]


def shown(index: Mapping[Key, Margin], name: str, quantity: str, kind: str, side: str) -> Margin | None:
    """Look up a margin, by the first way to come by the spread where there are several, of any importance class."""
    kinds = (kind, *(f"{kind}, {way}" for way in WAYS), *(kind_of(kind, one) for one in COMBINATION))
    return next((index[name, quantity, k, side] for k in kinds if (name, quantity, k, side) in index), None)


def card_of(sheet: Sheet, name: str) -> Iterator[tuple[str, str, dict[str, Margin]]]:
    """Give the lines of the card of a set, what a designer takes of it: use, clause, margins by side."""
    for use, clause, *kinds in LINES:
        found = {
            side: shown(sheet.by_key, name, _quantity(k, side), k, side) for k, side in zip(kinds, SIDES, strict=True)
        }
        values = {side: row for side, row in found.items() if row}
        if any(math.isfinite(row.value) or not sheet.withheld for row in values.values()):
            said = values[MIDDLE].formula if use == "nominal" else clause
            named = use.replace("all conn", f"{sheet.together} conn")
            yield named.removesuffix(": use these two") if sheet.extrapolated else named, said, values


def _entries(sheet: Sheet, name: str) -> Iterator[CardEntry]:
    """Lines of the card of a set as files have them."""
    for use, clause, values in card_of(sheet, name):
        rows = values.values()
        yield CardEntry(
            set=name,
            use=use,
            **{side: codec.finite(values[side].value) if side in values else None for side in SIDES},
            unit=next(iter(rows)).unit,
            clause=clause,
            formula="; ".join(dict.fromkeys(row.formula for row in rows)),
            warning="; ".join(dict.fromkeys(row.warning for row in rows if row.warning)),
        )


def _quantity(kind: str, side: str) -> str:
    """Quantity of a line: values by testing are of the smallest plateau and the largest force of all runs."""
    if kind in (CHARACTERISTIC, X_D):
        return LOWEST if side == LOW else HIGHEST
    return "K" if kind in STIFFNESS else "force"


def facts_of(sheet: Sheet, name: str) -> Iterator[tuple[str, str]]:
    """Say what a set is, what was tested, and what its card holds for: heads and words."""
    if name == ANY_SET:
        yield "what", f"a set never tested, from {sheet.n_sets} tested sets"
    else:
        yield "ONE connection", connection_words(sheet.connections.get(name, Connection()))
    tested = sheet.tested
    if tested is not None:
        yield (
            "tested",
            f"slip of {tested.smallest_mm:.3g} to {tested.largest_mm:.3g} mm, cycles of {tested.slowest_mm_s:.3g} to "
            f"{tested.fastest_mm_s:.3g} mm/s ({tested.source})",
        )
        travel = sheet.connections.get(name, Connection()).travel_mm
        if travel is not None and travel < tested.largest_mm:
            yield (
                "TO MIND",
                f"the tests slid to {tested.largest_mm:.3g} mm, and a slot of this length ends at {travel:.3g} mm: "
                "check slot and bolt, and where displacement was measured",
            )
    yield "holds for", f"{sheet.share} of new devices {sheet.holds}, in {sheet.history}"
    age = sheet.by_key.get((name, "force", "lambda_ae,min", LOW))
    if age is not None:
        yield "ageing", f"only in ASCE 7 and EN 15129: {age.inputs}"


def connection_words(connection: Connection) -> str:
    """Say what a connection is."""
    c = connection
    size = "" if c.bolt_mm is None else f" M{c.bolt_mm:g}"
    parts = [
        "" if c.bolts is None else f"{c.bolts} bolts{size}{f' {c.bolt_grade}' if c.bolt_grade else ''}",
        "" if c.surfaces is None else f"{c.surfaces} sliding surfaces",
        "" if c.clamping_kN is None else f"clamped with {c.clamping_kN:g} kN a bolt",
        "" if c.slot_mm is None else f"slot {c.slot_mm:g} mm",
        "" if c.travel_mm is None else f"free travel {c.travel_mm:g} mm to either side",
        f"shim {c.shim}" if c.shim else "",
        f"surfaces {c.finish}" if c.finish else "",
        {"device": "stiffness of the device alone", "machine": "stiffness with grips and frame in it"}.get(
            c.displacement or "",
            "" if c == Connection() else "whether grips and frame are in the stiffness is not said",
        ),
    ]
    return ", ".join(filter(None, parts)) or "as tested; what it is can be said in [set.connection] of the manifest"


def to_table(sheet: Sheet) -> Cells:
    """Every margin, one line each."""
    heads = tuple(key for key, *_ in codec.fields_of(Margin))
    numbers = ("value", "degrees")  # some are whole
    return Cells(heads, [[float(v) if k in numbers else v for k, v in vars(row).items()] for row in sheet.rows])


def to_json(sheet: Sheet) -> dict[str, Any]:
    """Content of ``margins.json``; infinite degrees of freedom read "known", what does not apply is null."""
    record = MarginsRecord(
        history=sheet.history,
        tested=sheet.tested,
        extrapolated=sheet.extrapolated,
        reliability=sheet.reliability,
        facts={name: dict(facts_of(sheet, name)) for name in sheet.spoken},
        cards=tuple(line for name in sheet.spoken for line in _entries(sheet, name)),
        warnings=sheet.warnings,
        diagnoses=sheet.diagnoses,
        margins=(),
        over_amplitude=sheet.over_amplitude,
    )
    written: dict[str, Any] = codec.to_json(record)
    known = {"degrees_of_freedom": "known"}
    heads = [key for key, *_ in codec.fields_of(Margin)]
    for row in sheet.rows:  # thousands, which the general way takes long over
        entry = codec.finite(dict(zip(heads, vars(row).values(), strict=True)))
        written["margins"].append(entry | (known if math.isinf(row.degrees) else {}))
    return written


def write_margins(sheet: Sheet, folder: Path) -> tuple[Path, ...]:
    """Write ``margins.csv``, ``.xlsx``, ``.json`` and ``margins-devices.csv`` into a folder that exists."""
    table = to_table(sheet)
    endings = (".csv", ".xlsx", ".json", "-devices.csv", "-amplitude.csv")
    paths = tuple(folder / f"{STEM}{ending}" for ending in endings)
    write_text(paths[0], table.to_csv())
    _write_excel(sheet, table, paths[1])
    write_text(paths[2], _line_by_line(to_json(sheet)))
    write_text(paths[3], device_table(sheet).to_csv())
    write_text(paths[4], amplitude_table(sheet).to_csv())
    return paths


def _line_by_line(content: Mapping[str, Any]) -> str:
    """Content as JSON, a line for each item of a list: written at a stroke, which indented text is not."""
    written = json.JSONEncoder(ensure_ascii=False, allow_nan=False).encode
    parts = []
    for key, part in content.items():
        text = "[\n " + ",\n ".join(map(written, part)) + "\n]" if isinstance(part, list) else written(part)
        parts.append(f"{written(key)}: {text}")
    return "{\n" + ",\n".join(parts) + "\n}\n"


def amplitude_table(sheet: Sheet) -> Cells:
    """Effective stiffness and equivalent viscous damping of the tested devices over the amplitude, run by run."""
    heads = [f"{name}_{level}" for name in ("stiffness_kN_mm", "damping") for level in ("q05", "q50", "q95")]
    rows = [
        (p.set_name, p.n_devices, p.run, p.amplitude_mm, *p.stiffness_kN_mm, *p.damping) for p in sheet.over_amplitude
    ]
    return Cells(("set", "devices", "run", "amplitude_mm", *heads), rows)


def device_table(sheet: Sheet) -> Cells:
    """All design quantities of every tested device and run: predicted by its best model, and measured."""
    rows = [
        (test.set_name, test.name, run, name, TABLE[name][0], *values, TABLE[name][1])
        for test in sheet.tests
        for run, table in enumerate(test.table, start=1)
        for name, values in table.items()
    ]
    return Cells(("set", "device", "run", "quantity", "unit", "q05", "q50", "q95", "measured", "meaning"), rows)


def _write_excel(sheet: Sheet, table: Cells, path: Path) -> None:
    """Write cards with the factors of the codes, a page for design, every margin (filter it), and what to mind."""
    notes = [[note] for note in (*sheet.warnings, *sheet.diagnoses)] or [["nothing"]]
    write_workbook(
        {
            "Cards": card_table(sheet),
            "Design": Cells.of(design_table(sheet)),
            "Over amplitude": amplitude_table(sheet),
            "All margins": table,
            "To mind": Cells(("to mind",), notes),
        },
        path,
    )


def card_table(sheet: Sheet) -> Cells:
    """Cards of all sets: what each is, its lines, then every factor of a code that no line has."""
    lines: list[dict[str, Any]] = []
    for name in sheet.spoken:
        lines += [{"set": name, "use": head, "clause": said} for head, said in facts_of(sheet, name)]
        lines += map(vars, _entries(sheet, name))
        told = {row.kind for *_, values in card_of(sheet, name) for row in values.values()}
        rest = [r for r in sheet.rows if r.set_name == name and r.method == FACTORS and r.kind not in told]
        lines += [
            {"set": name, "use": r.kind, r.side: r.value, "unit": r.unit, "clause": r.clause,
             "formula": r.formula, "warning": r.warning}
            for r in rest
        ]  # fmt: skip
    return Cells.of(lines, (f.name for f in fields(CardEntry)))


CHOSEN = ("new device", "EN 1990 characteristic", "EN 1990 design", "tolerance 95/95 one-sided")


def degrees_words(degrees: float) -> str:
    """Degrees of freedom of a spread; a dash where there is none, "known" where it was stated."""
    return "-" if math.isnan(degrees) else "known" if math.isinf(degrees) else f"{degrees:.0f}"


def design_table(sheet: Sheet) -> list[dict[str, Any]]:
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
    return lines


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
                arrays = unpacked(arrays)
                tests = codec.from_json(Tests, put_back(said["tests"], arrays))
                fits = fits_of({key: own for key, own in arrays.items() if "/" in key})
                return tests, pool(tests, result, known=fits)
    except PopulationError:  # missing or damaged
        pass
    tests = make()
    design = pool(tests, result, progress=progress)
    arrays = {}
    said = {"rests_on": wanted, "tests": taken_out(codec.to_json(tests), arrays)}
    arrays = packed(arrays | draws_of(design))
    said["arrays"] = digest_of(arrays)
    write_arrays(arrays | {"said": np.frombuffer(json.dumps(said).encode(), np.uint8)}, path)
    return tests, design
