"""``residual.json``: what a device page found left over, so that a campaign page can say it without reading draws."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from shj_bayes._util.files import read_json, write_text
from shj_bayes.errors import ReportError
from shj_bayes.report import words
from shj_bayes.report.force_unit import KN, ForceUnit

if TYPE_CHECKING:
    from shj_bayes.report.residuals import Structure

FILE, SCHEMA = "residual.json", "shj-bayes/residual/1"


@dataclass(frozen=True)
class LeftOver:
    """What a residual file says.

    Parameters
    ----------
    structured : bool
        Whether more than noise is left over.
    statement, fit, cell : str
        What is left over; how much of the force is unexplained, empty in a file of version 0.1; the statement as far as
        a cell of a table has room for it.
    """

    structured: bool
    statement: str
    fit: str
    cell: str


def write_residual(folder: Path, structure: Structure, unit: ForceUnit = KN) -> None:
    """Write what was found, its sentence with forces in the unit that the page shows."""
    record = {
        "schema": SCHEMA,
        "structured": structure.structured,
        "statement": words.residual_headline(structure, unit.name, unit.factor),
        "cell": words.in_a_cell(structure, unit.name, unit.factor),
        "grade": structure.grade,
        "fit": words.fit_words(structure),
        **asdict(structure),
    }
    write_text(folder / FILE, json.dumps(record, indent=1))


def read_residual(folder: Path) -> LeftOver | None:
    """Read what was found in a device; None where nothing was written."""
    try:
        record = read_json(folder / FILE, ReportError)
        said = str(record["statement"])
        return LeftOver(bool(record["structured"]), said, str(record.get("fit", "")), str(record.get("cell", said)))
    except (ReportError, KeyError, TypeError):
        return None
