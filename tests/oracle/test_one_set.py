"""The posterior of a single set by quadrature, beside the grid and beside Student's t."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from shj_bayes.population.hierarchy import fit_quantity
from shj_bayes.population.quantities import QuantityLikelihood, other_priors, population_prior, spaced

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from one_set import AT, draws_of_one_set

PRIOR = population_prior("least")
PRIORS = {"default": PRIOR, **other_priors(PRIOR)}
VALUES, ERRORS = np.log([70.0, 76.0, 73.0]), np.array([0.01, 0.02, 0.005])
LEVELS = (0.05, 0.5, 0.95)


@pytest.mark.parametrize("label", list(PRIORS))
def test_the_grid_finds_what_quadrature_finds(label):
    exact = np.quantile(draws_of_one_set(VALUES, ERRORS, PRIORS[label], read=False), LEVELS)
    devices = [
        QuantityLikelihood(False, np.array([y]), np.array([e]), np.ones(1)) for y, e in zip(VALUES, ERRORS, strict=True)
    ]
    fit = fit_quantity("least", [devices], PRIORS[label], np.random.SeedSequence(1))
    noise = stats.norm.ppf(spaced(fit.mu.shape[0], np.random.default_rng(0)))
    drawn = np.quantile(fit.mu[:, 0] + fit.tau[:, 0] * noise, LEVELS)
    assert drawn == pytest.approx(exact, abs=0.03 * (exact[2] - exact[0]))


def test_a_flat_prior_of_the_spread_gives_students_t():
    """With the logarithm of the spread all but flat, and no error, a new device follows t with n - 1 degrees."""
    wide = draws_of_one_set(VALUES, np.zeros(3), PRIOR)
    t = stats.t.ppf(AT[[10, 100, 189]], 2) * VALUES.std(ddof=1) * np.sqrt(4.0 / 3.0) + VALUES.mean()
    assert wide[[10, 100, 189]] == pytest.approx(t, abs=0.02)


def test_a_new_device_carries_the_error_of_its_reading():
    values, errors = np.log([70.0, 72.0, 74.0, 76.0, 78.0, 80.0]), np.full(6, 0.05)
    alone, read = (np.quantile(draws_of_one_set(values, errors, PRIOR, read=r), LEVELS) for r in (False, True))
    assert read[0] < alone[0] < alone[2] < read[2]
