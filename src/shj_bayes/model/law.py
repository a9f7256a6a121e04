"""The velocity-augmented Menegotto-Pinto law: Eq. (1) with Eq. (2) of the paper, and its continuous variant.

The compiled functions work on plain arrays, many parameter sets at once; those below give them names and checks.
The saturation is written so that the compiler turns its loop into vector instructions: with u = |e|/Fy and
w = min(u, 1/u)^beta, Eq. (1) is min(|e|, Fy) (1 + w)^(-1/beta). w comes from a logarithm and an exponential written as
polynomials on the bits of a double, and the last factor is a polynomial in w whose coefficients belong to beta
(`knee_of`). Error below 1e-14 for every beta from 1 to 500 (``tests/oracle``).
Tried and rejected (``benchmarks/law.py``): calls of the mathematics library, which stop the vector instructions (ten
times slower); a second logarithm and exponential in place of the polynomial in w (1.8 times slower); the power form of
the equation, which overflows for beta above about 150 where the elastic branch runs far ahead of Fy.
"""

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic
from numpy.polynomial.chebyshev import cheb2poly
from numpy.typing import ArrayLike

from shj_bayes._util.arrays import FloatArray
from shj_bayes.errors import ModelError, did_you_mean
from shj_bayes.recording.motion import Motion

PUBLISHED, CONTINUOUS = 0, 1
DEGREE = 18  # of the knee's polynomial: its singularity at w = -1 makes the error 5.8^-18 = 1.7e-14
CHUNK = 64  # samples that are looked at together for being all elastic or all saturated
_MAGIC = 6755399441055744.0  # 1.5 * 2^52: adding it leaves a rounded integer in the low bits of a double
_LN2 = math.log(2.0)
_PER_LN2 = 2.0 / _LN2
_POWERS = np.zeros((DEGREE + 1, DEGREE + 1))  # column k: the powers of x that make up the Chebyshev polynomial T_k
for _k in range(DEGREE + 1):
    _POWERS[: _k + 1, _k] = cheb2poly(np.eye(_k + 1)[_k])
VARIANTS = {"published": PUBLISHED, "continuous": CONTINUOUS}
OLD_NAMES = {"seed": "published"}  # in results and scripts of earlier versions
BETA_RANGE = (1.0, 500.0)


def _bits_code(_typing: Any, _value: Any) -> Any:
    """Reinterpret a double as a 64-bit integer."""

    def codegen(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], ir.IntType(64))

    return types.int64(types.float64), codegen


