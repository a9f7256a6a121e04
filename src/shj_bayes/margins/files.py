"""Margins as files: everything as CSV, Excel and JSON, a short table for the terminal, and one card a set."""

import io
import json
import math
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import pandas as pd

from shj_bayes._util.files import damage_told, replacing, write_text
from shj_bayes.errors import PopulationError
from shj_bayes.margins.sheet import CAPACITY, DRIFT, NOMINAL, Sheet, pool
from shj_bayes.margins.spread import FACTORS, HIGH, LOW, MIDDLE, V_BETWEEN, V_COMMON, V_KNOWN, V_UNKNOWN, Key, Margin
from shj_bayes.margins.uses import (
    BATCH_PASSES,
    FIRST,
    FRICTION,
    LARGEST,
    LATER,
    MOMENT,
    PASSES,
    PER_BOLT,
    STOREY,
    SUM,
    TIGHTENED,
    WANTED_BOLTS,
    WANTED_CAPACITY,
    WANTED_CLAMPING,
)
from shj_bayes.margins.virtual_test import TABLE, CyclePoint, VirtualTestResult, over_amplitude
from shj_bayes.population.device import RangeTested
from shj_bayes.population.hierarchy import ANY_SET, PopulationResult
from shj_bayes.population.quantities import HIGHEST, LOWEST
from shj_bayes.population.results import PopulationRecord, draws_of, fits_of, safe_cell
from shj_bayes.results import codec
from shj_bayes.results.campaign import Connection
from shj_bayes.results.store import digest_of, package, put_back, read_arrays, taken_out, write_arrays

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
    ("first event alone", "the same of the first run", FIRST, "", FIRST),
    ("second event", "the same of the later runs", LATER, "", LATER),
    ("all connections together", "sum: storey drift; base shear", SUM, "", SUM),
    ("largest of all connections", "members beside any of them", "", "", LARGEST),
    ("with the tightening tolerance", "one connection", TIGHTENED, "", TIGHTENED),
    ("per bolt and sliding surface", "", PER_BOLT, PER_BOLT, PER_BOLT),
    ("effective friction coefficient", "of the clamping stated", FRICTION, FRICTION, FRICTION),
    ("bolts for the force wanted", "in proportion to those tested", WANTED_BOLTS, "", ""),
    ("clamping of one bolt for it", "as tested, if their proof load allows", WANTED_CLAMPING, "", ""),
    ("force with the bolts for it", "in proportion", "", "", WANTED_CAPACITY),
    ("moment at the joint", "force x lever arm", MOMENT, MOMENT, MOMENT),
    ("storey force of one brace", "force x cos angle", STOREY, STOREY, STOREY),
    ("nominal", "", "", NOMINAL, ""),
    ("ASCE 7: two analyses", "18.2.4; ageing in it", f"{ASCE} lower bound force", "", f"{ASCE} upper bound force"),
    ("ASCE 7: lambda on nominal", "18.2.4.5", f"lambda_min {FLOOR}", "", f"lambda_max {FLOOR}"),
    ("EN 15129: LBDP, UBDP", "EN 1998-2 Annex J; ageing in it", "EN 15129 LBDP", "", "EN 15129 UBDP"),
    ("NZ: phi, phi_o on nominal", "", "phi equivalent, first run", "", "phi_o equivalent"),
    ("NZ: phi, second event", "", "phi equivalent, after a first earthquake", "", ""),
    ("EN 1990: X_k", "D7.2; divide the lower one by gamma_m", CHARACTERISTIC, "", CHARACTERISTIC),
    ("EN 1990: X_d from tests", "D7.3; no gamma_m to follow", X_D, "", X_D),
    ("share accepted, one device", f"of good ones {PRODUCTION}", PASSES, "", ""),
    ("share accepted, all connections", f"of good deliveries {PRODUCTION}", BATCH_PASSES, "", ""),
    ("initial stiffness", "", *STIFFNESS),
)
Tests = tuple[VirtualTestResult, ...]
SCHEMA: Literal["shj-bayes/margins/1"] = "shj-bayes/margins/1"
STEM = "margins"
HEADS = {"set_name": "set", "degrees": "degrees_of_freedom"}
"""Columns whose name in a file says more than the one in the code."""
WIDTH_ROWS, WIDEST = 200, 60
"""Rows of a workbook that the width of a column is taken from, and most of it in characters."""
EPOCH = (2000, 1, 1, 0, 0, 0)
_CLOCK = re.compile(rb"(?<=W3CDTF\">)[^<]*")  # in the properties of a workbook


