"""From finished devices, or from the published tables, to population, margins, comparison and the page over them."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from shj_bayes._util.made import digests, made
from shj_bayes._util.shipped import shipped
from shj_bayes.commands.campaign import Outcome
from shj_bayes.commands.comparison import curve_records, curves_of_pairs
from shj_bayes.commands.margin_sheet import POPULATION, design_margins
from shj_bayes.commands.summary import WRITES
from shj_bayes.population.device import PUBLISHED, Claim, common, device_from_fit, published_devices, tested_by_fit
from shj_bayes.population.hierarchy import ANY_SET, PopulationResult, fit_population
from shj_bayes.population.predict import never_tested_words, new_device_table, sets_suffice
from shj_bayes.population.results import load_population, record_of, write_population
from shj_bayes.report.campaign import render_campaign, render_tables
from shj_bayes.report.sets import SHOWN, name_of
from shj_bayes.results.codec import to_json


def pooled_campaign(usable: Sequence[Outcome], folder: Path, *, seed: int, progress: bool = False) -> dict[str, Any]:
    """Pool devices, draw up margins, compare sets and write the page; without a device that can be used, the page.

    Arguments are those of `shj_bayes.commands.summary.summarise_campaign`. ``record`` is for machines, ``lines`` for
    people.
    """
    if not usable:
        for name in WRITES:  # of devices that are no longer there
            (folder / name).unlink(missing_ok=True)
        render_campaign(folder)
        return {"record": {}, "lines": []}

    def pool() -> None:
        places = [folder / o.device.folder for o in usable]
        devices = [
            device_from_fit(place, o.device.name, o.device.set_name, o.device.tags)
            for place, o in zip(places, usable, strict=True)
        ]
        ranges = [tested_by_fit(place) for place in places]
        tested = common([r for r in ranges if r]) if all(ranges) else None
        write_population(replace(fit_population(devices, seed=seed, progress=progress), tested=tested), folder)

    fits = [
        (o.device.name, o.device.set_name, asdict(o.device.tags), digests(folder / o.device.folder, ["fit.json"]))
        for o in usable
    ]
    made(folder, "population", [seed, fits], POPULATION, pool)
    population = load_population(folder)
    design = design_margins(folder, progress=progress)
    curves = curves_of_pairs(folder, population)
    render_campaign(folder, population, curves)
    record = {"population": to_json(record_of(population)), "margins": design.record, "curves": curve_records(curves)}
    return {"record": record, "lines": [band_text(population), "", design.text]}


def pooled_tables(claims: Sequence[Claim], folder: Path, *, seed: int, progress: bool = False) -> dict[str, Any]:
    """Pool the published tables and write their page with the paper's claims; as for `pooled_campaign`."""

    def pool() -> None:
        population = replace(fit_population(published_devices(), seed=seed, progress=progress), tested=PUBLISHED)
        write_population(population, folder)

    made(folder, "population", [seed, digests(shipped("data", "published"), ["*"])], POPULATION, pool)
    population = load_population(folder)
    design = design_margins(folder, progress=progress)
    render_tables(folder, population, claims)
    answers = [f"- The paper: {c.claim}. Its tables: {c.verdict}. {c.sentence}" for c in claims]
    record = {
        "population": to_json(record_of(population)),
        "margins": design.record,
        "claims": [vars(c) for c in claims],
    }
    return {"record": record, "lines": [band_text(population), "", *answers, "", design.text]}


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
