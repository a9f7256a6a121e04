"""From finished devices, or from the published tables, to population, comparison and margins, with their pages."""

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from itertools import starmap
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from shj_bayes._util.files import need_population, shipped, write_text
from shj_bayes.app.campaign import WRITES, Outcome
from shj_bayes.app.resume import POOLS, POPULATION, CommandResult, campaign_inputs, design_margins
from shj_bayes.errors import PopulationError
from shj_bayes.margins.curves import CurveContrast, compare_curves
from shj_bayes.margins.export import (
    PROGRAMS,
    bounds,
    draw_devices,
    draws_csv,
    draws_script,
    link_csv,
    links_script,
    loops,
    python_script,
    stiffness_words,
    tcl_script,
    write_loops,
)
from shj_bayes.margins.files import CHOSEN, Tests, design_table, kept_pool, write_margins
from shj_bayes.margins.history import LEEWAY, LoadingHistory, left_out_words, loading_history, untested
from shj_bayes.margins.sheet import CAPACITY, DRIFT, Sheet, margins
from shj_bayes.margins.specimen import (
    Specimen,
    find_diagnosis,
    largest_ranges,
    read_specimen,
    specimens_of_table,
    words_of,
)
from shj_bayes.margins.spread import BANDS, SPREAD, TESTING, TOLERANCE
from shj_bayes.margins.virtual_test import virtual_tests
from shj_bayes.options import MarginOptions
from shj_bayes.planning.protocol import Protocol, ProtocolBlock
from shj_bayes.population.compare import ROPE, Contrast, compare, members, row_of, strata_of
from shj_bayes.population.device import (
    PUBLISHED,
    Claim,
    DeviceEstimate,
    common,
    device_from_fit,
    published_devices,
    tested_by_fit,
)
from shj_bayes.population.hierarchy import ANY_SET, PopulationResult, QuantityPosterior, fit_population
from shj_bayes.population.predict import never_tested_words, new_device_table, sets_suffice
from shj_bayes.population.results import PopulationRecord, load_population, record_of, write_population
from shj_bayes.report.campaign import render_campaign, render_tables
from shj_bayes.report.campaign_physics import statements
from shj_bayes.report.margins_page import band_words, extrapolated_words, render_margins, shown_cards, told
from shj_bayes.report.sets import FORCES, SHOWN, contrast_words, curve_words, multiplicity_words, name_of, pairs
from shj_bayes.report.words import digits
from shj_bayes.results.campaign import WITH_SET, CampaignRecord, Connection, read_campaign
from shj_bayes.results.codec import to_json
from shj_bayes.results.diagnosis import DiagnosisVerdict
from shj_bayes.results.store import digests, has, made
from shj_bayes.results.tables import Cells, write_workbook


def pooled_campaign(usable: Sequence[Outcome], folder: Path, *, seed: int, progress: bool = False) -> dict[str, Any]:
    """Pool devices, draw up margins, compare sets and write the page; without a device that can be used, the page.

    Arguments are those of `shj_bayes.app.campaign.summarise_campaign`. ``record`` is for machines, ``lines`` for
    people.
    """
    if not usable:
        for name in (*WRITES, *POOLS):  # of devices that are no longer there
            (folder / name).unlink(missing_ok=True)
        render_campaign(folder)
        return {"record": {}, "lines": []}
    places = [(folder / o.device.folder, o.device.name, o.device.set_name, o.device.tags) for o in usable]

    def devices() -> tuple[list[DeviceEstimate], Any]:
        ranges = [tested_by_fit(place) for place, *_ in places]
        return list(starmap(device_from_fit, places)), common([r for r in ranges if r]) if all(ranges) else None

    fits = [(name, of_set, asdict(tags), digests(place, ["fit.json"])) for place, name, of_set, tags in places]
    population, design, record = _pooled(folder, fits, devices, seed, progress)
    curves, forces = compared_pairs(folder, population)
    render_campaign(folder, population, curves, forces, design.record)
    lines = [band_text(population), "", design.text]
    return {"record": {**record, "curves": curve_records(curves)}, "lines": lines}


