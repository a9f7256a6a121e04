"""Nanoseconds per sample of the compiled law against the ways it is otherwise written, all measured in one run.

Run ``python benchmarks/law.py`` (a minute). Every way is first checked to give the same force to 1e-9 of Fy. The C
reference (``law_reference.c``) is compiled when gcc is there, with glibc's vector mathematics; OpenSees' own material
is called when openseespy is installed (``benchmarks/requirements.txt``), for the time of a call: it is another law.
"""

from __future__ import annotations

import argparse
import ctypes
import importlib
import math
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy_posterior import saturate
from timing import best

from shj_bayes._util.arrays import FloatArray
from shj_bayes.model import law as kernel
from shj_bayes.model.law import force_of_laws
from shj_bayes.recording.motion import Motion, exact_motion, table_1

LAW = (18.0, 80.0, 0.01)  # K kN/mm, Fy kN, gamma s/mm
Way = Callable[[Motion, float], FloatArray]
MANY = 16  # parameter sets in a call of the kernel
GCC = ("-O3", "-march=native", "-ffast-math", "-fopenmp-simd", "-shared", "-fPIC")


def held(e: FloatArray, beta: float) -> FloatArray:
    """Eq. (1) in numpy, without overflow."""
    with np.errstate(divide="ignore"):
        return np.asarray(e * np.exp(-np.logaddexp(0.0, beta * np.log(np.abs(e) / LAW[1])) / beta))


def held_at(e: float, beta: float) -> float:
    """Eq. (1) at one moment, in plain Python."""
    size = abs(e) / LAW[1]
    if size > 1.0:  # the same expression with the large power taken out, which would overflow
        return math.copysign(LAW[1], e) * math.pow(1.0 + size**-beta, -1.0 / beta)
    return e * math.pow(1.0 + size**beta, -1.0 / beta)


def resets(motion: Motion, beta: float) -> list[float]:
    """Force at the start of each half-cycle."""
    turning, out = motion.turning_mm.tolist(), [0.0]
    for before, after in pairwise(turning):
        out.append(held_at(LAW[0] * (after - before) + out[-1], beta))
    return out


def half_cycles(motion: Motion, beta: float) -> FloatArray:
    """Numpy on one half-cycle after the other."""
    out = np.empty(motion.displacement_mm.size)
    for k, reset in enumerate(resets(motion, beta)):
        part = slice(int(motion.start[k]), int(motion.start[k + 1]))
        e = LAW[0] * (motion.displacement_mm[part] - motion.turning_mm[k]) + reset
        out[part] = held(e, beta) * (1 + LAW[2] * motion.speed_mm_s[part])
    return out


def whole_array() -> Way:
    """Numpy at its best: the reversals first, then one pass over all samples, in place, in memory that is kept."""
    kept: dict[int, tuple[FloatArray, ...]] = {}

    def way(motion: Motion, beta: float) -> FloatArray:
        if id(motion) not in kept:
            lengths = np.diff(motion.start)
            since = motion.displacement_mm - np.repeat(motion.turning_mm, lengths)
            kept[id(motion)] = (since, lengths.astype(np.float64), np.empty_like(since), np.empty_like(since))
        since, lengths, e, w = kept[id(motion)]
        np.multiply(since, LAW[0], out=e)
        e += np.repeat(resets(motion, beta), lengths.astype(np.int64))
        saturate(e, w, LAW[1], beta)
        np.multiply(motion.speed_mm_s, LAW[2], out=w)
        w += 1.0
        e *= w
        return e

    return way


def plain_loop(motion: Motion, beta: float) -> FloatArray:
    """One sample after the other in Python."""
    K, gamma = LAW[0], LAW[2]
    x, speed = motion.displacement_mm.tolist(), motion.speed_mm_s.tolist()
    turning, start = motion.turning_mm.tolist(), motion.start.tolist()
    out = []
    for k, reset in enumerate(resets(motion, beta)):
        for i in range(start[k], start[k + 1]):
            out.append(held_at(K * (x[i] - turning[k]) + reset, beta) * (1.0 + gamma * speed[i]))
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


