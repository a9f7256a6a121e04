"""Which test next: protocols are weighed, the best of them again with fresh outcomes, and written."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
import pandas as pd

from shj_bayes._util.arrays import one_blas_thread
from shj_bayes._util.files import write_text
from shj_bayes.errors import PlanError
from shj_bayes.inference.store import versions
from shj_bayes.mismatch.hypothesis import ALPHA, MIN_EFFECT
from shj_bayes.planning.information import OUTCOMES, WHICH, LinearQuantity, expected_information
from shj_bayes.planning.protocol import LEEWAY, Protocol, ProtocolBlock, Rig
from shj_bayes.planning.rivals import Further, PretestPosterior, mechanisms_of
from shj_bayes.results.codec import IF_KNOWN, Stored
from shj_bayes.results.diagnosis import DependenceId
from shj_bayes.results.store import write

SCHEMA: Literal["shj-bayes/plan/1"] = "shj-bayes/plan/1"
DIGITS = 4  # of times and displacements in the file
FINAL = 6  # protocols that are weighed again with fresh outcomes: the best of many is partly luck
SHOWN = 3
LITTLE = 0.1  # of what is not known: a test that is expected to settle less is not worth its time


class WorthOfTest(StrEnum):
    """Whether a test is worth its time."""

    YES = "yes"
    DECIDED = "decided"
    LITTLE = "little"


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
    blocks: Annotated[tuple[ProtocolBlock, ...], {"description": "the pattern"}]
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
    times: Annotated[int, {"minimum": 1, "description": "how often the blocks come, one after the other"}] = 1

    @property
    def order(self) -> tuple[bool, float, float]:
        """By what protocols are ranked, larger is better: for ``which`` how far contenders are apart, else the gain.

        Entropy alone would praise a test that makes sure of a wrong set. Protocols whose motion is read with an error
        that matters come last: a diagnosis would take the error for an effect.
        """
        return self.misread <= MIN_EFFECT, self.apart_nats if self.sd is None else self.gain_nats, self.gain_nats


@dataclass(frozen=True, kw_only=True)
class PlanRecord(Stored, file="plan.json", command="shj-bayes plan", error=PlanError):
    """Content of ``plan.json``."""

    schema: Literal["shj-bayes/plan/1"] = SCHEMA
    question: Annotated[str, {"description": "which, force, or a quantity"}]
    rig: Rig | None
    seed: int
    versions: Mapping[str, str]
    devices: tuple[PlannedDevice, ...]
    now: Now
    worth: WorthOfTest
    candidates: Annotated[tuple[RankedProtocol, ...], {"description": "within the limits, best first"}]
    compared: Annotated[tuple[RankedProtocol, ...], {"description": "Table 1, and the files given"}]
    further_devices: Further | None = None


class Plan(NamedTuple):
    """The answer to which test is next: what is written of it, and what its histories and pictures are made from."""

    record: PlanRecord
    known: tuple[PretestPosterior, ...]
    rig: Rig
    best: tuple[Protocol, ...]  # those of ``record.candidates``


@one_blas_thread
def make_plan(
    known: Sequence[PretestPosterior],
    rig: Rig,
    proposed: Sequence[Protocol],
    given: Sequence[Protocol] = (),
    *,
    question: str = WHICH,
    quantities: Sequence[LinearQuantity] = (),
    seed: int = 1,
    tell: Callable[[str], None] = lambda _: None,
) -> Plan:
    """Choose the next test for one device, or for several that it is planned for.

    Of the proposed protocols the first (Table 1) is shown beside the best whatever it gives, as those `given` are. The
    `question` is which set of classes is there, or the name of the quantity that should become narrow (`quantities`,
    one a device). `tell` gets one line for each step.
    """

    def ranked(
        protocols: Sequence[Protocol], seed: int, n: int
    ) -> tuple[dict[Protocol, RankedProtocol], list[Protocol]]:
        """Weigh protocols; those that the rig allows, best first."""
        rows = {p: _weighed(known, quantities, rig, p, seed, n) for p in protocols}
        allowed = [p for p in protocols if not rows[p].limits_broken]
        return rows, sorted(allowed, key=lambda p: rows[p].order, reverse=True)

    everything, compared = [*proposed, *given], [proposed[0], *given]
    tell(f"weighing {len(everything)} protocols")
    finalists = [p for p in ranked(everything, seed, OUTCOMES)[1][:FINAL] if p not in compared]
    tell("weighing the best again, with fresh outcomes")
    found, best = ranked([*finalists, *compared], seed + 1, 3 * OUTCOMES)
    shown = tuple(replace(found[p], file=f"next-{i}.csv") for i, p in enumerate(best[:SHOWN], start=1))
    left, decided = 1.0, False
    if question == WHICH:
        left = float(np.mean([k.entropy for k in known]))
        decided = all(max(k.probabilities.values()) >= 1.0 - ALPHA for k in known)
    worth = WorthOfTest.YES if shown and shown[0].gain_nats >= LITTLE * left else WorthOfTest.LITTLE
    mean, sd = quantities[0].now(known[0]) if quantities else (None, None)
    now = Now(
        entropy_nats=float(np.mean([k.entropy for k in known])),
        largest_probability=max(known[0].probabilities.values()),
        mean=mean,
        sd=sd,
        unit=quantities[0].unit if quantities else None,
    )
    record = PlanRecord(
        question=question,
        rig=rig,
        seed=seed,
        versions=versions(),
        devices=tuple(map(_device, known)),
        now=now,
        worth=WorthOfTest.DECIDED if decided else worth,
        candidates=shown,
        compared=tuple(found[p] for p in compared),
    )
    return Plan(record, tuple(known), rig, tuple(best[:SHOWN]))


def _weighed(
    known: Sequence[PretestPosterior],
    quantities: Sequence[LinearQuantity],
    rig: Rig,
    protocol: Protocol,
    seed: int,
    n: int,
) -> RankedProtocol:
    """Say what a protocol is expected to give, from `n` outcomes of each rival of each device."""
    asked: Sequence[LinearQuantity | None] = quantities or (None,) * len(known)
    told = [expected_information(k, protocol, rig.rate_Hz, seed, q, n) for k, q in zip(known, asked, strict=True)]
    gains = [
        k.entropy - one.entropy if q is None or one.sd is None else math.log(q.now(k)[1] / one.sd)
        for k, one, q in zip(known, told, asked, strict=True)
    ]
    gain, minutes = float(np.mean(gains)), protocol.duration_s / 60.0
    force, broken = max(one.force_kN for one in told), rig.broken_by(protocol)
    if force > rig.max_force_kN:
        broken = (*broken, f"force up to {force:.4g} kN, allowed {rig.max_force_kN:.4g}")
    sds = [one.sd for one in told if one.sd is not None]
    as_it_is = ("name", "blocks", "times", "largest_mm", "fastest_mm_s", "travel_m")
    return RankedProtocol(
        **{name: getattr(protocol, name) for name in as_it_is},
        minutes=minutes,
        file=None,
        gain_nats=gain,
        gain_per_minute=gain / minutes,
        apart_nats=float(np.mean([one.separation for one in told])),
        probability_of_truth=float(np.mean([one.of_truth for one in told])),
        chance_right=float(np.mean([one.right for one in told])),
        sd=float(np.sqrt(np.mean(np.square(sds)))) if sds else None,
        misread=max(one.misread_kN / k.sliding_kN for one, k in zip(told, known, strict=True)),
        force_kN=force,
        limits_broken=broken,
    )


def _device(known: PretestPosterior) -> PlannedDevice:
    """Say what a device may be, and which of its further channels are taken to stay as they were."""
    measured = known.old[-1].history.measured if known.old else {}
    acting = frozenset[str]().union(*known.keys)
    held = tuple(
        HeldChannel(coordinate=name, unit=one.unit, value=one.reference)
        for name, one in measured.items()
        if str(DependenceId("capacity", name)) in acting
    )
    sets = tuple(
        PossibleSet(classes=tuple(sorted(key)), mechanisms=mechanisms_of(key), probability=p)
        for key, p in known.probabilities.items()
    )
    return PlannedDevice(name=known.name, n_runs=len(known.runs), sets=sets, channels=held)


def force_record(further: Further, names: tuple[str, ...], seed: int) -> PlanRecord:
    """Say how many further devices are needed, where they are asked for, not a protocol."""
    worth = {None: WorthOfTest.LITTLE, 0: WorthOfTest.DECIDED}
    return PlanRecord(
        question="force",
        rig=None,
        seed=seed,
        versions=versions(),
        devices=tuple(PlannedDevice(name=name, n_runs=None, sets=()) for name in names),
        now=Now(force_kN=further.force_kN, half_width=further.half_width_now),
        worth=worth.get(further.n_further, WorthOfTest.YES),
        candidates=(),
        compared=(),
        further_devices=further,
    )


def write_plan(folder: Path, record: PlanRecord, plan: Plan | None) -> None:
    """Write the histories, then ``plan.json``, into a folder that exists."""
    for old in folder.glob("next-?.csv"):
        old.unlink()
    for i, protocol in enumerate(plan.best if plan else (), start=1):
        assert plan is not None
        write_text(folder / f"next-{i}.csv", history_csv(protocol, plan.rig, plan.known[0].middle_mm))
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