def pooled_tables(claims: Sequence[Claim], folder: Path, *, seed: int, progress: bool = False) -> dict[str, Any]:
    """Pool the published tables and write their page with the paper's claims; as for `pooled_campaign`."""
    rests_on = digests(shipped("data", "published"), ["*"])
    devices = lambda: (published_devices(), PUBLISHED)  # noqa: E731
    population, design, record = _pooled(folder, rests_on, devices, seed, progress)
    render_tables(folder, population, claims, pooled_forces(folder, population, specimens_of_table(population)))
    answers = [f"- The paper: {c.claim}. Its tables: {c.verdict}. {c.sentence}" for c in claims]
    lines = [band_text(population), "", *answers, "", design.text]
    return {"record": {**record, "claims": [vars(c) for c in claims]}, "lines": lines}


def _pooled(
    folder: Path,
    rests_on: object,
    devices: Callable[[], tuple[Sequence[DeviceEstimate], Any]],
    seed: int,
    progress: bool,
) -> tuple[PopulationResult, CommandResult, dict[str, Any]]:
    """Give the population of devices and of what was tested, or the one that stands; margins; and both for machines.

    Bands and values by testing, thousands of rows, are in the file alone.
    """

    def pool() -> None:
        those, tested = devices()
        write_population(replace(fit_population(those, seed=seed, progress=progress), tested=tested), folder)

    made(folder, "population", [seed, rests_on], POPULATION, pool)
    population, design = load_population(folder), design_margins(folder, progress=progress)
    rows = [row for row in design.record["margins"] if row["method"] not in (BANDS, TESTING, TOLERANCE, SPREAD)]
    files = {"population": PopulationRecord.FILE, "margins": "margins.json"}
    record = {"population": to_json(record_of(population)), "margins": {**design.record, "margins": rows}}
    return population, design, {**record, "files": files}


def band_text(population: PopulationResult) -> str:
    """Bands of a new device, one line per set and quantity."""
    lines = ["A NEW device of each set: 5 %, 50 %, 95 %"]
    enough = sets_suffice(len(population.sets))
    for row in new_device_table(population):
        if row["quantity"] in SHOWN and (enough or row["set"] != ANY_SET):
            unit = "" if row["unit"] == "1" else f" {row['unit']}"
            numbers = f"{row['q05']:10.4g} {row['q50']:10.4g} {row['q95']:10.4g}{unit}"
            devices = devices_words(row["n_devices"])
            lines.append(f"  {name_of(row['set']):34.34}{devices:12}{row['quantity']:10}{numbers}")
    return "\n".join(lines if enough else [*lines, f"  {never_tested_words(len(population.sets))}"])


def pool_of_tests(
    folder: Path,
    result: PopulationResult,
    specimens: Sequence[Specimen],
    asked: LoadingHistory | None = None,
    *,
    extrapolate: bool = False,
    progress: bool = False,
) -> tuple[Tests, PopulationResult]:
    """Put the devices of a folder through a virtual test and pool them, or find both kept beside its population."""
    rests_on = [digests(folder, POPULATION), campaign_inputs(folder), asked, extrapolate]
    tests = partial(virtual_tests, specimens, asked, extrapolate=extrapolate)
    return kept_pool(folder / POOLS[asked is not None], rests_on, result, tests, progress=progress)


def pooled_forces(folder: Path, result: PopulationResult, specimens: Sequence[Specimen]) -> PopulationResult | None:
    """Pool the forces that devices made in their own tests, to be compared; None where none gives any."""
    if not specimens:
        return None
    design = pool_of_tests(folder, result, specimens)[1]

    def few(fits: Mapping[str, QuantityPosterior]) -> dict[str, QuantityPosterior]:
        return {q: fit for q, fit in fits.items() if q in FORCES}

    others = {label: few(fits) for label, fits in design.other_priors.items()}
    return replace(design, posteriors=few(design.posteriors), other_priors=others)


