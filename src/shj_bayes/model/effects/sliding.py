"""Distance slid: what is left of the motion once the connection has unloaded and loaded again; it heats and wears.

The compiled law with effects stands here as well: a capacity that changes, slack, compliance and a reversal rule.
"""

import math
from collections.abc import Callable

import numpy as np
from numba import njit

from shj_bayes._util.arrays import FloatArray
from shj_bayes.model.effects.effect import Base
from shj_bayes.model.history import History
from shj_bayes.model.law import held_at, knee_of, saturate, saturate_with_slope
from shj_bayes.model.priors import Prior

# Bolts with unlike clearances: a part of the stiffness comes back first. 0.3 to 0.5 fit brfd-lehigh alike.
FIRST = 0.4
STEP = 1e-6  # of the capacity, for derivatives
_TOGETHER = 64  # samples whose equation is solved together, until the last one is close
_MAX_NEWTON = 40
_CLOSE = 1e-16  # square of the last change, in units of the capacity; the next would be about its square
CELLS = 160  # of the slot, over 1.2 half strokes to either side, in which it is counted what slides where
# Distance slid over which a contact follows its speed, and where a search for it begins.
MEMORY = Prior("memory", "mm", "loguniform", 1e-4, 1.0, "At once if thermally activated; 1 to 100 um (Marone 1998).")
MEMORIES = {"memory": (0.0003, 0.1)}


@njit(error_model="numpy", fastmath={"contract"}, inline="always")
def _held(e, sense, capacity, beta, knee, smooth):  # type: ignore[no-untyped-def]
    """Eq. (1) with a share of the continuous reversal rule."""
    held = saturate(e, capacity, 1.0 / capacity, beta, knee)
    return held if e * sense > 0.0 else held + smooth * (e - held)


@njit(error_model="numpy", fastmath={"contract"}, inline="always")
def _elastic(distance, reset, sense, stiffness, slack, take_up):  # type: ignore[no-untyped-def]
    """Elastic force after a distance since the reversal, with free travel at zero force; without branches."""
    along = reset * sense + stiffness * max(distance, 0.0)
    if reset * sense > 0.0:  # the gap opens only when the force comes down to zero on the way
        return sense * along
    past, full = along - stiffness * slack, stiffness * take_up
    return sense * (min(along, 0.0) + FIRST * min(max(past, 0.0), full) + max(past - full, 0.0))


@njit(error_model="numpy", fastmath={"contract"})
def _fill_straight(out, x, caps, origin, reset, sense, law, knee, smooth, slack, take_up):  # type: ignore[no-untyped-def]  # noqa: PLR0913, PLR0917
    """Force of the samples of a half-cycle of the device without an elastic part in series."""
    stiffness, capacity, beta = law[0], law[1], law[2]
    if (slack == 0.0 and take_up == 0.0) or reset * sense > 0.0:
        for i in range(out.size):
            e = stiffness * (x[i] - origin) + reset
            out[i] = _held(e, sense, capacity * caps[i], beta, knee, smooth)
    else:
        for i in range(out.size):
            e = _elastic((x[i] - origin) * sense, reset, sense, stiffness, slack, take_up)
            out[i] = _held(e, sense, capacity * caps[i], beta, knee, smooth)


@njit(error_model="numpy", fastmath={"contract"})
def _divide(targets, softs, x, origin, reset, sense, law, caps, knee, parts):  # type: ignore[no-untyped-def]
    """Find on which straight piece of `_elastic` each sample lies: targets = softs e + compliance H(e) holds there.

    Pieces: before the gap, in it (force 0), at the share `FIRST` of the stiffness, at full stiffness. Their ends follow
    from the forces there, so no sample has to try more than one.
    """
    slack, take_up, compliance = parts[0], parts[1], parts[2]
    soft = 1.0 / law[0]
    softs[:] = soft
    for i in range(targets.size):
        targets[i] = x[i] - origin + (soft + compliance) * reset
    if (slack == 0.0 and take_up == 0.0) or reset * sense > 0.0:
        return
    for i in range(targets.size):
        along = targets[i] * sense
        if along <= 0.0:
            continue
        if along <= slack:
            targets[i] = 0.0
            continue
        past, capacity = along - slack, law[1] * caps[i]
        at_end = FIRST * law[0] * take_up
        first = past <= take_up + compliance * min(at_end, capacity)  # dearer to say in most samples: by Eq. (1)
        if first and past <= take_up + compliance * saturate(at_end, capacity, 1.0 / capacity, law[2], knee):
            targets[i], softs[i] = sense * past, soft / FIRST
        else:
            targets[i] = sense * (past - (1.0 - FIRST) * take_up)


