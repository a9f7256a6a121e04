"""One steady sine cycle: force at mid-stroke, energy, effective stiffness and damping, for many devices at once."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.integrate import trapezoid

from shj_bayes.errors import PopulationError
from shj_bayes.model.law import BETA_RANGE, force_of_laws
from shj_bayes.population.quantities import FloatArray
from shj_bayes.recording.protocol import Block, exact_motion

_SAMPLES = 400


@dataclass(frozen=True, eq=False)
class Cycle:
    """What a designer needs of a steady cycle, one value per device.

    Parameters
    ----------
    force_kN : array, shape (m,)
        At mid-stroke, where the speed is greatest; mean of both directions.
    energy_kJ : array, shape (m,)
        Dissipated in the cycle.
    stiffness_kN_mm : array, shape (m,)
        Effective: k_eff = (|F+| + |F-|) / (|D+| + |D-|).
    damping : array, shape (m,)
        Effective: beta_eff = (2/pi) E / [k_eff (|D+| + |D-|)^2].
    """

    force_kN: FloatArray
    energy_kJ: FloatArray
    stiffness_kN_mm: FloatArray
    damping: FloatArray


def steady_cycle(laws: FloatArray, amplitude_mm: float, peak_speed_mm_s: float, variant: str = "published") -> Cycle:
    """Run the law over the second cycle of a sine.

    Parameters
    ----------
    laws : array, shape (m, 4)
        K (kN/mm), Fy (kN), beta, gamma (s/mm); beta is kept inside what the law allows.
    amplitude_mm, peak_speed_mm_s : float
        Of the sine.
    variant : {"published", "continuous"}
        Reversal rule.

    Returns
    -------
    Cycle
    """
    if not (math.isfinite(amplitude_mm) and math.isfinite(peak_speed_mm_s) and min(amplitude_mm, peak_speed_mm_s) > 0):
        raise PopulationError(
            f"amplitude and peak speed must be above zero; got {amplitude_mm:g} mm and {peak_speed_mm_s:g} mm/s"
        )
    frequency = peak_speed_mm_s / (2.0 * math.pi * amplitude_mm)
    _, motion = exact_motion((Block(amplitude_mm, frequency, 2),), _SAMPLES * frequency)
    laws = np.array(laws, dtype=np.float64)
    laws[:, 2] = np.clip(laws[:, 2], *BETA_RANGE)
    x, start = motion.displacement_mm, motion.start
    top, bottom = int(start[3]), int(start[2])
    keep = slice(bottom - 1, int(start[4]) + 1)  # from the trough to the next trough
    out = [
        _of(force_of_laws(motion, part, variant=variant), x, keep, (bottom, top))
        for part in np.array_split(laws, max(1, math.ceil(laws.shape[0] / 500)))
    ]
    force, energy, stiffness, damping = (np.concatenate(column) for column in zip(*out, strict=True))
    return Cycle(force, energy, stiffness, damping)


def _of(force: FloatArray, x: FloatArray, keep: slice, turns: tuple[int, int]) -> tuple[FloatArray, ...]:
    bottom, top = turns
    last = keep.stop - 1
    push, pull = _at_zero(force, x, bottom, top), _at_zero(force, x, top, last)
    energy = np.asarray(trapezoid(force[:, keep], x[keep], axis=1))
    highest, lowest = np.abs(force[:, top - 1]), np.abs(force[:, last - 1])
    reach = abs(x[top - 1]) + abs(x[last - 1])
    stiffness = (highest + lowest) / reach
    damping = (2.0 / math.pi) * energy / (stiffness * reach**2)
    return 0.5 * (push - pull), energy / 1000.0, stiffness, damping


def _at_zero(force: FloatArray, x: FloatArray, begin: int, end: int) -> FloatArray:
    """Force of every device where the displacement passes zero between two samples."""
    part = x[begin:end]
    i = begin + int(np.flatnonzero(part[:-1] * part[1:] <= 0)[0])
    weight = x[i] / (x[i] - x[i + 1])
    return np.asarray((1.0 - weight) * force[:, i] + weight * force[:, i + 1])
