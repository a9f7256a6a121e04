"""One device of known numbers as a table of numbers, for tests that write it in the ways of laboratories."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.motion import table_1

TRUTH = Truth(K=18.0, Fy=80.0, beta=10.0, gamma=1 / 60, sigma=1.0, phi=0.8, displacement_noise_mm=0.01)
RATE_HZ = 20.0
N_ROWS = 3400  # 170 s of the first run of Table 1: 25 half-cycles


@dataclass(frozen=True, eq=False)
class Plain:
    """The readings as they are."""

    # time_s, displacement_mm, force_kN: shape (N_ROWS,), with four decimals
    time_s: FloatArray
    displacement_mm: FloatArray
    force_kN: FloatArray


@cache
def plain() -> Plain:
    """Give the readings of the device, the same at every call."""
    whole = simulate_device(TRUTH, seed=20, rate_Hz=RATE_HZ, blocks=table_1(5))[0]
    columns = [np.round(values[:N_ROWS], 4) for values in (whole.time_s, whole.displacement_mm, whole.force_kN)]
    for column in columns:
        column.setflags(write=False)
    return Plain(*columns)
