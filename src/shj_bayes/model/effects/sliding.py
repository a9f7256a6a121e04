"""Distance slid: what is left of the motion once the connection has unloaded and loaded again; it heats and wears."""

from collections.abc import Callable

import numpy as np
from numba import njit

from shj_bayes.model.effects.effect import Base
from shj_bayes.model.effects.kernel import gone_further
from shj_bayes.model.history import History
from shj_bayes.model.kernel import held_at, knee_of, saturate_with_slope
from shj_bayes.model.parameters import FloatArray
from shj_bayes.model.priors import Prior

CELLS = 160  # of the slot, over 1.2 half strokes to either side, in which it is counted what slides where
# Distance slid over which a contact follows its speed, and where a search for it begins.
MEMORY = Prior("memory", "mm", "loguniform", 1e-4, 1.0, "At once if thermally activated; 1 to 100 um (Marone 1998).")
MEMORIES = {"memory": (0.0003, 0.1)}


@njit(cache=True, error_model="numpy")
def _slid(slip, start, turning, direction, law):  # type: ignore[no-untyped-def]
    """Part of the slip that is not elastic, and its slope: from each reversal along Eq. (1), whose knee is rounded."""
    stiffness, capacity, beta = law
    knee, per_capacity = knee_of(beta), 1.0 / capacity
    out = np.empty((2, slip.size))
    force = 0.0
    for k in range(turning.size):
        before = force * direction[k]
        begins = before - held_at(before, 1.0, capacity, beta, knee)
        for i in range(start[k], start[k + 1]):
            e = before + stiffness * slip[i]
            held, slope = (e, 1.0) if e < 0.0 else saturate_with_slope(e, capacity, per_capacity, beta, knee)
            out[0, i] = (e - held - begins) / stiffness
            out[1, i] = 1.0 - slope
        if k + 1 < turning.size:
            e = before + stiffness * abs(turning[k + 1] - turning[k])
            force = direction[k] * held_at(e, 1.0, capacity, beta, knee)
    return out


def slid_mm(history: History, base: Base) -> FloatArray:
    """Slip since the reversal less the elastic part, shape (n_samples,), mm: 2 Fy/K after a stroke that slid.

    After a reversal under load it is less, after one that came before sliding more: in an earthquake both are common.
    Sliding sets in gradually, as the knee of Eq. (1) does.
    """
    return np.asarray(_slid_along(history, base)[0])


def sliding_mm_s(history: History, base: Base) -> FloatArray:
    """Speed of sliding at each sample, shape (n_samples,), mm/s: that of the motion, less what is elastic."""
    return np.asarray(_slid_along(history, base)[1] * history.speed_mm_s)


def _slid_along(history: History, base: Base) -> FloatArray:
    motion, law = history.motion, (base.K, base.Fy, base.beta)
    return history.recall(
        ("slid", law),
        lambda: np.asarray(_slid(history.slip_mm, motion.start, motion.turning_mm, motion.direction, law)),
    )


def slid_since_mm(history: History, base: Base) -> FloatArray:
    """Distance slid since the sample before, shape (n_samples,), mm: what heats, wears and changes a contact.

    Motion of the elastic branches is not sliding; in small cycles it is most of the travel.
    """
    return history.recall(
        ("slid since", base.K, base.Fy, base.beta),
        lambda: np.asarray(gone_further(slid_mm(history, base), history.motion.start)),
    )


def _slid_by(turned: FloatArray, base: Base, capacity_kN: float) -> FloatArray:
    """Distance slid by each turning point and in the end, shape (n_half + 1,), mm."""
    moved, law = np.abs(np.diff(turned)), (base.K, capacity_kN, base.beta)
    each = _slid(moved, np.arange(turned.size), turned[:-1], np.sign(np.diff(turned)).astype(np.int64), law)[0]
    return np.append(0.0, np.cumsum(each))


def slid_m(history: History, base: Base) -> FloatArray:
    """Distance slid since the first sample of the first run, shape (n_samples,), m.

    It is the travel less what was elastic: that share of `History.travel_m`, so that whoever bounds the travel bounds
    this too.
    """
    return history.recall(("slid through runs", base), lambda: _slid_m(history, base))


def _slid_m(history: History, base: Base) -> FloatArray:
    half, here = history.motion.half_cycle, history.turned_at
    slid_before = sum(float(_slid_by(turned, base, base.Fy_first)[-1]) for turned in history.earlier)
    moved_before = sum(float(np.abs(np.diff(turned)).sum()) for turned in history.earlier)
    slid = slid_before + _slid_by(here, base, base.Fy)[half] + slid_mm(history, base)
    moved = moved_before + np.append(0.0, np.cumsum(np.abs(np.diff(here))))[half] + history.slip_mm
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
    """How often the place of each point of a run has been slid over, through all runs, shape (n_samples,).

    `width` is that of the pad that wears and is worn: standard deviation of its bell, as a share of the half stroke.
    """
    half = history.half_stroke_mm
    cell = 2.4 * half / CELLS
    low = -1.2 * half
    rubbed = np.zeros(CELLS)
    for turned in history.earlier:
        slid = np.diff(_slid_by(turned, base, base.Fy_first))
        for begin, end, distance in zip(turned[:-1], turned[1:], slid, strict=True):
            _rub(rubbed, low, cell, end, begin, distance)
    reach = int(np.ceil(3.0 * width * half / cell))
    bell = np.exp(-0.5 * (np.arange(-reach, reach + 1) * cell / (width * half)) ** 2)
    motion = history.motion
    weights = bell / (bell.sum() * cell)
    place, begins = history.position_mm, history.turned_at[:-1]
    return np.asarray(_passed(rubbed, low, cell, weights, place, slid_mm(history, base), motion.start, begins))


def felt(goal: FloatArray, history: History, base: Base, memory_mm: float) -> FloatArray:
    """Let a contact follow, over a distance slid, what changes along the motion, shape (n,); at once for 0 mm.

    Friction that depends on low speeds would otherwise change within the last micrometres of each stroke, and with it
    the force from which the next one starts.
    """
    if memory_mm <= 0.0:
        return goal
    return np.asarray(remembered(goal, slid_since_mm(history, base), memory_mm, float(goal[0])))


def remembered_through(
    goal: Callable[[History], FloatArray], history: History, base: Base, length_mm: float, begin: float | None = None
) -> FloatArray:
    """State that follows a goal late over a distance slid, shape (n,), through all runs: nothing slides between them.

    `goal(history)` is what it follows in a run; the first run begins with `begin`, by default with what it follows.
    """
    own, before = goal(history), history.before
    first = float(own[0]) if begin is None else begin
    if before is not None:
        first = float(remembered_through(goal, before, base._replace(Fy=base.Fy_first), length_mm, begin)[-1])
    return np.asarray(remembered(own, slid_since_mm(history, base), length_mm, first))


@njit(cache=True)
def remembered(goal: FloatArray, moved: FloatArray, length: float, begin: float) -> FloatArray:
    """State that follows a goal late, L dm/ds + m = u, shape (n,); exact for a goal straight over each step.

    `goal` is u, shape (n,), `moved` the distance slid since the sample before, mm, `length` L, mm, `begin` the state
    at the first sample.
    """
    out = np.empty_like(goal)
    out[0] = begin
    for i in range(1, goal.size):
        step = moved[i] / length
        if step < 1e-9:
            out[i] = out[i - 1]
            continue
        rise = (goal[i] - goal[i - 1]) / step
        keep = np.exp(-step)
        out[i] = goal[i] - rise + (out[i - 1] - goal[i - 1] + rise) * keep
    return out
