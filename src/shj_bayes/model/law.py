"""The velocity-augmented Menegotto-Pinto law: Eq. (1) with Eq. (2) of the paper, and its continuous variant."""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike

from shj_bayes.errors import ModelError, did_you_mean
from shj_bayes.model import kernel
from shj_bayes.model.parameters import FloatArray
from shj_bayes.recording.motion import Motion

VARIANTS = {"published": kernel.PUBLISHED, "continuous": kernel.CONTINUOUS}
OLD_NAMES = {"seed": "published"}  # in results and scripts of earlier versions
BETA_RANGE = (1.0, 500.0)


def force_of_laws(
    motion: Motion, laws: FloatArray, *, variant: str = "published", start_force_kN: float = 0.0
) -> FloatArray:
    """Force for many parameter sets at once.

    In half-cycle k, which starts at displacement x_reset with the rate-free force F_reset,

        F = e / (1 + |e / Fy|^beta)^(1/beta) * (1 + gamma |v|),   e = K (x - x_reset) + F_reset

    (Eqs. 1 and 2 with dep = 1/gamma; the speed enters without its sign, see the decision page on the law).
    ``published`` is this: at a reversal the force jumps by the factor 2^(-1/beta).
    ``continuous`` lets the denominator act only once e has the sign of the motion, so unloading starts from F_reset.

    `laws`, shape (m, 4), are K (kN/mm), Fy (kN), beta, gamma (s/mm) of each set; the rate-free force at the first
    sample is given. The force has shape (m, n_samples), kN. `ModelError` if a parameter is outside what the law allows.
    """
    laws = np.ascontiguousarray(laws, dtype=np.float64)
    variant = variant_named(variant)
    if laws.ndim != 2 or laws.shape[1] != 4:
        raise ModelError(f"laws has shape {laws.shape}; it needs (m, 4) for K, Fy, beta, gamma")
    _check("K", "kN/mm", laws[:, 0], 0.0, np.inf)
    _check("Fy", "kN", laws[:, 1], 0.0, np.inf)
    _check("beta", "", laws[:, 2], *BETA_RANGE)
    _check("gamma", "s/mm", laws[:, 3], -np.inf, np.inf)
    if not np.isfinite(start_force_kN):
        raise ModelError(f"start force = {start_force_kN} kN: it must be a finite number")
    out = np.empty((laws.shape[0], motion.displacement_mm.size))
    half_cycles = (motion.start, motion.turning_mm, motion.direction)
    way = (motion.displacement_mm, motion.speed_mm_s, *half_cycles)
    kernel.force_of_many(out, *way, laws, float(start_force_kN), VARIANTS[variant])
    return out


def variant_named(word: str) -> str:
    """Reversal rule of a word, also of its old name; `ModelError` where there is none."""
    word = OLD_NAMES.get(word, word)
    if word not in VARIANTS:
        raise ModelError(
            f"model '{word}' is not known; choose one of {', '.join(VARIANTS)}{did_you_mean(word, VARIANTS)}"
        )
    return word


def force(
    motion: Motion, *, K: float, Fy: float, beta: float, gamma: float = 0.0, variant: str = "published"
) -> FloatArray:
    """Force of a run from rest for one parameter set, kN; see `force_of_laws`."""
    return np.asarray(force_of_laws(motion, np.array([[K, Fy, beta, gamma]]), variant=variant)[0])


def _check(name: str, unit: str, values: FloatArray, low: float, high: float) -> None:
    """Raise when a value is not finite or lies outside [low, high] (low excluded when it is 0)."""
    ok = np.isfinite(values) & (values >= low) & (values <= high) & ((values > 0) | (low != 0))
    if not ok.all():
        bad = values[np.flatnonzero(~ok)[0]]
        allowed = f"above {low:g}" if high == np.inf and low == 0 else f"{low:g} to {high:g}"
        suffix = f" {unit}" if unit else ""
        raise ModelError(f"{name} = {bad:g}{suffix}: allowed is {allowed}{suffix}")


def work_between(force_kN: FloatArray, displacement_mm: FloatArray, marks: ArrayLike) -> FloatArray:
    """Work of a force, its integral over the displacement, between neighbouring marks, by the trapezoidal rule: J.

    Force of shape (..., n), kN, and displacement of shape (n,), mm, give shape (..., n_marks - 1); marks are sample
    numbers, fractional ones, too.
    """
    piece = 0.5 * (force_kN[..., 1:] + force_kN[..., :-1]) * np.diff(displacement_mm)
    total = np.concatenate([np.zeros((*piece.shape[:-1], 1)), np.cumsum(piece, axis=-1)], axis=-1)
    at = np.asarray(marks, dtype=np.float64)
    whole = np.minimum(np.floor(at).astype(int), displacement_mm.size - 2)
    return np.asarray(np.diff(total[..., whole] + (at - whole) * piece[..., whole], axis=-1))


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
