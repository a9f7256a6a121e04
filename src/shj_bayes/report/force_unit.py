"""The unit in which pages and terminal show the forces of a device."""

from dataclasses import dataclass, replace
from typing import TypeVar

from shj_bayes.recording import recording as rule
from shj_bayes.report.words import short
from shj_bayes.results.diagnosis import EffectParameter
from shj_bayes.results.fit import FitRecord, ParameterRow

Row = TypeVar("Row", ParameterRow, EffectParameter)


@dataclass(frozen=True)
class ForceUnit:
    """Unit in which forces are shown."""

    name: str  # "kN", "N": as printed
    factor: float  # of it in a kilonewton

    def of(self, unit: str) -> tuple[str, float]:
        """Give the unit in which one of a parameter is shown (N for kN, N/mm for kN/mm), and the factor to it."""
        if unit.split("/", maxsplit=1)[0] != "kN":
            return unit, 1.0
        return self.name + unit[2:], self.factor

    def shown(self, kN: float) -> str:
        """Write a force of so many kN, with its unit."""
        return f"{short(kN * self.factor)} {self.name}"

    def row(self, row: Row) -> Row:
        """Row of a parameter table in the unit that is shown."""
        unit, factor = self.of(row.unit)
        values = {key: getattr(row, key) for key in ("mean", "sd", "q05", "q50", "q95")}
        return replace(row, unit=unit, **{key: value * factor for key, value in values.items() if value is not None})


KN = ForceUnit("kN", 1.0)


def force_unit(record: FitRecord) -> ForceUnit:
    """Choose the unit for a device by its sliding force in ``fit.json``."""
    row = record.parameter("Fy")
    return unit_for(row.q50 if row else None)


def unit_for(sliding_kN: float | None) -> ForceUnit:
    """Choose the unit for a device by its sliding force, which may not be known."""
    return KN if sliding_kN is None else ForceUnit(*rule.unit_for(sliding_kN))
