"""From finished devices, or from the published tables, to population, comparison and the page over them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shj_bayes.campaign import Manifest, Outcome, campaign_record
from shj_bayes.errors import PopulationError
from shj_bayes.population.compare import compare
from shj_bayes.population.fits import device_from_fit
from shj_bayes.population.hierarchy import fit_population
from shj_bayes.population.paper_claims import paper_claims
from shj_bayes.population.posterior import PopulationResult
from shj_bayes.population.predict import new_device_table
from shj_bayes.population.published import published_devices
from shj_bayes.population.results import load_population, to_json, write_population
from shj_bayes.report.campaign import render_campaign, render_tables

SHOWN = ("Fy", "Fy_second", "ratio", "K", "gamma")


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
    lines = [f"{o.device.set_name}, {o.device.name}: {o.status}, {o.verdict or o.reason}" for o in outcomes]
    record = campaign_record(manifest, outcomes)
    population = None
    if usable:
        devices = [device_from_fit(folder / o.device.folder, o.device.name, o.device.set_name) for o in usable]
        population = fit_population(devices, seed=seed, progress=progress)
        write_population(population, folder)
        record["population"] = to_json(population)
        lines += ["", band_text(population)]
    page = render_campaign(folder, population)
    return Summary(record, "\n".join([*lines, "", f"report: {page}"]), bool(usable))


def summarise_tables(folder: Path, *, seed: int, progress: bool = False) -> Summary:
    """Pool the published tables and write their page; arguments as for `summarise_campaign`."""
    population = fit_population(published_devices(), seed=seed, progress=progress)
    claims = paper_claims()
    write_population(population, folder)
    page = render_tables(folder, population, claims)
    text = "\n".join([band_text(population), "", *(f"- {claim.sentence}" for claim in claims), "", f"report: {page}"])
    return Summary({"population": to_json(population), "claims": [vars(claim) for claim in claims]}, text)


def compare_sets(folder: Path, set_a: str, set_b: str) -> tuple[dict[str, Any], str]:
    """Compare two sets of a folder that `campaign` or `tables` wrote.

    Returns
    -------
    dict, str
        For machines, for people.
    """
    if not folder.is_dir():
        raise PopulationError(f"{folder} is not a folder; run `shj-bayes tables` or `shj-bayes campaign` first")
    comparison = compare(load_population(folder), set_a, set_b)
    table = comparison.to_table()
    text = "\n".join(f"- {sentence}" for sentence in table["sentence"])
    rows = table.astype(object).where(table.notna(), None).to_dict(orient="records")
    return {"schema": "shj-bayes/comparison/1", "set_a": set_a, "set_b": set_b, "contrasts": rows}, text


def band_text(population: PopulationResult) -> str:
    """Bands of a new device, one line per set and quantity."""
    table = new_device_table(population)
    lines = ["A NEW device of each set: 5 %, 50 %, 95 %"]
    for row in table[table["quantity"].isin(SHOWN)].itertuples():
        unit = "" if row.unit == "1" else f" {row.unit}"
        numbers = f"{row.q05:10.4g} {row.q50:10.4g} {row.q95:10.4g}{unit}"
        devices = f"{row.n_devices} device{'' if row.n_devices == 1 else 's'}"
        lines.append(f"  {row.set:34.34}{devices:12}{row.quantity:10}{numbers}")
    return "\n".join(lines)
