"""Points shared out among threads give the same bits; a climb is made once for each hill."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from shj_bayes.inference.binning import runs_of
from shj_bayes.inference.convergence import Diagnostics
from shj_bayes.inference.likelihood import SharedDensity, make_likelihood
from shj_bayes.inference.sampler import LEAST_ROUND, SamplingPlan, _next_round
from shj_bayes.inference.start import find_start, polish
from shj_bayes.model.device import DeviceModel, effects_named
from shj_bayes.model.noise import noise_model
from shj_bayes.model.priors import read_priors
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.motion import Block

BLOCKS = (Block(12.0, 0.13, 2), Block(24.0, 0.067, 2))


@pytest.fixture(scope="module", params=[("slow", ()), ("student", ()), ("ar1", ("wear",))], ids=str)
def posterior(request):
    noise, effects = request.param
    runs = runs_of(simulate_device(Truth(phi=0.3), seed=4, rate_Hz=4.0, blocks=BLOCKS))
    model = DeviceModel(2, read_priors(), effects=effects_named(effects), noise=noise_model(noise))
    return make_likelihood(runs, model)


@pytest.mark.parametrize("n", [2, 3])
def test_the_same_bits_whatever_the_number_of_threads(posterior, n):
    z = np.random.default_rng(1).standard_normal((17, len(posterior.model.names)))
    with ThreadPoolExecutor(n) as pool:
        shared = SharedDensity(posterior, pool, n)
        np.testing.assert_array_equal(shared.log_posterior_free(z), posterior.log_posterior_free(z))
        assert shared.log_posterior_free(z[:1]).shape == (1,)
    (_, one), (_, two) = find_start(posterior, threads=1), find_start(posterior, threads=n)
    np.testing.assert_array_equal(one.free, two.free)
    np.testing.assert_array_equal(one.covariance, two.covariance)


class Hill:
    """A narrow Gaussian hill that counts how often it is asked."""

    def __init__(self) -> None:
        self.n = 0

    def log_posterior_free(self, z):
        self.n += z.shape[0]
        return -0.5 * np.sum((z / 0.01) ** 2, axis=1)


def test_searches_that_end_together_are_climbed_from_once():
    alone, thrice = Hill(), Hill()
    start = np.full(3, 0.05)  # five standard deviations from the top, each
    polish(alone, [start])
    found = polish(thrice, [start, start + 1e-5, start - 1e-5])
    assert np.abs(found.free).max() < 1e-4
    assert thrice.n == alone.n
    polish(thrice, [start, -start])  # another side: it might have been another hill
    assert thrice.n > 2.5 * alone.n


def test_the_next_look_comes_when_the_chain_should_be_long_enough():
    def figures(tau: float, n_burn: int) -> Diagnostics:
        ones = np.ones(1)
        return Diagnostics(("K",), tau * ones, ones, ones, ones, np.ones((4, 20)), 44, n_burn)

    plan = SamplingPlan()
    assert _next_round(plan, 1, None) == plan.round_steps
    assert _next_round(plan, 61, figures(1.6, 17)) == 40  # 1.04 (17 + 50 * 1.6) = 101
    assert _next_round(plan, 61, figures(20.0, 30)) == plan.round_steps  # far from it: as ever
    assert _next_round(plan, 99, figures(1.6, 17)) == LEAST_ROUND  # no look at every step
    assert _next_round(plan, 200, figures(1.6, 17)) == plan.round_steps  # it is something else that is missing
    assert _next_round(plan, 61, figures(np.inf, 30)) == plan.round_steps
    assert _next_round(plan, plan.max_steps - 3, figures(np.inf, 30)) == 3
