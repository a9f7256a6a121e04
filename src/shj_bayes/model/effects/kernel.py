"""Compiled law with effects: Eq. (1) with a capacity that changes, slack, compliance and a reversal rule."""

import math

import numpy as np
from numba import njit

from shj_bayes.model.kernel import knee_of, saturate, saturate_with_slope

# Bolts with unlike clearances: a part of the stiffness comes back first. 0.3 to 0.5 fit brfd-lehigh alike.
FIRST = 0.4

STEP = 1e-6  # of the capacity, for derivatives
_TOGETHER = 64  # samples whose equation is solved together, until the last one is close
_MAX_NEWTON = 40
_CLOSE = 1e-16  # square of the last change, in units of the capacity; the next would be about its square


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
