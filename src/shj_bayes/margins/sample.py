"""The devices of a set as a sample: one positive number each, and how well it is known."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from shj_bayes.errors import PopulationError
from shj_bayes.margins.cycle import steady_cycle
from shj_bayes.margins.speed_guard import Guard
from shj_bayes.population.posterior import DeviceSet, PopulationResult
from shj_bayes.population.predict import RUN_FORCES, NewDevice
from shj_bayes.population.quantities import QUANTITIES, FloatArray

RATIOS = tuple(RUN_FORCES.values())
SAMPLED = ("Fy", *RUN_FORCES, *RATIOS, "K", "energy", "force")
UNITS = {"Fy": "kN", "degradation": "1", "K": "kN/mm", "energy": "kJ", "force": "kN"}
UNITS |= dict.fromkeys(RUN_FORCES, "kN") | dict.fromkeys(RATIOS, "1")
"""Quantities that are pooled, or follow from pooled ones, and are positive; degradation = 1 - ratio follows."""
N_DRAWS = 1600
LAW = ("K", "Fy", "beta", "gamma")


@dataclass(frozen=True)
class Motion:
    """The cycle for which energy and force are given.

    Parameters
    ----------
    amplitude_mm : float
        Half of the stroke, inside what was tested.
    guard : Guard
        The speed, and whether it was tested.
    """

    amplitude_mm: float
    guard: Guard

    def __post_init__(self) -> None:
        """Refuse an amplitude that was not tested."""
        self.guard.tested.check_amplitude(self.amplitude_mm)


@dataclass(frozen=True)
class Sample:
    """Devices of one set in one quantity.

    Parameters
    ----------
    values : array, shape (n,)
        Natural unit, above zero.
    floor : float
        Standard deviation of the logarithm that rounding or measurement alone would make.
    """

    values: FloatArray = field(repr=False)
    floor: float

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


def samples(group: DeviceSet, motion: Motion | None) -> dict[str, Sample]:
    """Every quantity of the devices of a set, as far as they give it."""
    n = len(group.devices)
    points = {q: np.array(group.points.get(q, (np.nan,) * n)) for q in QUANTITIES}
    values = {q: QUANTITIES[q].natural(points[q]) for q in QUANTITIES}
    values |= {force: values["Fy"] * values[q] for force, q in RUN_FORCES.items()}
    out = {}
    known = np.all(np.isfinite([values[q] for q in LAW]), axis=0)
    if motion is not None and known.any():
        table = {q: values[q][known] for q in LAW}
        values |= {name: np.mean(list(law.values()), axis=0) for name, law in derived(table, motion).items()}
    source = {q: (q,) for q in (*RATIOS, "K")} | {force: ("Fy", q) for force, q in RUN_FORCES.items()}
    for q in SAMPLED:
        found = values.get(q, np.empty(0))
        found = found[np.isfinite(found) & (found > 0)]
        errors = [np.nan_to_num(group.errors.get(s, (0.0,) * n)) for s in source.get(q, ("Fy",))]
        floor = float(np.sqrt(np.mean(np.sum(np.square(errors), axis=0)))) if n else 0.0
        if found.size:
            out[q] = Sample(found, floor)
    return out


def derived(values: dict[str, FloatArray], motion: Motion) -> dict[str, dict[str, FloatArray]]:
    """Energy (kJ) and force (kN) of one cycle, by law of speed, of devices given by K, Fy, beta and gamma."""
    out: dict[str, dict[str, FloatArray]] = {"energy": {}, "force": {}}
    guard = motion.guard
    for name, gamma in guard.gammas(values["gamma"]).items():
        laws = np.column_stack([values["K"], values["Fy"], values["beta"], gamma])
        cycle = steady_cycle(laws, motion.amplitude_mm, guard.speed_mm_s, guard.tested.variant)
        out["energy"][name], out["force"][name] = cycle.energy_kJ, cycle.force_kN
    return out


def predicted(device: NewDevice, motion: Motion | None) -> dict[str, dict[str, FloatArray]]:
    """Draws of a new device in every quantity, by law of speed ("linear" alone where the law does not matter)."""
    out = {q: {"linear": device.draws[q]} for q in ("Fy", *RUN_FORCES, *RATIOS, "K") if q in device.draws}
    if "ratio" in out:
        out["degradation"] = {"linear": 1.0 - device.draws["ratio"]}
    if motion is not None and all(q in device.draws for q in LAW):
        total = device.draws["K"].size
        chosen = np.linspace(0, total - 1, min(N_DRAWS, total)).astype(np.int64)
        out |= derived({q: device.draws[q][chosen] for q in LAW}, motion)
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


def everything(result: PopulationResult, motion: Motion | None) -> dict[str, dict[str, Sample]]:
    """Draw up the samples of every set, by set and quantity."""
    return {group.name: samples(group, motion) for group in result.sets}
