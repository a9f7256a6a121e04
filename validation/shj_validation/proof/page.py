"""The page of a proof: what was aimed at, what was found, what falls short."""

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2

from shj_bayes._util.files import write_text
from shj_bayes.report.page import environment_of, head
from shj_validation.proof import pictures
from shj_validation.proof.simulators.simulator import simulators_by_id

PAGE, TABLE = "proof.html", "trials.csv"
COLUMNS = (
    "number",
    "kind",
    "truth",
    "sizes",
    "protocol",
    "rate_Hz",
    "machine_share",
    "first_sd",
    "reversal",
    "noise",
    "noise_share",
    "visible_share",
    "evidence",
    "detectable",
    "coordinate_right",
    "verdict",
    "p_value",
    "found",
    "family",
    "outcome",
    "seconds",
)


def render(folder: Path, score: Mapping[str, Any]) -> Path:
    """Write ``proof.html`` and ``trials.csv``.

    Parameters
    ----------
    folder : Path
        Folder of the proof.
    score : mapping
        Content of ``score.json``.

    Returns
    -------
    Path
        The page, one file that needs nothing else.
    """
    write_text(folder / TABLE, _table(score["trials"]))
    text = (
        environment()
        .get_template("proof.html")
        .render(
            **head(),
            score=score,
            simulators=simulators_by_id(),
            pictures=[
                pictures.power(score["power"]),
                pictures.confusion(score["confusion"]["by_family"], "family"),
                pictures.heldout(score["trials"]),
                pictures.before_after(score["trials"]),
                pictures.confusion(score["confusion"]["by_effect"], "effect"),
                pictures.reliability(score["reliability"]),
            ],
            wrong=[row for row in score["trials"] if row["outcome"] in ("wrong", "sibling", "false alarm", "failed")],
        )
    )
    write_text(folder / PAGE, text)
    return folder / PAGE


def environment() -> jinja2.Environment:
    """Templates of the proof, on those of the reports, with escaping."""
    made = environment_of("shj_validation.proof", "shj_bayes.report")
    made.filters |= {"rate": _rate, "percent": _percent, "times": _times}
    return made


def _table(rows: Sequence[Mapping[str, Any]]) -> str:
    """All trials as CSV; lists are joined by a plus sign."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in rows:
        cells = [row.get(name, "") for name in COLUMNS]
        writer.writerow(["+".join(map(str, cell)) if isinstance(cell, list) else cell for cell in cells])
    return stream.getvalue()


def _rate(entry: Mapping[str, Any]) -> str:
    if not entry["n"]:
        return "none"
    return (
        f"{entry['hits']} of {entry['n']} ({100 * entry['share']:.1f} %, "
        f"95 % interval {100 * entry['low']:.1f} to {100 * entry['high']:.1f} %)"
    )


def _percent(value: float | None) -> str:
    return "not determined" if value is None else f"{100 * value:.2g} %"


def _times(value: float | None) -> str:
    return "none" if value is None else f"{value:.2f}"
