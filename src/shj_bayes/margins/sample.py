"""The devices of a set as a sample: one positive number each, and how well it is known."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from shj_bayes.errors import PopulationError
from shj_bayes.population.posterior import DeviceSet, PopulationResult
from shj_bayes.population.quantities import FloatArray, quantity


@dataclass(frozen=True)
class Sample:
    """Devices of one set in one quantity."""

    values: FloatArray = field(repr=False)  # shape (n,): natural unit, above zero
    floor: float  # standard deviation of the logarithm that rounding or measurement alone would make

    def __post_init__(self) -> None:
        """Refuse values without a logarithm."""
        if not (np.all(np.isfinite(self.values)) and np.all(self.values > 0)):
            raise PopulationError(f"a sample must be finite and above zero; got {self.values}")

    @property
    def n(self) -> int:
        """Devices."""
        return int(self.values.size)

    @property
    def mean(self) -> float:
        """Mean, natural unit."""
        return float(self.values.mean())

    @property
    def mean_log(self) -> float:
        """Mean of the logarithm."""
        return float(np.log(self.values).mean())

    @property
    def sd_log(self) -> float:
        """Standard deviation of the logarithm, not below what rounding or measurement alone makes; NaN for one."""
        return max(float(np.log(self.values).std(ddof=1)), self.floor) if self.n > 1 else math.nan

    @property
    def variation(self) -> float:
        """Coefficient of variation, with the same floor; NaN for one."""
        return max(float(self.values.std(ddof=1)) / self.mean, self.floor) if self.n > 1 else math.nan


def samples(group: DeviceSet) -> dict[str, Sample]:
    """Every quantity of the devices of a set, as far as they give it."""
    out = {}
    for q, points in group.points.items():
        values = np.array(points)
        known = np.isfinite(values)
        if known.any():
            errors = np.nan_to_num(group.errors.get(q, (0.0,) * values.size))[known]
            out[q] = Sample(quantity(q).natural(values[known]), float(np.sqrt(np.mean(np.square(errors)))))
    return out


def common_spread(of_sets: list[Sample]) -> tuple[float, int]:
    """Pool the standard deviation of the logarithm common to several sets, and its degrees of freedom (0: none)."""
    several = [s for s in of_sets if s.n > 1]
    degrees = sum(s.n - 1 for s in several)
    if not degrees:
        return math.nan, 0
    squares = sum(float(np.sum((np.log(s.values) - s.mean_log) ** 2)) for s in several)
    floor = math.sqrt(sum(s.floor**2 * (s.n - 1) for s in several) / degrees)
    return max(math.sqrt(squares / degrees), floor), degrees


def everything(result: PopulationResult) -> dict[str, dict[str, Sample]]:
    """Draw up the samples of every set, by set and quantity."""
    return {group.name: samples(group) for group in result.sets}
