"""Simulated recordings: reproducible, as stated, and refused where the law is not defined."""

import math
import re

import numpy as np
import pytest

from shj_bayes.errors import ModelError, RecordingError
from shj_bayes.model.law import force
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.motion import Block, exact_motion, table_1

BLOCKS = (Block(12.0, 0.13, 2), Block(48.0, 0.034, 2))


def test_same_seed_same_numbers_other_seed_others() -> None:
    a, b = (simulate_device(Truth(), seed=5, blocks=BLOCKS) for _ in range(2))
    other = simulate_device(Truth(), seed=6, blocks=BLOCKS)
    for first, second, third in zip(a, b, other, strict=True):
        for channel in ("time_s", "displacement_mm", "force_kN"):
            assert np.array_equal(getattr(first, channel), getattr(second, channel))
        assert not np.array_equal(first.force_kN, third.force_kN)


def test_first_run_does_not_depend_on_the_number_of_runs() -> None:
    one = simulate_device(Truth(), seed=5, n_runs=1, blocks=BLOCKS)
    two = simulate_device(Truth(), seed=5, n_runs=2, blocks=BLOCKS)
    assert (len(one), len(two)) == (1, 2)
    assert np.array_equal(one[0].force_kN, two[0].force_kN)


@pytest.mark.parametrize("variant", ["published", "continuous"])
def test_without_noise_it_is_the_law(variant: str) -> None:
    truth = Truth(K=10.0, Fy=60.0, beta=30.0, gamma=-0.02, ratio=0.5, sigma=0.0, displacement_noise_mm=0.0)
    runs = simulate_device(truth, seed=1, blocks=BLOCKS, variant=variant)
    time, motion = exact_motion(BLOCKS, 20.0)
    for run, capacity in zip(runs, (60.0, 30.0), strict=True):
        clean = force(motion, K=10.0, Fy=capacity, beta=30.0, gamma=-0.02, variant=variant)
        assert np.array_equal(run.force_kN, clean)
        assert np.array_equal(run.displacement_mm, motion.displacement_mm)
        assert np.array_equal(run.time_s, time)
    assert runs[0].source.name == "simulated-run1"
    assert any("not a measurement" in finding.message for finding in runs[0].findings)


def test_noise_is_as_stated() -> None:
    truth = Truth(sigma=2.0, phi=0.8, displacement_noise_mm=0.05)
    (run,) = simulate_device(truth, seed=2, n_runs=1)
    _, motion = exact_motion(table_1(), 20.0)
    noise = run.force_kN - force(motion, K=truth.K, Fy=truth.Fy, beta=truth.beta, gamma=truth.gamma)
    n = noise.size
    # AR(1): the variance of the sample variance is that of n (1 - phi^2)/(1 + phi^2) independent values
    assert noise.std() == pytest.approx(2.0, rel=4 * math.sqrt((1 + 0.64) / (1 - 0.64) / (2 * n)))
    assert np.corrcoef(noise[:-1], noise[1:])[0, 1] == pytest.approx(0.8, abs=4 * math.sqrt((1 - 0.64) / n))
    wobble = run.displacement_mm - motion.displacement_mm
    assert wobble.std() == pytest.approx(0.05, rel=4 / math.sqrt(2 * n))
    assert abs(np.corrcoef(wobble, noise)[0, 1]) < 4 / math.sqrt(n / 4)


def test_slow_noise_is_as_stated_and_adds_to_the_rest() -> None:
    """Exactly the recording without it, and a series whose memory is in seconds at any rate."""
    for rate in (5.0, 50.0):
        plain, slow = (
            simulate_device(Truth(sigma_slow=size, tau_slow=2.0), seed=2, n_runs=1, rate_Hz=rate)[0]
            for size in (0, 1.5)
        )
        assert np.array_equal(plain.displacement_mm, slow.displacement_mm)
        series = slow.force_kN - plain.force_kN
        steps = round(rate)  # in one second
        n = slow.duration_s / 4.0  # about as many independent values: twice the memory for each
        assert series.std() == pytest.approx(1.5, rel=4 / math.sqrt(2 * n))
        assert np.corrcoef(series[:-steps], series[steps:])[0, 1] == pytest.approx(math.exp(-0.5), abs=4 / math.sqrt(n))


def test_each_run_slides_at_the_ratio_of_the_one_before() -> None:
    truth = Truth(ratio=0.8, sigma=0.0, displacement_noise_mm=0.0)
    runs = simulate_device(truth, seed=1, n_runs=4, blocks=BLOCKS)
    _, motion = exact_motion(BLOCKS, 20.0)
    assert [run.source.name for run in runs] == [f"simulated-run{k}" for k in range(1, 5)]
    for k, run in enumerate(runs):
        assert np.array_equal(run.force_kN, force(motion, K=truth.K, Fy=80.0 * 0.8**k, beta=truth.beta, gamma=0.0))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"K": 0.0}, "K = 0: allowed is above 0"),
        ({"Fy": -1.0}, "Fy = -1: allowed is above 0"),
        ({"ratio": 0.0}, "ratio = 0: allowed is above 0"),
        ({"gamma": math.inf}, "gamma = inf: it must be a finite number"),
        ({"sigma": -1.0}, "sigma = -1 kN: a noise scale must be 0 or more"),
        ({"sigma_slow": -0.5}, "sigma_slow = -0.5 kN: a noise scale must be 0 or more"),
        ({"tau_slow": 0.0}, "tau_slow = 0: allowed is above 0"),
        ({"displacement_noise_mm": -0.1}, "displacement_noise_mm = -0.1 mm: a noise scale must be 0 or more"),
        ({"phi": 1.0}, "phi = 1: allowed is above -1 and below 1"),
    ],
)
def test_truths_that_cannot_be(change: dict[str, float], message: str) -> None:
    with pytest.raises(ModelError, match=re.escape(message)):
        Truth(**change)


def test_what_simulate_refuses() -> None:
    with pytest.raises(ModelError, match=r"beta = 0\.5: allowed is 1 to 500"):
        simulate_device(Truth(beta=0.5), seed=1, blocks=BLOCKS)
    for n_runs in (0, 10):
        with pytest.raises(ModelError, match=f"{n_runs} runs asked for; simulate makes 1 to 9"):
            simulate_device(Truth(), seed=1, n_runs=n_runs, blocks=BLOCKS)
    with pytest.raises(ModelError, match="seed = -1: allowed is 0 or more"):
        simulate_device(Truth(), seed=-1, blocks=BLOCKS)
    for rate in (1.0, 2e5, math.nan):
        with pytest.raises(RecordingError, match=r"rate .* Hz: allowed is 1\.04 Hz .* to 100000 Hz"):
            simulate_device(Truth(), seed=1, blocks=BLOCKS, rate_Hz=rate)
