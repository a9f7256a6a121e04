"""The device that the benchmarks fit: two runs of Table 1 with white noise of 0.8 kN and slow noise of 0.6 kN."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from shj_bayes.inference.binning import Run
from shj_bayes.inference.likelihood import Likelihood, make_likelihood
from shj_bayes.model.device import DeviceModel, effects_named
from shj_bayes.model.noise import DEFAULT, noise_model
from shj_bayes.model.priors import read_priors
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.motion import exact_motion, table_1

TRUTH = Truth(
    K=18.0, Fy=80.0, beta=10.0, gamma=1 / 60, ratio=0.875, sigma=0.8, phi=0.0, sigma_slow=0.6, tau_slow=3.0,
    displacement_noise_mm=0.0,
)  # fmt: skip


def device(
    rate_Hz: float,
    beta: float,
    *,
    noise: str = DEFAULT,
    effects: Sequence[str] = (),
    variant: str = "published",
    seed: int = 1,
) -> Likelihood:
    """Simulate the device at a sampling rate, with its exact motion; the posterior is in blocks for a first look."""
    recordings = simulate_device(replace(TRUTH, beta=beta), seed=seed, rate_Hz=rate_Hz, variant=variant)
    motion = exact_motion(table_1(), rate_Hz)[1]
    named = effects_named(effects)
    model = DeviceModel(2, read_priors("afc"), effects=named, noise=noise_model(noise), variant=variant)
    return make_likelihood([Run(recording, motion) for recording in recordings], model)


def n_samples(posterior: Likelihood) -> int:
    """Count the samples of all runs."""
    return sum(run.recording.n_samples for run in posterior.runs)
