"""From finished devices, or from the published tables, to population, comparison and the page over them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from shj_bayes.alone import alone_in
from shj_bayes.campaign import Manifest, Outcome, campaign_record
from shj_bayes.design import design_margins
from shj_bayes.files import make_writable, need_population
from shj_bayes.population.compare import Comparison, compare
from shj_bayes.population.fits import device_from_fit, tested_by_fit
from shj_bayes.population.hierarchy import fit_population
from shj_bayes.population.paper_claims import paper_claims
from shj_bayes.population.posterior import ANY_SET, PopulationResult
from shj_bayes.population.predict import RUN_FORCES, never_tested_words, new_device_table, sets_suffice
from shj_bayes.population.published import published_devices
from shj_bayes.population.results import load_population, to_json, write_population
from shj_bayes.population.selectors import members, strata_of
from shj_bayes.population.tested import PUBLISHED, common
from shj_bayes.report.campaign import render_campaign, render_tables
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
    lines = [f"{o.device.set_name}, {o.device.name}: {o.status}, {o.verdict or o.reason}" for o in outcomes]
    record = campaign_record(manifest, outcomes)
    lines += record["warnings"]
    population = None
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
        record["population"], record["margins"] = to_json(population), design.record
        lines += ["", band_text(population), "", design.text]
    page = render_campaign(folder, population)
    return Summary(record, "\n".join([*lines, f"report: {page}"]), bool(usable))


@alone_in("folder")
def summarise_tables(folder: Path, *, seed: int, progress: bool = False) -> Summary:
    """Pool the published tables and write their page; arguments as for `summarise_campaign`."""
    make_writable(folder)
    population = replace(fit_population(published_devices(), seed=seed, progress=progress), tested=PUBLISHED)
    claims = paper_claims()
    write_population(population, folder)
    design = design_margins(folder, population=population, progress=progress)
    page = render_tables(folder, population, claims)
    answers = [f"- The paper: {c.claim}. Its tables: {c.verdict}. {c.sentence}" for c in claims]
    text = "\n".join([band_text(population), "", *answers, "", design.text, f"report: {page}"])
    record = {"population": to_json(population), "margins": design.record, "claims": [vars(c) for c in claims]}
    return Summary(record, text)


def compare_sets(folder: Path, set_a: str, set_b: str, rope_percent: float = 10.0) -> tuple[dict[str, Any], str]:
    """Compare two sets, or two kinds of sets, of a folder that `campaign` or `tables` wrote.

    Parameters
    ----------
    folder : Path
        The folder.
    set_a, set_b : str
        Names of sets, or kinds: coated, uncoated, corroded, uncorroded, "70 %".
    rope_percent : float
        Half-width of the region of practical equivalence, per cent.

    Returns
    -------
    dict, str
        For machines, for people.
    """
    need_population(folder)
    result = load_population(folder)
    first, second = members(result, strata_of(result, set_a, set_b)[2])
    comparison = compare(result, set_a, set_b, rope=rope_percent / 100.0)
    table = comparison.to_table()
    who = [
        f"{side}: {name}" + ("" if sets == (name,) else f" ({', '.join(sets)})")
        for side, name, sets in (("a", comparison.set_a, first), ("b", comparison.set_b, second))
    ]
    lines = [*who, *comparison_lines(comparison), "", *(f"- {c.sentence}" for c in comparison.contrasts)]
    rows = table.astype(object).where(table.notna(), None).to_dict(orient="records")
    record = {
        "schema": "shj-bayes/comparison/1",
        "set_a": comparison.set_a,
        "set_b": comparison.set_b,
        "members": {"a": list(first), "b": list(second)},
        "strata": comparison.strata,
        "multiplicity": comparison.multiplicity,
        "contrasts": rows,
    }
    return record, "\n".join([*lines, "", comparison.multiplicity])


def comparison_lines(comparison: Comparison) -> list[str]:
    """Comparison as a table of text, one line per quantity."""
    words = ("a / b or a - b", "90 %", "P(a > b)", "P(same)", "new a > new b", "Welch", "permuted (least)", "Holm")
    rows = [["", *words, "spread a/b"]]
    for c in comparison.contrasts:
        tests = c.tests
        exact = f"{_p(tests.permutation_p)} ({_p(tests.permutation_least)})"
        rows.append(
            [
                c.quantity + ("" if c.unit == "1" else f" {c.unit}"),
                f"{c.q50:.3g}",
                f"{c.q05:.3g} to {c.q95:.3g}",
                *(f"{x:.2f}" for x in (c.probability_level, c.probability_rope, c.superiority)),
                _p(tests.welch_p),
                exact if tests.permutation_p is not None else "-",
                f"{_p(c.holm_p)} {c.holm_test}".strip(),
                f"{c.spread_factor[1]:.2f}",
            ]
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  "
        + "   ".join(
            f"{cell:>{width}}" if i else f"{cell:{width}}"
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    ]


def _p(value: float | None) -> str:
    """Write a p-value; a dash where the test cannot be made."""
    if value is None:
        return "-"
    return f"{value:.3f}" if value >= 0.001 else f"{value:.0e}"


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
