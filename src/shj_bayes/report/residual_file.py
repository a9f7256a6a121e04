"""``residual.json``: what a device page found left over, so that a campaign page can say it without reading draws."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

from shj_bayes.errors import ReportError
from shj_bayes.files import read_json, write_text
from shj_bayes.report import words
from shj_bayes.report.residuals import Structure

FILE, SCHEMA = "residual.json", "shj-bayes/residual/1"


def write_residual(folder: Path, structure: Structure) -> None:
    """Write what was found."""
    record = {
        "schema": SCHEMA,
        "structured": structure.structured,
        "statement": words.residual_headline(structure),
        **asdict(structure),
    }
    write_text(folder / FILE, json.dumps(record, indent=1))


def read_residual(folder: Path) -> tuple[bool, str] | None:
    """Whether the residual of a device is structured, and the sentence; None where nothing was written."""
    try:
        record = read_json(folder / FILE, ReportError)
        return bool(record["structured"]), str(record["statement"])
    except (ReportError, KeyError, TypeError):
        return None
