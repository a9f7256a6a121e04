"""Evidence and posterior of a linear model against the densities that they are, worked out another way."""

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from shj_bayes.inference.gaussian import Gaussian, log_gains
from shj_bayes.planning.information import foretold

N, P = 40, 5


@pytest.fixture
def linear() -> tuple[np.ndarray, np.ndarray, Gaussian]:
    rng = np.random.default_rng(8)
    columns = rng.standard_normal((N, P)) * np.array([3.0, 1.0, 0.2, 5.0, 1.0])
    y = columns @ rng.standard_normal(P) + rng.standard_normal(N)
    whole = np.column_stack([y, columns])
    return y, columns, Gaussian.of(whole.T @ whole, -0.5 * N * np.log(2.0 * np.pi))


def density(y: np.ndarray, columns: np.ndarray) -> float:
    return float(multivariate_normal(np.zeros(y.size), np.eye(y.size) + columns @ columns.T).logpdf(y))


def test_the_evidence_is_the_density_of_the_data(linear: tuple[np.ndarray, np.ndarray, Gaussian]) -> None:
    y, columns, found = linear
    assert found.log_evidence == pytest.approx(density(y, columns), rel=1e-12)
    assert found.gain == pytest.approx(density(y, columns) - density(y, np.zeros((N, 1))), rel=1e-10)
    sizes = np.array([0.1, 2.0, 1.0, 0.5, 3.0])
    assert found.sized(sizes).log_evidence == pytest.approx(density(y, columns * sizes), rel=1e-12)


def test_the_posterior_is_that_of_the_regression(linear: tuple[np.ndarray, np.ndarray, Gaussian]) -> None:
    y, columns, found = linear
    spread = np.linalg.inv(np.eye(P) + columns.T @ columns)
    np.testing.assert_allclose(found.covariance, spread, rtol=1e-10)
    np.testing.assert_allclose(found.mean, spread @ columns.T @ y, rtol=1e-10)


def test_coefficients_that_are_integrated_out_leave_the_others_as_they_were(
    linear: tuple[np.ndarray, np.ndarray, Gaussian],
) -> None:
    y, columns, found = linear
    rest = found.given(2)
    assert rest.log_evidence == pytest.approx(found.log_evidence, rel=1e-12)
    assert rest.gain == pytest.approx(density(y, columns) - density(y, columns[:, :2]), rel=1e-10)
    np.testing.assert_allclose(rest.mean, found.mean[2:], rtol=1e-10)
    np.testing.assert_allclose(rest.covariance, found.covariance[2:, 2:], rtol=1e-10)
    root = found.whitened(columns.T @ y)
    assert root @ root == pytest.approx(found.along @ found.mean, rel=1e-12)


def test_gains_of_many_sets_at_many_sizes(linear: tuple[np.ndarray, np.ndarray, Gaussian]) -> None:
    y, columns, found = linear
    pairs = [Gaussian(found.square, found.along[own], found.inner[own, own]) for own in (slice(2), slice(3, 5))]
    sizes = np.array([0.2, 1.0, 3.0])
    gains = log_gains(np.stack([p.inner for p in pairs]), np.stack([p.along for p in pairs]), sizes)
    expected = [[p.sized(size).gain for size in sizes] for p in pairs]
    np.testing.assert_allclose(gains, expected, rtol=1e-10)
    assert np.isfinite(logsumexp(gains))
    assert y.shape == (len(columns),)


def test_data_that_were_foretold_narrow_and_do_not_move(linear: tuple[np.ndarray, np.ndarray, Gaussian]) -> None:
    _, columns, found = linear
    further = np.random.default_rng(9).standard_normal((7, P))
    after = foretold(found, further)
    np.testing.assert_allclose(after.mean, found.mean, rtol=1e-10)
    both = np.concatenate([columns, further])
    np.testing.assert_allclose(after.covariance, np.linalg.inv(np.eye(P) + both.T @ both), rtol=1e-10)


def test_the_root_is_that_of_the_precision(linear: tuple[np.ndarray, np.ndarray, Gaussian]) -> None:
    _, columns, found = linear
    root = np.tril(found.root)
    np.testing.assert_allclose(root @ root.T, np.eye(P) + columns.T @ columns, rtol=1e-10)