def _double_code(_typing: Any, _value: Any) -> Any:
    """Reinterpret a 64-bit integer as a double."""

    def codegen(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.bitcast(args[0], ir.DoubleType())

    return types.float64(types.int64), codegen


_bits: Any = intrinsic(_bits_code)
_double: Any = intrinsic(_double_code)


@njit(error_model="numpy", fastmath={"contract"})
def log2(u: float) -> float:
    """Binary logarithm of a positive normal double, to about 2e-16 of it."""
    k = (_bits(u) - 0x3FE6A09E667F3BCD) >> 52  # exponent so that the mantissa lies in [sqrt(1/2), sqrt(2))
    m = _double(_bits(u) - (k << 52))
    exponent = _double(k + 0x4338000000000000) - _MAGIC
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    series = _PER_LN2 / 21.0
    series = series * z + _PER_LN2 / 19.0
    series = series * z + _PER_LN2 / 17.0
    series = series * z + _PER_LN2 / 15.0
    series = series * z + _PER_LN2 / 13.0
    series = series * z + _PER_LN2 / 11.0
    series = series * z + _PER_LN2 / 9.0
    series = series * z + _PER_LN2 / 7.0
    series = series * z + _PER_LN2 / 5.0
    series = series * z + _PER_LN2 / 3.0
    series = series * z + _PER_LN2
    return float(exponent + s * series)


@njit(error_model="numpy", fastmath={"contract"})
def exp2(t: float) -> float:
    """Two to the power t for |t| below 1000, to about 3e-16 of it."""
    shifted = t + _MAGIC
    f = (t - (shifted - _MAGIC)) * _LN2
    p = 1.0 / 6227020800.0
    p = p * f + 1.0 / 479001600.0
    p = p * f + 1.0 / 39916800.0
    p = p * f + 1.0 / 3628800.0
    p = p * f + 1.0 / 362880.0
    p = p * f + 1.0 / 40320.0
    p = p * f + 1.0 / 5040.0
    p = p * f + 1.0 / 720.0
    p = p * f + 1.0 / 120.0
    p = p * f + 1.0 / 24.0
    p = p * f + 1.0 / 6.0
    p = p * f + 0.5
    p = p * f + 1.0
    p = p * f + 1.0
    return float(_double(_bits(p) + ((_bits(shifted) - 0x4338000000000000) << 52)))


@njit(error_model="numpy")
def knee_of(beta):  # type: ignore[no-untyped-def]
    """Coefficients of (1 + w)^(-1/beta) in powers of x = 2 w - 1, lowest first, as a tuple.

    With 1 + w = (3 + x)/2 the Chebyshev coefficients t_k of (3 + x)^-b, b = 1/beta, obey
    (k - 1 + b) t_(k-1) + 6 k t_k + (k + 1 - b) t_(k+1) = 0; run downwards (Miller) this keeps all digits of the small
    ones, which interpolation loses when they are turned into powers.
    """
    b = 1.0 / beta
    t = np.zeros(DEGREE + 14)
    t[DEGREE + 12] = 1e-30
    for k in range(DEGREE + 12, 0, -1):
        t[k - 1] = -(6.0 * k * t[k] + (k + 1.0 - b) * t[k + 1]) / (k - 1.0 + b)
    t[0] *= 0.5
    at_zero = 0.0  # w = 0 is x = -1, where the value is 1
    for k in range(DEGREE + 13):
        at_zero += t[k] if k % 2 == 0 else -t[k]
    c = np.zeros(DEGREE + 1)
    for i in range(DEGREE + 1):
        for k in range(i, DEGREE + 1):
            c[i] += _POWERS[i, k] * t[k]
        c[i] /= at_zero
    return (
        c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8], c[9],
        c[10], c[11], c[12], c[13], c[14], c[15], c[16], c[17], c[18],
    )  # fmt: skip


@njit(error_model="numpy", fastmath={"contract"}, inline="always")  # too long for the compiler to do so by itself
def _bend(u, beta, knee):  # type: ignore[no-untyped-def]
    """2 w - 1 and (1 + w)^(-1/beta), where w is u^beta below saturation and u^-beta above."""
    c0, c1, c2, c3, c4, c5, c6, c7, c8, c9, c10, c11, c12, c13, c14, c15, c16, c17, c18 = knee
    x = 2.0 * exp2(-min(abs(beta * log2(u)), 60.0)) - 1.0  # 2^-60 is nothing beside 1
    g = c18
    g = g * x + c17
    g = g * x + c16
    g = g * x + c15
    g = g * x + c14
    g = g * x + c13
    g = g * x + c12
    g = g * x + c11
    g = g * x + c10
    g = g * x + c9
    g = g * x + c8
    g = g * x + c7
    g = g * x + c6
    g = g * x + c5
    g = g * x + c4
    g = g * x + c3
    g = g * x + c2
    g = g * x + c1
    g = g * x + c0
    return x, g


@njit(error_model="numpy", fastmath={"contract"}, inline="always")
def saturate(e, capacity, per_capacity, beta, knee):  # type: ignore[no-untyped-def]
    """Eq. (1): elastic force `e` held below `capacity` with sharpness `beta`; `knee` is `knee_of` (beta)."""
    u = max(abs(e) * per_capacity, 1e-290)
    _, g = _bend(u, beta, knee)
    return (e if u < 1.0 else math.copysign(capacity, e)) * g


@njit(error_model="numpy", fastmath={"contract"}, inline="always")
def saturate_with_slope(e, capacity, per_capacity, beta, knee):  # type: ignore[no-untyped-def]
    """Eq. (1) as `saturate`, and its derivative (1 + u^beta)^(-1/beta - 1)."""
    u = max(abs(e) * per_capacity, 1e-290)
    x, g = _bend(u, beta, knee)
    share = 0.5 * (1.0 + x)  # w
    if u < 1.0:
        held = e * g
        slope = g / (1.0 + share)
    else:
        held = math.copysign(capacity, e) * g
        slope = g * share / (u * (1.0 + share))
    return held, slope


