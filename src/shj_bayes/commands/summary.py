"""From finished devices, or from the published tables, to population, comparison and the page over them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from shj_bayes._util.files import make_writable
from shj_bayes._util.lock import alone_in
from shj_bayes.commands.campaign import FAILED, Manifest, Outcome
from shj_bayes.commands.comparison import curve_records, curves_of_pairs
from shj_bayes.commands.design import design_margins
from shj_bayes.margins.curves import CurveContrast
from shj_bayes.population.fits import device_from_fit, tested_by_fit
from shj_bayes.population.hierarchy import fit_population
from shj_bayes.population.posterior import ANY_SET, PopulationResult
from shj_bayes.population.predict import RUN_FORCES, never_tested_words, new_device_table, sets_suffice
from shj_bayes.population.published import Claim, published_devices
from shj_bayes.population.results import to_json, write_population
from shj_bayes.population.tested import PUBLISHED, common
from shj_bayes.report.campaign import render_campaign, render_tables
from shj_bayes.report.campaign_file import read_campaign
from shj_bayes.report.campaign_physics import statements
from shj_bayes.report.sets import name_of

SHOWN = ("Fy", *RUN_FORCES, *RUN_FORCES.values(), "K", "gamma")


@dataclass(frozen=True, eq=False)
class Summary:
    """End of a campaign or of the tables.

    Parameters
    ----------
    record : dict
        For machines.
    text : str
        For people; ends with where the page is.
    usable : bool
        False when no device could be used.
    """

    record: dict[str, Any]
    text: str
    usable: bool = True


@alone_in("folder")
def summarise_campaign(
    manifest: Manifest, outcomes: Sequence[Outcome], folder: Path, *, seed: int, progress: bool = False
) -> Summary:
    """Pool the usable devices of a campaign and write its page.

    Parameters
    ----------
    manifest : Manifest
        The campaign.
    outcomes : sequence of Outcome
        What became of each device.
    folder : Path
        Campaign folder.
    seed : int
        Same seed and devices, same numbers.
    progress : bool
        Show a progress bar.

    Returns
    -------
    Summary
    """
    usable = [o for o in outcomes if o.status != "failed" and o.verdict != "unusable"]
    lines = [_line(o) for o in outcomes]
    record = read_campaign(folder)
    lines += [*record["warnings"], *statements(record)]
    population = None
    curves: tuple[CurveContrast, ...] = ()
    if usable:
        places = [folder / o.device.folder for o in usable]
        devices = [
            device_from_fit(place, o.device.name, o.device.set_name, o.device.tags)
            for place, o in zip(places, usable, strict=True)
        ]
        ranges = [tested_by_fit(place) for place in places]
        population = replace(
            fit_population(devices, seed=seed, progress=progress),
            tested=common([r for r in ranges if r]) if all(ranges) else None,
        )
        write_population(population, folder)
        design = design_margins(folder, population=population, progress=progress)
        curves = curves_of_pairs(folder, population, design.specimens)
        record["population"], record["margins"] = to_json(population), design.record
        record["curves"] = curve_records(curves)
        lines += ["", band_text(population), "", design.text]
    page = render_campaign(folder, population, curves)
    return Summary(record, "\n".join([*lines, f"report: {page}"]), bool(usable))


def _line(o: Outcome) -> str:
    """Say what became of a device."""
    parts = [o.status, o.verdict or o.reason]
    if o.diagnosis not in ("", "off"):
        parts.append(f"{o.diagnosis}{f' ({o.diagnosis_reason})' if o.diagnosis_reason else ''}")
    if o.with_set:
        parts.append(f"with what its set has: {o.with_set}{f' ({o.with_set_reason})' if o.with_set == FAILED else ''}")
    return f"{o.device.set_name}, {o.device.name}: {', '.join(parts)}"


@alone_in("folder")
def summarise_tables(folder: Path, claims: Sequence[Claim], *, seed: int, progress: bool = False) -> Summary:
    """Pool the published tables and write their page with the paper's claims; the rest as for `summarise_campaign`."""
    make_writable(folder)
    population = replace(fit_population(published_devices(), seed=seed, progress=progress), tested=PUBLISHED)
    write_population(population, folder)
    design = design_margins(folder, population=population, progress=progress)
    page = render_tables(folder, population, claims)
    answers = [f"- The paper: {c.claim}. Its tables: {c.verdict}. {c.sentence}" for c in claims]
    text = "\n".join([band_text(population), "", *answers, "", design.text, f"report: {page}"])
    record = {"population": to_json(population), "margins": design.record, "claims": [vars(c) for c in claims]}
    return Summary(record, text)


def band_text(population: PopulationResult) -> str:
    """Bands of a new device, one line per set and quantity."""
    table = new_device_table(population)
    lines = ["A NEW device of each set: 5 %, 50 %, 95 %"]
    enough = sets_suffice(len(population.sets))
    if not enough:
        table = table[table["set"] != ANY_SET]
    for row in table[table["quantity"].isin(SHOWN)].itertuples():
        unit = "" if row.unit == "1" else f" {row.unit}"
        numbers = f"{row.q05:10.4g} {row.q50:10.4g} {row.q95:10.4g}{unit}"
        devices = f"{row.n_devices} device{'' if row.n_devices == 1 else 's'}"
        lines.append(f"  {name_of(str(row.set)):34.34}{devices:12}{row.quantity:10}{numbers}")
    return "\n".join(lines if enough else [*lines, f"  {never_tested_words(len(population.sets))}"])
