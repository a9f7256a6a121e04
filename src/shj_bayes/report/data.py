"""The files of a fit as plain values for the page."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from shj_bayes.inference.record import EXTRA, read_record, whole
from shj_bayes.model.parameters import FloatArray

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
OLD = ("posterior_predictive", "observed_data")


@dataclass(frozen=True, eq=False)
class RunData:
    """One run: what was measured and what the posterior predicts, at all samples or, of a long one, at some."""

    number: int  # 1 for the first run
    # time_s to force_kN: shape (n,): channels; displacement and speed as the law used them
    time_s: FloatArray = field(repr=False)
    displacement_mm: FloatArray = field(repr=False)
    speed_mm_s: FloatArray = field(repr=False)
    force_kN: FloatArray = field(repr=False)
    used: BoolArray = field(repr=False)  # shape (n,): samples that are evidence
    half_cycle: IntArray = field(repr=False)  # shape (n,): index of the half-cycle of each sample
    # law_kN, predicted_kN: shape (m, n): posterior draws of the force without noise, and as it would be measured
    law_kN: FloatArray = field(repr=False)
    predicted_kN: FloatArray = field(repr=False)
    extras: Mapping[str, FloatArray] = field(default_factory=dict, repr=False)  # shape (n,): further channels by name

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


@dataclass(frozen=True, eq=False)
class DeviceData:
    """One device: its record, its draws and its runs."""

    record: Mapping[str, Any]  # content of ``fit.json``
    # shape (n_ensembles, n_draws): posterior in natural units, in the order of the record
    draws: Mapping[str, FloatArray] = field(repr=False)
    prior: Mapping[str, FloatArray] = field(repr=False)  # shape (n,): prior draws
    runs: tuple[RunData, ...] = field(repr=False)  # in the order they were made

    @property
    def name(self) -> str:
        """Name of the device, as given."""
        return str(self.record["device"])

    def parameter(self, name: str) -> dict[str, Any]:
        """Row of the parameter table."""
        return next(dict(row) for row in self.record["parameters"] if row["name"] == name)


def read_device(folder: Path) -> DeviceData:
    """Read ``fit.json`` and ``posterior.nc`` of a finished fit.

    `InferenceError` if a file is missing or damaged, or the posterior lacks what a page needs.
    """
    record = read_record(folder)
    names = [row["name"] for row in record["parameters"]]
    # Of a dozen groups four are drawn; all of them through xarray took as long as drawing a fifth of the page.
    with whole(folder) as path, h5py.File(path, "r") as file:
        # Files of shj-bayes/fit/1 hold every sample, in groups of ArviZ.
        loops, measured = (file[name] for name in (("loops", "constant_data") if "loops" in file else OLD))
        force = _values(measured["force"])
        constant = {name: _values(part) for name, part in file["constant_data"].items() if part.shape == force.shape}
        law, predicted = (_values(loops[name]).reshape(-1, force.size) for name in ("force_model", "force"))
        draws = {name: _values(file["posterior"][name]) for name in names}
        prior = {name: _values(file["prior"][name]).ravel() for name in names}
    runs = []
    for number in np.unique(constant["run"]):
        mine = constant["run"] == number
        runs.append(
            RunData(
                int(number),
                constant["time_s"][mine],
                constant["displacement_mm"][mine],
                constant["speed_mm_s"][mine],
                force[mine],
                constant["used"][mine].astype(np.bool_),
                constant["half_cycle_of_sample"][mine],
                law[:, mine],
                predicted[:, mine],
                {name[len(EXTRA) :]: values[mine] for name, values in constant.items() if name.startswith(EXTRA)},
            )
        )
    return DeviceData(record, draws, prior, tuple(runs))


def _values(part: Any) -> NDArray[Any]:
    """Array of a netCDF variable, unpacked where it is stored in whole numbers (netCDF attribute ``scale_factor``)."""
    scale = part.attrs.get("scale_factor")
    return np.asarray(part) if scale is None else np.asarray(part, dtype=np.float32) * np.float32(np.squeeze(scale))