def compare_sets(folder: Path, set_a: str, set_b: str, rope_percent: float = 10.0) -> tuple[dict[str, Any], str]:
    """Compare two sets of a folder that `campaign` or `tables` wrote: for machines, and for people.

    `set_a` and `set_b` are names of sets, or kinds: coated, uncoated, corroded, uncorroded, "70 %". `rope_percent` is
    the half-width of the region of practical equivalence. The forces that the devices made come first, then the
    parameters.
    """
    need_population(folder)
    result = load_population(folder)
    a, b, strata = strata_of(result, set_a, set_b)
    first, second = members(result, strata)
    rope = rope_percent / 100.0
    specimens = read_devices(folder, result)[1]
    curves = compare_curves(result, specimens, set_a, set_b, rope=rope)
    parameters = compare(result, set_a, set_b, rope=rope)
    forces: tuple[Contrast, ...] = ()
    held = {s.set_name for s in specimens}
    if held >= {*first, *second} and (design := pooled_forces(folder, result, specimens)):
        forces = compare(design, set_a, set_b, rope=rope, names=[q for q in FORCES if q in design.posteriors])
    contrasts = (*forces, *parameters)
    sides = (("a", a, first), ("b", b, second))
    who = [f"{side}: {name}" + ("" if of == (name,) else f" ({', '.join(of)})") for side, name, of in sides]
    said = {c.quantity: contrast_words(c, a, b) for c in contrasts}
    multiplicity = multiplicity_words(forces, parameters, len(strata))
    table, of_pairs = comparison_lines(contrasts)
    lines = [*who, *table, "", COLUMNS.format(rope=rope_percent), "", *of_pairs, ""]
    lines += [] if forces else ["Not every set gives K, Fy, beta and gamma: no forces are compared.", ""]
    lines += [f"- {words}" for words in (*said.values(), *map(curve_words, curves))]
    record = {
        "schema": "shj-bayes/comparison/1",
        "set_a": a,
        "set_b": b,
        "members": {"a": list(first), "b": list(second)},
        "strata": len(strata),
        "multiplicity": multiplicity,
        "contrasts": [
            {**row_of(c), "pairs": [pair._asdict() for pair in c.pairs], "sentence": said[c.quantity]}
            for c in contrasts
        ],
        "curves": curve_records(curves),
    }
    return record, "\n".join([*lines, "", multiplicity])


COLUMNS = (
    "observed: means of the devices; a / b, 90 %: of the typical devices, from the posterior; P(a > b): the typical "
    "device of a is above that of b; P(same): they differ by less than {rope:g} %; new a > new b: a new device of a is "
    "above one of b; Welch, permuted, Holm: p-values; spread a/b: standard deviation between devices of a over that of "
    "b. Forces: plateau and energy of the first run as tested, highest of all runs."
)


def write_comparison(record: dict[str, Any], folder: Path) -> Path:
    """Write ``comparison.json``, ``.csv``, ``comparison-devices.csv`` and both as ``.xlsx``; gives the workbook."""
    folder.mkdir(parents=True, exist_ok=True)
    contrasts = Cells.of([{k: v for k, v in c.items() if k != "pairs"} for c in record["contrasts"]])
    devices = Cells.of(
        [
            {"quantity": c["quantity"], "unit": c["difference_unit"], "pair": i, "side": side,
             "set": pair[f"set_{side}"], "device": device, "value": value, "observed_of_pair": pair["observed"]}
            for c in record["contrasts"]
            for i, pair in enumerate(c["pairs"], start=1)
            for side in ("a", "b")
            for device, value in pair[f"devices_{side}"].items()
        ]
    )  # fmt: skip
    notes = [record["multiplicity"], *(c["sentence"] for c in record["curves"])]
    pages = {"Comparison": contrasts, "Devices": devices, "To mind": Cells(("to mind",), [[note] for note in notes])}
    write_text(folder / "comparison.json", json.dumps(record, indent=1, ensure_ascii=False, allow_nan=False) + "\n")
    write_text(folder / "comparison.csv", contrasts.to_csv())
    write_text(folder / "comparison-devices.csv", devices.to_csv())
    write_workbook(pages, folder / "comparison.xlsx")
    return folder / "comparison.xlsx"


def curve_records(curves: Sequence[CurveContrast]) -> list[dict[str, Any]]:
    """Comparisons of curves for machines."""
    return [{**asdict(curve), "sentence": curve_words(curve)} for curve in curves]


