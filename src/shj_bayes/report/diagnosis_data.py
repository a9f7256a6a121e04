"""The files of a diagnosis as plain values for the page."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes._util.files import read_json, refuse_windows
from shj_bayes.errors import ReportError, shown
from shj_bayes.model.parameters import FloatArray
from shj_bayes.report.force_unit import ForceUnit, unit_for
from shj_bayes.results.device import BoolArray, IntArray
from shj_bayes.results.diagnosis import READ, Verdict

KEYS = (
    "p_value", "effects", "family", "location", "before", "after", "heldout", "shift", "aliases", "candidates",
)  # fmt: skip
FLOATS = ("time_s", "position_mm", "speed_mm_s", "slip_mm", "travel_m", "force_kN", "before_kN", "after_kN")
KINDS: dict[str, type] = {  # of fields that hold tables
    **dict.fromkeys(("effects", "family", "coordinates", "sets", "location", "aliases", "candidates"), list),
    "shift": dict,
}
PLAIN: dict[type, str] = {list: "list", dict: "table"}


@dataclass(frozen=True, eq=False)
class Channels:
    """Samples of all runs, one after the other; arrays have shape (n,)."""

    # time_s to travel_m: time, displacement from mid-stroke, speed, distance since the last reversal, distance in all
    time_s: FloatArray = field(repr=False)
    position_mm: FloatArray = field(repr=False)
    speed_mm_s: FloatArray = field(repr=False)
    slip_mm: FloatArray = field(repr=False)
    travel_m: FloatArray = field(repr=False)
    direction: IntArray = field(repr=False)  # +1 while displacement grows (push), -1 while it falls
    run: IntArray = field(repr=False)  # number of the run
    used: BoolArray = field(repr=False)  # samples that are evidence
    # force_kN to after_kN: measured, modelled by the base law, modelled by the law with what was found
    force_kN: FloatArray = field(repr=False)
    before_kN: FloatArray = field(repr=False)
    after_kN: FloatArray = field(repr=False)

    @property
    def changed(self) -> bool:
        """True when something was added to the base law."""
        return not np.array_equal(self.before_kN, self.after_kN)

    @property
    def residuals(self) -> tuple[FloatArray, FloatArray]:
        """Measured less modelled force, before and after, kN."""
        return self.force_kN - self.before_kN, self.force_kN - self.after_kN


@dataclass(frozen=True, eq=False)
class DiagnosisData:
    """What a diagnosis left in its folder."""

    record: Mapping[str, Any]  # content of ``diagnosis.json``
    channels: Channels = field(repr=False)  # content of ``diagnosis.nc``

    @property
    def capacity_kN(self) -> float:
        """Sliding force of the base law, kN; from the measured force where the record does not say."""
        stated = number(self.record.get("fy_kN"))
        return stated if stated > 0 else float(np.quantile(np.abs(self.channels.force_kN), 0.9)) or 1.0

    @property
    def force(self) -> ForceUnit:
        """Unit in which the page shows forces."""
        return unit_for(self.capacity_kN)


def number(value: Any) -> float:
    """Return a number of a record; nan where there is none."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return math.nan
    return float(value)


def read_diagnosis(folder: Path) -> DiagnosisData:
    """Read ``diagnosis.json`` and ``diagnosis.nc``; `ReportError` where one is missing, damaged or another."""
    return DiagnosisData(diagnosis_record(folder), _read_channels(folder))


def diagnosis_record(folder: Path) -> dict[str, Any]:
    """Content of ``diagnosis.json``, its fields checked; `ReportError` where it is missing or damaged."""
    if not (folder / "diagnosis.json").exists():
        raise ReportError(f"{folder.name} holds no diagnosis.json; run shj-bayes diagnose first")
    record = read_json(folder / "diagnosis.json", ReportError)
    if not isinstance(record, dict) or record.get("schema") not in READ:
        raise ReportError(
            f"diagnosis.json in {folder.name} is of none of the schemas {', '.join(READ)}; run the diagnosis again"
        )
    if record.get("verdict") not in tuple(Verdict):
        raise ReportError(f"diagnosis.json in {folder.name}: the verdict is none of {', '.join(Verdict)}")
    missing = [key for key in KEYS if key not in record]
    if missing:
        raise ReportError(f"diagnosis.json in {folder.name} lacks {', '.join(missing)}; run the diagnosis again")
    for key, outer in KINDS.items():
        value = record.get(key, outer())
        parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
        if not isinstance(value, outer) or not all(isinstance(part, dict) for part in parts):
            words = f"it must be a {PLAIN[outer]} of tables; restore it, or run the diagnosis again"
            raise ReportError(f"diagnosis.json in {folder.name}: {key} is {shown(value)}; {words}")
    return record


def _read_channels(folder: Path) -> Channels:
    import xarray as xr  # noqa: PLC0415  (who reads only the words of a diagnosis need not load it)

    try:
        refuse_windows(folder / "diagnosis.nc")
        with xr.open_dataset(folder / "diagnosis.nc", engine="h5netcdf") as data:
            channels = Channels(
                **{name: np.asarray(data[name].to_numpy(), dtype=np.float64) for name in FLOATS},
                direction=np.sign(data["direction"].to_numpy()).astype(np.int64),
                run=data["run"].to_numpy().astype(np.int64),
                used=np.asarray(data["weight"].to_numpy() > 0),
            )
    except (OSError, KeyError, ValueError, TypeError) as error:
        raise ReportError(f"diagnosis.nc in {folder.name} cannot be read: {error}; run the diagnosis again") from error
    if not channels.used.any():
        raise ReportError(f"diagnosis.nc in {folder.name} holds no sample that is evidence")
    return channels
