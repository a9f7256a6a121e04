"""What comes again from one half-cycle to the next: right for noise, blind to drift, and of the right size."""

import numpy as np
import pytest

from shj_bayes.inference.run import Run
from shj_bayes.mismatch.evidence import evidence_of
from shj_bayes.mismatch.repeats import repeating_share, repeats
from shj_bayes.model.noise.catalogue import noise_model
from shj_bayes.model.noise.filter import simulate
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.protocol import Block, exact_motion

BLOCKS = (Block(24.0, 0.13, 6), Block(48.0, 0.067, 6))
RATE_HZ = 5.0
TIME, MOTION = exact_motion(BLOCKS, RATE_HZ)
EVIDENCE = evidence_of(
    [Run(r, MOTION) for r in simulate_device(Truth(sigma=0.0), seed=1, rate_Hz=RATE_HZ, blocks=BLOCKS)]
)
N = EVIDENCE.force_kN.size
X, SENSE = EVIDENCE.stack("position_mm"), EVIDENCE.stack("direction")


def noise(phi, seed):
    rng, values = np.random.default_rng(seed), {"sigma": 1.0, "phi": phi}
    return simulate(noise_model("ar1"), values, np.arange(N) / RATE_HZ, np.arange(N) == 0, rng)


def look(residual, seed=0):
    return repeats(EVIDENCE, residual, np.random.default_rng(seed))


@pytest.mark.parametrize("phi", [0.0, 0.8, 0.95])
def test_noise_of_any_colour_raises_few_alarms(phi):
    """At the level of one per cent, 200 series give 2; 7 or more have a chance of 0.5 %."""
    assert sum(look(noise(phi, seed), seed).p_value < 0.01 for seed in range(200)) < 7


def test_a_ripple_along_the_slot_is_found_with_its_size():
    again = look(noise(0.8, 1) + 0.6 * SENSE * np.sin(2 * np.pi * X / 16.0))
    assert again.p_value < 1e-3
    assert again.coordinate == "position"
    assert again.rms_kN == pytest.approx(0.6 / np.sqrt(2), rel=0.2)
    assert again.size_kN == pytest.approx(2.576 * again.rms_kN)


def test_a_shape_that_grows_from_cycle_to_cycle_is_found_although_its_mean_says_little():
    growth = np.linspace(-1.0, 1.0, N)
    assert look(noise(0.8, 2) + 1.5 * growth * SENSE * np.cos(2 * np.pi * X / 40.0)).p_value < 1e-3


def test_slow_drift_is_no_shape():
    assert look(noise(0.8, 3) + np.linspace(-5.0, 5.0, N)).p_value > 0.01


def test_the_share_that_is_taken_up():
    ripple = SENSE * np.sin(2 * np.pi * X / 16.0)
    whole, half, none = (look(noise(0.5, 4) + size * ripple) for size in (2.0, 1.0, 0.0))
    assert repeating_share(whole, half) == pytest.approx(0.75, abs=0.05)
    assert repeating_share(whole, none) > 0.97
    assert repeating_share(half, whole) == 0.0
