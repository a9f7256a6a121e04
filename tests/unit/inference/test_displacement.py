"""The share of the displacement's noise in the intervals of a fit."""

from dataclasses import replace

import numpy as np
import pytest

from shj_bayes.inference.displacement import MATTERS, N_COPIES, of_displacement
from shj_bayes.inference.fit import fit, make_problem
from shj_bayes.inference.sampler import Plan
from shj_bayes.inference.start import find_start
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.protocol import Block

BLOCKS = (Block(24.0, 0.13, 4), Block(48.0, 0.067, 4))


def problem(wobble_mm: float, sigma: float, rate_Hz: float = 10.0):
    truth = Truth(sigma=sigma, phi=0.5, displacement_noise_mm=wobble_mm)
    return make_problem(simulate_device(truth, seed=4, rate_Hz=rate_Hz, blocks=BLOCKS))


@pytest.fixture(scope="module")
def rough():
    made = problem(0.03, 0.1)
    return made, find_start(made)


def test_it_is_left_out_where_it_does_not_matter():
    made = problem(0.001, 1.0)
    share = of_displacement(made, find_start(made), 1)
    assert share.ratio < MATTERS
    assert share.moves.shape == (0, 7)
    assert share.words == ()
    assert share.spread([], 1) == []


def test_it_is_as_large_as_the_scatter_between_recordings(rough):
    """Other noise on the same displacement moves the stiffness as far as the copies say (a factor of 2 either way)."""
    made, start = rough
    share = of_displacement(made, start, 1)
    assert share.moves.shape == (N_COPIES, 7)
    np.testing.assert_allclose(share.moves.mean(axis=0), 0.0, atol=1e-12)
    truth = Truth(sigma=0.1, phi=0.5, displacement_noise_mm=0.0)
    clean = simulate_device(truth, seed=4, rate_Hz=10.0, blocks=BLOCKS)
    tops = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        noisy = [replace(r, displacement_mm=r.displacement_mm + 0.03 * rng.standard_normal(r.n_samples)) for r in clean]
        tops.append(find_start(make_problem(noisy)).free[0])
    assert 0.5 < share.moves[:, 0].std(ddof=1) / np.std(tops, ddof=1) < 2.0


def test_a_fit_holds_it_and_says_so(rough):
    made, start = rough
    plan = Plan(seed=2)
    result = fit(made, plan=plan)
    share = of_displacement(made, start, plan.seed)
    assert result.record["sampling"]["displacement_copies"] == N_COPIES
    assert result.record["sampling"]["displacement_noise_over_force_noise"] == pytest.approx(share.ratio, rel=1e-6)
    assert any("noise of the displacement (0.03" in reason for reason in result.verdict.reasons)
    free = made.priors.of("K").to_free(result.data["posterior"]["K"].to_numpy().ravel())
    assert free.std() > share.moves[:, 0].std(ddof=1)
    again = fit(made, plan=plan)
    np.testing.assert_array_equal(again.data["posterior"]["K"], result.data["posterior"]["K"])


def test_many_samples_are_thinned_with_their_noise():
    """A copy of a recording at ten times the rate has as many samples and moves as little as it should: by less."""
    slow, fast = problem(0.03, 0.1, 10.0), problem(0.03, 0.1, 200.0)
    moves = [of_displacement(p, find_start(p), 1).moves[:, 0].std() for p in (slow, fast)]
    assert moves[1] < 0.7 * moves[0]
