"""Which test next: from folders of results, or from priors alone, to a protocol with its files and its page."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from shj_bayes._util.files import alone_in
from shj_bayes.app.resume import CommandResult
from shj_bayes.errors import PlanError
from shj_bayes.margins.history import from_file
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.options import PlanOptions
from shj_bayes.planning.information import FORCE, WHICH, quantity_named
from shj_bayes.planning.plan import force_record, make_plan, write_plan
from shj_bayes.planning.protocol import LIMITS, Protocol, Rig, proposals, read_rig, table_1_protocol
from shj_bayes.planning.rivals import (
    DeviceUnderTest,
    before_any_test,
    class_of,
    common_scales,
    further_devices,
    linearise,
    read_device,
)
from shj_bayes.report.plan_page import plan_text, render_plan
from shj_bayes.results.diagnosis import DiagnosisRecord
from shj_bayes.results.fit import FitRecord
from shj_bayes.results.store import DIAGNOSIS, diagnosis_in, has, read

HEADROOM = 1.3  # of the largest force so far, that a rig is taken to bear where nothing is said
FIRST_RATE_HZ = 20.0  # where no test has been made and nothing is said
DEFAULT_QUESTION = "gamma"  # of a device about which nothing is undecided


@alone_in("out")
def plan_next(
    folders: Sequence[Path],
    out: Path,
    asked: PlanOptions,
    *,
    rig: Path | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> CommandResult:
    """Plan the next test and write ``plan.json``, ``next-1.csv`` to ``next-3.csv`` and ``plan.html``.

    The devices are those of the `folders` that `shj_bayes.api.plan` takes; `rig` is a file of limits. `tell` gets one
    line for each step. `PlanError` if a folder, a limit or a question cannot be used.
    """
    limits = {} if rig is None else read_rig(rig)
    limits |= {name: value for name in LIMITS if (value := getattr(asked, name)) is not None}
    tested = [_read(folder) for folder in folders]
    plan = None
    if asked.question == FORCE:
        further = further_devices([one.Fy[0] for one in tested], [one.Fy[1] for one in tested])
        record = force_record(further, tuple(one.name for one in tested), asked.seed)
    else:
        if asked.among and not tested:
            raise PlanError("--among needs the folder of a device; from priors alone all mechanisms are compared")
        base = DeviceModel(1, read_priors(asked.priors))
        limited = _rig(tested, base, limits)
        proposed, given = proposals(limited), tuple(_protocol(Path(path), tell) for path in asked.histories)
        protocols = (*proposed, *given)
        if asked.among:
            rivals = tuple((class_of(word), 1.0 / len(asked.among)) for word in asked.among)
            tested = [replace(one, sets=rivals, untold=True) for one in tested]
        known = [linearise(one, common_scales(one.runs, limited, protocols), tell) for one in tested]
        known = known or [before_any_test(base, common_scales((), limited, protocols))]
        word = asked.question or (WHICH if any(len(k.keys) > 1 for k in known) else DEFAULT_QUESTION)
        quantities = () if word == WHICH else tuple(quantity_named(k, word) for k in known)
        plan = make_plan(
            known, limited, proposed, given, question=word, quantities=quantities, seed=asked.seed, tell=tell
        )
        record = plan.record
    write_plan(out, record, plan)
    return CommandResult(record, f"{plan_text(record)}\n\nplan: {render_plan(out, record, plan)}")


def _read(folder: Path) -> DeviceUnderTest:
    if not folder.is_dir():
        raise PlanError(f"{folder} is not a folder of results; run shj-bayes diagnose first, or plan from --priors")
    # A campaign puts the diagnosis of a device, by default a first look, below the fit of the same recordings.
    below = folder.name == DIAGNOSIS and not has(FitRecord, folder) and has(FitRecord, folder.parent)
    place = folder.parent if below else folder
    looked = place / diagnosis_in(place)
    diagnosis = read(DiagnosisRecord, looked) if has(DiagnosisRecord, looked) else None
    if diagnosis and looked != place and diagnosis.sha256_of_inputs != read(FitRecord, place).sha256_of_inputs:
        raise PlanError(f"{looked} is of other recordings than the fit in {place.name}; run shj-bayes diagnose again")
    return read_device(place, diagnosis)


def _rig(tested: Sequence[DeviceUnderTest], base: DeviceModel, limits: Mapping[str, float]) -> Rig:
    """Limits as they are given, else what every test so far reached; from priors alone, what Table 1 needs."""
    table, runs = table_1_protocol(), [run for one in tested for run in one.runs]
    if runs:
        motions = [[run.motion for run in one.runs] for one in tested]
        stroke_mm = min(max(float(np.ptp(m.turning_mm)) for m in own) / 2.0 for own in motions)
        speed_mm_s = min(max(float(np.percentile(m.speed_mm_s, 99)) for m in own) for own in motions)
        force_kN = max(float(np.abs(r.recording.force_kN).max()) for r in runs)
        seconds, rate_Hz = max(r.recording.duration_s for r in runs), min(r.recording.rate_Hz for r in runs)
    else:
        stroke_mm, speed_mm_s, seconds, rate_Hz = table.largest_mm, table.fastest_mm_s, table.duration_s, FIRST_RATE_HZ
        force_kN = float(base.priors.of("Fy").quantile(0.95))
    reached = (stroke_mm, speed_mm_s, HEADROOM * force_kN, seconds / 60.0, rate_Hz)
    return Rig(**{name: float(f"{value:.4g}") for name, value in zip(LIMITS, reached, strict=True)} | dict(limits))


def _protocol(path: Path, tell: Callable[[str], None]) -> Protocol:
    asked = from_file(path)
    for line in asked.found:
        tell(line)
    return Protocol(path.stem, samples=(asked.time_s, asked.motion))
