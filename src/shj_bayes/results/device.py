"""``posterior.nc`` and ``diagnosis.nc``: draws, channels and predictions of a device, and its model rebuilt."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from shj_bayes._util.arrays import BoolArray, FloatArray, IntArray
from shj_bayes.errors import ReportError
from shj_bayes.model.device import DeviceModel, effects_named
from shj_bayes.model.history import History, Measured, histories
from shj_bayes.model.noise import noise_model
from shj_bayes.model.priors import Prior, Priors
from shj_bayes.recording.motion import Motion, alternating
from shj_bayes.results.diagnosis import DiagnosisRecord
from shj_bayes.results.fit import FitRecord
from shj_bayes.results.store import netcdf_file, posterior_file, read

EXTRA = "extra_"  # before the names of further channels
FLOATS = ("time_s", "position_mm", "speed_mm_s", "slip_mm", "travel_m", "force_kN", "before_kN", "after_kN")
OLD = ("posterior_predictive", "observed_data")  # groups with every sample in files of shj-bayes/fit/1


class RunData(NamedTuple):
    """One run: what was measured and what the posterior predicts, at all samples or, of a long one, at some."""

    number: int  # 1 for the first run
    # channels, shape (n,); displacement and speed as the law used them
    time_s: FloatArray
    displacement_mm: FloatArray
    speed_mm_s: FloatArray
    force_kN: FloatArray
    used: BoolArray  # samples that are evidence
    half_cycle: IntArray  # index of the half-cycle of each sample
    # posterior draws of the force, shape (m, n), without noise and as it would be measured
    law_kN: FloatArray
    predicted_kN: FloatArray
    extras: Mapping[str, FloatArray] = {}  # further channels by name

    @property
    def reversals(self) -> IntArray:
        """First sample of every half-cycle but the first."""
        return np.asarray(np.flatnonzero(np.diff(self.half_cycle)) + 1, dtype=np.int64)

    @property
    def starts(self) -> IntArray:
        """First sample of every half-cycle."""
        return np.concatenate([[0], self.reversals]).astype(np.int64)

    @property
    def travel_m(self) -> float:
        """Distance moved in the run, from turning point to turning point, m."""
        turns = np.append(self.displacement_mm[self.starts], self.displacement_mm[-1])
        return float(np.abs(np.diff(turns)).sum()) / 1000.0

    @property
    def direction(self) -> IntArray:
        """+1 where displacement grows within the half-cycle of a sample (push), -1 where it falls; shape (n,)."""
        ends = np.concatenate([self.reversals, [self.time_s.size]]) - 1
        x = self.displacement_mm
        sign = np.where(x[ends] >= x[self.starts], 1, -1)
        return np.asarray(np.repeat(sign, ends - self.starts + 1), dtype=np.int64)


class DeviceData(NamedTuple):
    """One device: its record, its draws and its runs."""

    record: FitRecord
    draws: Mapping[str, FloatArray]  # of the posterior, natural units, shape (n_ensembles, n_draws)
    prior: Mapping[str, FloatArray]  # draws of the prior, shape (n,)
    runs: tuple[RunData, ...]  # in the order they were made


@dataclass(frozen=True, eq=False)
class DeviceResult:
    """What is stored of a fitted device, for whatever goes on from it; arrays are read when they are asked for.

    Attributes
    ----------
    folder : Path
        Folder of its fit.
    record : FitRecord
        Content of ``fit.json``.
    """

    folder: Path
    record: FitRecord

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read ``fit.json`` of a finished fit; `InferenceError` where it is missing or damaged."""
        return cls(folder, read(FitRecord, folder))

    @cached_property
    def laws(self) -> dict[str, Prior]:
        """Prior law of every parameter, by name."""
        return {law.name: Prior(**vars(law)) for law in self.record.prior_laws}

    @cached_property
    def model(self) -> DeviceModel:
        """The model that was fitted, with the priors that it was fitted with."""
        said = self.record.model
        laws = {name: law for name, law in self.laws.items() if "." not in name}
        laws.setdefault("ratio", Prior("ratio", "1", "lognormal", 0.8, 0.5, "As in the family afc, for one run."))
        return DeviceModel(
            len(self.record.inputs),
            Priors(said.priors, said.priors_statement, laws, str(said.priors_sha256)),
            effects=effects_named(said.effects),
            noise=noise_model(said.noise),
            free=said.free_between_runs,
            variant=said.variant,
            speed=said.speed,
        )

    @cached_property
    def draws(self) -> dict[str, FloatArray]:
        """Draws of the posterior by name, natural units, shape (n,) each."""
        return {name: values.ravel() for name, values in read_group(self.folder, "posterior").items()}

    @cached_property
    def samples(self) -> dict[str, FloatArray]:
        """Channels of all runs, one behind the other, as they were fitted: time_s, displacement_mm, run and others."""
        return read_group(self.folder, "constant_data")

    def by_run(self, values: FloatArray) -> tuple[FloatArray, ...]:
        """Values of all samples, shape (n,), run by run."""
        run = self.samples["run"]
        return tuple(np.asarray(values[run == number]) for number in np.unique(run))

    @cached_property
    def measured_kN(self) -> tuple[FloatArray, ...]:
        """Measured force of each run."""
        # Fits of the first schema hold the measured force with what was observed.
        held = self.samples if "force" in self.samples else read_group(self.folder, "observed_data")
        return tuple(np.asarray(force, dtype=np.float64) for force in self.by_run(held["force"]))

    @cached_property
    def histories(self) -> tuple[History, ...]:
        """What happened in each run."""
        names = ("displacement_mm", "speed_mm_s", "half_cycle_of_sample")
        motions = [_motion(*own) for own in zip(*(self.by_run(self.samples[name]) for name in names), strict=True)]
        times = [np.asarray(time, dtype=np.float64) for time in self.by_run(self.samples["time_s"])]
        further: list[dict[str, Measured]] = [{} for _ in times]
        for name, said in self.record.channels.items():
            for own, time, values in zip(further, times, self.by_run(self.samples[name]), strict=True):
                own[name] = Measured(said.unit, time - time[0], values, said.low, said.high, said.reference)
        return histories(times, motions, further)

    @cached_property
    def likelihood_of_half_cycles(self) -> dict[tuple[int, int], FloatArray]:
        """Log likelihood of half-cycles under every draw, shape (n,), by run and number, as far as the fit holds it."""
        stored = read_group(self.folder, "log_likelihood")
        if not {"force_of_half_cycle", "run", "number"} <= set(stored):
            return {}
        places = zip(stored["run"].tolist(), stored["number"].tolist(), strict=True)
        values = stored["force_of_half_cycle"].reshape(self.draws["Fy"].size, -1)
        return {(int(run), int(number)): values[:, i] for i, (run, number) in enumerate(places)}


