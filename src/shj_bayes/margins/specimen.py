"""A tested device as the margins need it: its draws, its runs, and what its diagnosis found."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes._util.files import damage_told
from shj_bayes.errors import InferenceError, PopulationError, ReportError, shown
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.history import History, histories
from shj_bayes.model.law import BETA_RANGE
from shj_bayes.model.priors import read_priors
from shj_bayes.population.hierarchy import PopulationResult
from shj_bayes.population.quantities import QUANTITIES
from shj_bayes.recording.motion import exact_motion, table_1
from shj_bayes.results.device import DeviceResult
from shj_bayes.results.diagnosis import NOTHING_MISSING, DiagnosisRecord, DiagnosisVerdict
from shj_bayes.results.fit import FitRecord
from shj_bayes.results.store import diagnosis_in, has, read

Key = tuple[str, str]


@dataclass(frozen=True)
class Diagnosed:
    """What a diagnosis says of a device."""

    verdict: DiagnosisVerdict  # what it found
    found: tuple[str, ...]  # what was left out, in words; for a family its members
    fit: Path | None = None  # folder of the fit that it ended in; None for a first look, which has none


def find_diagnosis(folder: Path) -> tuple[Diagnosed | None, str]:
    """Look for the diagnosis of a device in the folder of its fit.

    None where there is none, or one that does not belong to this fit; and why one that is there was not used.
    """
    place = folder / diagnosis_in(folder)
    if not has(DiagnosisRecord, place):
        return None, ""
    try:
        record, fitted = read(DiagnosisRecord, place), read(FitRecord, folder)
    except (InferenceError, ReportError) as error:
        return None, f"its diagnosis cannot be read ({error}); run shj-bayes diagnose again"
    if record.sha256_of_inputs != fitted.sha256_of_inputs:
        return None, "its diagnosis is of other recordings; run shj-bayes diagnose on those of the fit"
    found = [e.title or e.id for e in record.effects]
    if record.verdict is DiagnosisVerdict.FAMILY:
        nothing = [NOTHING_MISSING] if any(not one.classes for one in record.sets) else []
        found = [*(e.id for e in record.family), *nothing]
    return Diagnosed(record.verdict, tuple(found), place if has(FitRecord, place) and not record.quick else None), ""


def words_of(found: Mapping[Key, Diagnosed], n_devices: int, notes: Iterable[str] = ()) -> tuple[str, ...]:
    """Say what the diagnoses found, by (set, device), of how many devices, and what could not be used (`notes`)."""
    out = []
    for (set_name, name), diagnosis in found.items():
        what = ", ".join(diagnosis.found) or "something without a name"
        first_look = " (first look without a posterior: bounds rest on the law alone and on what was measured)"
        said = {
            DiagnosisVerdict.NAMED: what,
            DiagnosisVerdict.FAMILY: f"one of {what}, not told apart",
            DiagnosisVerdict.UNKNOWN: f"left out and not explained by the catalogue; best model found: {what}",
        }
        if diagnosis.verdict is not DiagnosisVerdict.ADEQUATE:
            out.append(f"{set_name}, {name}: {said[diagnosis.verdict]}{'' if diagnosis.fit else first_look}")
    others = "; the others rest on the law as published" if len(found) < n_devices else ""
    how_many = f"{len(found)} of {n_devices} devices have a diagnosis{others}."
    if not found:
        how_many = (
            "No device has a diagnosis: the margins rest on the law as published (shj-bayes diagnose looks beyond it)."
        )
    return (*out, how_many, *notes)


N_DRAWS = 64
"""Draws of each device that are driven: its own uncertainty is known to a tenth from them."""
TABLE_RATE_HZ = 10.0


@dataclass(frozen=True, eq=False)
class Belief:
    """A model of a device, and draws of its parameters."""

    model: DeviceModel  # with its effects
    theta: FloatArray  # shape (m, d): draws in natural units
    # shape (m,): log likelihood of each half-cycle under each draw, as far as the fit holds it: what the draws would be
    # without that half-cycle follows from it
    likely: Mapping[tuple[int, int], FloatArray] = field(default_factory=dict, repr=False)

    @property
    def typical(self) -> FloatArray:
        """Median of each parameter, shape (1, d)."""
        return np.median(self.theta, axis=0, keepdims=True)


@dataclass(frozen=True, eq=False)
class Specimen:
    """A tested device."""

    name: str
    set_name: str
    beliefs: tuple[Belief, ...]  # the best model first, the law alone last
    histories: tuple[History, ...]  # its test, run by run
    start_force_kN: tuple[float, ...]  # force with which each run began
    # measured force of each run; empty for a device known by printed parameters
    measured_kN: tuple[FloatArray, ...] = ()

    @cached_property
    def ranges(self) -> dict[str, float]:
        """Largest value of every coordinate in its test: position (mm), speed (mm/s), travel (m), time (s)."""
        last = self.histories[-1]
        ends = (last.half_stroke_mm, last.peak_speed_mm_s, float(last.travel_m[-1]), last.tested_s)
        return dict(zip(("position", "speed", "travel", "time"), ends, strict=True))


def drive(
    model: DeviceModel, theta: FloatArray, histories: Sequence[History], start_force_kN: Sequence[float] = ()
) -> tuple[FloatArray, ...]:
    """Force of every draw of a device, shape (m, d), in consecutive runs, each of shape (m, n_samples), kN.

    Each run starts with the force given, or unloaded.
    """
    starts = start_force_kN or (0.0,) * len(histories)
    forces = tuple(model.force(theta, history, start) for history, start in zip(histories, starts, strict=True))
    if not all(np.isfinite(force).all() for force in forces):
        raise PopulationError("the model of a device gives no finite force for this history; check its posterior")
    return forces


def read_specimen(folder: Path, name: str, set_name: str, found: Path | None = None) -> Specimen:
    """Read a tested device from the folder of its fit, and of the fit that its diagnosis ended in (`found`), if any."""
    with damage_told(f"fit.json or posterior.nc in {folder.name}", PopulationError):
        fit = DeviceResult.read(folder)
        if name != fit.record.device:
            raise PopulationError(
                f"{folder.name} holds the fit of {shown(fit.record.device)}, not of {shown(name)}; put the folders "
                "of the devices back, or run shj-bayes campaign again"
            )
        fits = (fit,) if found is None else (DeviceResult.read(found), fit)
        starts = tuple(entry.start_force_kN for entry in fit.record.inputs)
        return Specimen(name, set_name, tuple(map(_belief, fits)), fit.histories, starts, fit.measured_kN)


def _belief(fit: DeviceResult) -> Belief:
    total = fit.draws["Fy"].size
    chosen = np.linspace(0, total - 1, min(N_DRAWS, total)).astype(np.int64)
    # Noise parameters do not move the force; a fit of an earlier version may name them otherwise.
    columns = [fit.draws[name][chosen] if name in fit.draws else np.zeros(chosen.size) for name in fit.model.names]
    likely = {place: values[chosen] for place, values in fit.likelihood_of_half_cycles.items()}
    return Belief(fit.model, np.stack(columns, axis=1).astype(np.float64), likely)


def specimens_of_table(result: PopulationResult) -> tuple[Specimen, ...]:
    """Devices known by printed parameters, driven through the regime of Table 1.

    Their values have the error of their rounding; those that lack K, Fy, beta or gamma are left out.
    """
    variant = result.tested.variant if result.tested else "published"
    time, motion = exact_motion(table_1(), TABLE_RATE_HZ)
    tested = {n: histories([time] * n, [motion] * n) for n in (1, 2)}
    models = {n: DeviceModel(n, read_priors(), variant=variant) for n in tested}
    out = []
    for group in result.sets:
        for i, device in enumerate(group.devices):
            rng, theta = np.random.default_rng([result.seed, i]), dict[str, FloatArray]()
            for q in ("K", "Fy", "beta", "gamma", "ratio"):
                points = group.points.get(q, ())
                if i < len(points) and np.isfinite(points[i]):
                    error = np.nan_to_num(group.errors.get(q, (0.0,) * len(points))[i])
                    drawn = QUANTITIES[q].natural(points[i] + error * rng.standard_normal(N_DRAWS))
                    theta[q] = np.clip(drawn, *BETA_RANGE) if q == "beta" else drawn
            if {"K", "Fy", "beta", "gamma"} <= set(theta):
                n_runs = 2 if "ratio" in theta else 1
                columns = [theta.get(name, np.zeros(N_DRAWS)) for name in models[n_runs].names]
                belief = Belief(models[n_runs], np.stack(columns, axis=1))
                out.append(Specimen(device, group.name, (belief,), tested[n_runs], (0.0,) * n_runs))
    return tuple(out)


def largest_ranges(specimens: Sequence[Specimen]) -> dict[str, float]:
    """Range of every coordinate that all devices went through."""
    return {name: min(s.ranges[name] for s in specimens) for name in specimens[0].ranges}
