"""Which test next: protocols are weighed, changed for the better, the leading ones simulated in full, and written."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
import pandas as pd

from shj_bayes._util.files import write_text
from shj_bayes._util.one_thread import one_blas_thread
from shj_bayes.errors import PlanError, ShjError
from shj_bayes.inference.store import versions
from shj_bayes.mismatch.classes import DOUBT, MATTERS
from shj_bayes.planning.information import (
    OUTCOMES,
    WHICH,
    Foreseen,
    ForeseenQuantity,
    Rehearsal,
    entropy_of,
    foresee,
    rehearse,
)
from shj_bayes.planning.protocol import LEEWAY, Candidates, Protocol, ProtocolBlock, Rig, changed
from shj_bayes.planning.rivals import Further, Known, mechanisms_of
from shj_bayes.results.codec import IF_KNOWN
from shj_bayes.results.diagnosis import ClassId
from shj_bayes.results.store import write

ROUNDS, PARENTS, CHILDREN = 1, 4, 4
FINAL = 6  # protocols that are foreseen again with fresh outcomes: the best of many is partly luck
SHOWN, REHEARSALS = 3, 8
LITTLE = 0.1  # of what is not known: a test that is expected to settle less is not worth its time


class Worth(StrEnum):
    """Whether a test is worth its time."""

    YES = "yes"
    DECIDED = "decided"
    LITTLE = "little"


@dataclass(frozen=True, eq=False)
class Row:
    """One protocol and what it is expected to give."""

    protocol: Protocol
    foreseen: tuple[Foreseen, ...]  # for each device
    # information, nats, mean over the devices: loss of entropy, or of the logarithm of the standard deviation
    gain: float
    misread: float  # largest error of the force for what readers get wrong of the motion, as a share of Fy
    broken: tuple[str, ...] = ()  # limits of the rig that it does not keep, in words
    rehearsal: Rehearsal | None = None  # what simulated tests ended in, first device

    @property
    def order(self) -> tuple[bool, float, float]:
        """By what protocols are ranked, larger is better: for ``which`` how far contenders are apart, else the gain.

        Entropy alone would praise a test that makes sure of a wrong set. Protocols whose motion is read with an error
        that matters come last: a diagnosis would take the error for an effect.
        """
        which = self.foreseen[0].sd is None
        first = float(np.mean([s.apart for s in self.foreseen])) if which else self.gain
        return self.misread <= MATTERS, first, self.gain

    @property
    def gain_per_minute(self) -> float:
        """Gain per minute on the rig, nats/min."""
        return self.gain / (self.protocol.duration_s / 60.0)


@dataclass(frozen=True, eq=False)
class Question:
    """What the next test is to settle."""

    word: str = WHICH  # which set of classes is there, or the name of the quantity that should become narrow
    quantities: tuple[ForeseenQuantity, ...] = ()  # that quantity for each device; empty for ``which``


ANY_SET = Question()


@dataclass(frozen=True, eq=False)
class Plan:
    """The answer to which test is next."""

    known: tuple[Known, ...]
    rig: Rig
    question: Question
    best: tuple[Row, ...]  # protocols that the rig allows, best first
    compared: tuple[Row, ...]  # Table 1 again, and the files that were given
    worth: Worth  # whether the best is worth its time
    seed: int

    @property
    def unsettled(self) -> float:
        """Mean entropy of the probabilities of the sets before the test, nats."""
        return float(np.mean([_entropy(k) for k in self.known]))


@one_blas_thread
def make_plan(
    known: Sequence[Known],
    candidates: Candidates,
    question: Question = ANY_SET,
    *,
    seed: int = 1,
    rehearsals: int = REHEARSALS,
    tell: Callable[[str], None] = lambda _: None,
) -> Plan:
    """Choose the next test for one device, or for several that it is planned for.

    The leading protocols are simulated in full so many times (`rehearsals`). `tell` gets one line for each step.
    """
    rig = candidates.rig
    asked: tuple[ForeseenQuantity | None, ...] = question.quantities or (None,) * len(known)

    def row(protocol: Protocol, seed: int, n: int = OUTCOMES) -> Row:
        seen = tuple(foresee(k, protocol, rig.rate_Hz, seed, q, n) for k, q in zip(known, asked, strict=True))
        gain = float(np.mean([_gain(k, s, q) for k, s, q in zip(known, seen, asked, strict=True)]))
        force = max(s.force_kN for s in seen)
        broken = rig.broken_by(protocol)
        if force > rig.max_force_kN:
            broken = (*broken, f"force up to {force:.4g} kN, allowed {rig.max_force_kN:.4g}")
        misread = max(s.misread_kN / k.sliding_kN for s, k in zip(seen, known, strict=True))
        return Row(protocol, seen, gain, misread, broken)

    compared = [candidates.first[0], *candidates.given]
    tell(f"weighing {len(candidates.all)} protocols")
    rows = [row(p, seed) for p in candidates.all]
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(2,)))
    for k in range(ROUNDS):
        parents = ranked(rows)[:PARENTS]
        children = [new for r in parents for _ in range(CHILDREN) if (new := changed(r.protocol, rig, rng)) is not None]
        tell(f"improving the best, {k + 1} of {ROUNDS}: {len(children)} further protocols")
        rows += [row(p, seed) for p in children]
    tell("weighing the best again, with fresh outcomes")
    different = list({r.protocol.blocks or r.protocol: r for r in reversed(ranked(rows))}.values())[::-1]
    finalists = [r.protocol for r in different[:FINAL] if r.protocol not in compared]
    again = [row(p, seed + 1, 3 * OUTCOMES) for p in (*finalists, *compared)]
    best = ranked(again)[:SHOWN]
    others = [r for r in again if r.protocol in compared]

    def rehearsed(r: Row) -> Row:
        tell(f"simulating '{r.protocol.name}' in full, {rehearsals} times")
        return replace(r, rehearsal=rehearse(known[0], r.protocol, rig.rate_Hz, rehearsals, seed, asked[0]))

    worth = _worth(known, best, question.word)
    if rehearsals and worth is Worth.YES:
        done = {id(r): rehearsed(r) for r in [*best, *(r for r in others if r not in best)]}
        best, others = [done[id(r)] for r in best], [done.get(id(r), r) for r in others]
    return Plan(tuple(known), rig, question, tuple(best), tuple(others), worth, seed)


def ranked(rows: Sequence[Row]) -> list[Row]:
    """Protocols that the rig allows, best first."""
    return sorted((r for r in rows if not r.broken), key=lambda r: r.order, reverse=True)


def _entropy(known: Known) -> float:
    return float(entropy_of(np.array(list(known.probabilities.values()))))


def _gain(known: Known, seen: Foreseen, quantity: ForeseenQuantity | None) -> float:
    if quantity is None:
        return _entropy(known) - seen.entropy
    assert seen.sd is not None
    return math.log(quantity.now(known)[1] / seen.sd)


def _worth(known: Sequence[Known], best: Sequence[Row], question: str) -> Worth:
    if question != WHICH:
        return Worth.YES if best and best[0].gain >= LITTLE else Worth.LITTLE
    if all(max(k.probabilities.values()) >= 1.0 - DOUBT for k in known):
        return Worth.DECIDED
    left = float(np.mean([_entropy(k) for k in known]))
    return Worth.YES if best and best[0].gain >= LITTLE * left else Worth.LITTLE


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