def c_reference(folder: Path) -> Way | None:
    """Compile the C reference; None without gcc."""
    gcc, library = shutil.which("gcc"), folder / "law_reference.so"
    if gcc is None:
        return None
    source = Path(__file__).with_name("law_reference.c")
    if subprocess.run([gcc, *GCC, str(source), "-o", str(library), "-lmvec", "-lm"], check=False).returncode:
        return None
    function = ctypes.CDLL(str(library)).force
    kept = np.empty(0)

    def way(motion: Motion, beta: float) -> FloatArray:
        nonlocal kept
        if kept.size != motion.displacement_mm.size:
            kept = np.empty(motion.displacement_mm.size)
        law = np.array([LAW[0], LAW[1], beta, LAW[2]])
        arrays = (kept, motion.displacement_mm, motion.speed_mm_s, motion.start, motion.turning_mm)
        pointers = [ctypes.c_void_p(a.ctypes.data) for a in arrays]
        function(*pointers, ctypes.c_ssize_t(motion.n_half), ctypes.c_void_p(law.ctypes.data))
        return kept

    return way


def opensees() -> Callable[[Motion], None] | None:
    """Prepare OpenSees' Steel02 (Menegotto-Pinto) to be driven sample by sample; None where it is not installed."""
    try:
        ops: Any = importlib.import_module("openseespy.opensees")
    except (ImportError, RuntimeError, OSError):
        return None
    ops.wipe()
    ops.model("basic", "-ndm", 1, "-ndf", 1)
    ops.uniaxialMaterial("Steel02", 1, LAW[1], LAW[0], 1e-6, 20.0, 0.925, 0.15)
    ops.testUniaxialMaterial(1)

    def drive(motion: Motion) -> None:
        for x in motion.displacement_mm.tolist():
            ops.setStrain(x)
            ops.getStress()

    return drive


def ways(folder: Path) -> Iterator[tuple[str, Way, int]]:
    """All other ways, with how often to repeat them."""
    reference = c_reference(folder)
    if reference is not None:
        yield "C, gcc with libmvec", reference, 40
    yield "numpy, whole array in one pass", whole_array(), 40
    yield "numba loop with pow", compiled_pow, 20
    yield "numpy on half-cycles", half_cycles, 20
    yield "Python loop", plain_loop, 4


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--rate", type=float, default=20.0, help="sampling rate of Table 1, Hz")
    parser.add_argument("--beta", type=float, nargs="+", default=[1.0, 3.0, 10.0, 30.0, 100.0, 300.0])
    options = parser.parse_args()
    motion = exact_motion(table_1(), options.rate)[1]
    n = motion.displacement_mm.size
    print(f"{n} samples (one run of Table 1 at {options.rate:g} Hz); nanoseconds per sample, one processor")
    print(f"{'':36s}" + "".join(f"{f'beta {beta:g}':>12s}" for beta in options.beta))
    out = np.empty((MANY, n))
    laws = {beta: np.tile([LAW[0], LAW[1], beta, LAW[2]], (MANY, 1)) for beta in options.beta}
    given = (motion.displacement_mm, motion.speed_mm_s, motion.start, motion.turning_mm, motion.direction)
    own = []
    for sets in laws.values():
        took = best(lambda x=sets: kernel.force_of_many(out, *given, x, 0.0, kernel.PUBLISHED), 30)  # type: ignore[misc]
        own.append(took / (MANY * n))
    print(f"{f'shj-bayes, {MANY} sets a call':36s}" + "".join(f"{1e9 * s:12.2f}" for s in own), flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for name, way, repeats in ways(Path(folder)):
            cells = []
            for beta, base in zip(options.beta, own, strict=True):
                reference = force_of_laws(motion, laws[beta][:1])[0]
                assert np.abs(way(motion, beta) - reference).max() < 1e-9 * LAW[1], name
                seconds = best(lambda w=way, b=beta: w(motion, b), repeats) / n  # type: ignore[misc]
                cells.append(f"{1e9 * seconds:6.1f} {f'({seconds / base:.1f}x)':>5s}")
            print(f"{name:36s}" + "".join(cells), flush=True)
    drive = opensees()
    if drive is None:
        print("OpenSees: not installed here (pip install -r benchmarks/requirements.txt)")
    else:
        seconds = best(lambda: drive(motion), 3) / n
        print(f"{'OpenSees Steel02 through openseespy':36s}{1e9 * seconds:6.1f} ({seconds / own[0]:.1f}x)")


if __name__ == "__main__":
    main()