def _motion(x: FloatArray, speed: FloatArray, half: FloatArray) -> Motion:
    """Motion of a run from its stored channels; turning points are the outermost samples beside each reversal."""
    start = np.append(np.flatnonzero(np.diff(half, prepend=-1)), x.size)
    direction = alternating(start.size - 1, int(np.sign(x[start[1] - 1] - x[0]) or 1))
    beside = np.stack([x[start[1:-1] - 1], x[start[1:-1]]])
    turning = np.where(direction[1:] < 0, beside.max(axis=0), beside.min(axis=0))
    return Motion(x, speed, start, np.concatenate([x[:1], turning]), direction)


def read_group(folder: Path, group: str) -> dict[str, FloatArray]:
    """Read the arrays of one group of ``posterior.nc``, by variable in the shape in which they are stored.

    A campaign's summary asks three times for a little of every device; all groups with their coordinates through
    xarray took a third of a second each time. `InferenceError` where the file is missing or damaged.
    """
    with posterior_file(folder, group) as file:
        return {name: np.asarray(part) for name, part in file[group].items() if hasattr(part, "dtype")}


def read_device(folder: Path) -> DeviceData:
    """Read ``fit.json`` and ``posterior.nc`` of a finished fit.

    `InferenceError` if a file is missing or damaged, or the posterior lacks what a page needs.
    """
    record = read(FitRecord, folder)
    names = [row.name for row in record.parameters]
    # Of a dozen groups four are drawn; all of them through xarray took as long as drawing a fifth of the page.
    with posterior_file(folder) as file:
        loops, measured = (file[name] for name in (("loops", "constant_data") if "loops" in file else OLD))
        force = _values(measured["force"])
        held = {name: _values(part) for name, part in file["constant_data"].items() if part.shape == force.shape}
        law, predicted = (_values(loops[name]).reshape(-1, force.size) for name in ("force_model", "force"))
        draws = {name: _values(file["posterior"][name]) for name in names}
        prior = {name: _values(file["prior"][name]).ravel() for name in names}
    further = [name for name in held if name.startswith(EXTRA)]
    runs = []
    for number in np.unique(held["run"]):
        mine = held["run"] == number
        time, x, speed = (held[name][mine] for name in ("time_s", "displacement_mm", "speed_mm_s"))
        used, half = held["used"][mine].astype(np.bool_), held["half_cycle_of_sample"][mine]
        extras = {name.removeprefix(EXTRA): held[name][mine] for name in further}
        drawn = law[:, mine], predicted[:, mine]
        runs.append(RunData(int(number), time, x, speed, force[mine], used, half, *drawn, extras))
    return DeviceData(record, draws, prior, tuple(runs))


