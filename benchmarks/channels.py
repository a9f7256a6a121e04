"""First looks at simulated devices with a bolt tension that wanders by 10 %: one that the force follows, or not.

    python benchmarks/channels.py follows 401 10
    python benchmarks/channels.py unrelated 401 20

Devices, motion and noise are those of the development trials; the tension has 0.2 kN of noise.
"""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from shj_bayes.inference.binning import runs_of
from shj_bayes.mismatch.diagnosis import diagnose
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.history import History
from shj_bayes.model.priors import read_priors
from shj_bayes.options import DiagnoseOptions
from shj_bayes.recording.motion import exact_motion, table_1
from shj_bayes.recording.recording import Column, Recording
from shj_validation.trials import RATE_HZ, ar1, simulate

MEMORY_S = 120.0
TENSION_KN, SHARE, NOISE_KN = 45.0, 0.1, 0.2
STREAM = {"unrelated": 7, "follows": 8}


def device(seed: int, kind: str) -> list[Recording]:
    """Two runs of a device with the tension beside the force."""
    rng = np.random.default_rng([seed, STREAM[kind]])
    time, _ = exact_motion(table_1(), RATE_HZ)
    walks = [_wandering(time.size, rng) for _ in range(2)]

    def clamping(history: History) -> NDArray[np.float64]:
        return 1.0 + SHARE * np.interp(history.time_s, time, walks[history.run - 1])

    runs = simulate({}, seed, clamping=clamping if kind == "follows" else None)
    out = []
    for run, walk in zip(runs, walks, strict=True):
        tension = TENSION_KN * (1.0 + SHARE * walk) + NOISE_KN * rng.standard_normal(walk.size)
        out.append(Recording(run.time_s, run.displacement_mm, run.force_kN, extras=(Column("tension", tension, "kN"),)))
    return out


def _wandering(n: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Values between -1 and 1 that change over minutes."""
    walk = gaussian_filter1d(ar1(float(np.exp(-1.0 / (MEMORY_S * RATE_HZ))), n, rng), MEMORY_S * RATE_HZ / 10.0)
    return np.asarray(walk / np.abs(walk).max())


def main() -> None:
    """Print verdict and likely dependences of each device."""
    kind, first, n = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
    for seed in range(first, first + n):
        runs = runs_of(device(seed, kind))
        record = diagnose(runs, DeviceModel(len(runs), read_priors("afc")), DiagnoseOptions(quick=True)).content
        likely = [f"{c['action']} over {c['coordinate']}" for c in record["coordinates"] if c["probability"] > 0.5]
        print(seed, record["verdict"], "; ".join(likely), flush=True)


if __name__ == "__main__":
    main()
