"""The likelihood by sums over blocks against the one that goes through the samples."""

import dataclasses
import itertools
from collections.abc import Callable

import numpy as np
import pytest

from shj_bayes.inference import moments
from shj_bayes.inference.fit import make_problem
from shj_bayes.inference.moments import log_density_of_sums, moments_of
from shj_bayes.inference.moments_kernel import N_NODES, NODES, calm_below, is_polynomial, shape_of
from shj_bayes.inference.problem import Problem, Run
from shj_bayes.model.law import force_of_laws
from shj_bayes.model.noise import Stretches, log_density
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.motion import Motion
from shj_bayes.recording.protocol import Block, exact_motion
from shj_bayes.recording.recording import Recording

Make = Callable[..., Problem]
BLOCKS = (Block(12.0, 0.13, 2), Block(60.0, 0.02, 2))
RATE_HZ = 60.0  # blocks of several sizes in a half-cycle, some of them smooth, some saturated, some through samples


def near(beta: float, n: int = 12) -> np.ndarray:
    """Laws around K 18, Fy 80, as an ensemble holds them, and a few far away."""
    rng = np.random.default_rng(1)
    laws = np.array([18.0, 80.0, beta, 0.015]) * np.exp(rng.normal(size=(n, 4)) * [0.05, 0.05, 0.1, 0.3])
    far = np.array([[1.0, 95.0, beta, 0.0], [300.0, 5.0, beta, -0.02], [40.0, 500.0, beta, 0.05]])
    laws = np.vstack([laws, far])
    laws[:, 2] = np.clip(laws[:, 2], 1.0, 500.0)
    return laws


