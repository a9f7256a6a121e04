"""The page of a diagnosis: what did the model leave out."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from shj_bayes.errors import ReportError
from shj_bayes.report import diagnosis_words as say
from shj_bayes.report.diagnosis_data import DiagnosisData, number, read_diagnosis
from shj_bayes.report.page import LOOPS, write_page
from shj_bayes.report.page import PAGE as PAGE_OF_FIT
from shj_bayes.report.viewer import diagnosis_viewer, thinning_words

PAGE = "diagnosis.html"


def render_diagnosis(folder: Path) -> Path:
    """Write ``diagnosis.html`` of a finished diagnosis, one file that needs nothing else; `ReportError` without one."""
    # Drawing needs matplotlib, whose import takes a second that commands without a page need not wait for.
    from shj_bayes.report.diagnosis_pictures import draw  # noqa: PLC0415

    data = read_diagnosis(folder)
    try:
        pictures = draw(data)
        viewer = diagnosis_viewer(data)
        filled = content(data) | {"pictures": pictures, "viewer": viewer, "thinning": thinning_words(viewer)}
        filled["fit"] = PAGE_OF_FIT if (folder / PAGE_OF_FIT).exists() else ""
    except (AttributeError, IndexError, KeyError, TypeError, ValueError) as error:
        raise ReportError(
            f"diagnosis.json in {folder.name} cannot be shown, {type(error).__name__}: {error}; run diagnose again"
        ) from error
    # Beside the old page, then in its place: a reader never sees half a page.
    with TemporaryDirectory(dir=folder, prefix=".page-") as part:
        os.replace(write_page(Path(part), "diagnosis.html", filled, LOOPS), folder / PAGE)
    return folder / PAGE


def content(data: DiagnosisData) -> dict[str, Any]:
    """Everything on the page but the pictures, as plain values."""
    record = data.record
    sign, colour, headline = say.verdict_words(record)
    return {
        "name": str(record.get("device") or "Device"),
        "simulated": bool(record.get("simulated")),
        "verdict": record["verdict"],
        "sign": sign,
        "colour": colour,
        "headline": headline,
        "lines": say.sentences(record),
        "size": say.size_words(data),
        "changed": data.channels.changed,
        "quick": bool(record.get("quick")),
        "cards": say.cards(data),
        "coordinates": say.coordinates(data),
        "limits": say.limits_words(data),
        "effects": say.effects(data),
        "family": say.family(data),
        "unknown": say.unknown(data),
        "shift": say.shift(data),
        "locations": say.locations(data),
        "aliases": say.aliases(data),
        "candidates": say.candidates(data),
        "quality": say.quality(data),
        "heldout": say.heldout_words(data),
        "next_test": record.get("next_test") or "",
        "reason": record.get("reason") or "",
        "p": say.p_words(record["p_value"]),
        "capacity": f"{data.capacity_kN:.4g}",
        "inputs": record.get("inputs") or [],
        "seed": record.get("seed"),
        "seconds": f"{number(record.get('seconds')):.0f}" if record.get("seconds") is not None else "",
        "model": record.get("model") or {},
        "sampling": record.get("sampling") or {},
        "versions": record.get("versions") or {},
        "schema": record["schema"],
    }
