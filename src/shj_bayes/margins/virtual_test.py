"""A virtual test: a device's model driven through a displacement history, and what is read off its force.

The same reading serves a predicted force and a measured one, so that the two can be held against each other.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import trapezoid

from shj_bayes.errors import PopulationError
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.history import History
from shj_bayes.model.parameters import FloatArray
from shj_bayes.recording.motion import Motion

MIDDLE = 0.25
"""Share of the stroke on either side of mid-stroke over which the plateau force of a half-cycle is the mean."""
FLAT, UNEVEN = 0.9, 0.6
"""Least force at the beginning of that part, as a share of its mean, of a half-cycle that slides fully: of a device
whose force is much alike along the stroke, and of one whose force never is."""
TAKEN = 5
REACH_MM = 0.5
"""Samples over which a measured force is averaged before its largest value is read, as far as the device moves no
farther than this meanwhile: a breakaway peak fades over a millimetre, and five samples of 10 Hz took 5 % off it."""


READ = ("plateau_kN", "onset_kN", "largest_kN", "end_kN", "work_kJ")


@dataclass(frozen=True, eq=False)
class Readings:
    """What is read off the force of one run, half-cycle by half-cycle, for one or many devices."""

    amplitude_mm: FloatArray  # shape (n_half,): half of the stroke
    direction: FloatArray  # shape (n_half,): +1 in push (displacement grows), -1 in pull
    travel_m: FloatArray  # shape (n_half,): cumulative sliding distance in the middle of the half-cycle
    complete: NDArray[np.bool_]  # shape (n_half,): whether it runs from one reversal to the next
    # shape (m, n_half): mean force over the middle half of the stroke, in the direction of motion
    plateau_kN: FloatArray
    # shape (m, n_half): force where that part begins: well below the plateau where the device does not slide yet
    onset_kN: FloatArray
    largest_kN: FloatArray  # shape (m, n_half): largest force in the direction of motion
    end_kN: FloatArray  # shape (m, n_half): force at the end of the stroke
    work_kJ: FloatArray  # shape (m, n_half): work done on the device

    def sliding(self, flat: float = FLAT) -> NDArray[np.bool_]:
        """Complete half-cycles in which the typical device slides before the middle part of the stroke, (n_half,)."""
        onset, plateau = np.median(self.onset_kN, axis=0), np.median(self.plateau_kN, axis=0)
        return np.asarray(self.complete & (plateau > 0) & (onset >= flat * plateau))


def read_off(force_kN: FloatArray, motion: Motion, travel_m: FloatArray, *, measured: bool = False) -> Readings:
    """Read the force of one or many devices, shape (m, n_samples), half-cycle by half-cycle.

    A `measured` force carries noise: it is averaged over up to `TAKEN` samples, and `REACH_MM` of motion, before its
    largest value is taken.
    """
    x, start = motion.displacement_mm, motion.start
    n = motion.n_half
    out = {name: np.full((force_kN.shape[0], n), np.nan) for name in READ}
    amplitude, travel = np.zeros(n), np.zeros(n)
    moved = np.abs(np.gradient(x)) + 1e-12
    for h in range(n):
        part, sign = slice(start[h], start[h + 1]), float(motion.direction[h])
        own, force = x[part], sign * force_kN[:, part]
        begin, end = motion.turning_mm[h], motion.turning_mm[h + 1] if h + 1 < n else own[-1]
        stroke = abs(end - begin)
        amplitude[h], travel[h] = 0.5 * stroke, float(np.mean(travel_m[part]))
        weight = np.where(np.abs(own - 0.5 * (begin + end)) <= MIDDLE * stroke, moved[part], 0.0)
        if not weight.any():
            weight = moved[part].copy()
        first = weight * (np.cumsum(weight) <= 0.2 * weight.sum())
        out["plateau_kN"][:, h] = force @ weight / weight.sum()
        out["onset_kN"][:, h] = force @ first / first.sum() if first.any() else out["plateau_kN"][:, h]
        last = np.where(np.abs(end - own) <= 0.02 * stroke, 1.0, 0.0) if measured else np.zeros(own.size)
        last[-1] = 1.0
        out["end_kN"][:, h] = force @ last / last.sum()
        taken = min(TAKEN, own.size, 1 + int(REACH_MM / moved[part].max())) if measured else 1
        if taken > 1:
            force = np.stack([np.convolve(row, np.full(taken, 1.0 / taken), "valid") for row in force])
        out["largest_kN"][:, h] = force.max(axis=1)
        joined = slice(start[h], min(start[h + 1] + 1, x.size))
        out["work_kJ"][:, h] = trapezoid(force_kN[:, joined], x[joined], axis=1) / 1000.0
    complete = (np.arange(n) > 0) & (np.arange(n) < n - 1)
    return Readings(amplitude, motion.direction.astype(np.float64), travel, complete, *out.values())


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
