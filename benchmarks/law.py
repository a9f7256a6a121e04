"""Nanoseconds per sample of the compiled law against three plainer ways to write it, all measured in one run.

Run ``python benchmarks/law.py`` (half a minute). Every way is first checked to give the same force to 1e-9 of Fy;
the best of several repeats is reported, because other work on the machine only ever makes a repeat slower.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable

import numpy as np
from numba import njit

from shj_bayes.model.law import force_of_laws
from shj_bayes.model.parameters import FloatArray
from shj_bayes.recording.motion import Motion
from shj_bayes.recording.protocol import exact_motion, table_1

LAW = (18.0, 80.0, 0.01)  # K kN/mm, Fy kN, gamma s/mm


def whole_arrays(motion: Motion, beta: float) -> FloatArray:
    """Numpy on one half-cycle after the other."""
    K, Fy, gamma = LAW
    out = np.empty(motion.displacement_mm.size)
    reset = 0.0

    def held(e: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore"):
            return np.asarray(e * np.exp(-np.logaddexp(0.0, beta * np.log(np.abs(e) / Fy)) / beta))

    for k in range(motion.n_half):
        part = slice(int(motion.start[k]), int(motion.start[k + 1]))
        e = K * (motion.displacement_mm[part] - motion.turning_mm[k]) + reset
        out[part] = held(e) * (1 + gamma * motion.speed_mm_s[part])
        if k + 1 < motion.n_half:
            reset = float(held(np.array([K * (motion.turning_mm[k + 1] - motion.turning_mm[k]) + reset]))[0])
    return out


def plain_loop(motion: Motion, beta: float) -> FloatArray:
    """One sample after the other in Python."""
    K, Fy, gamma = LAW
    x, speed = motion.displacement_mm.tolist(), motion.speed_mm_s.tolist()
    turning, start = motion.turning_mm.tolist(), motion.start.tolist()
    out, reset = [], 0.0

    def held(e: float) -> float:
        size = abs(e) / Fy
        if size > 1.0:  # the same expression with the large power taken out, which would overflow
            return math.copysign(Fy, e) * math.pow(1.0 + size**-beta, -1.0 / beta)
        return e * math.pow(1.0 + size**beta, -1.0 / beta)

    for k in range(len(turning)):
        for i in range(start[k], start[k + 1]):
            out.append(held(K * (x[i] - turning[k]) + reset) * (1.0 + gamma * speed[i]))
        if k + 1 < len(turning):
            reset = held(K * (turning[k + 1] - turning[k]) + reset)
    return np.array(out)


@njit(error_model="numpy")
def _pow_held(e, fy, beta):  # type: ignore[no-untyped-def]
    size = abs(e) / fy
    if size > 1.0:
        return math.copysign(fy, e) * (1.0 + size**-beta) ** (-1.0 / beta)
    return e * (1.0 + size**beta) ** (-1.0 / beta)


@njit(error_model="numpy")
def _pow_loop(out, x, speed, start, turning, stiffness, fy, beta, gamma):  # type: ignore[no-untyped-def]
    reset = 0.0
    for k in range(turning.size):
        for i in range(start[k], start[k + 1]):
            out[i] = _pow_held(stiffness * (x[i] - turning[k]) + reset, fy, beta) * (1.0 + gamma * speed[i])
        if k + 1 < turning.size:
            reset = _pow_held(stiffness * (turning[k + 1] - turning[k]) + reset, fy, beta)


def compiled_pow(motion: Motion, beta: float) -> FloatArray:
    """Compile the plain loop with numba, with the library's power function."""
    K, Fy, gamma = LAW
    out = np.empty(motion.displacement_mm.size)
    _pow_loop(out, motion.displacement_mm, motion.speed_mm_s, motion.start, motion.turning_mm, K, Fy, beta, gamma)
    return out


def best(work: Callable[[], object], repeats: int) -> float:
    """Shortest time of several repeats, s."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return min(times)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rate", type=float, default=20.0, help="sampling rate of Table 1, Hz")
    parser.add_argument("--repeats", type=int, default=40)
    options = parser.parse_args()
    motion = exact_motion(table_1(), options.rate)[1]
    n = motion.displacement_mm.size
    print(f"{n} samples; nanoseconds per sample, and how many times slower than the kernel")
    for beta in (10.0, 100.0):
        K, Fy, gamma = LAW
        laws = np.tile([K, Fy, beta, gamma], (16, 1))
        out = np.empty((16, n))
        reference = force_of_laws(motion, laws)[0]

        def kernel(laws: FloatArray = laws, out: FloatArray = out) -> object:
            return force_of_laws(motion, laws, out=out)

        base = best(kernel, options.repeats) / (16 * n)
        print(f"beta {beta:g}\n  {'kernel (16 sets a call)':36s} {1e9 * base:8.2f}      1.0")
        plainer = (
            ("numba loop with pow", compiled_pow),
            ("numpy on half-cycles", whole_arrays),
            ("Python loop", plain_loop),
        )
        for name, way in plainer:
            assert np.abs(way(motion, beta) - reference).max() < 1e-9 * Fy, name

            def run(way: Callable[[Motion, float], FloatArray] = way, beta: float = beta) -> object:
                return way(motion, beta)

            seconds = best(run, options.repeats if way is not plain_loop else 8) / n
            print(f"  {name:36s} {1e9 * seconds:8.2f} {seconds / base:8.1f}")


if __name__ == "__main__":
    main()