def compared_pairs(folder: Path, result: PopulationResult) -> tuple[tuple[CurveContrast, ...], PopulationResult | None]:
    """Compare the curves of the pairs of sets that a campaign page names, and write ``comparison-curves.csv``.

    Then the forces that the devices made, pooled. Nothing is said of more devices than `MOST_DRAWN`.
    """
    few = sum(len(group.devices) for group in result.sets) <= MOST_DRAWN
    chosen = pairs(result) if few else ()
    specimens = read_devices(folder, result)[1] if chosen else ()
    found = tuple(c for pair in chosen for c in compare_curves(result, specimens, *pair, rope=ROPE))
    path = folder / "comparison-curves.csv"
    path.unlink(missing_ok=True)
    if found:
        write_text(path, Cells.of([row for curve in found for row in curve.rows()]).to_csv())
    return found, pooled_forces(folder, result, specimens)


def comparison_lines(contrasts: Sequence[Contrast]) -> tuple[list[str], list[str]]:
    """Comparison as tables of text: one line per quantity, and one per pair of sets with what was observed of it."""

    def shown(value: float | None) -> str:
        return "-" if value is None else f"{value:.3g}"

    def p(value: float | None) -> str:
        return "-" if value is None else f"{value:.3f}" if value >= 0.001 else f"{value:.0e}"

    def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
        first, *others = (max(map(len, column)) for column in zip(*rows, strict=True))
        return [
            "   ".join([f"  {head:{first}}", *(f"{cell:>{width}}" for cell, width in zip(cells, others, strict=True))])
            for head, *cells in rows
        ]

    words = ("observed", "a / b or a - b", "90 %", "P(a > b)", "P(same)", "new a > new b", "Welch", "permuted (least)")
    rows = [["", *words, "Holm", "spread a/b"]]
    for c in contrasts:
        exact, least = c.tests.permutation_p, c.tests.permutation_least
        numbers = [shown(c.observed), f"{c.q50:.3g}", f"{c.q05:.3g} to {c.q95:.3g}"]
        numbers += [f"{x:.2f}" for x in (c.probability_level, c.probability_rope, c.superiority)]
        numbers += [p(c.tests.welch_p), "-" if exact is None else f"{p(exact)} ({p(least)})"]
        numbers += [f"{p(c.holm_p)} {c.holm_test}".strip(), f"{c.spread_factor[1]:.2f}"]
        rows.append([c.quantity + ("" if c.unit == "1" else f" {c.unit}"), *numbers])
    pairs = [["Observed, pair by pair", "devices", *(c.quantity for c in contrasts)]]
    for i, pair in enumerate(contrasts[0].pairs):
        counts = f"{len(pair.devices_a)}, {len(pair.devices_b)}"
        pairs.append([f"{pair.set_a} / {pair.set_b}", counts, *(shown(c.pairs[i].observed) for c in contrasts)])
    return aligned(rows), aligned(pairs)


TABLES_NAME = "Published tables"
MOST_DRAWN = 100  # devices whose loops are drawn and written


def drawn_up(folder: Path, request: MarginOptions, *, progress: bool = False) -> str:
    """Draw up and write the margins of a folder; parameters and errors as for `design_margins`."""
    pooled = pooled_tests(folder, request, progress=progress)
    sheet, asked, campaign = sheet_of(pooled, request), pooled.asked, pooled.campaign
    slowest = min(s.ranges["speed"] for s in pooled.specimens)
    speed = slowest if asked is None else float(asked.motion.speed_mm_s.max())
    loop_bands = loops(sheet.tests, speed) if len(sheet.tests) <= MOST_DRAWN else ()
    write_margins(sheet, folder)
    write_loops(loop_bands, folder)
    name = campaign.name if campaign else TABLES_NAME
    simulated = campaign is not None and campaign.simulated
    render_margins(folder, sheet, loop_bands, name=name, importance=request.importance, simulated=simulated)
    notes = [f"- {line}" for line in (*sheet.diagnoses, *sheet.warnings)]
    if beyond := extrapolated_words(sheet):
        notes += ["", f"EXTRAPOLATED. {beyond}"]
    return "\n".join([margin_text(sheet), "", *notes, "", *two_numbers(sheet)])


