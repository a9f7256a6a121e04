"""Verdicts from whole runs of the sampler on densities that go wrong in a known way."""

import numpy as np
import pytest

from shj_bayes.errors import InferenceError
from shj_bayes.inference.convergence import judge
from shj_bayes.inference.sampler import SamplingPlan, run_ensembles
from shj_bayes.inference.start import Start

NAMES = ("a", "b", "c")
PLAN = SamplingPlan(round_steps=200, max_steps=600)


class Normal:
    """A standard normal density, with what a test adds."""

    def __init__(self, change=lambda z, value: value):
        self.change = change

    def log_posterior_free(self, z):
        """Log density."""
        return self.change(z, -0.5 * np.sum(z**2, axis=1))


def run(density, width=1.0, plan=PLAN):
    _, figures = run_ensembles(density, NAMES, Start(np.zeros(3), width**2 * np.eye(3), 0.0), plan)
    return judge(figures)


def test_two_modes():
    """Two peaks 60 sd apart: moves by whole differences lead from one into the other, but not often in a short run."""
    two = Normal(lambda z, _: -0.5 * np.sum((np.abs(z) - [30.0, 0.0, 0.0]) ** 2 * [4.0, 1.0, 1.0], axis=1))
    verdict = run(two, width=15.0)
    assert verdict.word != "reliable"
    assert "run longer" in " ".join(verdict.reasons)


def test_stuck_walkers():
    """A density so rough that hardly any move is accepted."""
    rough = Normal(lambda z, value: value + 1e5 * np.sin(1e7 * z.sum(axis=1)))
    verdict = run(rough)
    assert verdict.word == "unusable"
    assert "accept fewer than" in " ".join(verdict.reasons)


def test_a_chain_that_is_too_short():
    verdict = run(Normal(), plan=SamplingPlan(round_steps=60, max_steps=60))
    assert verdict.word in ("tentative", "unusable")
    assert "run longer" in " ".join(verdict.reasons)


@pytest.mark.parametrize("value", [np.nan, -np.inf])
def test_a_density_that_is_nowhere_finite(value):
    with pytest.raises(InferenceError, match="no finite starting points"):
        run(Normal(lambda z, _: np.full(len(z), value)))