@njit(error_model="numpy")
def held_at(e, sense, capacity, beta, knee):  # type: ignore[no-untyped-def]
    """Rate-free force at one moment; `sense` is that of the motion for the continuous rule, 0 for the published one."""
    return e if e * sense < 0.0 else saturate(e, capacity, 1.0 / capacity, beta, knee)


@njit(error_model="numpy")
def elastic_below(beta):  # type: ignore[no-untyped-def]
    """|e|/Fy below which Eq. (1) is e, and above whose inverse it is Fy, to double precision."""
    return (1e-16 * beta) ** (1.0 / beta)


@njit(error_model="numpy", fastmath={"nnan", "nsz", "reassoc"})
def _range(x):  # type: ignore[no-untyped-def]
    low = x[0]
    high = x[0]
    for i in range(x.size):
        low = min(low, x[i])
        high = max(high, x[i])
    return low, high


@njit(error_model="numpy")
def _regime(low, high, origin, reset, law, sense, elastic):  # type: ignore[no-untyped-def]
    """Tell how the law acts between two displacements: 1 or -1 saturated, 0 elastic, 2 in general."""
    least = law[0] * (low - origin) + reset
    most = law[0] * (high - origin) + reset
    if least * elastic > law[1] and not least * sense < 0.0:
        return 1
    if -most * elastic > law[1] and not most * sense < 0.0:
        return -1
    return 0 if max(-least, most) < elastic * law[1] else 2


@njit(error_model="numpy", fastmath={"contract"})
def _span(out, x, speed, regime, origin, reset, law, knee, sense):  # type: ignore[no-untyped-def]
    """Force of neighbouring samples of one `regime`, as `_regime` gives it."""
    stiffness, capacity, beta, gamma = law[0], law[1], law[2], law[3]
    if regime == 0:
        for i in range(out.size):
            out[i] = (stiffness * (x[i] - origin) + reset) * (1.0 + gamma * speed[i])
    elif regime < 2:
        for i in range(out.size):
            out[i] = regime * capacity * (1.0 + gamma * speed[i])
    else:
        per_capacity = 1.0 / capacity
        for i in range(out.size):
            e = stiffness * (x[i] - origin) + reset
            held = saturate(e, capacity, per_capacity, beta, knee)
            out[i] = (e if e * sense < 0.0 else held) * (1.0 + gamma * speed[i])


@njit(cache=True, nogil=True, error_model="numpy")
def force_of_many(out, x, speed, start, turning, direction, laws, start_force, variant):  # type: ignore[no-untyped-def]
    """Fill row j of `out` with the force for row j of `laws` (K, Fy, beta, gamma)."""
    n_chunks = 0
    for k in range(turning.size):
        n_chunks += (start[k + 1] - start[k] + CHUNK - 1) // CHUNK
    low = np.empty(n_chunks)
    high = np.empty(n_chunks)
    c = 0
    for k in range(turning.size):
        for a in range(start[k], start[k + 1], CHUNK):
            low[c], high[c] = _range(x[a : min(a + CHUNK, start[k + 1])])
            c += 1
    for j in range(laws.shape[0]):
        law = laws[j]
        knee = knee_of(law[2])
        elastic = elastic_below(law[2])
        reset = start_force
        c = 0
        for k in range(turning.size):
            sense = float(direction[k]) if variant == CONTINUOUS else 0.0
            a = start[k]
            while a < start[k + 1]:
                regime = _regime(low[c], high[c], turning[k], reset, law, sense, elastic)
                b = min(a + CHUNK, start[k + 1])
                c += 1
                while b < start[k + 1] and _regime(low[c], high[c], turning[k], reset, law, sense, elastic) == regime:
                    b = min(b + CHUNK, start[k + 1])
                    c += 1
                _span(out[j, a:b], x[a:b], speed[a:b], regime, turning[k], reset, law, knee, sense)
                a = b
            if k + 1 < turning.size:
                reset = held_at(law[0] * (turning[k + 1] - turning[k]) + reset, sense, law[1], law[2], knee)