class PooledTests(NamedTuple):
    """Devices of a folder after their virtual tests: what margins are drawn up from, whatever is asked of them."""

    sets: tuple[str, ...]  # that are asked for; empty for all
    campaign: CampaignRecord | None
    specimens: tuple[Specimen, ...]
    words: tuple[str, ...]  # what the diagnoses found
    asked: LoadingHistory | None
    connections: dict[str, Connection]
    lifts: str
    tests: Tests
    design: PopulationResult


def pooled_tests(folder: Path, request: MarginOptions, *, progress: bool = False) -> PooledTests:
    """Read the devices of a folder, and the tests and the pool that are kept beside them, or make these.

    Of `request` only the sets, the history and whether to extrapolate count.
    """
    result = load_population(folder)
    sets = tuple(name if name == ANY_SET else result.set_names[result.index(name)] for name in request.sets)
    campaign, specimens, words = read_devices(folder, result, sets)
    asked = loading_history(request, specimens) if specimens else None
    connections = connections_of(campaign, result)
    lifts = lifting_words(asked, specimens, connections)
    extrapolate = request.extrapolate
    try:
        tests, design = pool_of_tests(folder, result, specimens, asked, extrapolate=extrapolate, progress=progress)
    except PopulationError as error:
        raise PopulationError(f"{error}. {lifts}") if lifts else error from error
    return PooledTests(sets, campaign, specimens, words, asked, connections, lifts, tests, design)


def sheet_of(known: PooledTests, request: MarginOptions) -> Sheet:
    """Draw up the margins of pooled tests."""
    return margins(
        known.design,
        known.tests,
        replace(request, sets=known.sets),
        asked=known.asked,
        words=known.words,
        connections=known.connections,
        lifts=known.lifts,
    )


def export_analysis(
    folder: Path,
    out: Path | None = None,
    amplitude_mm: float | None = None,
    draws: int | None = None,
    *,
    target: str = PROGRAMS[0],
    progress: bool = False,
) -> tuple[Path, ...]:
    """Write the bounds of every set of a folder for an analysis program; by default into a folder of its name.

    For OpenSees ``connection_materials.py`` and ``.tcl`` and, with draws (new devices of each set for Monte Carlo),
    ``connection_draws.py`` and ``.csv``; for SAP2000 and ETABS ``connection_links.py``; for all ``link-elements.csv``
    and ``loops.csv`` (bands of the virtual test). The amplitude is that of the cycle for effective stiffness and
    damping, the largest tested by default.
    """
    if draws is not None and target != PROGRAMS[0]:
        raise PopulationError("--draws are materials of OpenSees; leave it out, or take --to opensees")
    need_population(folder)
    result = load_population(folder)
    campaign, specimens, _ = read_devices(folder, result)
    if not specimens:
        raise PopulationError("no device gives all of K, Fy, beta and gamma, which a material needs")
    tested = largest_ranges(specimens)["position"]
    amplitude = tested if amplitude_mm is None else amplitude_mm
    if not 0 < amplitude <= LEEWAY * tested:
        raise PopulationError(f"an amplitude of {amplitude:g} mm was not tested; tested was up to {tested:.4g} mm")
    tests, design = pool_of_tests(folder, result, specimens, progress=progress)
    said = connections_of(campaign, result)
    connections = {name: said.get(name, Connection()) for name in design.set_names}
    drawn = bounds(design, result, amplitude, connections)
    speed = min(s.ranges["speed"] for s in specimens)
    source = campaign.name if campaign else TABLES_NAME
    devices = {} if draws is None else draw_devices(design, result, draws, speed)
    left_out = (*stiffness_words(connections), *left_out_words([test.channels for test in tests]))
    files = {"link-elements.csv": link_csv(drawn, f"{amplitude:.3g} mm", left_out)}
    if target == PROGRAMS[0]:
        files["connection_materials.py"] = python_script(drawn, amplitude, source, left_out)
        files["connection_materials.tcl"] = tcl_script(drawn, source, left_out)
    else:
        files["connection_links.py"] = links_script(drawn, target, source, left_out)
    if devices:
        files["connection_draws.py"] = draws_script(devices, amplitude, speed, source, left_out)
        files["connection_draws.csv"] = draws_csv(devices, speed)
    place = folder / target if out is None else out
    place.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        write_text(place / name, text)
    drawn_loops = write_loops(loops(tests, speed) if len(tests) <= MOST_DRAWN else (), place)
    return (*(place / name for name in files), *((drawn_loops,) if drawn_loops else ()))


