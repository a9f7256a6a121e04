"""The fitted proposal: a proper density, close to the target whatever the start, and the same every time."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy import integrate, stats

from shj_bayes.inference.proposal import N_DRAWS, N_ROUNDS, TAIL, Proposal, fit_proposal
from shj_bayes.inference.start import Start

D = 5


class Target:
    """A log density of many points that counts its calls."""

    def __init__(self, log_density: Callable[[np.ndarray], np.ndarray]) -> None:
        self.log_density, self.n = log_density, 0

    def log_posterior_free(self, z: np.ndarray) -> np.ndarray:
        """Count and evaluate."""
        self.n += len(z)
        return np.asarray(self.log_density(z))


def skewed(z: np.ndarray) -> np.ndarray:
    """A Gaussian but for the first coordinate, which has a long tail: a sharpness that the data only bound below."""
    return np.asarray(stats.gumbel_r.logpdf(z[:, 0]) - 0.5 * np.sum(z[:, 1:] ** 2, axis=1))


def gaussian(z: np.ndarray) -> np.ndarray:
    return np.asarray(-0.5 * np.sum((z / SCALE) ** 2, axis=1))


def bounded_below(z: np.ndarray) -> np.ndarray:
    """A first coordinate that falls off within 0.1 on one side and with the prior's width on the other."""
    side = np.where(z[:, 0] < 0, 0.1, 1.0)
    return np.asarray(-0.5 * (z[:, 0] / side) ** 2 - 0.5 * np.sum(z[:, 1:] ** 2, axis=1))


SCALE = np.array([1e-3, 0.1, 1.0, 3.0, 20.0])
FAR = Start(1.5 * SCALE, 0.3 * np.diag(SCALE**2), 0.0)  # off by 1.5 and half as wide
LAWS = {
    "gaussian": (gaussian, Start(np.zeros(D), np.diag(SCALE**2), 0.0), 0.7),
    "gaussian, poor start": (gaussian, FAR, 0.55),
    "skewed": (skewed, Start(np.zeros(D), np.eye(D), 0.0), 0.55),
}


def acceptance(proposal: Proposal, log_density: Callable[[np.ndarray], np.ndarray]) -> float:
    """Share of its draws that a chain at rest accepts."""
    rng = np.random.default_rng(9)
    z = proposal.draw(8000, rng)
    weight = np.exp(log_density(z) - proposal.log_density(z))
    at = rng.choice(weight.size, weight.size, p=weight / weight.sum())
    return float(np.mean(np.minimum(1.0, weight / weight[at])))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", LAWS)
def test_it_comes_close_to_the_target(name: str, seed: int) -> None:
    law, start, least = LAWS[name]
    target = Target(law)
    proposal = fit_proposal(target, start, np.random.default_rng(seed))
    assert acceptance(proposal, law) > least
    assert target.n <= N_ROUNDS[1] * N_DRAWS


@pytest.mark.parametrize("seed", range(3))
def test_a_tail_that_the_curvature_does_not_tell_is_met(seed: int) -> None:
    """A chain out there must come back: two components of the same shape left it there for hundreds of steps."""
    start = Start(np.zeros(D), np.diag([0.1**2, 1.0, 1.0, 1.0, 1.0]), 0.0)
    proposal = fit_proposal(Target(bounded_below), start, np.random.default_rng(seed))
    rng = np.random.default_rng(10)
    out = np.column_stack([np.full(400, 2.5), rng.standard_normal((400, D - 1))])
    there = bounded_below(out) - proposal.log_density(out)
    new = proposal.draw(400, rng)
    weight = bounded_below(new) - proposal.log_density(new)
    leaves = float(np.mean(np.exp(np.minimum(0.0, weight[:, None] - there[None, :]))))
    assert leaves > 0.1


def hidden_noise(z: np.ndarray) -> np.ndarray:
    """A white noise that another part of the noise may be all of: of both, in logarithms, only the sum is known."""
    total = np.logaddexp(z[:, 0], z[:, 1]) - np.log(2.0)
    return np.asarray(-0.5 * (total / 0.05) ** 2 - 0.5 * (z[:, 0] ** 2 + z[:, 1] ** 2) / 9.0 + other(z))


