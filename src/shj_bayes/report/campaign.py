"""The page of a campaign, with what it shows of coating sets, and that of the published tables."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from shj_bayes.errors import ShjError
from shj_bayes.margins.curves import CurveContrast
from shj_bayes.margins.spread import BANDS
from shj_bayes.model.coordinates import coordinate_named
from shj_bayes.model.curve import curve_named
from shj_bayes.population.compare import Direction, compare
from shj_bayes.population.device import Claim, Holding
from shj_bayes.population.hierarchy import PopulationResult
from shj_bayes.population.predict import dep_words, how_wide, never_tested_words, sets_suffice
from shj_bayes.population.results import PopulationRecord, load_population
from shj_bayes.report import sets, words
from shj_bayes.report.campaign_physics import NUMBERS, certain, class_words, set_words, statement, statements, table
from shj_bayes.report.diagnosis_words import along_words, percent
from shj_bayes.report.figures import population as figures
from shj_bayes.report.page import PAGE, Picture, write_page
from shj_bayes.results.campaign import WITH_SET, CampaignRecord, DeviceEntry, SharedDependence, read_campaign
from shj_bayes.results.device import DeviceResult
from shj_bayes.results.diagnosis import CurveRecord, DependenceId, DiagnosisRecord, LeftOver
from shj_bayes.results.fit import SummaryRecord
from shj_bayes.results.store import DIAGNOSIS, find, has, read

PLACES = 61  # of a curve
Curve = tuple[CurveRecord, bool]  # of a device, and whether it shows it alone
Panel = tuple[str, SharedDependence, list[Curve]]  # set, class, curves of its devices
MOST = 40  # curves in a panel, and panels in a picture


def _bands(quantity: str, rows: tuple[sets.SetBand, ...]) -> Picture:
    unit, title = "no unit" if rows[0].unit == "1" else rows[0].unit, sets.title_of(quantity)
    caption = _ends(rows)
    if quantity == "Fy":
        caption = (
            "Dots are tested devices; how many stands behind the name of the set. The blue bar is the 90 % interval "
            "of a new device of that set, its upright line the median."
        )
    if quantity == "gamma":
        caption += " 0 means no dependence on speed; a band on both sides of 0 leaves dep = 1/gamma open."
    low, high = figures.span(rows)
    if any(row.widest[0] < low or row.widest[1] > high for row in rows):
        caption += " Lines that end in an arrow run off the sheet: hardly anything is known there."
    return Picture(
        figures.bands(rows, f"{sets.MEANING[quantity]} ({unit})"),
        f"{title} of every set: the tested devices, and the band in which a new device is expected.",
        caption,
        title,
        wide=True,
    )


def _ends(rows: tuple[sets.SetBand, ...]) -> str:
    """Say which sets lie at the ends, and which is known least."""
    unit = "" if rows[0].unit == "1" else f" {rows[0].unit}"
    least, most = min(rows, key=lambda row: row.band[1]), max(rows, key=lambda row: row.band[1])
    widest = max(rows, key=lambda row: row.band[2] - row.band[0])
    low, _, high = (f"{value:.3g}" for value in widest.band)
    text = f"Widest band: {widest.name}, {low} to {high}{unit}."
    if least is most:
        return f"Median: {least.band[1]:.3g}{unit}. {text}"
    return f"Medians from {least.band[1]:.3g}{unit} ({least.name}) to {most.band[1]:.3g}{unit} ({most.name}). {text}"


def population_content(
    result: PopulationResult,
    intervals: Mapping[tuple[str, str], Mapping[str, sets.Interval]],
    motion: tuple[float, float],
    curves: Sequence[CurveContrast] = (),
    forces: PopulationResult | None = None,
) -> dict[str, Any]:
    """Everything about the sets, plain values and pictures.

    `motion` is the amplitude, mm, and the peak speed, mm/s, of the loops; `forces` are those that the devices made,
    pooled.
    """
    bands = sets.set_bands(result, intervals)
    amplitude, speed = motion
    if forces is not None and forces.set_names != result.set_names:
        forces = None  # not every set gives them
    names = [q for q in sets.FORCES if forces is not None and q in forces.posteriors]
    names += [q for q in bands if q in result.posteriors]
    loops = groupby(sets.loop_bands(result, *motion), key=lambda band: band.set_name)
    return {
        "quantities": [{"name": q, "meaning": sets.MEANING[q], "unit": rows[0].unit} for q, rows in bands.items()],
        "table": _table(bands),
        "first": _bands("Fy", bands["Fy"]) if "Fy" in bands else None,
        "bands": [{"quantity": q, "picture": _bands(q, rows)} for q, rows in bands.items() if q != "Fy"],
        "loops": [
            {"address": figures.loop(runs), "name": sets.name_of(name), "runs": runs}
            for name, runs in ((name, list(group)) for name, group in loops)
        ],
        "curves": [
            {
                "address": figures.apart(curve),
                "of": curve,
                "title": coordinate_named(curve.coordinate).title,
                "words": sets.curve_words(curve),
            }
            for curve in curves
        ],
        "motion": f"{words.short(amplitude)} mm at a peak speed of {words.short(speed)} mm/s",
        "wide": [how_wide(result, row.set_name) for row in bands.get("Fy", ())],
        "untested": "" if sets_suffice(len(result.sets)) else never_tested_words(len(result.sets)),
        "few": _few(result),
        "matrix": sets.force_matrix(forces or result),
        "of_forces": forces is not None,
        "compared": [{"name": q, "meaning": sets.MEANING[q]} for q in names],
        "contrasts": [_contrast(a, b, forces, result) for a, b in sets.pairs(result)],
        "priors": [
            {"name": name, "source": prior.source} for name, prior in result.priors.items() if name in result.posteriors
        ],
        "result": result,
    }


def delivered(record: Mapping[str, Any]) -> dict[str, dict[str, dict[str, str]]]:
    """Plateau force of a new device in the tests, by set, quantity (plateau; plateau_2 of run 2) and side.

    `record` is the content of ``margins.json``.
    """
    out: dict[str, dict[str, dict[str, str]]] = {}
    for row in record.get("margins", ()):
        if row["method"] == BANDS and row["quantity"] in ("plateau", "plateau_2"):
            own = out.setdefault(row["set"], {}).setdefault(row["quantity"], {})
            own[row["side"]] = words.digits(row["value"], row.get("monte_carlo_error", 0.0))
    return out


def tested_motion(folder: Path) -> tuple[float, float] | None:
    """Largest amplitude, mm, and peak speed, mm/s, of a fitted device; None where its files cannot be read."""
    try:
        samples = DeviceResult.read(folder).samples
        x, speed = samples["displacement_mm"], samples["speed_mm_s"]
    except (ShjError, KeyError):
        return None
    amplitude, peak = 0.5 * float(np.ptp(x)), float(np.quantile(speed, 0.99))
    return (amplitude, peak) if amplitude > 0 and peak > 0 else None


def _table(bands: Mapping[str, tuple[sets.SetBand, ...]]) -> list[dict[str, Any]]:
    """One row per set: a new device in every quantity."""
    second = {b.name: f"{100 * b.band[0]:.0f} to {100 * b.band[2]:.0f} %" for b in bands.get("ratio", ())}
    rows: dict[str, dict[str, Any]] = {}
    for quantity, of_sets in bands.items():
        for band in of_sets:
            low, middle, high = band.band
            head = {"set": band.set_name, "name": band.name, "n": 0, "cells": {}, "second": second.get(band.name, "")}
            row = rows.setdefault(band.set_name, head)
            row["n"] = max(row["n"], band.n_devices)
            # Band of gamma as dep, short enough for a cell.
            dep = "dep open" if low <= 0 <= high else f"dep {dep_words(low, high)}"
            dep = dep if quantity == "gamma" else ""
            row["cells"][quantity] = {"low": low, "middle": middle, "high": high, "dep": dep}
    return list(rows.values())


def _few(result: PopulationResult) -> str:
    """Say plainly when there are too few devices for a band of their own."""
    counts = [len(group.devices) for group in result.sets]
    if min(counts) >= 6:
        return ""
    few = sum(n <= 2 for n in counts)
    verb = "rests" if few == 1 else "rest"
    tail = f" {few} of the {len(counts)} sets here {verb} on one or two devices." if few and len(counts) > 1 else ""
    return (
        f"{NUMBERS[max(2, min(counts))]} devices are not a band: the next one need not lie between them. The blue "
        "bars are for a new device. They hold how much devices of one set differ, which few devices can hardly tell, "
        "so most of their width comes from the other sets and from assumptions; the thin grey lines show how far other "
        f"assumptions move them.{tail}"
    )


def _contrast(a: str, b: str, forces: PopulationResult | None, result: PopulationResult) -> dict[str, Any]:
    """One pair of sets: a cell for each quantity, and the sentence on the force."""
    cells, sentence = {}, ""
    for c in (c for of in (forces, result) if of is not None for c in compare(of, a, b)):
        form = ".2f" if c.kind == "quotient" else "+.3g"
        cells[c.quantity] = {
            "text": f"{c.q50:{form}}",
            "range": f"{c.q05:{form}} to {c.q95:{form}}",
            "observed": "" if c.observed is None else f"observed {c.observed:{form}}",
            "settled": c.direction is Direction.SETTLED,
        }
        if c.quantity == (sets.FORCES[0] if forces is not None else "Fy"):
            sentence = sets.contrast_words(c, a, b)
    return {"pair": f"{a} against {b}", "cells": cells, "sentence": sentence}


def pictures(folder: Path, record: CampaignRecord) -> list[Picture]:
    """Draw one picture for each class that some set has: a panel for each set, a curve for each device."""
    with_set = {device.folder: device.usable_with_set for _, device in record.devices}
    by_class: dict[DependenceId, list[Panel]] = {}
    for group in record.together:
        known = group.set and all(place in with_set for place in group.devices)
        for row in group.classes if known else ():
            if not certain(row) or row.action == "motion":
                continue
            places = [(i, group.devices[i]) for i in row.holders[:MOST]]
            curves = [c for i, at in places if (c := _curve(folder / at, row, i, with_set[at])) is not None]
            if curves:
                by_class.setdefault(row.id, []).append((group.set, row, curves))
    return [_picture(parts[:MOST]) for parts in by_class.values()]


def _picture(parts: Sequence[Panel]) -> Picture:
    first = parts[0][1]
    over = along_words(first.coordinate).removeprefix("the ")
    unit = "" if first.unit == "1" else f" ({first.unit})"
    what = class_words(first.id)
    drawn = figures.curves([(name, curves) for name, _, curves in parts], f"{over}{unit}")
    who = ", ".join(set_words(name) for name, *_ in parts)
    said = " ".join(statement(row, name) for name, row, _ in parts)
    alt = f"Change of the {what}, per cent of Fy, for each device of {who}."
    return Picture(drawn, alt, said, f"Change of the {what}", wide=True)


def _curve(place: Path, row: SharedDependence, i: int, with_set: bool) -> Curve | None:
    """Curve of a device, and whether it shows it alone: of its fit with what its set has, or of its diagnosis.

    None where neither holds one.
    """
    try:
        effect = row.effects[i]
        curve = curve_named(effect) if with_set else None
        if curve is None:
            known, own = read(DiagnosisRecord, place / DIAGNOSIS).coordinates, (row.action, row.coordinate, "both")
            found = next((c.curve for c in known if (c.action, c.coordinate, c.direction) == own and c.curve), None)
            return (found, True) if found else None
        fit = DeviceResult.read(place / WITH_SET)
        if curve.sides or effect not in fit.record.model.effects:
            return None
        coefficients = np.stack([fit.draws[f"{effect}.c{k}"] for k in range(1, curve.n + 1)])
        share = np.linspace(0.0, 1.0, PLACES)
        at = curve.over.value_of(share, DeviceResult.read(place).histories[0])
        values = 100.0 * curve.rows(share, np.ones(PLACES)) @ coefficients
    except (ShjError, OSError, KeyError, TypeError, ValueError):  # a damaged file: the page goes without that curve
        return None
    bands = (at, values.mean(axis=1), *np.quantile(values, [0.05, 0.95], axis=1))
    places, mean, low, high = (tuple(band.tolist()) for band in bands)
    return CurveRecord(at=places, mean=mean, q05=low, q95=high, unit=row.unit), row.alone[i]


MARGINS = "margins.html"  # sheet of `shj-bayes margins`, linked where it is
PUBLISHED_MOTION = (95.0, 10.0)  # largest amplitude (mm) and peak speed (mm/s) of the paper's Table 1


def render_campaign(
    folder: Path,
    population: PopulationResult | None = None,
    curves: Sequence[CurveContrast] = (),
    forces: PopulationResult | None = None,
    margins: Mapping[str, Any] | None = None,
) -> Path:
    """Write ``report.html`` of a campaign; its population is read from the folder when that holds one.

    `curves` are comparisons of curves of its sets, `forces` those that its devices made, pooled, `margins` the content
    of ``margins.json`` for the tests themselves.
    `ReportError` if the folder holds no readable ``campaign.json``.
    """
    record, margins = read_campaign(folder), margins or {}
    if population is None and has(PopulationRecord, folder):
        population = load_population(folder)
    devices = [device_row(folder, set_name, device) for set_name, device in record.devices]
    done = [d for d in devices if d["status"] != "failed"]
    intervals = {(d["set"], d["name"]): d["intervals"] for d in done}
    motion = next((m for d in done if d["link"] and (m := tested_motion(folder / d["folder"]))), PUBLISHED_MOTION)
    shared = table(record.together)
    content = {
        "name": record.name,
        "simulated": record.simulated,
        "warnings": record.warnings,
        "devices": devices,
        "notes": [(group.name, group.note) for group in record.sets if group.note],
        "done": done,
        "delivered": delivered(margins),
        "fastest": (margins.get("tested") or {}).get("fastest_mm_s"),
        "population": population_content(population, intervals, motion, curves, forces) if population else None,
        "margins": MARGINS if (folder / MARGINS).exists() else "",
        "physics": shared
        and {
            "said": statements(record.together),
            "table": shared,
            "percent": percent,
            "pictures": pictures(folder, record),
        },
    }
    return write_page(folder, "campaign.html", content, name=PAGE)


def render_tables(
    folder: Path,
    population: PopulationResult,
    claims: Sequence[Claim] = (),
    forces: PopulationResult | None = None,
) -> Path:
    """Write ``report.html`` of the published devices, with the paper's claims against its own numbers."""
    content = {
        "claims": claims,
        "colours": {Holding.YES: "holds", Holding.NO: "not"},
        "n_devices": sum(len(group.devices) for group in population.sets),
        "population": population_content(population, {}, PUBLISHED_MOTION, forces=forces),
        "margins": MARGINS if (folder / MARGINS).exists() else "",
    }
    folder.mkdir(parents=True, exist_ok=True)
    return write_page(folder, "tables.html", content, name=PAGE)


