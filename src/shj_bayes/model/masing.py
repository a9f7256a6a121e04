"""The law as a material with memory: springs in parallel, each with its own slider (Iwan 1966, J. Appl. Mech. 33, 893).

Eq. (1) is a formula for half-cycles that start from full sliding. Where a device turns before it slides, Masing's rule
is the other one that is in use: a branch after a reversal is the first loading at twice the scale, until it meets the
loop that it left. Limits of the sliders are chosen so that the branch after full sliding is that of Eq. (1) under the
continuous rule; the two rules differ on the first loading and in cycles that do not slide.
"""

import numpy as np
from numba import njit

from shj_bayes.model.parameters import FloatArray
from shj_bayes.recording.motion import Motion

N_ELEMENTS = 32


def masing_force(motion: Motion, law: FloatArray, start_force_kN: float = 0.0) -> FloatArray:
    """Force of one parameter set (K, Fy, beta, gamma) under Masing's rule, kN."""
    stiffness, capacity, beta, gamma = (float(value) for value in law)
    hold = 1.0 - (np.arange(N_ELEMENTS) + 0.5) / N_ELEMENTS  # of the stiffness, where an element gives way
    limit = 1.0 + (hold ** (-beta / (beta + 1.0)) - 1.0) ** (1.0 / beta)  # where Eq. (1) has that slope
    limits = capacity * limit / limit.sum()
    out = np.empty(motion.displacement_mm.size)
    start = min(max(start_force_kN / capacity, -1.0), 1.0) * limits
    _step(out, motion.displacement_mm, motion.start, motion.turning_mm, limits, stiffness / N_ELEMENTS, start)
    return np.asarray(out * (1.0 + gamma * motion.speed_mm_s))


@njit(cache=True, nogil=True, error_model="numpy")
def _step(out, x, start, turning, limits, stiffness, held):  # type: ignore[no-untyped-def]
    """Move all elements along the displacements, by way of the turning points."""
    at = turning[0]
    for k in range(turning.size):
        _move(held, limits, stiffness * (turning[k] - at))
        at = turning[k]
        for i in range(start[k], start[k + 1]):
            out[i] = _move(held, limits, stiffness * (x[i] - at))
            at = x[i]


@njit(cache=True, nogil=True, error_model="numpy")
def _move(held, limits, step):  # type: ignore[no-untyped-def]
    """Move all elements by a force that those which hold take up; give the sum."""
    total = 0.0
    for e in range(held.size):
        held[e] = min(max(held[e] + step, -limits[e]), limits[e])
        total += held[e]
    return total
