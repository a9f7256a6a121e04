"""The files of a plan: ``plan.json`` and the displacement histories as CSV."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from shj_bayes._util.files import read_json, write_text
from shj_bayes.errors import PlanError
from shj_bayes.inference.store import versions
from shj_bayes.planning.devices import Further
from shj_bayes.planning.known import Known, mechanisms_of
from shj_bayes.planning.plan import Plan, Row
from shj_bayes.planning.protocol import Protocol
from shj_bayes.planning.rig import LEEWAY, Rig
from shj_bayes.results.diagnosis import ClassId

SCHEMA = "shj-bayes/plan/1"
PLAN = "plan.json"
DIGITS = 4  # of times and displacements in the file


def plan_record(plan: Plan) -> dict[str, Any]:
    """Content of ``plan.json``."""
    known = plan.known[0]
    now: dict[str, Any] = {"entropy_nats": plan.unsettled, "largest_probability": max(known.probabilities.values())}
    if plan.question.quantities:
        mean, sd = plan.question.quantities[0].now(known)
        now |= {"mean": mean, "sd": sd, "unit": plan.question.quantities[0].unit}
    return _head(plan.question.word, plan.rig, plan.seed) | {
        "devices": [_device(k) for k in plan.known],
        "now": now,
        "worth": plan.worth.value,
        "candidates": [_row(r, f"next-{i}.csv") for i, r in enumerate(plan.best, start=1)],
        "compared": [_row(r, None) for r in plan.compared],
        "further_devices": None,
    }


def force_record(further: Further, names: tuple[str, ...], seed: int) -> dict[str, Any]:
    """Content of ``plan.json`` where further devices are asked for, not a protocol."""
    return _head("force", None, seed) | {
        "devices": [{"name": name, "n_runs": None, "sets": []} for name in names],
        "now": {"force_kN": further.force_kN, "half_width": further.half_width_now},
        "worth": "yes" if further.n_further else "decided" if further.n_further == 0 else "little",
        "candidates": [],
        "compared": [],
        "further_devices": asdict(further)
        | {"table": [{"n_further": n, "half_width_expected": a, "half_width_assured": b} for n, a, b in further.table]},
    }


def write_plan(folder: Path, record: Mapping[str, Any], plan: Plan | None) -> None:
    """Write the histories, then ``plan.json``, into a folder that exists."""
    for old in folder.glob("next-?.csv"):
        old.unlink()
    if plan is not None:
        for i, row in enumerate(plan.best, start=1):
            write_text(folder / f"next-{i}.csv", history_csv(row.protocol, plan.rig, plan.known[0].middle_mm))
    write_text(folder / PLAN, json.dumps(record, indent=1, allow_nan=False))


def read_plan(folder: Path) -> dict[str, Any]:
    """Read ``plan.json`` of a folder; `PlanError` where it is damaged or of another kind."""
    record = read_json(folder / PLAN, PlanError)
    if not isinstance(record, dict) or record.get("schema") != SCHEMA:
        raise PlanError(f"{PLAN} in {folder.name} is not of schema {SCHEMA}; run shj-bayes plan again")
    return record


def history_csv(protocol: Protocol, rig: Rig, middle_mm: float = 0.0) -> str:
    """Displacement history at the rig's rate; `PlanError` where a sample leaves the limits of the rig."""
    time, motion = protocol.sampled(rig.rate_Hz)
    x = np.round(motion.displacement_mm, DIGITS)
    fastest = float(np.abs(np.diff(x)).max() * rig.rate_Hz)
    if np.abs(x).max() > LEEWAY * rig.max_stroke_mm or fastest > LEEWAY * rig.max_speed_mm_s + 1e-3:
        raise PlanError(
            f"{protocol.name}: its samples reach {np.abs(x).max():.4g} mm and {fastest:.4g} mm/s; the rig allows "
            f"{rig.max_stroke_mm:.4g} mm and {rig.max_speed_mm_s:.4g} mm/s"
        )
    table = pd.DataFrame({"time_s": np.round(time, 6), "displacement_mm": np.round(x + middle_mm, DIGITS)})
    return str(table.to_csv(index=False, lineterminator="\n"))


def _head(question: str, rig: Rig | None, seed: int) -> dict[str, Any]:
    limits = None if rig is None else asdict(rig)
    return {"schema": SCHEMA, "question": question, "rig": limits, "seed": seed, "versions": versions()}


def _device(known: Known) -> dict[str, Any]:
    """Describe a device and what it may be, most probable first."""
    p = known.probabilities
    rows = [
        {"classes": sorted(key), "mechanisms": list(mechanisms_of(key)), "probability": p[key]} for key in known.keys
    ]
    measured = known.old[-1].history.measured if known.old else {}
    held = [
        {"coordinate": name, "unit": one.unit, "value": one.reference}
        for name, one in measured.items()
        if any(str(ClassId("capacity", name)) in key for key in known.keys)
    ]
    return {"name": known.name, "n_runs": len(known.runs), "sets": rows, "channels": held}


def _row(row: Row, file: str | None) -> dict[str, Any]:
    """One protocol with what it is expected to give; of several devices the mean."""
    sds = [s.sd for s in row.foreseen if s.sd is not None]
    checked = None if row.rehearsal is None else asdict(row.rehearsal)
    return row.protocol.to_dict() | {
        "file": file,
        "gain_nats": row.gain,
        "gain_per_minute": row.gain_per_minute,
        "apart_nats": float(np.mean([s.apart for s in row.foreseen])),
        "probability_of_truth": float(np.mean([s.of_truth for s in row.foreseen])),
        "chance_right": float(np.mean([s.right for s in row.foreseen])),
        "sd": float(np.sqrt(np.mean(np.square(sds)))) if sds else None,
        "misread": row.misread,
        "force_kN": max(s.force_kN for s in row.foreseen),
        "limits_broken": list(row.broken),
        "simulated": checked,
    }
