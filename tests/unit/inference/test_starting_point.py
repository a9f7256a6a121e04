"""The search for the most probable parameters."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats

from shj_bayes.errors import InferenceError
from shj_bayes.inference.problem import Problem, Run
from shj_bayes.inference.start import find_start
from shj_bayes.model.parameters import Layout
from shj_bayes.model.priors import read_priors
from shj_bayes.model.simulate import Truth
from shj_bayes.recording.recording import Recording

Make = Callable[..., Problem]
DEVICES = {
    "sharp, slower when fast": Truth(K=15.0, Fy=90.0, beta=60.0, gamma=-1 / 30, ratio=0.87, sigma=0.5, phi=0.3),
    "round, faster when fast": Truth(K=8.0, Fy=50.0, beta=3.0, gamma=1 / 60, ratio=0.4, sigma=1.0, phi=0.7),
    "weak": Truth(K=18.0, Fy=22.0, beta=10.0, gamma=0.0, ratio=0.5, sigma=0.2, phi=0.0),
}


@pytest.mark.parametrize("variant", ["seed", "continuous"])
@pytest.mark.parametrize("name", DEVICES)
def test_map_is_near_the_truth(make_small: Make, as_vector: Callable[..., np.ndarray], name: str, variant: str) -> None:
    problem = make_small(DEVICES[name], variant=variant)
    start = find_start(problem)
    truth = problem.free(as_vector(problem, DEVICES[name]))[0]
    # In units of its own curvature the truth is a chi-squared draw; 1e-4 of those are larger than this.
    distance = (start.free - truth) @ np.linalg.solve(start.covariance, start.free - truth)
    assert distance < stats.chi2(truth.size).ppf(1 - 1e-4) * 1.5  # the Gaussian is an approximation
    assert start.log_posterior >= problem.log_posterior_free(truth[None])[0]


def test_map_is_a_maximum_with_the_right_curvature(small_device: Problem) -> None:
    start = find_start(small_device)
    sd = np.sqrt(np.diag(start.covariance))
    around = start.free + np.vstack([np.diag(0.3 * sd), -np.diag(0.3 * sd)])
    assert np.all(small_device.log_posterior_free(around) < start.log_posterior)
    assert np.all(np.linalg.eigvalsh(start.covariance) > 0)
    # Along each eigenvector, one standard deviation away, the density has fallen by about 1/2.
    values, vectors = np.linalg.eigh(start.covariance)
    both = [start.free + s * np.sqrt(values)[:, None] * vectors.T for s in (1, -1)]
    fall = start.log_posterior - 0.5 * sum(small_device.log_posterior_free(z) for z in both)
    assert np.all(fall > 0.3)
    assert np.all(fall < 0.9)


def test_search_is_repeatable(make_small: Make) -> None:
    a, b = (find_start(make_small()) for _ in range(2))
    assert np.array_equal(a.free, b.free)
    assert np.array_equal(a.covariance, b.covariance)


def test_nothing_to_fit(make_small: Make) -> None:
    run = make_small(n_runs=1).runs[0]
    flat = Recording(run.recording.time_s, run.recording.displacement_mm, np.zeros(run.recording.n_samples))
    problem = Problem.__new__(Problem)  # past the check that the priors can hold the data, to the search's own
    for name, value in {
        "runs": (Run(flat, run.motion),),
        "layout": Layout(1),
        "priors": read_priors("general"),
        "variant": "seed",
    }.items():
        object.__setattr__(problem, name, value)
    with pytest.raises(InferenceError, match="nothing to fit: largest force 0 kN, stroke 48 mm"):
        find_start(problem)
