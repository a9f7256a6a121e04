"""Every proposal we ship must reproduce a target of known spread; emcee 3.1.6's snooker move must be caught.

The measure is the mean square of the whitened coordinates of a 6-d Gaussian, which is 1: its root is the sampled
standard deviation over the true one. Its Monte-Carlo error comes from the integrated autocorrelation time of that very
quantity; a move passes when it is within four of them of the truth. Quick: errors of 0.002 to 0.005 (printed on
failure), enough to see the bias of 0.035 of the 0.8 DE + 0.2 snooker mix several times over.
"""

from collections.abc import Callable
from dataclasses import dataclass
from threading import Event

import emcee
import numpy as np
import pytest

from shj_bayes.inference.proposal import Proposal, fit_proposal
from shj_bayes.inference.sampler import EnsembleState, _advance, moves
from shj_bayes.inference.start import Start

D = 6
N_WALKERS = 60
Mix = list[tuple[emcee.moves.Move, float]]


@dataclass(frozen=True)
class Target:
    """A law whose coordinates become independent standard normals; the way there keeps volumes, up to a constant."""

    to_unit: Callable[[np.ndarray], np.ndarray]
    from_unit: Callable[[np.ndarray], np.ndarray]

    def log_posterior_free(self, x: np.ndarray) -> np.ndarray:
        """Log density, up to a constant."""
        return np.asarray(-0.5 * np.sum(self.to_unit(x) ** 2, axis=1))


def linear(root: np.ndarray) -> Target:
    """Gaussian with covariance root root'."""
    inverse = np.linalg.inv(root)
    return Target(lambda x: x @ inverse.T, lambda z: z @ root.T)


def posterior_like() -> np.ndarray:
    """Spreads from 1e-4 to 10 and neighbouring correlations of 0.9, as K, beta, gamma and sigma have them."""
    scale = np.array([1e-4, 1e-2, 0.03, 0.3, 1.0, 10.0])
    lag = np.abs(np.subtract.outer(np.arange(D), np.arange(D)))
    return np.asarray(np.linalg.cholesky(0.9**lag) * scale[:, None])


def bent(x: np.ndarray, by: float) -> np.ndarray:
    """A banana: the second coordinate moves with the square of the first."""
    out = np.array(x, dtype=np.float64)
    out[:, 1] += by * (out[:, 0] ** 2 - 1.0)
    return out


TARGETS = {
    "unit": linear(np.eye(D)),
    "posterior-like": linear(posterior_like()),
    "banana": Target(lambda x: bent(x, -0.7), lambda z: bent(z, 0.7)),
}


def fitted(target: Target) -> Proposal:
    """The proposal as the sampler makes it, from a start that is half a spread off and a third too narrow."""
    draws = target.from_unit(np.random.default_rng(3).standard_normal((4000, D)))
    covariance = np.cov(draws.T)
    start = Start(draws.mean(axis=0) + 0.5 * np.sqrt(np.diag(covariance)), 0.5 * covariance, 0.0)
    return fit_proposal(target, start, np.random.default_rng(4))


@dataclass(frozen=True)
class Spread:
    """Sampled spread over the true one."""

    all: float  # root mean square over all whitened coordinates
    error: float  # its Monte-Carlo standard error
    worst: float  # largest deviation of a single coordinate, in its own errors

    @property
    def honest(self) -> bool:
        """Within four errors of the truth, overall and in each coordinate (there are six: 4.5 for those)."""
        return abs(self.all - 1) < 4 * self.error and self.worst < 4.5


