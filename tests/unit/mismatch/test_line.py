"""The line over time: right for noise of any colour, and sees what flipping cycles cannot."""

from types import SimpleNamespace

import numpy as np
import pytest

from shj_bayes.mismatch.calibrate import strongest_line
from shj_bayes.model.noise.catalogue import noise_model
from shj_bayes.model.noise.filter import simulate

N, RATE_HZ = 3000, 5.0


def look(residual):
    time = np.arange(N) / RATE_HZ
    evidence = SimpleNamespace(histories=[SimpleNamespace(run=1, time_s=time)], run=np.ones(N))
    return strongest_line(evidence, SimpleNamespace(residual_kN=residual))


def noise(phi, seed):
    rng, values = np.random.default_rng(seed), {"sigma": 1.0, "phi": phi}
    return simulate(noise_model("ar1"), values, np.arange(N) / RATE_HZ, np.arange(N) == 0, rng)


@pytest.mark.parametrize("phi", [0.0, 0.8, 0.95, 0.99])
def test_noise_of_any_colour_raises_few_alarms(phi):
    """At the level of one per cent, 200 series give 2; 7 or more have a chance of 0.5 %."""
    alarms = sum(look(noise(phi, seed)).p_value < 0.01 for seed in range(200))
    assert alarms < 7


def test_a_wave_is_found_with_period_and_amplitude():
    time = np.arange(N) / RATE_HZ
    line = look(noise(0.8, 1) + 2.0 * np.sin(2 * np.pi * time / 40.0))
    assert line.p_value < 1e-6
    assert line.period_s == pytest.approx(40.0, rel=0.03)
    assert line.amplitude_kN == pytest.approx(2.0, rel=0.15)


def test_a_drift_is_no_line():
    assert look(noise(0.8, 2) + np.linspace(-5.0, 5.0, N)).p_value > 0.01