@njit(error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def _solve(out, targets, softs, reset, sense, law, caps, knee, parts, work):  # type: ignore[no-untyped-def]
    """Force of neighbouring samples of the device behind an elastic part.

    The unknown is the elastic force e of Eq. (1), since then the travel is explicit: for a device without slack
    x - origin = (e - reset) / K + c (H(e) - reset). It rises with e and bends one way on either side of 0, and lies
    beyond both its straight ends, so Newton's steps from the further of these come to it from one side.
    """
    compliance, smooth, beta = parts[2], parts[3], law[2]
    for i in range(out.size):
        capacity = law[1] * caps[i]
        target = targets[i]
        elastic = target / (softs[i] + compliance)
        sliding = (target - compliance * np.copysign(capacity, target)) / softs[i]
        far = elastic if abs(elastic) >= sliding * np.sign(target) else sliding
        # Where unloading is straight (a share of the continuous rule) the elastic line is the nearer guess.
        guess = far if smooth == 0.0 or target * sense > 0.0 else elastic
        work[i] = guess if (guess - reset) * sense > 0.0 else reset
    for _ in range(_MAX_NEWTON):
        left = 0.0
        for i in range(out.size):
            capacity = law[1] * caps[i]
            e = work[i]
            held, slope = saturate_with_slope(e, capacity, 1.0 / capacity, beta, knee)
            share = smooth if e * sense <= 0.0 else 0.0
            held = held + share * (e - held)
            slope = slope + share * (1.0 - slope)
            missing = targets[i] - softs[i] * e - compliance * held
            moved = e + missing / (softs[i] + compliance * slope)
            # Eq. (1) as published jumps towards unloading at a reversal: the part in series takes that up at first.
            moved = moved if (moved - reset) * sense > 0.0 else reset
            work[i] = moved
            out[i] = held + slope * (moved - e)
            change = (moved - e) / capacity
            left += change * change
        if left < _CLOSE:
            break


@njit(error_model="numpy", fastmath={"contract"})
def _fill_in_series(out, x, origin, reset, sense, law, caps, knee, parts, work):  # type: ignore[no-untyped-def]
    """Force of the samples of a half-cycle of the device behind an elastic part, perhaps with slack."""
    for i in range(0, out.size, _TOGETHER):
        own = slice(i, min(i + _TOGETHER, out.size))
        n = own.stop - own.start
        targets, softs, guess = work[0, :n], work[1, :n], work[2, :n]
        _divide(targets, softs, x[own], origin, reset, sense, law, caps[own], knee, parts)
        _solve(out[own], targets, softs, reset, sense, law, caps[own], knee, parts, guess)


@njit(cache=True, nogil=True, error_model="numpy")
def gone_further(distance, start):  # type: ignore[no-untyped-def]
    """Distance beyond the furthest point of each half-cycle so far, at each of its samples.

    Nothing else counts as motion: the noise of a displacement at rest goes to and fro, and its ways forth would add up
    to any distance.
    """
    out = np.zeros(distance.size)
    for k in range(start.size - 1):
        furthest = 0.0
        for i in range(start[k], start[k + 1]):
            out[i] = max(distance[i] - furthest, 0.0)
            furthest += out[i]
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def limit_rise(clamping, gone, start, slope):  # type: ignore[no-untyped-def]
    """Keep the capacity from rising faster than the elastic stiffness can follow: `slope` per distance `gone_further`.

    A capacity that recovers makes no force without motion. Without this a pause in which the plates cool looked like a
    force that grows at rest, and friction that rises as the speed falls came back at full height within the last
    hundredth of a millimetre of a stroke, from where the next one then started. The other direction has a capacity of
    its own, so each half-cycle begins anew.
    """
    for k in range(start.size - 1):
        for i in range(start[k] + 1, start[k + 1]):
            clamping[i] = min(clamping[i], clamping[i - 1] + slope * gone[i])


@njit(cache=True, nogil=True, error_model="numpy")
def at_speed(force, speed, gamma, added):  # type: ignore[no-untyped-def]
    """Make a rate-free force, in its place, that of Eq. (2) with a force `added` to it: one number, or n of them."""
    for i in range(force.size):
        force[i] = force[i] * (1.0 + gamma * speed[i]) + added[i if added.size > 1 else 0]


@njit(error_model="numpy", fastmath={"contract"})
def _fill(out, x, origin, reset, sense, law, caps, knee, parts, work):  # type: ignore[no-untyped-def]
    """Force of the samples of a half-cycle, which each have one of their own once the force at its start is known."""
    if parts[2] > 0.0:
        _fill_in_series(out, x, origin, reset, sense, law, caps, knee, parts, work)
    else:
        _fill_straight(out, x, caps, origin, reset, sense, law, knee, parts[3], parts[0], parts[1])


@njit(cache=True, nogil=True, error_model="numpy")
def rate_free_force(out, slopes, at_ends, x, start, turning, direction, law, clamping, parts, start_force):  # type: ignore[no-untyped-def]  # noqa: PLR0913, PLR0917
    """Fill `out` with the rate-free force of one run.

    `law` holds K, Fy, beta; `clamping` multiplies Fy; `parts` holds slack and take-up (mm), compliance (mm/kN),
    the share of the continuous reversal rule, and the share of the slack that lies ahead of the first motion.

    `slopes`, shape (2, n), gets the derivatives of the force after that at the start of its half-cycle and after the
    clamping there; `at_ends`, shape (2, n_half), the same of the force at the end of each half-cycle. Without them for
    shapes (2, 0).
    """
    stiffness, slack, compliance = law[0], parts[0], parts[2]
    # A reversal inside the clearance leads back over what was crossed of it, not over the whole of it.
    ahead = parts.copy()
    ahead[0] = slack * parts[4] if start_force == 0.0 else slack
    knee = knee_of(law[2])
    work, end, moved_end = np.empty((3, _TOGETHER)), np.empty(1), np.empty(1)
    reset = start_force
    for k in range(turning.size):
        a, b, sense = start[k], start[k + 1], float(direction[k])
        xs, caps, origin = x[a:b], clamping[a:b], turning[k]
        _fill(out[a:b], xs, origin, reset, sense, law, caps, knee, ahead, work)
        capacity = law[1] * clamping[b - 1]
        there, last = turning[k + 1 : k + 2], caps[b - a - 1 :]
        if k + 1 < turning.size:
            _fill(end, there, origin, reset, sense, law, last, knee, ahead, work)
        if slopes.size > 0:
            for i, step in enumerate((math.copysign(STEP * capacity, reset), STEP)):
                other = reset + step if i == 0 else reset
                more = step if i == 1 else 0.0
                _fill(slopes[i, a:b], xs, origin, other, sense, law, caps + more, knee, ahead, work)
                slopes[i, a:b] = (slopes[i, a:b] - out[a:b]) / step
                if k + 1 < turning.size:
                    _fill(moved_end, there, origin, other, sense, law, last + more, knee, ahead, work)
                    at_ends[i, k] = (moved_end[0] - end[0]) / step
        if k + 1 < turning.size:
            reach, before, reset = (turning[k + 1] - origin) * sense, reset, end[0]
            if abs(reset) <= 1e-9 * capacity and before * sense <= 0.0:
                crossed = reach + compliance * before * sense + before * sense / stiffness
                ahead[0] = max(slack - ahead[0] + min(max(crossed, 0.0), ahead[0]), 0.0)
            else:
                ahead[0] = slack


@njit(cache=True, nogil=True, error_model="numpy")
def changes_of_force(changes, first, limited, slopes, at_ends, start):  # type: ignore[no-untyped-def]
    """Make small changes of the clamping, shape (n, p), in their place those of the rate-free force.

    `first`, shape (p,), is the change of the force at the first sample; a capacity that `limit_rise` has `limited`
    changes as it did before. Other arguments as from `rate_free_force`.
    """
    reset, before = first.copy(), np.zeros(first.size)
    for k in range(start.size - 1):
        for i in range(start[k], start[k + 1]):
            for j in range(first.size):
                own = before[j] if limited[i] else changes[i, j]
                before[j] = own
                changes[i, j] = slopes[0, i] * reset[j] + slopes[1, i] * own
        for j in range(first.size):
            reset[j] = at_ends[0, k] * reset[j] + at_ends[1, k] * before[j]


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