def read_devices(
    folder: Path, result: PopulationResult, told: Sequence[str] = ()
) -> tuple[CampaignRecord | None, tuple[Specimen, ...], tuple[str, ...]]:
    """Read the tested devices of a folder with the models that their diagnoses ended in, and what these found.

    First comes the record of the campaign; None for the published tables. What was found is told of the sets
    `told`, of all where that is empty.
    """
    if not has(CampaignRecord, folder):
        return None, specimens_of_table(result), ()
    campaign = read_campaign(folder)
    members = {group.name: group.devices for group in result.sets}
    out, found, notes, n_told = [], {}, [], 0
    for of_set, device in campaign.devices:
        if device.name not in members.get(of_set, ()):
            continue
        name, place, with_set = device.name, folder / device.folder, device.usable_with_set
        diagnosis, why = find_diagnosis(place)
        better = diagnosis.fit if diagnosis is not None and diagnosis.verdict is not DiagnosisVerdict.ADEQUATE else None
        if with_set:
            better = place / WITH_SET
        if not told or of_set in told:
            n_told += 1
            if why:
                notes.append(f"{of_set}, {name}: {why}")
            if diagnosis is not None:  # one without a fit, a first look, may have been fitted with its set after all
                found[of_set, name] = replace(diagnosis, fit=better) if with_set else diagnosis
        out.append(read_specimen(place, name, of_set, better))
    common = [group for group in campaign.together if not told or group.set in told]
    words = (*statements(common), *words_of(found, n_told, notes))
    return campaign, tuple(out), words


DEVICES_MORE = 2  # one says nothing of how much devices differ
CYCLES = 3  # of each speed: the nominal force is that of the third


def lifting_words(
    asked: LoadingHistory | None, specimens: Sequence[Specimen], connections: Mapping[str, Connection]
) -> str:
    """Say which tests would let a history stand that leaves what was tested; empty where all was tested."""
    beyond = {} if asked is None else untested(asked, specimens)
    if asked is None or not beyond:
        return ""
    tested = largest_ranges(specimens)
    amplitude = rounded_up(float(np.ptp(asked.motion.displacement_mm)) / 2.0)
    amplitude = max(amplitude, rounded_up(beyond["position"])) if "position" in beyond else amplitude
    fastest = beyond.get("speed", tested["speed"])
    speeds = sorted({rounded_up(v) for v in (math.sqrt(tested["speed"] * fastest), fastest)})
    far = max(beyond.get("travel", 0.0), beyond.get("time", 0.0) * fastest / 2000.0)  # mean speed: about half the peak
    cycles = max(CYCLES, math.ceil(1000.0 * far / (4.0 * amplitude * len(speeds))))
    test = Protocol("lifting", tuple(ProtocolBlock(amplitude, speed, cycles) for speed in speeds))
    narrow = [n for n, one in connections.items() if one.travel_mm is not None and one.travel_mm < amplitude]
    slot = f"; the slot of {', '.join(narrow)} is too short for it" if narrow else ""
    return (
        f"What would lift this: of each set {DEVICES_MORE} devices, {cycles} cycles of {amplitude:g} mm at "
        f"{' and '.join(f'{speed:g}' for speed in speeds)} mm/s ({test.duration_s:.0f} s and {test.travel_m:.2g} m of "
        f"sliding a device{slot}); put their recordings into the manifest and run shj-bayes campaign again"
    )