def measure(mix: Mix, target: Target, n_steps: int, seed: int) -> Spread:
    """Run one ensemble from exact draws; without a burn-in there is nothing that could hide a drift."""
    rng = np.random.default_rng(seed)
    sampler = emcee.EnsembleSampler(N_WALKERS, D, target.log_posterior_free, moves=mix, vectorize=True)
    start = emcee.State(
        target.from_unit(rng.standard_normal((N_WALKERS, D))), random_state=np.random.RandomState(seed).get_state()
    )
    sampler.run_mcmc(start, n_steps, skip_initial_state_check=True)
    return spread_of(sampler.get_chain()[n_steps // 10 :], target)


def spread_of(chain: np.ndarray, target: Target) -> Spread:
    """Spread of a chain, shape (n_steps, n_walkers, d)."""
    squares = target.to_unit(chain.reshape(-1, D)).reshape(chain.shape) ** 2
    one, each = error_of(squares.mean(axis=2)[..., None]), error_of(squares)
    mean = squares.mean(axis=(0, 1))
    return Spread(float(np.sqrt(mean.mean())), float(one[0] / 2), float(np.max(np.abs(mean - 1) / each)))


def error_of(values: np.ndarray) -> np.ndarray:
    """Monte-Carlo standard error of the mean, shape (n_steps, n_walkers, k) to (k,)."""
    tau = emcee.autocorr.integrated_time(values, tol=0, quiet=True)
    return np.asarray(values.std(axis=(0, 1)) * np.sqrt(tau / (values.shape[0] * values.shape[1])))


def shipped(name: str, target: Target) -> Mix:
    """The mix as it is used, or one of its moves alone."""
    mix = moves(fitted(target))
    return mix if name == "mix" else [(mix[NAMES.index(name) - 1][0], 1.0)]


NAMES = ("mix", "fitted proposal alone", "DE alone", "whole differences alone")
# Independent draws from a poor proposal, and jumps along a banana, take too long to be measured this closely.
CASES = [(name, target) for name in NAMES for target in TARGETS if target != "banana" or name == "mix"]


SNOOKER: dict[str, Callable[[], Mix]] = {
    "snooker alone": lambda: [(emcee.moves.DESnookerMove(), 1.0)],
    "0.8 DE + 0.2 snooker": lambda: [(emcee.moves.DEMove(), 0.8), (emcee.moves.DESnookerMove(), 0.2)],
}


@pytest.mark.parametrize(("name", "target"), CASES)
def test_shipped_moves_reproduce_the_spread(name: str, target: str) -> None:
    spread = measure(shipped(name, TARGETS[target]), TARGETS[target], 2500, seed=1)
    assert spread.honest, spread
    assert spread.error < 0.006, spread  # a check with a large error would pass anything


def test_the_sampler_itself_reproduces_the_spread() -> None:
    """Whatever moves the walkers: the chain that a fit gets is measured, not the moves that emcee is given."""
    target, seed = TARGETS["posterior-like"], 1
    points = target.from_unit(np.random.default_rng(seed).standard_normal((N_WALKERS, D)))
    legacy = tuple(np.random.RandomState(seed).get_state())
    begin = EnsembleState(points[None], target.log_posterior_free(points)[None], np.zeros(N_WALKERS), legacy, 0)
    end = _advance(target, fitted(target), Event(), begin, 2500)
    spread = spread_of(end.chain[250:], target)
    assert spread.honest, spread
    assert spread.error < 0.006, spread


def test_the_check_sees_a_proposal_without_its_hastings_factor() -> None:
    """The fitted proposal accepted as if it were symmetric: close to the target, and wrong."""
    proposal = fitted(TARGETS["unit"])

    def careless(z: np.ndarray, random: np.random.RandomState) -> tuple[np.ndarray, np.ndarray]:
        return proposal.draw(z.shape[0], random), np.zeros(z.shape[0])

    spread = measure([(emcee.moves.MHMove(careless), 1.0)], TARGETS["unit"], 2500, seed=1)
    assert not spread.honest, spread
    assert spread.all < 0.9, spread


def test_a_poor_proposal_is_slow_but_honest() -> None:
    """Centre and widths wrong by more than any fit would leave them."""
    d = np.ones(D)
    poor = Proposal(np.array([0.5, 0.5]), np.stack([0.4 * d, -0.2 * d]), np.stack([1.4 * np.eye(D), np.eye(D)]), 1.0)
    spread = measure(moves(poor), TARGETS["unit"], 2500, seed=1)
    assert spread.honest, spread
    assert spread.error < 0.006, spread


@pytest.mark.parametrize("name", SNOOKER)
def test_the_check_sees_the_snooker_move(name: str) -> None:
    spread = measure(SNOOKER[name](), TARGETS["unit"], 1500 if "alone" in name else 2500, seed=1)
    assert not spread.honest, spread
    assert spread.all < 0.98, spread  # too narrow, the dangerous side


def test_the_plain_moves_pass_where_the_snooker_fails() -> None:
    """Same length, same seed, same check: it is the snooker that fails, not the check."""
    assert measure([(emcee.moves.DEMove(), 1.0)], TARGETS["unit"], 2500, seed=1).honest


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("name", "target"), CASES)
def test_shipped_moves_reproduce_the_spread_closely(name: str, target: str, seed: int) -> None:
    spread = measure(shipped(name, TARGETS[target]), TARGETS[target], 20_000, seed=10 + seed)
    assert spread.honest, spread
    assert spread.error < 0.0025, spread


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, 3, 4])
def test_the_check_sees_the_snooker_mix_whatever_the_seed(seed: int) -> None:
    """On the unit target: along one long axis, as in the other, its factor is nearly right (0.994 +/- 0.003)."""
    assert not measure(SNOOKER["0.8 DE + 0.2 snooker"](), TARGETS["unit"], 6000, seed=seed).honest
