"""The designer's sheet: margins of every set on two printed pages, each number with unit, clause and n."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from shj_bayes.margins.asked import published_factors
from shj_bayes.margins.sheet import Sheet
from shj_bayes.population.loops import LoopBand
from shj_bayes.population.posterior import ANY_SET
from shj_bayes.report import margins_numbers as numbers
from shj_bayes.report.page import write_page

MAX_PICTURES = 4
FEW_SETS = 6  # so many leave room on two sheets of A4 for wider tables
FAR_SPEED = 300.0
"""Speed of an earthquake's stroke (95 mm at a period of 1.5 to 2 s), mm/s."""
COVERAGE = {2: 0.896, 4: 0.892, 8: 0.896}
"""Simulated coverage of the 90 % band of a new device, by devices per set: decision 0004, typical truth, 500 campaigns;
`python benchmarks/population.py coverage -n 500` prints it again."""


def render_margins(
    folder: Path,
    sheet: Sheet,
    loops: Sequence[LoopBand] = (),
    *,
    name: str,
    importance: str,
    simulated: bool = False,
) -> Path:
    """Write ``margins.html``: the sheet that was drawn up for an importance class of the structure.

    `loops`, bands of the loop of a new device, are drawn where the sheet has room, that is for few sets.
    """
    content: dict[str, Any] = {
        "name": name,
        "simulated": simulated,
        "sets": numbers.set_table(sheet, importance),
        "spreads": numbers.spread_table(sheet),
        "quantities": numbers.BANDS,
        "tests": numbers.TESTED,
        "testing": [
            {"title": "first run", "rows": numbers.testing_table(sheet, "least")},
            {"title": "after a first earthquake (second run)", "rows": numbers.testing_table(sheet, "least_2")},
        ],
        "importance": importance,
        "left_out": max(0, len(numbers.tested_sets(sheet.spoken)) - numbers.MAX_SETS),
        "never": ANY_SET,
        "few": len(numbers.shown_sets(sheet)) <= FEW_SETS,
        "far": published_factors(FAR_SPEED),
        "coverage": ", ".join(f"{100 * c:.1f} % with {n}" for n, c in COVERAGE.items()),
        "sheet": sheet,
        "loops": _pictures(loops),
    }
    return write_page(folder, "margins.html", content)


def _pictures(loops: Sequence[LoopBand]) -> dict[str, str]:
    """Loop bands of the tested sets, as far as two pages have room for them."""
    by_set: dict[str, list[LoopBand]] = {}
    for band in loops:
        if band.set_name != ANY_SET:
            by_set.setdefault(band.set_name, []).append(band)
    if len(by_set) > MAX_PICTURES:
        return {}
    # Drawing needs matplotlib, whose import takes a second that commands without a page need not wait for.
    from shj_bayes.report.figures.population import loop  # noqa: PLC0415

    return {name: loop(bands) for name, bands in by_set.items()}