@dataclass(frozen=True)
class CardLine:
    """One use of a connection: what for, and which margins serve it."""

    use: str
    clause: str  # clause, or what the values are
    low: Margin | None  # for displacement and drift
    middle: Margin | None
    high: Margin | None  # for the forces on what is connected


@dataclass(frozen=True)
class Card:
    """What a designer takes of one set."""

    set_name: str
    facts: tuple[tuple[str, str], ...]  # what it is, what was tested, what it holds for
    lines: tuple[CardLine, ...]


def shown(index: Mapping[Key, Margin], name: str, quantity: str, kind: str, side: str) -> Margin | None:
    """Look up a margin, by the first way to come by the spread where there are several."""
    kinds = (kind, *(f"{kind}, {way}" for way in WAYS))
    return next((index[name, quantity, k, side] for k in kinds if (name, quantity, k, side) in index), None)


def cards(sheet: Sheet) -> tuple[Card, ...]:
    """Give the card of each set that the sheet tells of."""
    index = {(r.set_name, r.quantity, r.kind.partition(", importance")[0], r.side): r for r in sheet.rows}
    return tuple(
        Card(name, tuple(_facts(sheet, name, index)), tuple(_lines(name, index, sheet))) for name in sheet.spoken
    )


def _lines(name: str, index: Mapping[Key, Margin], sheet: Sheet) -> Iterator[CardLine]:
    for use, clause, *kinds in LINES:
        low, middle, high = (shown(index, name, _quantity(k, s), k, s) for k, s in zip(kinds, SIDES, strict=True))
        rows = [row for row in (low, middle, high) if row]
        if any(math.isfinite(row.value) or not sheet.withheld for row in rows):
            said = middle.formula if middle and use == "nominal" else clause
            named = use.replace("all conn", f"{sheet.together} conn")
            named = named.removesuffix(": use these two") if sheet.extrapolated else named
            yield CardLine(named, said, low, middle, high)


def _quantity(kind: str, side: str) -> str:
    """Quantity of a line: values by testing are of the smallest plateau and the largest force of all runs."""
    if kind in (CHARACTERISTIC, X_D):
        return LOWEST if side == LOW else HIGHEST
    return "K" if kind in STIFFNESS else "force"


def _facts(sheet: Sheet, name: str, index: Mapping[Key, Margin]) -> Iterator[tuple[str, str]]:
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
    age = index.get((name, "force", "lambda_ae,min", LOW))
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


def to_table(sheet: Sheet) -> pd.DataFrame:
    """Every margin, one line each; names made safe for spreadsheets."""
    table = pd.DataFrame([vars(row) for row in sheet.rows])
    return table.rename(columns=HEADS).map(safe_cell)


@dataclass(frozen=True, kw_only=True)
class MarginEntry:
    """A margin; what cannot be given, or does not apply, is null."""

    set: str
    quantity: str
    method: str
    kind: str
    side: str
    value: float | None
    unit: str
    n_devices: int
    degrees_of_freedom: Any  # "known" where they are infinite
    clause: str
    formula: str
    inputs: str
    purpose: str
    note: str
    warning: str
    monte_carlo_error: float | None


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
class MarginsRecord:
    """Content of ``margins.json``."""

    FILE: ClassVar[str] = "margins.json"

    schema: Literal["shj-bayes/margins/1"] = SCHEMA
    history: str
    tested: RangeTested | None
    extrapolated: bool
    reliability: float
    facts: Mapping[str, Mapping[str, str]]
    cards: tuple[CardEntry, ...]
    warnings: tuple[str, ...]
    diagnoses: tuple[str, ...]
    margins: tuple[MarginEntry, ...]
    over_amplitude: tuple[CyclePoint, ...]


def to_json(sheet: Sheet) -> dict[str, Any]:
    """Content of ``margins.json``; infinite degrees of freedom read "known", what does not apply is null."""
    found = cards(sheet)
    record = MarginsRecord(
        history=sheet.history,
        tested=sheet.tested,
        extrapolated=sheet.extrapolated,
        reliability=sheet.reliability,
        facts={card.set_name: dict(card.facts) for card in found},
        cards=tuple(line for card in found for line in card_entries(card)),
        warnings=sheet.warnings,
        diagnoses=sheet.diagnoses,
        margins=tuple(map(_entry, sheet.rows)),
        over_amplitude=over_amplitude(sheet.tests),
    )
    written: dict[str, Any] = codec.to_json(record)
    return written