# Shares of the speed of the last sample but one of a half-cycle at which samples are added up to its end. Friction that
# rises as the speed falls rises most there, and no faster than the stiffness allows: the force at the turning point
# hangs on the whole way to it. Without them it was off by up to 1.2 kN of 65 at 10 Hz, with the end alone by 1.1.
SLOWING = (0.5, 0.25, 0.125, 0.0625, 0.03125, 0.0)
# Distances from a turning point, of the half stroke, at which samples that thinning leaves out go on being followed.
NEAR_TURNING = (0.0003, 0.001, 0.003, 0.01)
OF_MOTION = ("time_s", "displacement_mm", "speed_mm_s")
ROWS = (*OF_MOTION, "direction", "slip_mm", "travel_m", "amplitude_mm", "acceleration_mm_s2", "rest_s")


def course_of(
    time: FloatArray, displacement: FloatArray, velocity: FloatArray, travel: FloatArray, acceleration: FloatArray
) -> FloatArray:
    """Polynomials in the time since each sample, for `fill_between`, shape (n_samples - 1, 9).

    Displacement (mm) follows the cubics through displacement and velocity of the samples on either side, travel (m) and
    acceleration the straight lines.
    """
    step = np.diff(time)
    step = np.where(step > 0.0, step, np.inf)  # two points of one moment have nothing between them
    mean, before, after = np.diff(displacement) / step, velocity[:-1], velocity[1:]
    second, third = (3 * mean - 2 * before - after) / step, (before + after - 2 * mean) / step**2
    rows = [time[:-1], displacement[:-1], before, second, third]
    for channel in (travel, acceleration):
        rows += [channel[:-1], np.diff(channel) / step]
    return np.ascontiguousarray(np.stack(rows, axis=1))


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def fill_between(out, own, time, lag, start, of_half, course, way):  # type: ignore[no-untyped-def]
    """Fill the rows of `out`, in the order of `ROWS`, with what was `lag` before each time, and `own` with where it is.

    In between come the samples of `way`: their rows, and where they begin in each half-cycle. Before the first sample
    and after the last everything stands at what it was there. `start` is where in `time` each half-cycle has come;
    `of_half` holds direction, turning point, amplitude and rest of each.
    """
    direction, turning, amplitude, rest = of_half
    rows, begins = way
    i, last, m = 0, course.shape[0] - 1, 0
    for half in range(direction.size):
        sense, origin, w = float(direction[half]), turning[half], begins[half]
        until = rows[0, w] + lag if w < begins[half + 1] else np.inf
        for k in range(start[half], start[half + 1] + 1):
            ends = k == start[half + 1]
            while w < begins[half + 1] and (ends or until <= time[k]):
                out[:, m] = rows[:, w]
                out[0, m] = until
                m, w = m + 1, w + 1
                until = rows[0, w] + lag if w < begins[half + 1] else np.inf
            if ends:
                break
            then = min(max(time[k] - lag, time[0]), time[-1])
            while i < last and course[i + 1, 0] <= then:
                i += 1
            p = course[i]
            s = then - p[0]
            x = p[1] + s * (p[2] + s * (p[3] + s * p[4]))
            # The first half-cycle may begin with a rest on either side of its origin.
            x = origin if half > 0 and lag != 0.0 and sense * (x - origin) < 0.0 else x
            out[0, m] = time[k]
            out[1, m] = x
            out[2, m] = max(sense * (p[2] + s * (2.0 * p[3] + s * 3.0 * p[4])), 0.0)
            out[3, m] = sense
            out[4, m] = abs(x - origin)
            out[5, m] = p[5] + s * p[6]
            out[6, m] = amplitude[half]
            out[7, m] = p[7] + s * p[8]
            out[8, m] = rest[half]
            own[k] = m
            m += 1


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
    force_of_many(out, *way, laws, float(start_force_kN), VARIANTS[variant])
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