def rounded_up(value: float) -> float:
    """Next number with two digits."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / step * (1.0 - 1e-9)) * step:.3g}")


def connections_of(campaign: CampaignRecord | None, result: PopulationResult) -> dict[str, Connection]:
    """Give what the manifest says of the connection of each set; of the published tables what the paper says."""
    if campaign is not None:
        return {group.name: group.connection for group in campaign.sets if group.connection}
    paper = Connection(bolts=2, bolt_mm=16.0, bolt_grade="8.8", surfaces=2, slot_mm=220.0)
    return {group.name: replace(paper, shim=group.tags.material or None) for group in result.sets}


def card_lines(sheet: Sheet) -> Iterator[str]:
    """Card of each set as text."""
    for card in shown_cards(sheet):
        yield f"{card['name']}"
        yield from (f"  {head}: {said}" for head, said in card["facts"])
        yield f"  {'':32}{'drift':>9}{'typical':>9}{'capacity':>9}         {'+-draws':>7}"
        for line in card["lines"]:
            low, middle, high = line["values"]
            numbers = f"{low:>9}{middle:>9}{high:>9} {line['unit']:7} {line['error']:>7}"
            yield f"  {line['use']:32}{numbers}  {line['clause']}".rstrip()
        yield from (f"  {head:32}{''.join(f'{cell:>9}' for cell in cells)}" for head, *cells in card["curve"])
        yield ""


LEGEND = (
    "lowest, highest: smallest plateau and largest force of all runs; least, most: of the first run; plateau: mean; "
    "third: third cycle; energy: of a cycle of the largest amplitude; _2: second run; ratio: second run / first; "
    "degradation: 1 - ratio; K: initial stiffness; nu: degrees of freedom of the spread"
)


def margin_text(sheet: Sheet) -> str:
    """Cards as text, then per set and quantity the new device, EN 1990 and a tolerance limit."""
    table, index = design_table(sheet), sheet.by_key
    lines = ["", *card_lines(sheet), LEGEND]
    for name in sheet.spoken:
        shown = "(all devices)" if name == ANY_SET else name
        part = [line for line in table if line["set"] == shown]
        lines += ["", f"{name_of(name)}: {_behind(sheet, name)}"]
        lines.append(
            f"  {'':16}{'new device':>28}{'EN 1990 X_k':>22}{'EN 1990 X_d':>22}{'95/95 one-sided':>22}{'nu':>7}"
        )
        complete = True
        for line in part:
            ends = [(line.get(f"{head}, low", math.nan), line.get(f"{head}, high", math.nan)) for head in CHOSEN[1:]]
            complete &= bool(np.isfinite(ends).all())
            pairs = [f"{digits(low)} to {digits(high)}" if math.isfinite(low + high) else "-" for low, high in ends]
            low, middle, high = band_words(index, name, line["quantity"])
            band = f"{middle} ({low} to {high})"
            unit = "" if line["unit"] == "1" else f" {line['unit']}"
            head, nu = f"{line['quantity']}{unit}", line.get(f"{CHOSEN[1]}, degrees of freedom", "-")
            lines.append(f"  {head:16}{band:>28}{pairs[0]:>22}{pairs[1]:>22}{pairs[2]:>22}{nu:>7}")
        if sheet.withheld:
            lines.append(f"  (-: {sheet.withheld})")
        elif not complete:
            lines.append("  (-: EN 1990 has no factor for a spread known from fewer than 3 (X_k) or 4 (X_d) devices)")
    if untested := sheet.untested:
        lines += ["", untested]
    return "\n".join(lines[1:])


def two_numbers(sheet: Sheet) -> list[str]:
    """End of the text, where a terminal shows it: the force for drift and the one for capacity design of each set."""
    head = f"Two numbers of each set, of the devices that were tested, {sheet.holds}, in {sheet.history}"
    lines = [f"{head} (ageing is in the ASCE 7 and EN 15129 bounds alone):"]
    for name in sheet.spoken:
        own = {row.kind: row for row in sheet.rows if row.set_name == name}
        said = f"{DRIFT}: {told(own[DRIFT])} kN; {CAPACITY}: {told(own[CAPACITY])} kN"
        warning = f" ({own[DRIFT].warning})" if own[DRIFT].warning else ""
        lines.append(f"  {name_of(name)}, {_behind(sheet, name)}: {said}{warning}")
    return lines


def _behind(sheet: Sheet, name: str) -> str:
    """Say on how many devices, or sets, the margins of a set rest."""
    if name == ANY_SET:
        return f"from {sheet.n_sets} tested sets"
    return devices_words(max(row.n_devices for row in sheet.rows if row.set_name == name))


def devices_words(n: int) -> str:
    """Say how many devices there are."""
    return f"{n} device{'' if n == 1 else 's'}"
