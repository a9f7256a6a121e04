"""Noise: the density against full covariances and direct products, and simulator and density as a pair."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats

from shj_bayes.errors import ModelError
from shj_bayes.model.noise import Stretches, log_density, log_density_terms, simulate_noise

Density = Callable[[np.ndarray, Stretches, np.ndarray, np.ndarray], np.ndarray]


def gappy(n: int = 40) -> Stretches:
    """Unused samples at both ends and inside, breaks at a used sample, before an unused one, and next to each other."""
    used = np.ones(n, dtype=bool)
    used[[0, 7, 8, 20, n - 1]] = False
    return Stretches(used, np.array([0, 12, 13, 20, 30]))


def stretch_numbers(stretches: Stretches) -> list[int]:
    """Stretch of each sample, -1 where unused; found by walking, independently of `Stretches.kind`."""
    numbers, current, before = [], -1, False
    for i, used in enumerate(stretches.used):
        if used and (not before or i in stretches.breaks.tolist()):
            current += 1
        numbers.append(current if used else -1)
        before = bool(used)
    return numbers


@pytest.mark.parametrize("phi", [-0.7, 0.0, 0.3, 0.95])
@pytest.mark.parametrize("sigma", [0.2, 3.0])
def test_ar1_is_the_multivariate_normal(sigma: float, phi: float) -> None:
    stretches = gappy()
    residual = np.random.default_rng(1).normal(0, 2, (3, 40))
    number = np.array(stretch_numbers(stretches))
    keep = np.flatnonzero(number >= 0)
    lag = np.abs(keep[:, None] - keep[None, :])
    together = number[keep][:, None] == number[keep][None, :]
    covariance = np.where(together, sigma**2 * phi**lag, 0.0)
    expected = stats.multivariate_normal(np.zeros(keep.size), covariance).logpdf(residual[:, keep])
    got = log_density("ar1", residual, stretches, sigma=np.full(3, sigma), phi=np.full(3, phi))
    np.testing.assert_allclose(got, expected, rtol=1e-11)


@pytest.mark.parametrize("nu", [1.5, 4.0, 60.0])
@pytest.mark.parametrize("phi", [-0.4, 0.0, 0.8])
def test_student_is_the_direct_product(phi: float, nu: float) -> None:
    stretches, sigma = gappy(), 1.3
    residual = np.random.default_rng(2).normal(0, 2, 40)
    numbers = stretch_numbers(stretches)
    expected = 0.0
    for i, number in enumerate(numbers):
        if number < 0:
            continue
        if i and numbers[i - 1] == number:
            expected += stats.t(nu, phi * residual[i - 1], sigma * math.sqrt(1 - phi**2)).logpdf(residual[i])
        else:
            expected += stats.t(nu, 0.0, sigma).logpdf(residual[i])
    one = np.ones(1)
    got = log_density("student", residual[None], stretches, sigma=sigma * one, phi=phi * one, nu=nu * one)
    assert got[0] == pytest.approx(expected, rel=1e-11)


def test_independent_is_the_product_of_normals_and_has_no_correlation() -> None:
    stretches = gappy()
    residual = np.random.default_rng(3).normal(0, 2, 40)
    expected = stats.norm(0, 0.8).logpdf(residual[stretches.used]).sum()
    got = log_density("independent", residual[None], stretches, sigma=np.array([0.8]))
    assert got[0] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("model", ["independent", "ar1", "student"])
def test_terms_add_up(model: str) -> None:
    stretches = gappy()
    residual = np.random.default_rng(4).normal(0, 1, 40)
    parameters = {"sigma": 0.9, "phi": 0.6, "nu": 5.0}
    terms = log_density_terms(model, residual, stretches, **parameters)
    total = log_density(model, residual[None], stretches, **{k: np.array([v]) for k, v in parameters.items()})
    assert terms.sum() == pytest.approx(total[0], rel=1e-12)
    assert np.all(terms[~stretches.used] == 0)


@pytest.mark.parametrize("model", ["ar1", "student"])
def test_unused_samples_are_no_evidence(model: str) -> None:
    stretches = gappy()
    residual = np.random.default_rng(5).normal(0, 1, (1, 40))
    spoilt = residual.copy()
    spoilt[:, ~stretches.used] = 1e6
    parameters = {"sigma": np.array([1.0]), "phi": np.array([0.7]), "nu": np.array([5.0])}
    # Equal up to the order of summation: the spoilt squares are multiplied by a weight of exactly 0.
    np.testing.assert_allclose(
        log_density(model, spoilt, stretches, **parameters),
        log_density(model, residual, stretches, **parameters),
        rtol=1e-13,
    )


def test_kinds_of_samples() -> None:
    stretches = gappy()
    numbers = stretch_numbers(stretches)
    expected = [0 if k < 0 else (2 if i and numbers[i - 1] == k else 1) for i, k in enumerate(numbers)]
    assert stretches.kind.tolist() == expected
    assert stretches.n_used == sum(k > 0 for k in expected)
    assert stretches.n_follow == sum(k == 2 for k in expected)


@pytest.mark.parametrize("phi", [-0.6, 0.9])
def test_simulated_noise_is_stationary_from_the_first_sample(phi: float) -> None:
    stretches = Stretches(np.ones(12, dtype=bool), np.array([0, 6]))
    rng = np.random.default_rng(6)
    n = 6000
    series = np.stack([simulate_noise("ar1", stretches, rng, sigma=2.0, phi=phi) for _ in range(n)])
    # sd of a sample standard deviation is sigma/sqrt(2n); 4.5 of them over 12 samples is a false alarm in 10^4
    assert np.abs(series.std(axis=0) / 2.0 - 1).max() < 4.5 / math.sqrt(2 * n)
    lag = np.array([np.corrcoef(series[:, i], series[:, i + 1])[0, 1] for i in range(11)])
    expected = np.where(np.arange(11) == 5, 0.0, phi)  # the noise restarts before sample 6
    assert np.abs(lag - expected).max() < 4.5 / math.sqrt(n)


# ---- simulator and density as a pair: truths drawn from a prior have uniform ranks in their posteriors ----

SIGMA = np.exp(np.linspace(-2.2, 2.2, 61))
PHI = np.linspace(-0.985, 0.985, 61)
PAIR = Stretches(np.ones(8, dtype=bool), np.array([0, 3]))  # short, so that the first samples carry weight


def wrong_density(residual: np.ndarray, stretches: Stretches, sigma: np.ndarray, phi: np.ndarray) -> np.ndarray:
    """AR(1) whose innovations have the scale sigma instead of sigma sqrt(1 - phi^2)."""
    before = np.concatenate([np.zeros((residual.shape[0], 1)), residual[:, :-1]], axis=1)
    z = (residual - np.where(stretches.kind == 2, phi[:, None] * before, 0.0)) / sigma[:, None]
    return np.asarray(-0.5 * np.sum(z**2, axis=1) - residual.shape[1] * np.log(sigma))


def shipped_density(residual: np.ndarray, stretches: Stretches, sigma: np.ndarray, phi: np.ndarray) -> np.ndarray:
    return log_density("ar1", residual, stretches, sigma=sigma, phi=phi)


def rank_p_values(density: Density, n: int = 500) -> tuple[float, float]:
    """p-values that the posterior ranks of the true sigma and phi are uniform (simulation-based calibration)."""
    rng = np.random.default_rng(7)
    grid_sigma, grid_phi = (g.ravel() for g in np.meshgrid(SIGMA, PHI, indexing="ij"))
    weight = np.tile(stats.norm(0, 0.5).logpdf(np.log(SIGMA))[:, None], (1, PHI.size))
    ranks = np.empty((n, 2))
    for k in range(n):
        sigma, phi = math.exp(0.5 * rng.standard_normal()), rng.uniform(-1, 1)
        residual = simulate_noise("ar1", PAIR, rng, sigma=sigma, phi=phi)
        log_posterior = density(np.tile(residual, (grid_sigma.size, 1)), PAIR, grid_sigma, grid_phi)
        log_posterior = log_posterior.reshape(weight.shape) + weight
        p = np.exp(log_posterior - log_posterior.max())
        p /= p.sum()
        for i, (axis, grid, value) in enumerate(((1, np.log(SIGMA), math.log(sigma)), (0, PHI, phi))):
            cumulative = np.cumsum(p.sum(axis=axis))
            edges = np.concatenate([grid - 0.5 * (grid[1] - grid[0]), [grid[-1] + 0.5 * (grid[1] - grid[0])]])
            ranks[k, i] = np.interp(value, edges, np.concatenate([[0.0], cumulative]))
    return tuple(float(stats.kstest(ranks[:, i], "uniform").pvalue) for i in range(2))  # type: ignore[return-value]


def test_simulator_and_density_are_a_pair() -> None:
    assert min(rank_p_values(shipped_density)) > 0.005


def test_the_pair_check_sees_a_wrong_density() -> None:
    assert min(rank_p_values(wrong_density)) < 1e-6


def student_p_value(nu_of_density: float | None, n: int = 400) -> float:
    """p-value that the posterior ranks of log nu are uniform, with sigma and phi known; nu may be pinned wrongly."""
    rng = np.random.default_rng(8)
    stretches = Stretches(np.ones(60, dtype=bool), np.array([0, 25]))
    log_sigma = np.linspace(-2.0, 2.0, 161)
    ranks = np.empty(n)
    for k in range(n):
        truth, phi, nu = 0.5 * rng.standard_normal(), rng.uniform(-0.95, 0.95), math.exp(rng.uniform(0.4, 2.0))
        residual = simulate_noise("student", stretches, rng, sigma=math.exp(truth), phi=phi, nu=nu)
        many = np.ones(log_sigma.size)
        log_posterior = stats.norm(0, 0.5).logpdf(log_sigma) + log_density(
            "student",
            np.tile(residual, (log_sigma.size, 1)),
            stretches,
            sigma=np.exp(log_sigma),
            phi=phi * many,
            nu=(nu_of_density or nu) * many,
        )
        p = np.exp(log_posterior - log_posterior.max())
        cumulative = np.cumsum(p) / p.sum()
        edges = np.append(log_sigma - 0.0125, log_sigma[-1] + 0.0125)
        ranks[k] = np.interp(truth, edges, np.concatenate([[0.0], cumulative]))
    return float(stats.kstest(ranks, "uniform").pvalue)


def test_student_simulator_and_density_are_a_pair() -> None:
    assert student_p_value(None) > 0.005
    assert student_p_value(1000.0) < 1e-6  # the same check with a Gaussian density


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"model": "white"}, "noise model 'white' is not known; choose one of independent, ar1, student"),
        ({"sigma": 0.0}, "sigma = 0 kN: allowed is above 0 kN"),
        ({"sigma": math.nan}, "sigma = nan kN"),
        ({"phi": 1.0}, "phi = 1: allowed is above -1 and below 1"),
        ({"phi": math.nan}, "phi = nan"),
        ({"model": "student", "nu": 0.0}, "nu = 0: allowed is above 0"),
    ],
)
def test_noise_outside_its_range_is_refused(change: dict[str, object], message: str) -> None:
    arguments = {"model": "ar1", "sigma": 1.0, "phi": 0.5} | change
    model = arguments.pop("model")
    with pytest.raises(ModelError, match=message.replace("(", r"\(")):
        simulate_noise(model, gappy(), np.random.default_rng(1), **arguments)


def test_same_stream_same_noise() -> None:
    draws = [simulate_noise("ar1", gappy(), np.random.default_rng(9), sigma=1.0, phi=0.5) for _ in range(2)]
    assert np.array_equal(*draws)