def other(z: np.ndarray) -> np.ndarray:
    return np.asarray(-0.5 * np.sum(z[:, 2:] ** 2, axis=1))


@pytest.mark.parametrize("seed", range(3))
def test_a_ridge_that_bends_is_met_to_its_end(seed: int) -> None:
    """Both ends hold a tenth of the mass and lie where no straight line from the top goes."""
    curvature = np.linalg.inv(np.full((2, 2), 0.25 / 0.05**2) + np.eye(2) / 9.0)
    covariance = np.block([[curvature, np.zeros((2, D - 2))], [np.zeros((D - 2, 2)), np.eye(D - 2)]])
    law = Target(hidden_noise)
    proposal = fit_proposal(law, Start(np.zeros(D), covariance, 0.0), np.random.default_rng(seed))
    grid = np.stack(np.meshgrid(*2 * [np.linspace(-12.0, 1.5, 1500)], indexing="ij"), axis=-1).reshape(-1, 2)
    exact = np.exp(hidden_noise(np.pad(grid, ((0, 0), (0, D - 2)))))
    ends = [float(exact[grid[:, i] < -4.0].sum() / exact.sum()) for i in range(2)]
    z = proposal.draw(20_000, np.random.default_rng(5))
    weight = np.exp(hidden_noise(z) - proposal.log_density(z))
    assert weight.max() < 30.0 * weight.mean()  # nowhere is a walker held for long
    assert min(ends) > 0.05
    found = [float(weight[z[:, i] < -4.0].sum() / weight.sum()) for i in range(2)]
    np.testing.assert_allclose(found, ends, atol=0.02)


def test_a_start_without_any_density_still_gives_a_proposal() -> None:
    nowhere = Target(lambda z: np.full(len(z), -np.inf))
    proposal = fit_proposal(nowhere, FAR, np.random.default_rng(1))
    assert proposal.efficiency == 0.0
    assert np.all(np.isfinite(proposal.draw(10, np.random.default_rng(1))))


def test_same_seed_same_proposal() -> None:
    a, b = (fit_proposal(Target(skewed), LAWS["skewed"][1], np.random.default_rng(4)) for _ in range(2))
    for name in ("weights", "means", "roots"):
        assert np.array_equal(getattr(a, name), getattr(b, name))


def mixture(d: int) -> Proposal:
    root = np.tril(np.full((d, d), 0.3)) + np.eye(d)
    return Proposal(np.array([0.3, 0.7]), np.stack([np.ones(d), -np.ones(d)]), np.stack([root, 2 * root]), 1.0)


def test_the_density_is_that_of_the_t_mixture() -> None:
    law = mixture(3)
    z = np.random.default_rng(1).normal(size=(20, 3))
    expected = sum(
        w * stats.multivariate_t(m, r @ r.T, df=TAIL).pdf(z)
        for w, m, r in zip(law.weights, law.means, law.roots, strict=True)
    )
    np.testing.assert_allclose(law.log_density(z), np.log(expected), rtol=1e-12)
    whole, _ = integrate.quad(lambda x: float(np.exp(mixture(1).log_density(np.array([[x]]))[0])), -np.inf, np.inf)
    assert whole == pytest.approx(1.0, abs=1e-8)


def test_draws_follow_the_density() -> None:
    law = mixture(2)
    z = law.draw(40_000, np.random.default_rng(2))
    mean = law.weights @ law.means
    np.testing.assert_allclose(z.mean(axis=0), mean, atol=0.06)
    grow = TAIL / (TAIL - 2)
    second = sum(
        w * (np.outer(m, m) + grow * r @ r.T) for w, m, r in zip(law.weights, law.means, law.roots, strict=True)
    )
    np.testing.assert_allclose(z.T @ z / len(z), second, rtol=0.05, atol=0.1)


def test_the_move_carries_its_hastings_factor() -> None:
    law = mixture(3)
    old = np.random.default_rng(1).normal(size=(6, 3))
    new, factor = law.move(old, np.random.RandomState(1))
    assert new.shape == old.shape
    np.testing.assert_allclose(factor, law.log_density(old) - law.log_density(new))