def both_ways(
    run: Run, laws: np.ndarray, noise: str, phi: float, variant: str, leaf: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Log density by the sums and by the samples."""
    sigma, lag = np.full(len(laws), 1.3), np.full(len(laws), phi)
    blocks = moments_of(run.motion, run.recording.force_kN, run.stretches, leaf)
    sums, sound = blocks.residual_sums(laws, variant=variant, start_force_kN=2.5)
    assert sound.all()
    residual = run.recording.force_kN - force_of_laws(run.motion, laws, variant=variant, start_force_kN=2.5)
    expected = log_density(noise, residual, run.stretches, sigma=sigma, phi=lag)
    return log_density_of_sums(noise, sums, run.stretches, sigma=sigma, phi=lag), expected


@pytest.fixture(scope="module")
def measured() -> Run:
    """Through the reader: smoothed displacement with noise, samples beside reversals unsure."""
    recording = simulate_device(Truth(gamma=0.01), seed=1, rate_Hz=RATE_HZ, n_runs=1, blocks=BLOCKS)[0]
    return make_problem([recording]).runs[0]


@pytest.mark.parametrize("leaf", [16, 64, 0, 10_000])
@pytest.mark.parametrize("variant", ["seed", "continuous"])
@pytest.mark.parametrize("beta", [1.0, 1.3, 2.0, 5.5, 10.0, 40.0, 100.0, 300.0])
def test_sums_are_those_of_the_samples(measured: Run, beta: float, variant: str, leaf: int) -> None:
    for noise, phi, tolerance in (("independent", 0.0, 1e-10), ("ar1", 0.8, 1e-9), ("ar1", -0.6, 1e-9)):
        got, expected = both_ways(measured, near(beta), noise, phi, variant, leaf)
        np.testing.assert_allclose(got, expected, rtol=tolerance)


def misses(low: float, high: float, beta: float, variant: str = "seed") -> float:
    """Largest error of the polynomial through the nodes of a block, in Fy."""
    angles = np.arccos(NODES)
    to_powers = np.cos(np.outer(np.arange(N_NODES), angles)) * (2.0 - (np.arange(N_NODES) == 0)[:, None]) / N_NODES
    t = np.cos(np.linspace(0.0, np.pi, 301))
    lagrange = np.cos(np.outer(np.arccos(t), np.arange(N_NODES))) @ to_powers

    def law(place: np.ndarray) -> np.ndarray:
        u = 0.5 * (low + high) + 0.5 * (high - low) * place
        size = np.maximum(np.abs(u), 1e-300)
        held = np.sign(u) * np.minimum(size, 1.0) * (1.0 + np.minimum(size, 1 / size) ** beta) ** (-1.0 / beta)
        return np.where((variant == "continuous") & (u < 0.0), u, held)

    return float(np.abs(lagrange @ law(NODES) - law(t)).max())


@pytest.mark.parametrize("variant", ["seed", "continuous"])
def test_a_calm_block_around_0_is_its_polynomial(variant: str) -> None:
    """For every beta, however much of the block lies on either side; a third further out it is not, for most."""
    betas = np.geomspace(3.0, 500.0, 120)
    for beta in betas:
        reach = calm_below(beta)
        for side in (-1.0, -0.6, -0.3, 0.0, 0.5):
            assert misses(side * reach, reach, beta, variant) < 1e-11
    assert sum(misses(-1.33 * calm_below(b), 1.33 * calm_below(b), b, variant) > 1e-11 for b in betas) > 80
    assert calm_below(2.9) == 0.0


@pytest.mark.parametrize("beta", [1.0, 1.3, 2.0, 2.5, 3.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 500.0])
def test_a_block_that_counts_as_polynomial_is_one(beta: float) -> None:
    """Anywhere about the knee and of any width; of those that are one, nine in ten are known to be."""
    rng = np.random.default_rng(int(10 * beta))
    shape, known, all_that_are = shape_of(beta), 0, 0
    for _ in range(400):
        middle = np.exp(rng.uniform(-30.0, 30.0) / beta)
        half = middle * np.exp(rng.uniform(-5.0, 0.0)) * min(1.0, 30.0 / beta)
        low, high = np.sort([-middle - half, -middle + half] if rng.random() < 0.5 else [middle - half, middle + half])
        error = misses(low, high, beta)
        all_that_are += error < 1e-11
        if is_polynomial(low, high, shape, 0.0):
            known += 1
            assert error < 1.2e-11
    assert known >= 0.88 * all_that_are


def test_blocks_are_used(measured: Run) -> None:
    """Few of the samples are gone through, or the test above would compare the samples with themselves."""
    blocks = moments_of(measured.motion, measured.recording.force_kN, measured.stretches, 64)
    columns, offset = blocks.packed
    emptied = (columns * np.array([1.0, 1.0, 1.0, 0.0, 0.0])[:, None], offset)  # samples of leaves weigh nothing
    without = dataclasses.replace(blocks, packed=emptied)
    laws = near(100.0)[:3]
    whole, part = (b.residual_sums(laws)[0][:, 0] for b in (blocks, without))
    assert np.all(part > 0.3 * whole)
    assert np.all(part < 0.999 * whole)


@pytest.mark.parametrize("phi", [0.99, 0.9999])
def test_nothing_cancels_where_noise_is_nearly_a_random_walk(measured: Run, phi: float) -> None:
    got, expected = both_ways(measured, near(10.0), "ar1", phi, "seed")
    np.testing.assert_allclose(got, expected, rtol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_any_samples_may_be_missing(measured: Run, seed: int) -> None:
    """Unused samples, gaps, single samples between unused ones, and reversals within a stretch."""
    rng = np.random.default_rng(seed)
    n = measured.recording.n_samples
    used = rng.random(n) > rng.choice([0.0, 0.02, 0.5])
    recording = dataclasses.replace(measured.recording, used=used)
    recording = Recording(
        np.cumsum(np.where(rng.random(n) < 0.003, 1.0, 1 / RATE_HZ)),
        recording.displacement_mm,
        recording.force_kN,
        used=used,
    )
    sure = dataclasses.replace(measured.motion, unsure=rng.random(n) < 0.01)
    run = Run(recording, sure)
    assert run.stretches.n_follow < run.stretches.n_used < n
    for noise, phi in (("independent", 0.0), ("ar1", 0.7)):
        got, expected = both_ways(run, near(10.0), noise, phi, "seed")
        np.testing.assert_allclose(got, expected, rtol=1e-9)


def test_rests_and_backward_steps() -> None:
    """Displacement that stands still for a block, and noise against the motion: no order is needed."""
    time, motion = exact_motion(BLOCKS, RATE_HZ)
    x = motion.displacement_mm.copy()
    x[900:1300] = x[900]
    x += 0.05 * np.random.default_rng(2).standard_normal(x.size)
    x[2000:2400] = x[2000]
    moved = Motion(x, motion.speed_mm_s, motion.start, motion.turning_mm, motion.direction)
    force = 80 * np.tanh(x) + np.random.default_rng(3).standard_normal(x.size)
    run = Run(Recording(time, x, force), moved)
    for noise, phi in (("independent", 0.0), ("ar1", 0.9)):
        got, expected = both_ways(run, near(10.0), noise, phi, "seed", 32)
        np.testing.assert_allclose(got, expected, rtol=1e-9)


def test_each_set_has_its_own_numbers(measured: Run) -> None:
    """A batch gives the bits of each set alone: the same numbers, serial or parallel."""
    blocks, laws = measured.moments, near(10.0)
    together = blocks.residual_sums(laws)[0]
    for row, law in zip(together, laws, strict=True):
        assert np.array_equal(row, blocks.residual_sums(law[None])[0][0])


def test_without_noise_the_samples_are_asked(make_small: Make, as_vector: Callable[..., np.ndarray]) -> None:
    """Squares that are rounding errors of differences are noticed, and the exact ones taken."""
    truth = Truth(sigma=0.0, displacement_noise_mm=0.0)
    problem = make_small(truth, blocks=BLOCKS, rate_Hz=200.0)
    theta = as_vector(problem, dataclasses.replace(truth, sigma=1e-3))
    run = problem.runs[0]
    assert not run.moments.residual_sums(problem.layout.laws(theta, 1))[1].any()
    assert np.array_equal(problem.log_likelihood(theta), problem.log_likelihood_by_samples(theta))


def test_overflow_is_asked_of_the_samples(make_small: Make) -> None:
    laws = np.array([[1e300, 1e200, 10.0, 0.0], [18.0, 80.0, 10.0, 1e200]])
    sums, sound = make_small().runs[0].moments.residual_sums(laws)
    assert not sound[~np.isfinite(sums).all(axis=1)].any()


@pytest.mark.parametrize("noise", ["independent", "ar1", "student"])
@pytest.mark.parametrize("n_runs", [1, 2])
def test_likelihood_of_a_problem(make_small: Make, noise: str, n_runs: int) -> None:
    problem = make_small(noise=noise, n_runs=n_runs)
    theta = problem.natural(np.random.default_rng(1).normal(0, 0.7, (25, len(problem.layout.names))))
    np.testing.assert_allclose(problem.log_likelihood(theta), problem.log_likelihood_by_samples(theta), rtol=1e-9)


def test_leaves_are_few_however_many_samples() -> None:
    """Memory is bounded; only samples far from the knee lie in leaves of many samples."""
    n_leaves = {}
    for rate in (60.0, 600.0, 6000.0):
        _, motion = exact_motion(BLOCKS, rate)
        force = force_of_laws(motion, np.array([[18.0, 80.0, 10.0, 0.0]]))[0]
        kind = Stretches(np.ones(force.size, dtype=np.bool_), np.zeros(1, dtype=np.int64))
        blocks = moments_of(motion, force, kind).tree[0]
        n_leaves[rate] = int(np.count_nonzero(blocks[:, 3]))
    assert n_leaves[6000.0] <= 1.5 * moments.MAX_LEAVES
    assert n_leaves[600.0] < 8 * n_leaves[60.0]


def test_blocks_tile_each_half_cycle() -> None:
    start = [0, 5, 400, 1000, 1063]
    slip = np.concatenate([np.linspace(0, 100, b - a) for a, b in itertools.pairwise(start)])
    blocks, of_half = moments._halve(start, slip, 30.0, 32)
    for k in range(4):
        part = blocks[of_half[k] : of_half[k + 1]]
        assert part[0, :2].tolist() == start[k : k + 2]
        leaves = part[part[:, 3] == 1]
        assert leaves[:, 0].tolist() == [start[k], *leaves[:-1, 1]]
        for a, b, beside, leaf in part.tolist():
            assert leaf == (b - a < 64 or (slip[a] > 30.0 and slip[b - 1] - slip[a] < moments.SHARE * slip[a]))
            assert beside == of_half[k + 1] or blocks[beside, 0] == b


def test_white_noise_needs_no_phi() -> None:
    stretches = Stretches(np.ones(9, dtype=np.bool_), np.zeros(1, dtype=np.int64))
    r = np.arange(9.0)[None]
    sums = np.array([[np.sum(r**2), 8.0, 64.0]])
    got = log_density_of_sums("independent", sums, stretches, sigma=np.array([2.0]))
    np.testing.assert_allclose(got, log_density("independent", r, stretches, sigma=np.array([2.0])), rtol=1e-14)
