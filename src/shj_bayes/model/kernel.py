"""Compiled arithmetic of Eq. (1): the saturation, the reversals, and the force of many parameter sets at once.

Everything here works on plain arrays; `law` gives it names, units and checks.
The saturation ``e / (1 + |e/Fy|^beta)^(1/beta)`` is evaluated with base-2 logarithms and exponentials written as
polynomials on the bits of a double, because the compiler turns such loops into vector instructions and a call of the
mathematics library stops it from doing so (three to four times slower, measured by ``benchmarks/law.py``).
Tried and rejected: the power form of the equation, which overflows for beta above about 150 where the elastic branch
runs far ahead of Fy.
"""

from __future__ import annotations

import math
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic

SEED, CONTINUOUS = 0, 1
_MAGIC = 6755399441055744.0  # 1.5 * 2^52: adding it leaves a rounded integer in the low bits of a double
_TWO_OVER_LN2 = 2.0 / math.log(2.0)
_LN2 = math.log(2.0)


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
def _log2(u: float) -> float:
    """Binary logarithm of a positive normal double, to about 2e-16."""
    k = (_bits(u) - 0x3FE6A09E667F3BCD) >> 52  # exponent so that the mantissa lies in [sqrt(1/2), sqrt(2))
    m = _double(_bits(u) - (k << 52))
    exponent = _double(k + 0x4338000000000000) - _MAGIC
    s = (m - 1.0) / (m + 1.0)
    z = s * s
    series = 1.0 / 21.0
    series = series * z + 1.0 / 19.0
    series = series * z + 1.0 / 17.0
    series = series * z + 1.0 / 15.0
    series = series * z + 1.0 / 13.0
    series = series * z + 1.0 / 11.0
    series = series * z + 1.0 / 9.0
    series = series * z + 1.0 / 7.0
    series = series * z + 1.0 / 5.0
    series = series * z + 1.0 / 3.0
    series = series * z + 1.0
    return float(exponent + _TWO_OVER_LN2 * s * series)


@njit(error_model="numpy", fastmath={"contract"})
def _exp2(t: float) -> float:
    """Two to the power t for |t| below 1000, to about 3e-16."""
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


@njit(error_model="numpy", fastmath={"contract"})
def saturate(e: float, per_capacity: float, beta: float, per_beta: float) -> float:
    """Eq. (1): elastic force `e` held below the capacity 1/`per_capacity` with sharpness `beta` = 1/`per_beta`."""
    size = max(abs(e) * per_capacity, 1e-290)
    power = beta * _log2(size)
    # Far above the knee log2(1 + 2^p) is p to double precision, and 2^p would overflow.
    soft = _log2(1.0 + _exp2(min(max(power, -900.0), 60.0)))
    return e * _exp2(-(max(soft, power) if power > 60.0 else soft) * per_beta)


@njit(error_model="numpy", fastmath={"contract"})
def _branch_seed(out, x, speed, x_reset, reset, law):  # type: ignore[no-untyped-def]
    """One half-cycle of Eq. (1) with Eq. (2) as published."""
    stiffness, per_capacity, beta, per_beta, gamma = law[0], 1.0 / law[1], law[2], 1.0 / law[2], law[3]
    for i in range(out.size):
        e = stiffness * (x[i] - x_reset) + reset
        out[i] = saturate(e, per_capacity, beta, per_beta) * (1.0 + gamma * speed[i])


@njit(error_model="numpy", fastmath={"contract"})
def _branch_continuous(out, x, speed, x_reset, reset, law, sense):  # type: ignore[no-untyped-def]
    """One half-cycle in which the saturation acts only on force that has the sign of the motion."""
    stiffness, per_capacity, beta, per_beta, gamma = law[0], 1.0 / law[1], law[2], 1.0 / law[2], law[3]
    for i in range(out.size):
        e = stiffness * (x[i] - x_reset) + reset
        held = saturate(e, per_capacity, beta, per_beta)
        out[i] = (held if e * sense > 0.0 else e) * (1.0 + gamma * speed[i])


@njit(cache=True, nogil=True, error_model="numpy")
def _force_of_run(out, x, speed, start, turning, direction, law, start_force, variant):  # type: ignore[no-untyped-def]
    """Fill `out` with the force of one run; `law` holds K, Fy, beta, gamma."""
    reset = start_force
    for k in range(turning.size):
        a, b, sense = start[k], start[k + 1], direction[k]
        if variant == SEED:
            _branch_seed(out[a:b], x[a:b], speed[a:b], turning[k], reset, law)
        else:
            _branch_continuous(out[a:b], x[a:b], speed[a:b], turning[k], reset, law, sense)
        if k + 1 < turning.size:
            e = law[0] * (turning[k + 1] - turning[k]) + reset
            reset = saturate(e, 1.0 / law[1], law[2], 1.0 / law[2]) if (variant == SEED or e * sense > 0.0) else e


@njit(cache=True, nogil=True, error_model="numpy")
def force_of_many(out, x, speed, start, turning, direction, laws, start_force, variant):  # type: ignore[no-untyped-def]
    """Fill row j of `out` with the force for row j of `laws` (K, Fy, beta, gamma)."""
    for j in range(laws.shape[0]):
        _force_of_run(out[j], x, speed, start, turning, direction, laws[j], start_force, variant)
