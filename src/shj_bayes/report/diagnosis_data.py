"""The files of a diagnosis as the page takes them."""

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from shj_bayes.report.force_unit import ForceUnit, unit_for
from shj_bayes.results.device import Channels, read_channels
from shj_bayes.results.diagnosis import DiagnosisRecord
from shj_bayes.results.store import read


@dataclass(frozen=True, eq=False)
class DiagnosisData:
    """What a diagnosis left in its folder."""

    record: DiagnosisRecord
    channels: Channels = field(repr=False)  # content of ``diagnosis.nc``

    @property
    def capacity_kN(self) -> float:
        """Sliding force of the base law, kN; from the measured force where the record does not say."""
        stated = self.record.fy_kN or 0.0
        return stated if stated > 0 else float(np.quantile(np.abs(self.channels.force_kN), 0.9)) or 1.0

    @property
    def force(self) -> ForceUnit:
        """Unit in which the page shows forces."""
        return unit_for(self.capacity_kN)


def number(value: float | None) -> float:
    """Return a number of a record; nan where there is none."""
    return math.nan if value is None else value


def read_diagnosis(folder: Path) -> DiagnosisData:
    """Read ``diagnosis.json`` and ``diagnosis.nc``; `ReportError` where one is missing, damaged or another."""
    return DiagnosisData(read(DiagnosisRecord, folder), read_channels(folder))
