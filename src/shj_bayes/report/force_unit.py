"""Newton for devices of less than a kilonewton: 0.26 kN is no number that a laboratory reads off its load cell."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from shj_bayes.report.words import short

SMALL_KN = 1.0


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

    def row(self, row: Mapping[str, Any]) -> dict[str, Any]:
        """Row of a parameter table in the unit that is shown."""
        unit, factor = self.of(str(row["unit"]))
        keys = ("mean", "sd", "q05", "q50", "q95")
        return {**row, "unit": unit} | {k: row[k] * factor for k in keys if row.get(k) is not None}


KN, N = ForceUnit("kN", 1.0), ForceUnit("N", 1000.0)


def force_unit(record: Mapping[str, Any]) -> ForceUnit:
    """Choose the unit for a device by its sliding force in ``fit.json``."""
    return unit_for(next((row["q50"] for row in record["parameters"] if row["name"] == "Fy"), None))


def unit_for(sliding_kN: float | None) -> ForceUnit:
    """Choose the unit for a device by its sliding force, which may not be known."""
    return N if sliding_kN is not None and abs(sliding_kN) < SMALL_KN else KN
