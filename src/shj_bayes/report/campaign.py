"""The page of a campaign, and that of the published tables."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from shj_bayes.errors import ShjError
from shj_bayes.margins.curves import CurveContrast
from shj_bayes.model.curve import curve_named
from shj_bayes.population.device import Claim, Holding
from shj_bayes.population.hierarchy import PopulationResult
from shj_bayes.population.results import PopulationRecord, load_population
from shj_bayes.report import words
from shj_bayes.report.campaign_physics import certain, class_words, set_words, statement, statements, table
from shj_bayes.report.diagnosis_words import along_words, percent
from shj_bayes.report.figures import population as figures
from shj_bayes.report.figures.population import DeviceCurve
from shj_bayes.report.page import PAGE, Picture, write_page
from shj_bayes.report.sets_page import delivered, population_content, tested_motion
from shj_bayes.results.campaign import (
    WITH_SET,
    CampaignRecord,
    DeviceEntry,
    SetTogether,
    SharedDependence,
    read_campaign,
)
from shj_bayes.results.device import DeviceResult
from shj_bayes.results.diagnosis import DependenceId, DiagnosisRecord, LeftOver
from shj_bayes.results.fit import SummaryRecord
from shj_bayes.results.store import DIAGNOSIS, find, has, read

PLACES = 61  # of a curve
Panel = tuple[str, SharedDependence, list[DeviceCurve]]  # set, class, curves of its devices
MOST = 40  # curves in a panel, and panels in a picture


def pictures(folder: Path, together: Sequence[SetTogether], with_set: Mapping[str, bool]) -> list[Picture]:
    """Draw one picture for each class that some set has: a panel for each set, a curve for each device.

    `with_set` says, for the folder of each device, whether it has a usable fit with what its set has.
    """
    by_class: dict[DependenceId, list[Panel]] = {}
    for group in together:
        for row in group.classes if group.set else ():
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


def _curve(place: Path, row: SharedDependence, i: int, with_set: bool) -> DeviceCurve | None:
    """Curve of a device: of its fit with what its set has, or of its diagnosis; None where neither holds one."""
    try:
        if with_set and curve_named(row.effects[i]) is not None:
            return _of_fit(place, row.effects[i], alone=row.alone[i])
        return _of_diagnosis(place / DIAGNOSIS, row)
    except (ShjError, OSError, KeyError, TypeError, ValueError):  # a damaged file: the page goes without that curve
        return None


def _of_fit(place: Path, effect: str, *, alone: bool) -> DeviceCurve | None:
    """Curve of a device's fit with what its set has, from its posterior; None where that does not hold it."""
    curve, fit = curve_named(effect), DeviceResult.read(place / WITH_SET)
    if curve is None or curve.sides or effect not in fit.record.model.effects:
        return None
    history = DeviceResult.read(place).histories[0]
    coefficients = np.stack([fit.draws[f"{effect}.c{k}"] for k in range(1, curve.n + 1)])
    share = np.linspace(0.0, 1.0, PLACES)
    values = 100.0 * curve.rows(share, np.ones(PLACES)) @ coefficients
    low, high = np.quantile(values, [0.05, 0.95], axis=1)
    return DeviceCurve(curve.over.value_of(share, history), values.mean(axis=1), low, high, alone)


def _of_diagnosis(place: Path, row: SharedDependence) -> DeviceCurve | None:
    """Curve that the diagnosis of a device found."""
    for one in read(DiagnosisRecord, place).coordinates:
        if (one.action, one.coordinate, one.direction) == (row.action, row.coordinate, "both") and one.curve:
            curve = one.curve
            at, mean, low, high = map(np.array, (curve.at, curve.mean, curve.q05, curve.q95))
            return DeviceCurve(at, mean, low, high, alone=True)
    return None


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
    record = read_campaign(folder)
    if population is None and has(PopulationRecord, folder):
        population = load_population(folder)
    devices = [device_row(folder, set_name, device) for set_name, device in record.devices]
    done = [d for d in devices if d["status"] != "failed"]
    intervals = {(d["set"], d["name"]): d["intervals"] for d in done}
    motion = next((m for d in done if d["link"] and (m := tested_motion(folder / d["folder"]))), PUBLISHED_MOTION)
    content = {
        "name": record.name,
        "simulated": record.simulated,
        "warnings": record.warnings,
        "devices": devices,
        "notes": [(group.name, group.note) for group in record.sets if group.note],
        "done": done,
        "delivered": delivered(margins or {}),
        "fastest": ((margins or {}).get("tested") or {}).get("fastest_mm_s"),
        "population": population_content(population, intervals, motion, curves, forces) if population else None,
        "margins": MARGINS if (folder / MARGINS).exists() else "",
        "physics": _physics(folder, record),
    }
    return write_page(folder, "campaign.html", content, name=PAGE)


def _physics(folder: Path, record: CampaignRecord) -> dict[str, Any] | None:
    """Give what sets have in common; None where no device was diagnosed."""
    found = table(record.together)
    if found is None:
        return None
    with_set = {device.folder: device.usable_with_set for _, device in record.devices}
    known = [group for group in record.together if all(place in with_set for place in group.devices)]
    drawn = pictures(folder, known, with_set)
    said = statements(record.together)
    return {"said": said, "table": found, "percent": percent, "pictures": drawn}


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
    place = device.folder
    row: dict[str, Any] = {
        **vars(device),
        **dict.fromkeys(("link", "diagnosis_link", "with_set_link", "grade", "residual"), ""),
        "set": set_name,
        "numbers": {},
        "intervals": {},
        "trouble": "; ".join(filter(None, (device.diagnosis_reason, device.with_set_reason))),
    }
    if row["status"] == "failed":
        return row
    pages = {"link": PAGE, "diagnosis_link": f"{DIAGNOSIS}/diagnosis.html", "with_set_link": f"{WITH_SET}/{PAGE}"}
    for key, page in pages.items():
        if (key == "link" or row[key.removesuffix("_link")] not in ("", "off", "failed")) and (
            folder / place / page
        ).exists():
            row[key] = quote(f"{place}/{page}")
    table = find(SummaryRecord, folder / place)
    for parameter in table.parameters if table else ():
        row["intervals"][parameter.name] = (parameter.q05, parameter.q50, parameter.q95)
        row["numbers"][parameter.name] = parameter
    left = find(LeftOver, folder / place)
    if left:
        row["grade"], row["residual"] = left.grade, words.left_cell(left)
    return row
