"""A contact under the published reversal rule: one branch of Eq. (1) after another, each from the force that there is.

The saturation lowers the force behind a reversal at once, by up to the factor 2^(-1/beta). A spring in series would
spring back at that jump, which is a reversal again: under this rule the frame is part of K; only free travel is apart.
"""

import numpy as np
from numba import njit

STILL_MM = 1e-6  # rounding while the grip rests is no reversal


@njit(cache=True, error_model="numpy")
def branches(out, x, clamping, stiffness, capacity, beta, lever, clearance):  # type: ignore[no-untyped-def]
    """Force (kN) along displacements `x` (mm) of a grip with clearance (mm, from side to side).

    A contact that grows stronger while it slides sticks until its spring has loaded it: the capacity that counts rises
    by no more than the spring can, within a branch.
    """
    half = 0.5 * clearance
    u, e, sense, force, limit = x[0], 0.0, 0.0, 0.0, 0.0
    for i in range(x.size):
        cap = clamping[i] * capacity
        pulled, pulled_sense = _stepped(e, sense, force, stiffness * (x[i] - half - u))
        pushed, pushed_sense = _stepped(e, sense, force, stiffness * (x[i] + half - u))
        moved, turned = 0.0, False
        if pulled > 0.0:
            if abs(x[i] - half - u) > STILL_MM:
                moved, turned = abs(x[i] - half - u), pulled_sense != sense
                u, e, sense = x[i] - half, pulled, pulled_sense
        elif pushed < 0.0:
            if abs(x[i] + half - u) > STILL_MM:
                moved, turned = abs(x[i] + half - u), pushed_sense != sense
                u, e, sense = x[i] + half, pushed, pushed_sense
        else:  # in the gap the contact rests where it holds no force
            u, e, turned = u - e / stiffness, 0.0, True
        limit = cap if turned or i == 0 else min(cap, limit + stiffness * moved)
        force = _saturated(e, sense, limit, beta, lever)
        out[i] = force


@njit(cache=True, error_model="numpy")
def _stepped(e, sense, force, step):  # type: ignore[no-untyped-def]
    """Elastic force and sense of motion after a step (kN); one against the sense starts from the force that there is.

    That is the force before the step: behind a reversal the capacity may be another one at once.
    """
    if step * sense < 0.0:
        e = force
    return e + step, np.sign(step) if step != 0.0 else sense


@njit(cache=True, error_model="numpy")
def _saturated(e, sense, cap, beta, lever):  # type: ignore[no-untyped-def]
    """Eq. (1); a lever that friction tightens acts by the sense of the motion, which holds Eq. (1)'s capacity."""
    limit = cap / (1.0 - lever if sense > 0.0 else 1.0 + lever)
    u = abs(e) / limit
    if u < 1.0:
        return e * (1.0 + u**beta) ** (-1.0 / beta)
    return np.sign(e) * limit * (1.0 + u ** (-beta)) ** (-1.0 / beta)
