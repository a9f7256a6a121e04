"""The device that the benchmarks fit: two runs of Table 1 with AR(1) noise of 1 kN."""

from __future__ import annotations

from shj_bayes.inference.problem import Problem, Run

from shj_bayes.model.parameters import Layout
from shj_bayes.model.priors import read_priors
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.protocol import exact_motion, table_1

PHI_AT_20_HZ = 0.8


def device(rate_Hz: float, beta: float, *, noise: str = "ar1", seed: int = 1) -> Problem:
    """Simulate the device at a sampling rate, with its exact motion; the noise has the same memory in seconds."""
    truth = Truth(
        K=18.0, Fy=80.0, beta=beta, gamma=1 / 60, ratio=0.875, sigma=1.0, phi=PHI_AT_20_HZ ** (20.0 / rate_Hz),
        displacement_noise_mm=0.0,
    )  # fmt: skip
    motion = exact_motion(table_1(), rate_Hz)[1]
    runs = tuple(Run(recording, motion) for recording in simulate_device(truth, seed=seed, rate_Hz=rate_Hz))
    return Problem(runs, Layout(2, noise), read_priors("afc"))
