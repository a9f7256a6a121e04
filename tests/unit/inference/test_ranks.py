"""R-hat, effective sample sizes and Pareto k are ArviZ's, and nothing of a fit imports ArviZ."""

import warnings

import numpy as np
import pytest

from shj_bayes._util.imports import arviz
from shj_bayes.inference import convergence as ranks

az = arviz()


@pytest.mark.parametrize("kind", ["white", "slow", "apart", "ties", "odd", "alternating", "short"])
def test_numbers_are_those_of_arviz(kind):
    rng = np.random.default_rng(4)
    n = {"odd": 501, "short": 9}.get(kind, 600)
    chains = rng.standard_normal((6, n))
    if kind == "slow":
        for k in range(1, n):
            chains[:, k] = 0.95 * chains[:, k - 1] + 0.3 * chains[:, k]
    if kind == "apart":
        chains += np.arange(6)[:, None]
    if kind == "ties":
        chains = np.round(chains)
    if kind == "alternating":
        chains[:, ::2] = -chains[:, 1::2] + 0.1 * chains[:, ::2]
    assert ranks.rhat(chains) == pytest.approx(float(az.rhat(chains)), rel=1e-10)
    assert ranks.ess_bulk(chains) == pytest.approx(float(az.ess(chains, method="bulk")), rel=1e-10)
    tail = float(az.ess(chains, method="tail", prob=(0.05, 0.95)))
    assert ranks.ess_tail(chains) == pytest.approx(tail, rel=1e-10)


@pytest.mark.parametrize("spread", [1e-3, 0.3, 1.0, 3.0])
@pytest.mark.parametrize("n", [100, 4000])
def test_the_shape_of_the_largest_weights_is_that_of_arviz(spread, n):
    log_weights = spread * np.random.default_rng(6).standard_normal(n)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # ArviZ says where the shape is too large
        assert ranks.pareto_k(log_weights) == pytest.approx(float(az.psislw(log_weights)[1]), rel=1e-10)


def test_equal_weights_have_no_tail_and_one_that_is_all_has_nothing_else():
    assert ranks.pareto_k(np.full(100, 3.0)) == 0.0
    assert ranks.pareto_k(np.append(np.full(99, -800.0), 0.0)) == np.inf