def device_row(folder: Path, set_name: str, device: DeviceEntry) -> dict[str, Any]:
    """One device of the list: numbers where it was fitted, the reason where it was not."""
    pages = {
        "link": (PAGE, ""),
        "diagnosis_link": (f"{DIAGNOSIS}/diagnosis.html", device.diagnosis or "off"),
        "with_set_link": (f"{WITH_SET}/{PAGE}", device.with_set or "off"),
    }
    row: dict[str, Any] = {
        **vars(device),
        **dict.fromkeys((*pages, "grade", "residual"), ""),
        "set": set_name,
        "numbers": {},
        "intervals": {},
        "trouble": "; ".join(filter(None, (device.diagnosis_reason, device.with_set_reason))),
    }
    if device.status == "failed":
        return row
    for key, (page, verdict) in pages.items():
        if verdict not in ("off", "failed") and (folder / device.folder / page).exists():
            row[key] = quote(f"{device.folder}/{page}")
    summary, left = find(SummaryRecord, folder / device.folder), find(LeftOver, folder / device.folder)
    if summary:
        row["numbers"] = {parameter.name: parameter for parameter in summary.parameters}
        row["intervals"] = {name: (p.q05, p.q50, p.q95) for name, p in row["numbers"].items()}
    if left:
        row["grade"], row["residual"] = left.grade, words.left_cell(left)
    return row
