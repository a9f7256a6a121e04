"""The friction element: many springs in parallel, each with its own slider (Iwan 1966; Jenkins elements).

Eq. (1) is a formula for a whole half-cycle; this is a material with memory that is stepped through time. The sliders'
limits are chosen so that the branch after a reversal from full sliding is that of the continuous rule of Eq. (1). The
first quarter cycle and loops that do not slide fully follow Masing's rule instead and differ a little; how little is
measured in ``docs/decisions/0007-proof.md``.
"""

import numpy as np
from numba import njit

from shj_bayes._util.arrays import FloatArray

N_ELEMENTS = 48


def elements(K: float, Fy: float, beta: float) -> tuple[float, FloatArray]:
    """Stiffness of each spring and the force at which its slider gives way.

    After a reversal the branch falls by B(d): the straight line K d to zero force, then Eq. (1) from zero. Masing's
    rule gives the first loading V(y) = B(2y)/2, whose slope is the share of springs that still hold.

    Parameters
    ----------
    K : float
        Stiffness of all springs together, kN/mm.
    Fy : float
        Force of all sliders together, kN.
    beta : float
        Sharpness of Eq. (1).

    Returns
    -------
    float, array, shape (N_ELEMENTS,)
        Stiffness of one spring, kN/mm; limits of the sliders, kN.
    """
    slope = 1.0 - (np.arange(N_ELEMENTS) + 0.5) / N_ELEMENTS
    past = (slope ** (-beta / (beta + 1.0)) - 1.0) ** (1.0 / beta)  # e/Fy where Eq. (1) has that slope
    limit = 0.5 * (1.0 + past)
    stiffness = K / N_ELEMENTS
    return stiffness, np.asarray(Fy * limit / limit.sum())


@njit(cache=True, error_model="numpy")
def try_move(held, limits, factor, lever, stiffness, step):  # type: ignore[no-untyped-def]
    """Force after a step, and the stiffness of the springs that still hold; the state is left as it is.

    A lever that friction tightens acts by the sign of the force, F = N + lever F: a slider that holds keeps its grip.
    """
    total = 0.0
    holding = 0
    for i in range(held.size):
        cap = limits[i] * factor
        f = held[i] + stiffness * step
        if f > cap / (1.0 - lever):
            f = cap / (1.0 - lever)
        elif f < -cap / (1.0 + lever):
            f = -cap / (1.0 + lever)
        else:
            holding += 1
        total += f
    return total, stiffness * holding


@njit(cache=True, error_model="numpy")
def move(held, limits, factor, lever, stiffness, step):  # type: ignore[no-untyped-def]
    """Take the step."""
    for i in range(held.size):
        cap = limits[i] * factor
        held[i] = min(max(held[i] + stiffness * step, -cap / (1.0 + lever)), cap / (1.0 - lever))


@njit(cache=True, error_model="numpy")
def grip(stretch, stiffness, clearance):  # type: ignore[no-untyped-def]
    """Force and slope of a spring with clearance (mm, from side to side) at zero force."""
    half = 0.5 * clearance
    if stretch > half:
        return stiffness * (stretch - half), stiffness
    if stretch < -half:
        return stiffness * (stretch + half), stiffness
    return 0.0, 0.0


@njit(cache=True, error_model="numpy")
def in_series(reach, held, limits, factor, lever, stiffness, spring, clearance, at):  # type: ignore[no-untyped-def]
    """Position of an element behind a spring with clearance whose far end is at `reach`; Newton held in a bracket."""
    low = min(at, reach) - 0.5 * clearance - 1.0
    high = max(at, reach) + 0.5 * clearance + 1.0
    u = at
    for _ in range(80):
        force, slope = try_move(held, limits, factor, lever, stiffness, u - at)
        pull, spring_slope = grip(reach - u, spring, clearance)
        wrong = force - pull
        if abs(wrong) < 1e-9:
            break
        if wrong > 0.0:
            high = u
        else:
            low = u
        rise = slope + spring_slope
        u = u - wrong / rise if rise > 0.0 else 0.5 * (low + high)
        if not low < u < high:
            u = 0.5 * (low + high)
        if high - low < 1e-12:
            break
    return u
