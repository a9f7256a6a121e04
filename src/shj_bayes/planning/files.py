"""The files of a plan: ``plan.json`` and the displacement histories as CSV."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
import pandas as pd

from shj_bayes._util.files import write_text
from shj_bayes.errors import PlanError, ShjError
from shj_bayes.inference.store import versions
from shj_bayes.planning.known import Further, Known, mechanisms_of
from shj_bayes.planning.plan import Plan, Row, Worth
from shj_bayes.planning.protocol import LEEWAY, Protocol, ProtocolBlock, Rig
from shj_bayes.planning.rehearsal import Rehearsal
from shj_bayes.results.codec import IF_KNOWN
from shj_bayes.results.diagnosis import ClassId
from shj_bayes.results.store import write

SCHEMA: Literal["shj-bayes/plan/1"] = "shj-bayes/plan/1"
DIGITS = 4  # of times and displacements in the file


@dataclass(frozen=True, kw_only=True)
class PossibleSet:
    """Classes that a device may have together."""

    classes: tuple[str, ...]
    mechanisms: tuple[str, ...]
    probability: float


@dataclass(frozen=True, kw_only=True)
class HeldChannel:
    """A further channel that is taken to stay as it was."""

    coordinate: str
    unit: str
    value: float


@dataclass(frozen=True, kw_only=True)
class PlannedDevice:
    """A device and what it may be, most probable first."""

    name: str
    n_runs: int | None
    sets: tuple[PossibleSet, ...]
    channels: tuple[HeldChannel, ...] | None = field(default=None, metadata=IF_KNOWN)


@dataclass(frozen=True, kw_only=True)
class Now:
    """What is known before the test: of the sets and the quantity, or of the force."""

    entropy_nats: float | None = field(default=None, metadata=IF_KNOWN)
    largest_probability: float | None = field(default=None, metadata=IF_KNOWN)
    mean: float | None = field(default=None, metadata=IF_KNOWN)
    sd: float | None = field(default=None, metadata=IF_KNOWN)
    unit: str | None = field(default=None, metadata=IF_KNOWN)
    force_kN: float | None = field(default=None, metadata=IF_KNOWN)
    half_width: float | None = field(default=None, metadata=IF_KNOWN)


@dataclass(frozen=True, kw_only=True)
class RankedProtocol:
    """A protocol with what it is expected to give; of several devices the mean."""

    name: str
    blocks: tuple[ProtocolBlock, ...]
    minutes: float
    largest_mm: float
    fastest_mm_s: float
    travel_m: float
    file: Annotated[str | None, {"description": "displacement history beside this file: time_s, displacement_mm"}]
    gain_nats: Annotated[
        float, {"description": "expected loss of entropy, or of the logarithm of the standard deviation"}
    ]
    gain_per_minute: float
    apart_nats: Annotated[
        float, {"description": "least log evidence of a true rival over another; protocols are ranked by it for which"}
    ]
    probability_of_truth: float
    chance_right: float
    sd: float | None
    misread: Annotated[float, {"description": "error of the force for what is lost between samples, share of Fy"}]
    force_kN: Annotated[float, {"description": "largest, two standard deviations above what is predicted"}]
    limits_broken: tuple[str, ...]
    simulated: Rehearsal | None


@dataclass(frozen=True, kw_only=True)
class PlanRecord:
    """Content of ``plan.json``."""

    FILE: ClassVar[str] = "plan.json"
    ERROR: ClassVar[type[ShjError]] = PlanError
    MISSING: ClassVar[str] = "holds no plan.json; run shj-bayes plan first"
    AGAIN: ClassVar[str] = "run shj-bayes plan again"

    schema: Literal["shj-bayes/plan/1"] = SCHEMA
    question: Annotated[str, {"description": "which, force, or a quantity"}]
    rig: Rig | None
    seed: int
    versions: Mapping[str, str]
    devices: tuple[PlannedDevice, ...]
    now: Now
    worth: Worth
    candidates: Annotated[tuple[RankedProtocol, ...], {"description": "within the limits, best first"}]
    compared: Annotated[tuple[RankedProtocol, ...], {"description": "Table 1, and the files given"}]
    further_devices: Further | None = None


def plan_record(plan: Plan) -> PlanRecord:
    """Say which protocols are best, and what is known now."""
    known = plan.known[0]
    now = Now(entropy_nats=plan.unsettled, largest_probability=max(known.probabilities.values()))
    if plan.question.quantities:
        mean, sd = plan.question.quantities[0].now(known)
        now = replace(now, mean=mean, sd=sd, unit=plan.question.quantities[0].unit)
    return PlanRecord(
        question=plan.question.word,
        rig=plan.rig,
        seed=plan.seed,
        versions=versions(),
        devices=tuple(map(_device, plan.known)),
        now=now,
        worth=plan.worth,
        candidates=tuple(_row(r, f"next-{i}.csv") for i, r in enumerate(plan.best, start=1)),
        compared=tuple(_row(r, None) for r in plan.compared),
    )


def force_record(further: Further, names: tuple[str, ...], seed: int) -> PlanRecord:
    """Say how many further devices are needed, where they are asked for, not a protocol."""
    return PlanRecord(
        question="force",
        rig=None,
        seed=seed,
        versions=versions(),
        devices=tuple(PlannedDevice(name=name, n_runs=None, sets=()) for name in names),
        now=Now(force_kN=further.force_kN, half_width=further.half_width_now),
        worth=Worth.YES if further.n_further else Worth.DECIDED if further.n_further == 0 else Worth.LITTLE,
        candidates=(),
        compared=(),
        further_devices=further,
    )


def write_plan(folder: Path, record: PlanRecord, plan: Plan | None) -> None:
    """Write the histories, then ``plan.json``, into a folder that exists."""
    for old in folder.glob("next-?.csv"):
        old.unlink()
    if plan is not None:
        for i, row in enumerate(plan.best, start=1):
            write_text(folder / f"next-{i}.csv", history_csv(row.protocol, plan.rig, plan.known[0].middle_mm))
    write(record, folder)


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


def _device(known: Known) -> PlannedDevice:
    p = known.probabilities
    measured = known.old[-1].history.measured if known.old else {}
    held = tuple(
        HeldChannel(coordinate=name, unit=one.unit, value=one.reference)
        for name, one in measured.items()
        if any(str(ClassId("capacity", name)) in key for key in known.keys)
    )
    sets = tuple(
        PossibleSet(classes=tuple(sorted(key)), mechanisms=tuple(mechanisms_of(key)), probability=p[key])
        for key in known.keys
    )
    return PlannedDevice(name=known.name, n_runs=len(known.runs), sets=sets, channels=held)


def _row(row: Row, file: str | None) -> RankedProtocol:
    sds, protocol = [s.sd for s in row.foreseen if s.sd is not None], row.protocol
    return RankedProtocol(
        name=protocol.name,
        blocks=protocol.blocks,
        minutes=protocol.duration_s / 60.0,
        largest_mm=protocol.largest_mm,
        fastest_mm_s=protocol.fastest_mm_s,
        travel_m=protocol.travel_m,
        file=file,
        gain_nats=row.gain,
        gain_per_minute=row.gain_per_minute,
        apart_nats=float(np.mean([s.apart for s in row.foreseen])),
        probability_of_truth=float(np.mean([s.of_truth for s in row.foreseen])),
        chance_right=float(np.mean([s.right for s in row.foreseen])),
        sd=float(np.sqrt(np.mean(np.square(sds)))) if sds else None,
        misread=row.misread,
        force_kN=max(s.force_kN for s in row.foreseen),
        limits_broken=tuple(row.broken),
        simulated=row.rehearsal,
    )
