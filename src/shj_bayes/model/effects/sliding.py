"""Distance slid: what is left of the motion once the connection has unloaded and loaded again; it heats and wears."""

import numpy as np
from numba import njit

from shj_bayes.model.effects.effect import Base
from shj_bayes.model.effects.kernel import gone_further
from shj_bayes.model.history import History
from shj_bayes.model.parameters import FloatArray

CELLS = 160  # of the slot, over 1.2 half strokes to either side, in which it is counted what slides where


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
    return np.asarray(gone_further(slid_mm(history, base), history.motion.start))


@njit(cache=True)
def _slid_by(turned, stiffness, capacity):  # type: ignore[no-untyped-def]
    """Distance slid by each turning point and in the end, shape (n_half + 1,), mm."""
    out = np.zeros(turned.size)
    force = 0.0
    for k in range(turned.size - 1):
        moved = turned[k + 1] - turned[k]
        elastic = (capacity - force * np.sign(moved)) / stiffness
        out[k + 1] = out[k] + max(abs(moved) - elastic, 0.0)
        force = min(max(force + stiffness * moved, -capacity), capacity)
    return out


def slid_m(history: History, base: Base) -> FloatArray:
    """Distance slid since the first sample of the first run, shape (n_samples,), m.

    It is the travel less what was elastic: that share of `History.travel_m`, so that whoever bounds the travel bounds
    this too.
    """
    slid, moved = (
        sum((float(_slid_by(t, base.K, before)[-1]) for t in history.earlier), 0.0)
        + _slid_by(history.turned_at, base.K, now)[history.motion.half_cycle]
        + since
        for before, now, since in ((base.Fy_first, base.Fy, slid_mm(history, base)), (0.0, 0.0, history.slip_mm))
    )
    return np.asarray(history.travel_m * slid / np.maximum(moved, 1e-12))


@njit(cache=True)
def _rub(rubbed, low, cell, end, begin, slid):  # type: ignore[no-untyped-def]
    """Add a distance slid up to a place, coming from another one, to the cells that it lies in, mm."""
    far = end - (slid if end > begin else -slid)
    first, last = (min(end, far) - low) / cell, (max(end, far) - low) / cell
    for j in range(max(int(first), 0), min(int(last), rubbed.size - 1) + 1):
        rubbed[j] += cell * (min(last, j + 1.0) - max(first, float(j)))


@njit(cache=True)
def _felt(rubbed, weights, place):  # type: ignore[no-untyped-def]
    """Weighted sum of the cells around a place, which is given in cells."""
    reach = weights.size // 2
    middle = int(place)
    total = 0.0
    for j in range(max(middle - reach, 0), min(middle + reach, rubbed.size - 1) + 1):
        total += weights[j - middle + reach] * rubbed[j]
    return total


@njit(cache=True)
def _passed(rubbed, low, cell, weights, place, slid, start, begins):  # type: ignore[no-untyped-def]
    """Rub along a run, shape (n,): what each place has been rubbed by the time that it is passed."""
    out = np.empty(place.size)
    for k in range(begins.size):
        before, done = begins[k], 0.0
        for i in range(start[k], start[k + 1]):
            if slid[i] > done:
                _rub(rubbed, low, cell, place[i], before, slid[i] - done)
                done = slid[i]
            before = place[i]
            at = (place[i] - low) / cell - 0.5
            share = at - np.floor(at)
            out[i] = (1.0 - share) * _felt(rubbed, weights, at) + share * _felt(rubbed, weights, at + 1.0)
    return out


def passes(history: History, base: Base, width: float) -> FloatArray:
    """How often the place of each point has been slid over, through all runs, shape (n_samples,).

    Parameters
    ----------
    history : History
        Of one run.
    base : Base
        Base parameters, for where sliding begins.
    width : float
        Of the pad that wears and is worn: standard deviation of its bell, as a share of the half stroke.
    """
    half = history.half_stroke_mm
    cell = 2.4 * half / CELLS
    low = -1.2 * half
    rubbed = np.zeros(CELLS)
    for turned in history.earlier:
        slid = np.diff(_slid_by(turned, base.K, base.Fy_first))
        for begin, end, distance in zip(turned[:-1], turned[1:], slid, strict=True):
            _rub(rubbed, low, cell, end, begin, distance)
    reach = int(np.ceil(3.0 * width * half / cell))
    bell = np.exp(-0.5 * (np.arange(-reach, reach + 1) * cell / (width * half)) ** 2)
    motion = history.motion
    weights = bell / (bell.sum() * cell)
    place, begins = history.position_mm, history.turned_at[:-1]
    return np.asarray(_passed(rubbed, low, cell, weights, place, slid_mm(history, base), motion.start, begins))


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
