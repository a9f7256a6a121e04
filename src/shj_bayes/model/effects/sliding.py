"""Distance slid since the last reversal: what is left of the slip once the connection has unloaded and loaded again."""

from __future__ import annotations

import numpy as np
from numba import njit

from shj_bayes.model.effects.effect import Base
from shj_bayes.model.history import History
from shj_bayes.model.parameters import FloatArray


@njit(cache=True)
def _slid(slip, start, turning, direction, stiffness, capacity):  # type: ignore[no-untyped-def]
    """Slip less the distance from each reversal to sliding: from the force there, by an elastic and plastic device."""
    out = np.empty(slip.size)
    force = 0.0
    for k in range(turning.size):
        elastic = (capacity - force * direction[k]) / stiffness
        for i in range(start[k], start[k + 1]):
            out[i] = max(slip[i] - elastic, 0.0)
        if k + 1 < turning.size:
            force += stiffness * (turning[k + 1] - turning[k])
            force = min(max(force, -capacity), capacity)
    return out


def slid_mm(history: History, base: Base) -> FloatArray:
    """Slip since the reversal less the elastic part, shape (n_samples,), mm: 2 Fy/K after a stroke that slid.

    After a reversal under load it is less, after one that came before sliding more: in an earthquake both are common.
    """
    motion = history.motion
    return np.asarray(_slid(history.slip_mm, motion.start, motion.turning_mm, motion.direction, base.K, base.Fy))


def slid_since_mm(history: History, base: Base) -> FloatArray:
    """Distance slid since the sample before, shape (n_samples,), mm: what heats, wears and changes a contact.

    Motion of the elastic branches is not sliding; in small cycles it is most of the travel.
    """
    return np.asarray(np.maximum(np.diff(slid_mm(history, base), prepend=0.0), 0.0))


@njit(cache=True)
def remembered(goal: FloatArray, moved: FloatArray, length: float) -> FloatArray:
    """State that follows a goal late, L dm/ds + m = u from 0, shape (n,); exact for a goal straight over each step.

    Parameters
    ----------
    goal : array, shape (n,)
        The goal u.
    moved : array, shape (n,)
        Distance slid since the sample before, mm.
    length : float
        L, mm.
    """
    out = np.zeros_like(goal)
    for i in range(1, goal.size):
        step = moved[i] / length
        if step < 1e-9:
            out[i] = out[i - 1]
            continue
        rise = (goal[i] - goal[i - 1]) / step
        keep = np.exp(-step)
        out[i] = goal[i] - rise + (out[i - 1] - goal[i - 1] + rise) * keep
    return out