def _values(part: Any) -> NDArray[Any]:
    """Array of a netCDF variable, unpacked where it is stored in whole numbers (netCDF attribute ``scale_factor``)."""
    scale = part.attrs.get("scale_factor")
    return np.asarray(part) if scale is None else np.asarray(part, dtype=np.float32) * np.float32(np.squeeze(scale))


class DiagnosisData(NamedTuple):
    """What a diagnosis left in its folder: its record, and samples of all runs, one after the other, shape (n,)."""

    record: DiagnosisRecord
    time_s: FloatArray
    position_mm: FloatArray  # from mid-stroke
    speed_mm_s: FloatArray
    slip_mm: FloatArray  # since the last reversal
    travel_m: FloatArray  # in all
    direction: IntArray  # +1 while displacement grows (push), -1 while it falls
    run: IntArray  # number of the run
    used: BoolArray  # samples that are evidence
    force_kN: FloatArray  # measured
    before_kN: FloatArray  # by the base law
    after_kN: FloatArray  # by the law with what was found

    @property
    def capacity_kN(self) -> float:
        """Sliding force of the base law, kN; from the measured force where the record does not say."""
        stated = self.record.fy_kN or 0.0
        return stated if stated > 0 else float(np.quantile(np.abs(self.force_kN), 0.9)) or 1.0

    @property
    def changed(self) -> bool:
        """True when something was added to the base law."""
        return not np.array_equal(self.before_kN, self.after_kN)

    @property
    def residuals(self) -> tuple[FloatArray, FloatArray]:
        """Measured less modelled force, before and after, kN."""
        return self.force_kN - self.before_kN, self.force_kN - self.after_kN


def read_diagnosis(folder: Path) -> DiagnosisData:
    """Read ``diagnosis.json`` and ``diagnosis.nc``; `ReportError` where one is missing, damaged or another."""
    record = read(DiagnosisRecord, folder)
    try:
        with netcdf_file(folder / "diagnosis.nc") as file:
            data = {name: np.asarray(file[name], dtype=np.float64) for name in (*FLOATS, "direction", "run", "weight")}
        found = DiagnosisData(
            record,
            **{name: data[name] for name in FLOATS},
            direction=np.sign(data["direction"]).astype(np.int64),
            run=data["run"].astype(np.int64),
            used=data["weight"] > 0,
        )
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise ReportError(f"diagnosis.nc in {folder.name} cannot be read: {error}; run the diagnosis again") from error
    if not found.used.any():
        raise ReportError(f"diagnosis.nc in {folder.name} holds no sample that is evidence")
    return found
