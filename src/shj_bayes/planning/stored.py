"""A diagnosed or fitted device as its folder holds it: the runs, the base model, and what it may be."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from shj_bayes._util.files import damage_told
from shj_bayes.errors import PlanError
from shj_bayes.inference.run import Run
from shj_bayes.margins.specimen import read_specimen
from shj_bayes.mismatch.look import Look
from shj_bayes.model.device import effects_named
from shj_bayes.model.measured import coordinate_of
from shj_bayes.planning.known import Key, Subject
from shj_bayes.recording.recording import Extra, Recording, Source
from shj_bayes.results.device import model_of, read_group
from shj_bayes.results.diagnosis import DiagnosisRecord
from shj_bayes.results.fit import FitRecord
from shj_bayes.results.store import has, read

ODDS_IN_FILES = 1e-6  # probabilities below it are left out


@dataclass(frozen=True, eq=False)
class Stored:
    """A tested device, and the sliding force that its fit found."""

    tested: Subject
    Fy: tuple[float, float]  # sliding force, kN, and the standard deviation of its logarithm


def read_device(folder: Path, diagnosis: DiagnosisRecord | None) -> Stored:
    """Read a device from the files of its fit and of its diagnosis; a fit without one is taken for what it is.

    `PlanError` if there is no fit, or the diagnosis states no probabilities.
    """
    if diagnosis is not None and not has(FitRecord, folder):
        raise PlanError(
            f"{folder.name} holds a first look, which keeps no recordings; run shj-bayes diagnose without --quick"
        )
    with damage_told(f"fit.json or posterior.nc in {folder.name}", PlanError):
        record = read(FitRecord, folder)
        specimen = read_specimen(folder, record.device, "")
        data, draws = read_group(folder, "constant_data"), read_group(folder, "posterior")
        runs = []
        for i, history in enumerate(specimen.histories):
            entry, own = record.inputs[i], data["run"] == i + 1
            motion = replace(history.motion, noise_mm=entry.displacement_noise_mm)
            source = Source(entry.name, str(entry.sha256), entry.format)
            named = {coordinate_of(name): name for name in entry.extras}
            recording = Recording(
                data["time_s"][own],
                motion.displacement_mm,
                specimen.measured_kN[i],
                data["used"][own] > 0,
                source,
                extras=tuple(Extra(named.get(k, k), one.unit, data[k][own]) for k, one in history.measured.items()),
            )
            runs.append(Run(recording, motion))
        logs = np.log(draws["Fy"].ravel())
    model = model_of(record)
    said = diagnosis.model if diagnosis else None
    effects = model.effects if diagnosis is None else effects_named(said.given if said else ())
    without = said.without if said else ()
    speed = model.speed and "velocity" not in without
    device = replace(model, effects=effects, speed=speed)
    sets: tuple[tuple[Key, float], ...] = ((frozenset(), 1.0),)
    if diagnosis is not None:
        sets = tuple((frozenset(row.classes), row.probability) for row in diagnosis.sets)
        sets = tuple(pair for pair in sets if pair[1] > ODDS_IN_FILES)
        if not sets:
            raise PlanError(f"diagnosis.json in {folder.name} states no probabilities; run shj-bayes diagnose again")
    spread = (float(np.exp(logs.mean())), float(logs.std(ddof=1)))
    tested = Subject(record.device, tuple(runs), device, sets, Look(without).hidden(device))
    return Stored(tested, spread)
