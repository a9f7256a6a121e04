"""A small simulated device that fits in well under a second, for every test that needs data."""

from collections.abc import Callable

import numpy as np
import pytest

from shj_bayes.inference.problem import Problem, Run
from shj_bayes.model.parameters import Layout
from shj_bayes.model.priors import Priors, read_priors
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.protocol import Block, exact_motion

BLOCKS = (Block(12.0, 0.13, 2), Block(24.0, 0.067, 2))
RATE_HZ = 6.0
TRUTH = Truth(K=18.0, Fy=80.0, beta=10.0, gamma=0.01, ratio=0.8, sigma=1.0, phi=0.5, displacement_noise_mm=0.0)


def small_problem(
    truth: Truth = TRUTH,
    *,
    seed: int = 1,
    n_runs: int = 2,
    noise: str = "ar1",
    free: tuple[str, ...] = (),
    variant: str = "seed",
    priors: Priors | None = None,
    blocks: tuple[Block, ...] = BLOCKS,
    rate_Hz: float = RATE_HZ,
) -> Problem:
    """Two short blocks, simulated and bound to the exact motion."""
    recordings = simulate_device(truth, seed=seed, rate_Hz=rate_Hz, n_runs=n_runs, blocks=blocks, variant=variant)
    # The exact motion keeps the reader's smoothing out of tests of the law, the noise and the sampler.
    _, motion = exact_motion(blocks, rate_Hz)
    runs = tuple(Run(recording, motion) for recording in recordings)
    return Problem(runs, Layout(n_runs, noise, free), priors or read_priors("afc"), variant)


def vector_of(problem: Problem, truth: Truth = TRUTH) -> np.ndarray:
    """Truth as one parameter set in natural units, shape (1, d)."""
    values = {"nu": 8.0}
    for name in problem.layout.names:
        base = name.partition("_")[0]
        values.setdefault(name, getattr(truth, base, 0.0))
    return np.array([[values[name] for name in problem.layout.names]])


@pytest.fixture(scope="session")
def make_small() -> Callable[..., Problem]:
    """Factory of problems of about 270 samples a run; keyword arguments as in `small_problem`."""
    return small_problem


@pytest.fixture(scope="session")
def small_device() -> Problem:
    """Two runs of one device, AR(1) noise."""
    return small_problem()


@pytest.fixture(scope="session")
def truth() -> Truth:
    """Parameters from which the small device is simulated."""
    return TRUTH


@pytest.fixture(scope="session")
def as_vector() -> Callable[..., np.ndarray]:
    """Truth as a parameter set of a problem, shape (1, d)."""
    return vector_of