def _entry(row: Margin) -> MarginEntry:
    values: dict[str, Any] = {HEADS.get(f.name, f.name): getattr(row, f.name) for f in fields(row)}
    values["degrees_of_freedom"] = "known" if math.isinf(row.degrees) else row.degrees
    values |= {k: None for k, v in values.items() if isinstance(v, float) and not math.isfinite(v)}
    return MarginEntry(**values)


def card_entries(card: Card) -> list[CardEntry]:
    """Lines of a card as records."""
    out = []
    for line in card.lines:
        own = [(side, row) for side, row in zip(SIDES, (line.low, line.middle, line.high), strict=True) if row]
        values: dict[str, Any] = dict.fromkeys(SIDES)
        values |= {side: row.value for side, row in own if math.isfinite(row.value)}
        unit, said = own[0][1].unit, "; ".join(dict.fromkeys(row.formula for _, row in own))
        warned = "; ".join(dict.fromkeys(row.warning for _, row in own if row.warning))
        values |= {"unit": unit, "clause": line.clause, "formula": said, "warning": warned}
        out.append(CardEntry(set=card.set_name, use=line.use, **values))
    return out


def write_margins(sheet: Sheet, folder: Path) -> tuple[Path, ...]:
    """Write ``margins.csv``, ``.xlsx``, ``.json`` and ``margins-devices.csv`` into a folder that exists."""
    table = to_table(sheet)
    endings = (".csv", ".xlsx", ".json", "-devices.csv", "-amplitude.csv")
    paths = tuple(folder / f"{STEM}{ending}" for ending in endings)
    write_text(paths[0], table.to_csv(index=False, lineterminator="\n"))
    _write_excel(sheet, table, paths[1])
    write_text(paths[2], json.dumps(to_json(sheet), indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    write_text(paths[3], device_table(sheet).to_csv(index=False, lineterminator="\n"))
    write_text(paths[4], amplitude_table(sheet).to_csv(index=False, lineterminator="\n"))
    return paths


def amplitude_table(sheet: Sheet) -> pd.DataFrame:
    """Effective stiffness and equivalent viscous damping of the tested devices over the amplitude, run by run."""
    heads = [f"{name}_{level}" for name in ("stiffness_kN_mm", "damping") for level in ("q05", "q50", "q95")]
    rows = [
        (p.set_name, p.n_devices, p.run, p.amplitude_mm, *p.stiffness_kN_mm, *p.damping)
        for p in over_amplitude(sheet.tests)
    ]
    return pd.DataFrame(rows, columns=["set", "devices", "run", "amplitude_mm", *heads]).map(safe_cell)


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
    """Write cards with the factors of the codes, a page for design, every margin (filter it), and what to mind."""
    notes = pd.DataFrame({"to mind": [*sheet.warnings, *sheet.diagnoses] or ["nothing"]})
    write_workbook(
        {
            "Cards": card_table(sheet).map(safe_cell),
            "Design": design_table(sheet).map(safe_cell),
            "Over amplitude": amplitude_table(sheet),
            "All margins": table,
            "To mind": notes.map(safe_cell),
        },
        path,
    )


def card_table(sheet: Sheet) -> pd.DataFrame:
    """Cards of all sets: what each is, its lines, then every factor of a code that no line has."""
    lines: list[dict[str, Any]] = []
    for card in cards(sheet):
        lines += [{"set": card.set_name, "use": head, "clause": said} for head, said in card.facts]
        lines += [dict(vars(entry)) for entry in card_entries(card)]
        told = {row.kind for line in card.lines for row in (line.low, line.middle, line.high) if row}
        rest = [r for r in sheet.rows if r.set_name == card.set_name and r.method == FACTORS and r.kind not in told]
        lines += [
            {"set": card.set_name, "use": r.kind, r.side: r.value, "unit": r.unit, "clause": r.clause,
             "formula": r.formula, "warning": r.warning}
            for r in rest
        ]  # fmt: skip
    return pd.DataFrame(lines, columns=[f.name for f in fields(CardEntry)])


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
                tests = codec.from_json(Tests, put_back(said["tests"], arrays))
                fits = fits_of({key: own for key, own in arrays.items() if "/" in key})
                return tests, pool(tests, result, known=fits)
    except PopulationError:  # missing or damaged
        pass
    tests = make()
    design = pool(tests, result, progress=progress)
    arrays = {}
    said = {"rests_on": wanted, "tests": taken_out(codec.to_json(tests), arrays)}
    arrays |= draws_of(design)
    said["arrays"] = digest_of(arrays)
    write_arrays(arrays | {"said": np.frombuffer(json.dumps(said).encode(), np.uint8)}, path)
    return tests, design
