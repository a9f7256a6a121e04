"""``residual.json``: how much of the force the model leaves unexplained, so that lists of devices need no draws.

A size, not a test. Whether the cycles scatter more than the model allows is judged by the fit, and whether physics is
missing by the diagnosis; what they found is repeated here, so that no page says anything else.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from shj_bayes._util.files import read_json, write_text
from shj_bayes.errors import ReportError
from shj_bayes.mismatch.schema import Verdict

if TYPE_CHECKING:
    from shj_bayes.report.data import DeviceData

DIAGNOSIS = "diagnosis"  # in the folder of a device of a campaign: that of its diagnosis
FILE, SCHEMA = "residual.json", "shj-bayes/residual/2"
FEWEST_CYCLES = 3  # what comes again twice may be shape; what is there once or twice may be chance
FAIR_PERCENT = 2.0  # of Fy: a load cell's own drift stays below
POOR_PERCENT = 5.0  # of Fy: more than nominally identical devices differ by
DIAGNOSED = tuple(Verdict)


@dataclass(frozen=True)
class LeftOver:
    """What the model leaves over."""

    # root mean square of the residual beyond the scatter from one sample to the next, per cent of the sliding force
    unexplained_percent: float
    n_cycles: int  # full cycles of all runs
    # largest factor by which the fit widened an interval since the cycles scatter more than the model and its noise
    # allow; 1 where they do not
    widening: float = 1.0
    diagnosed: str = ""  # verdict of the diagnosis of the same recordings; empty where there is none

    @property
    def grade(self) -> str:
        """Of the model: ``good``, ``fair``, ``poor``, or ``undecided`` where there are too few cycles to say."""
        if self.n_cycles < FEWEST_CYCLES:
            return "undecided"
        if self.unexplained_percent > POOR_PERCENT:
            return "poor"
        return "fair" if self.widening > 1.0 or self.unexplained_percent > FAIR_PERCENT else "good"


def left_over(device: DeviceData, folder: Path | None = None) -> LeftOver:
    """Measure what the model leaves over; a diagnosis of the same recordings in `folder` is taken note of."""
    from shj_bayes.report.binned import residual  # noqa: PLC0415  (whoever only reads the file needs no arrays)
    from shj_bayes.report.numbers import cycle_marks  # noqa: PLC0415

    parts = [residual(run)[run.used] for run in device.runs]
    rms = float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))
    # Median-based, so that the jumps at reversals do not count as scatter.
    short = 1.4826 * float(np.median(np.abs(np.concatenate([np.diff(part) for part in parts])))) / np.sqrt(2)
    capacity = max(abs(float(np.median(device.draws["Fy"]))), 1e-12)
    widening = device.record.get("cycles", {}).get("widening", {})
    return LeftOver(
        100.0 * float(np.sqrt(max(rms**2 - short**2, 0.0))) / capacity,
        sum(max(0, cycle_marks(run).size - 1) for run in device.runs),
        max(map(float, widening.values()), default=1.0),
        _diagnosed(device, folder) if folder else "",
    )


def _diagnosed(device: DeviceData, folder: Path) -> str:
    """Verdict of ``diagnosis.json``; empty where it is missing, unreadable, or of other recordings."""
    try:
        record = read_json(folder / diagnosis_in(folder) / "diagnosis.json", ReportError)
        same = [i["sha256"] for i in record["inputs"]] == [i["sha256"] for i in device.record["inputs"]]
        return str(record["verdict"]) if same and record["verdict"] in DIAGNOSED else ""
    except (ReportError, KeyError, TypeError):
        return ""


def diagnosis_in(folder: Path) -> str:
    """Where the diagnosis of a device lies, below the folder of its fit: beside a fit that it ended in, or alone."""
    return "." if (folder / "diagnosis.json").is_file() else DIAGNOSIS


def write_residual(folder: Path, left: LeftOver) -> None:
    """Write what is left over."""
    write_text(folder / FILE, json.dumps({"schema": SCHEMA, **asdict(left), "grade": left.grade}, indent=1))


def read_residual(folder: Path) -> LeftOver | None:
    """Read what a device's model leaves over; None where nothing was written that can be read."""
    try:
        record = read_json(folder / FILE, ReportError)
        said = str(record.get("diagnosed", ""))
        return LeftOver(
            float(record["unexplained_percent"]),
            int(record["n_cycles"]),
            float(record.get("widening", 1.0)),
            said if said in DIAGNOSED else "",
        )
    except (ReportError, KeyError, TypeError, ValueError, AttributeError):
        return None
