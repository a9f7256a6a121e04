"""The page of a campaign, and that of the published tables."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from shj_bayes.margins.curves import CurveContrast
from shj_bayes.population.device import Claim, Holding
from shj_bayes.population.hierarchy import PopulationResult
from shj_bayes.population.results import PopulationRecord, load_population
from shj_bayes.report import words
from shj_bayes.report.campaign_physics import statements, table
from shj_bayes.report.diagnosis_words import percent
from shj_bayes.report.page import PAGE, write_page
from shj_bayes.report.sets_page import population_content, tested_motion
from shj_bayes.results.campaign import WITH_SET, CampaignRecord, DeviceEntry, read_campaign
from shj_bayes.results.diagnosis import LeftOver
from shj_bayes.results.fit import SummaryRecord
from shj_bayes.results.store import DIAGNOSIS, find, has

MARGINS = "margins.html"  # sheet of `shj-bayes margins`, linked where it is
PUBLISHED_MOTION = (95.0, 10.0)  # largest amplitude (mm) and peak speed (mm/s) of the paper's Table 1


def render_campaign(
    folder: Path, population: PopulationResult | None = None, curves: Sequence[CurveContrast] = ()
) -> Path:
    """Write ``report.html`` of a campaign; its population is read from the folder when that holds one.

    `curves` are comparisons of curves of its sets. `ReportError` if the folder holds no readable ``campaign.json``.
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
        "done": done,
        "population": population_content(population, intervals, motion, curves) if population else None,
        "margins": MARGINS if (folder / MARGINS).exists() else "",
        "physics": _physics(folder, record),
    }
    return write_page(folder, "campaign.html", content, name=PAGE)


def _physics(folder: Path, record: CampaignRecord) -> dict[str, Any] | None:
    """Give what sets have in common; None where no device was diagnosed."""
    found = table(record.together)
    if found is None:
        return None
    from shj_bayes.report.campaign_curves import pictures  # noqa: PLC0415  (drawing needs matplotlib)

    with_set = {device.folder: device.usable_with_set for _, device in record.devices}
    known = [group for group in record.together if all(place in with_set for place in group.devices)]
    drawn = pictures(folder, known, with_set)
    said = statements(record.together)
    return {"said": said, "table": found, "percent": percent, "pictures": drawn}


def render_tables(folder: Path, population: PopulationResult, claims: Sequence[Claim] = ()) -> Path:
    """Write ``report.html`` of the published devices, with the paper's claims against its own numbers."""
    content = {
        "claims": claims,
        "colours": {Holding.YES: "holds", Holding.NO: "not"},
        "n_devices": sum(len(group.devices) for group in population.sets),
        "population": population_content(population, {}, PUBLISHED_MOTION),
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
