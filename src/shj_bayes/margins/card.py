"""One card a set: what was tested, what its forces hold for, and which row serves which clause."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from shj_bayes.margins.row import HIGH, LOW, MIDDLE, Key, Margin
from shj_bayes.margins.sheet import CAPACITY, DRIFT, NOMINAL, Sheet
from shj_bayes.margins.spread import BETWEEN, COMMON, KNOWN, UNKNOWN
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
from shj_bayes.population.hierarchy import ANY_SET
from shj_bayes.population.quantities import HIGHEST, LOWEST
from shj_bayes.results.campaign import Connection

WAYS = (KNOWN, COMMON, UNKNOWN, BETWEEN)
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
