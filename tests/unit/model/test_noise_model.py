"""Noise: the density against full covariances and direct products, and simulator and density as a pair."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from shj_bayes.errors import ModelError
from shj_bayes.model import noise
from shj_bayes.model.filter import Timing, density_and_zero, log_density, simulate, whiten
from shj_bayes.model.noise import (
    DEFAULT,
    Noise,
    NoiseParameter,
    gaussian,
    noise_model,
    noise_models,
    noise_parameters,
)

STEP = 0.05
INF = math.inf
# Blocks of many sizes; a gap of eight samples and a new beginning among them. Four half-cycles.
COUNTS = (1, 1, 5, 3, 1, 20, 7, 2, 1, 4)
GAPS = (INF, STEP, STEP, STEP, 0.4, STEP, STEP, INF, STEP, STEP)
HALVES = (0, 4, 7, 8, 10)


def timing(
    counts: Sequence[int] = COUNTS,
    gaps: Sequence[float] = GAPS,
    halves: Sequence[int] = HALVES,
    *,
    step: float = STEP,
    noise_mm: float = 0.0,
    turning_mm: Sequence[float] | None = None,
    zero_kN: float = 0.0,
) -> Timing:
    """Blocks of evenly spaced samples."""
    table = np.array([[m, step, gap] for m, gap in zip(counts, gaps, strict=True)], dtype=float)
    kinds, kind = np.unique(table, axis=0, return_inverse=True)
    turning = np.zeros(len(halves) - 1) if turning_mm is None else np.array(turning_mm)
    return Timing(kind.ravel(), kinds, np.array(halves), step, noise_mm, turning, zero_kN)


def singles(n: int, restarts: Sequence[int] = (0,), step: float = STEP) -> Timing:
    """Samples on their own, all in one half-cycle."""
    return timing([1] * n, [INF if i in restarts else step for i in range(n)], (0, n), step=step)


def covariance(
    of_lag: Callable[[np.ndarray], np.ndarray],
    white: float,
    counts: Sequence[int] = COUNTS,
    gaps: Sequence[float] = GAPS,
    step: float = STEP,
) -> np.ndarray:
    """Covariance of block means from that of all samples, which is written out."""
    time, block, piece = [], [], []
    for i, (m, gap) in enumerate(zip(counts, gaps, strict=True)):
        new = not math.isfinite(gap)
        first = (time[-1] if time else 0.0) + (1000.0 if new else gap)
        piece += [(piece[-1] + 1 if new else piece[-1]) if piece else 0] * m
        time += [first + j * step for j in range(m)]
        block += [i] * m
    t, of_block, of_piece = np.array(time), np.array(block), np.array(piece)
    lag = np.abs(t[:, None] - t[None])
    samples = np.where(of_piece[:, None] == of_piece[None], of_lag(lag), 0.0) + white**2 * np.eye(t.size)
    mean = np.zeros((len(counts), t.size))
    mean[of_block, np.arange(t.size)] = 1.0 / np.array(counts)[of_block]
    return np.asarray(mean @ samples @ mean.T)


def normal(residual: np.ndarray, matrix: np.ndarray) -> float:
    """Log density of a Gaussian vector."""
    return float(stats.multivariate_normal(np.zeros(residual.size), matrix).logpdf(residual))


def ou(size: float, tau: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda lag: size**2 * np.exp(-lag / tau)


def ar1(size: float, phi: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda lag: size**2 * phi ** np.rint(lag / STEP)


CASES = {
    "white and slow": ("slow", {"sigma_white": 0.8, "sigma_slow": 0.6, "tau_slow": 0.7}, ou(0.6, 0.7), 0.8),
    "a memory of one sample": ("slow", {"sigma_white": 0.8, "sigma_slow": 2.0, "tau_slow": 0.03}, ou(2.0, 0.03), 0.8),
    "a memory of days": ("slow", {"sigma_white": 0.8, "sigma_slow": 60.0, "tau_slow": 1e6}, ou(60.0, 1e6), 0.8),
    "hardly any white": ("slow", {"sigma_white": 1e-3, "sigma_slow": 0.6, "tau_slow": 3.0}, ou(0.6, 3.0), 1e-3),
    "ar1": ("ar1", {"sigma": 1.3, "phi": 0.8}, ar1(1.3, 0.8), 0.0),
    "ar1, negative": ("ar1", {"sigma": 1.3, "phi": -0.4}, ar1(1.3, -0.4), 0.0),
    "ar1, strongly negative": ("ar1", {"sigma": 0.2, "phi": -0.95}, ar1(0.2, -0.95), 0.0),
    "ar1, none": ("ar1", {"sigma": 1.3, "phi": 0.0}, ou(1.3, 1e-9), 0.0),
    "independent": ("independent", {"sigma": 0.7}, lambda lag: 0.0 * lag, 0.7),
}
every_case = pytest.mark.parametrize("case", CASES)


def sets(values: dict[str, float], m: int = 1) -> dict[str, np.ndarray]:
    return {name: np.full(m, value) for name, value in values.items()}


def total(word: str, values: dict[str, float], residual: np.ndarray, slope: np.ndarray, when: Timing) -> float:
    """Log density of one series."""
    return float(log_density(noise_model(word), sets(values), residual[None], slope[None], when).sum())


@every_case
def test_blocks_have_the_density_of_their_covariance(case: str) -> None:
    word, values, of_lag, white = CASES[case]
    rng = np.random.default_rng(1)
    matrix = covariance(of_lag, white)
    for _ in range(3):
        residual = rng.normal(0, 2, len(COUNTS))
        got = total(word, values, residual, np.zeros_like(residual), timing())
        assert got == pytest.approx(normal(residual, matrix), rel=1e-8)


@every_case
def test_noise_of_the_displacement_adds_where_the_force_is_steep(case: str) -> None:
    word, values, of_lag, white = CASES[case]
    rng = np.random.default_rng(2)
    residual, slope = rng.normal(0, 2, len(COUNTS)), rng.uniform(-15, 15, len(COUNTS))
    matrix = covariance(of_lag, white) + np.diag(slope**2 * 0.02**2 / np.array(COUNTS))
    got = total(word, values, residual, slope, timing(noise_mm=0.02))
    assert got == pytest.approx(normal(residual, matrix), rel=1e-8)


@every_case
def test_white_noise_that_is_rougher_in_some_blocks(case: str) -> None:
    """Density and whitening: only the white part is, not what the displacement or the slow part adds."""
    word, values, of_lag, white = CASES[case]
    rng = np.random.default_rng(14)
    residual, slope = rng.normal(0, 2, len(COUNTS)), rng.uniform(-15, 15, len(COUNTS))
    rough, share = rng.uniform(0.2, 9.0, len(COUNTS)), 1.0 / np.array(COUNTS)
    own = share * ((rough - 1.0) * white**2 + (0.02 * slope) ** 2)
    matrix = covariance(of_lag, white) + np.diag(own)
    when = replace(timing(noise_mm=0.02), rough=rough)
    assert total(word, values, residual, slope, when) == pytest.approx(normal(residual, matrix), rel=1e-8)
    got, log_det = whiten(noise_model(word), values, residual[:, None], slope, when)
    np.testing.assert_allclose(got[:, 0], np.linalg.solve(np.linalg.cholesky(matrix), residual), rtol=1e-7, atol=1e-9)
    assert log_det == pytest.approx(np.linalg.slogdet(matrix)[1], rel=1e-8)


TURNS = (0.0, 0.03, 0.01, 0.05)


@pytest.mark.parametrize("word", ["independent", "slow"])
def test_the_error_of_a_turning_point_moves_all_blocks_behind_it(word: str) -> None:
    """Exact where the noise forgets at each reversal: without memory, or with a new beginning there."""
    _, values, of_lag, white = CASES["independent" if word == "independent" else "white and slow"]
    gaps = list(GAPS)
    if word == "slow":
        for first in HALVES[1:-1]:
            gaps[first] = INF
    rng = np.random.default_rng(3)
    residual, slope = rng.normal(0, 2, len(COUNTS)), rng.uniform(-15, 15, len(COUNTS))
    matrix = covariance(of_lag, white, gaps=gaps) + np.diag(slope**2 * 0.01**2 / np.array(COUNTS))
    for turn, a, b in zip(TURNS, HALVES, HALVES[1:], strict=False):
        matrix[a:b, a:b] += turn**2 * np.outer(slope[a:b], slope[a:b])
    got = total(word, values, residual, slope, timing(gaps=gaps, noise_mm=0.01, turning_mm=TURNS))
    assert got == pytest.approx(normal(residual, matrix), rel=1e-9)
    assert abs(got - total(word, values, residual, slope, timing(gaps=gaps, noise_mm=0.01))) > 0.01


def test_long_blocks_at_a_high_rate_keep_their_digits() -> None:
    """300 samples at 1 kHz and a memory of minutes: 1 - r is 1e-5, its square is lost."""
    counts, gaps = (300, 299, 300), (INF, 1e-3, 1e-3)
    residual = np.array([0.5, -0.2, 0.1])
    for tau in (1.0, 100.0, 1e4, 1e6):
        matrix = covariance(ou(2.0, tau), 0.1, counts, gaps, step=1e-3)
        values = {"sigma_white": 0.1, "sigma_slow": 2.0, "tau_slow": tau}
        got = total("slow", values, residual, np.zeros(3), timing(counts, gaps, (0, 3), step=1e-3))
        assert got == pytest.approx(normal(residual, matrix), rel=1e-7)


@pytest.mark.parametrize("nu", [1.5, 4.0, 60.0])
def test_student_is_the_product_over_what_is_new_in_each_sample(nu: float) -> None:
    """Each residual given those before it, standardised by the Gaussian recursion, has a t density."""
    n = 30
    gaps = [INF if i in (0, 12) else 0.5 if i == 20 else STEP for i in range(n)]
    residual = np.random.default_rng(4).normal(0, 3, n)
    root = np.linalg.cholesky(covariance(ou(0.6, 0.7), 0.8, [1] * n, gaps))
    new = np.linalg.solve(root, residual)
    expected = float(np.sum(stats.t(nu).logpdf(new) - np.log(np.diag(root))))
    values = {"sigma_white": 0.8, "sigma_slow": 0.6, "tau_slow": 0.7, "nu": nu}
    got = total("student", values, residual, np.zeros(n), timing([1] * n, gaps, (0, n)))
    assert got == pytest.approx(expected, rel=1e-10)


def test_student_takes_the_error_of_turning_points_as_noise_of_each_block() -> None:
    values = {"sigma_white": 0.8, "sigma_slow": 0.0, "tau_slow": 0.7, "nu": 5.0}
    slope, residual = np.array([3.0, -2.0, 8.0]), np.array([1.0, 2.0, -4.0])
    scale = np.sqrt(0.8**2 + slope**2 * (0.1**2 + 0.3**2))
    when = timing([1] * 3, [INF, STEP, STEP], (0, 3), noise_mm=0.1, turning_mm=[0.3])
    got = total("student", values, residual, slope, when)
    assert got == pytest.approx(stats.t(5.0, 0.0, scale).logpdf(residual).sum(), rel=1e-12)


def test_student_with_many_degrees_of_freedom_is_gaussian() -> None:
    residual = np.random.default_rng(5).normal(0, 1, len(COUNTS))
    values = CASES["white and slow"][1]
    gauss = total("slow", values, residual, 0 * residual, timing())
    assert total("student", values | {"nu": 1e7}, residual, 0 * residual, timing()) == pytest.approx(gauss, rel=1e-5)


@every_case
@pytest.mark.parametrize("noise_mm", [0.0, 0.02])
def test_whitening_is_the_root_of_the_covariance(case: str, noise_mm: float) -> None:
    """Over gaps and new beginnings: solving with the lower Cholesky factor, which is what is new in each block."""
    word, values, of_lag, white = CASES[case]
    rng = np.random.default_rng(12)
    columns, slope = rng.normal(0, 2, (len(COUNTS), 3)), rng.uniform(-15, 15, len(COUNTS))
    own = slope**2 * noise_mm**2 / np.array(COUNTS)
    if noise_mm:  # the error of a turning point counts as independent from block to block
        own += np.repeat(np.square(TURNS), np.diff(HALVES)) * slope**2
    matrix = covariance(of_lag, white) + np.diag(own)
    when = timing(noise_mm=noise_mm, turning_mm=TURNS if noise_mm else None)
    got, log_det = whiten(noise_model(word), values, columns, slope, when)
    np.testing.assert_allclose(got, np.linalg.solve(np.linalg.cholesky(matrix), columns), rtol=1e-7, atol=1e-9)
    assert log_det == pytest.approx(np.linalg.slogdet(matrix)[1], rel=1e-8)


def test_whitening_passes_over_blocks_without_samples() -> None:
    word, values, of_lag, white = CASES["white and slow"]
    columns = np.random.default_rng(13).normal(0, 2, (len(COUNTS), 2))
    gaps, kept = list(GAPS), [i for i in range(len(COUNTS)) if i != 5]
    gaps[6] += GAPS[5] + 19 * STEP
    full = timing(gaps=gaps)
    kind = full.kind.copy()
    kind[5] = -1
    gone = Timing(kind, full.kinds, full.half, STEP, 0.0, full.turning_noise_mm)
    got, log_det = whiten(noise_model(word), values, columns, np.zeros(len(COUNTS)), gone)
    matrix = covariance(of_lag, white, [COUNTS[i] for i in kept], [gaps[i] for i in kept])
    np.testing.assert_allclose(got, np.linalg.solve(np.linalg.cholesky(matrix), columns[kept]), rtol=1e-8)
    assert log_det == pytest.approx(np.linalg.slogdet(matrix)[1], rel=1e-8)


@every_case
def test_blocks_without_samples_are_no_evidence(case: str) -> None:
    """They are passed over: the density is that of the others, with the gap that they leave."""
    word, values, _, _ = CASES[case]
    rng = np.random.default_rng(6)
    residual, slope = rng.normal(0, 2, len(COUNTS)), rng.uniform(-5, 5, len(COUNTS))
    gone = [2, 5]
    gaps = list(GAPS)
    gaps[3] += GAPS[2] + 4 * STEP
    gaps[6] += GAPS[5] + 19 * STEP
    kept = [i for i in range(len(COUNTS)) if i not in gone]
    halves = np.searchsorted(kept, HALVES)
    fewer = timing([COUNTS[i] for i in kept], [gaps[i] for i in kept], halves, noise_mm=0.02, turning_mm=TURNS)
    full = timing(gaps=gaps, noise_mm=0.02, turning_mm=TURNS)
    kind = full.kind.copy()
    kind[gone] = -1
    blank = Timing(kind, full.kinds, full.half, full.step_s, 0.02, full.turning_noise_mm)
    spoilt = residual.copy()
    spoilt[gone] = 1e6
    expected = total(word, values, residual[kept], slope[kept], fewer)
    assert total(word, values, spoilt, slope, blank) == pytest.approx(expected, rel=1e-12)


@every_case
def test_each_row_has_its_own_parameters(case: str) -> None:
    word, values, _, _ = CASES[case]
    rng = np.random.default_rng(7)
    residual, slope = rng.normal(0, 2, (3, len(COUNTS))), rng.uniform(-5, 5, (3, len(COUNTS)))
    rows = {name: np.array([value, 0.5 * value, 0.8 * value]) for name, value in values.items()}
    when = timing(noise_mm=0.02, turning_mm=TURNS)
    together = log_density(noise_model(word), rows, residual, slope, when)
    assert together.shape == (3, len(HALVES) - 1)
    for j in range(3):
        own = {name: column[j : j + 1] for name, column in rows.items()}
        alone = log_density(noise_model(word), own, residual[j : j + 1], slope[j : j + 1], when)
        assert np.array_equal(alone[0], together[j])


@every_case
def test_the_zero_of_the_load_cell_is_integrated_out(case: str) -> None:
    """The density is that of the covariance with a constant for the run, also beside errors of turning points."""
    word, values, of_lag, white = CASES[case]
    rng, zero = np.random.default_rng(9), 1.7
    residual = rng.normal(0.8, 2, len(COUNTS))
    matrix = covariance(of_lag, white)
    ones = np.ones(len(COUNTS))
    flat = np.zeros_like(residual)
    expected = normal(residual, matrix + zero**2 * np.outer(ones, ones))
    assert total(word, values, residual, flat, timing(zero_kN=zero)) == pytest.approx(expected, rel=1e-8)
    _, mean, sd = density_and_zero(noise_model(word), sets(values), residual[None], flat[None], timing(zero_kN=zero))
    precision = 1 / zero**2 + ones @ np.linalg.solve(matrix, ones)
    assert mean[0] == pytest.approx(ones @ np.linalg.solve(matrix, residual) / precision, rel=1e-7)
    assert sd[0] == pytest.approx(precision**-0.5, rel=1e-7)
    # With turning points: the known zero, averaged over what it may be.
    slope, levels = rng.uniform(-5, 5, len(COUNTS)), np.linspace(-9.0, 9.0, 4001) * zero
    turned = timing(noise_mm=0.02, turning_mm=TURNS)
    each = log_density(
        noise_model(word), sets(values, 4001), residual - levels[:, None], np.tile(slope, (4001, 1)), turned
    )
    logs = each.sum(axis=1) + stats.norm(0, zero).logpdf(levels)
    expected = float(np.log(np.trapezoid(np.exp(logs - logs.max()), levels)) + logs.max())
    known = timing(noise_mm=0.02, turning_mm=TURNS, zero_kN=zero)
    assert total(word, values, residual, slope, known) == pytest.approx(expected, rel=1e-6)


def test_a_thousand_blocks_neither_overflow_nor_vanish() -> None:
    """The variances are multiplied before their logarithm is taken; the product must not leave the doubles."""
    n = 1000
    for sigma in (1e-6, 1e6):
        residual = sigma * np.random.default_rng(8).standard_normal(n)
        got = total("independent", {"sigma": sigma}, residual, np.zeros(n), singles(n))
        assert got == pytest.approx(stats.norm(0, sigma).logpdf(residual).sum(), rel=1e-10)


def test_parts_that_do_not_belong_together_are_refused() -> None:
    for halves, turning in (((0, 4), [0.0]), ((0, 10), [0.0, 0.0])):
        with pytest.raises(ModelError, match="do not belong together"):
            timing(halves=halves, turning_mm=turning)


# ---- the simulator ----


@pytest.mark.parametrize("phi", [-0.6, 0.9])
def test_simulated_noise_is_stationary_from_the_first_sample(phi: float) -> None:
    time, restarts = STEP * np.arange(12), np.isin(np.arange(12), (0, 6))
    rng = np.random.default_rng(6)
    n = 6000
    values = {"sigma": 2.0, "phi": phi}
    series = np.stack([simulate(noise_model("ar1"), values, time, restarts, rng) for _ in range(n)])
    # sd of a sample standard deviation is sigma/sqrt(2n); 4.5 of them over 12 samples is a false alarm in 10^4
    assert np.abs(series.std(axis=0) / 2.0 - 1).max() < 4.5 / math.sqrt(2 * n)
    lag = np.array([np.corrcoef(series[:, i], series[:, i + 1])[0, 1] for i in range(11)])
    expected = np.where(np.arange(11) == 5, 0.0, phi)  # the noise restarts before sample 6
    assert np.abs(lag - expected).max() < 4.5 / math.sqrt(n)


def test_simulated_slow_noise_means_the_same_at_any_rate_and_over_gaps() -> None:
    rng = np.random.default_rng(7)
    n, values = 6000, {"sigma_white": 0.5, "sigma_slow": 1.5, "tau_slow": 0.4}
    time = np.array([0.0, 0.005, 0.05, 0.1, 0.5, 1.5])
    restarts = np.arange(time.size) == 0
    series = np.stack([simulate(noise_model("slow"), values, time, restarts, rng) for _ in range(n)])
    lag = np.abs(time[:, None] - time[None])
    expected = 1.5**2 * np.exp(-lag / 0.4) + 0.25 * np.eye(time.size)
    got = series.T @ series / n
    spread = np.sqrt((np.outer(np.diag(expected), np.diag(expected)) + expected**2) / n)
    assert np.abs((got - expected) / spread).max() < 4.5


def test_same_stream_same_noise() -> None:
    time, restarts = STEP * np.arange(40), np.arange(40) == 0
    values = {"sigma_white": 0.5, "sigma_slow": 1.5, "tau_slow": 0.4}
    draws = [simulate(noise_model("slow"), values, time, restarts, np.random.default_rng(9)) for _ in range(2)]
    assert np.array_equal(*draws)


# ---- simulator and density as a pair: truths drawn from a prior have uniform ranks in their posteriors ----

N_PAIR = 8  # short, so that the first samples carry weight
TIME, BEGIN = STEP * np.arange(N_PAIR), np.isin(np.arange(N_PAIR), (0, 3))
SCALES = np.exp(np.linspace(-2.2, 2.2, 61))
SECOND = {"phi": np.linspace(-0.985, 0.985, 61), "tau_slow": np.linspace(0.0, 0.4, 62)[1:] - 0.2 / 61}
WRONG = Noise("ar1", ("sigma", "phi"), lambda v: gaussian(v["sigma"], v["sigma"]), noise_model("ar1").decay)


def rank_p_values(
    density: Noise, word: str, scale: str, second: str, others: dict[str, float], n: int = 500
) -> tuple[float, ...]:
    """p-values that posterior ranks of a true scale and another parameter are uniform (simulation-based calibration).

    The scale is lognormal around 1, the other parameter uniform over its grid.
    """
    rng = np.random.default_rng(7)
    grid = SECOND[second]
    half = 0.5 * (grid[1] - grid[0])
    scales, seconds = (g.ravel() for g in np.meshgrid(SCALES, grid, indexing="ij"))
    weight = np.tile(stats.norm(0, 0.5).logpdf(np.log(SCALES))[:, None], (1, grid.size))
    many = {name: np.full(scales.size, value) for name, value in others.items()}
    flat, when = np.zeros((scales.size, N_PAIR)), singles(N_PAIR, (0, 3))
    ranks = np.empty((n, 2))
    for k in range(n):
        size, other = math.exp(0.5 * rng.standard_normal()), rng.uniform(grid[0] - half, grid[-1] + half)
        residual = simulate(noise_model(word), {scale: size, second: other} | others, TIME, BEGIN, rng)
        values = many | {scale: scales, second: seconds}
        log_posterior = log_density(density, values, np.tile(residual, (scales.size, 1)), flat, when).sum(axis=1)
        log_posterior = log_posterior.reshape(weight.shape) + weight
        p = np.exp(log_posterior - log_posterior.max())
        p /= p.sum()
        for i, (axis, axis_grid, value) in enumerate(((1, np.log(SCALES), math.log(size)), (0, grid, other))):
            cumulative = np.cumsum(p.sum(axis=axis))
            step = 0.5 * (axis_grid[1] - axis_grid[0])
            edges = np.concatenate([axis_grid - step, [axis_grid[-1] + step]])
            ranks[k, i] = np.interp(value, edges, np.concatenate([[0.0], cumulative]))
    return tuple(float(stats.kstest(ranks[:, i], "uniform").pvalue) for i in range(2))


def test_simulator_and_density_are_a_pair() -> None:
    assert min(rank_p_values(noise_model("ar1"), "ar1", "sigma", "phi", {})) > 0.005


def test_simulator_and_density_are_a_pair_in_continuous_time() -> None:
    values = rank_p_values(noise_model("slow"), "slow", "sigma_slow", "tau_slow", {"sigma_white": 0.3})
    assert min(values) > 0.005


def test_the_pair_check_sees_a_wrong_density() -> None:
    """AR(1) with white noise of the same size on top."""
    assert min(rank_p_values(WRONG, "ar1", "sigma", "phi", {})) < 1e-6


def student_p_value(nu_of_density: float | None, n: int = 400) -> float:
    """p-value that the posterior ranks of the white noise are uniform, with nu known; it may be pinned wrongly."""
    rng = np.random.default_rng(8)
    n_samples, log_sigma = 60, np.linspace(-2.0, 2.0, 161)
    time, begin = STEP * np.arange(n_samples), np.isin(np.arange(n_samples), (0, 25))
    many, when = np.ones(log_sigma.size), singles(n_samples, (0, 25))
    ranks = np.empty(n)
    for k in range(n):
        truth, nu = 0.5 * rng.standard_normal(), math.exp(rng.uniform(0.4, 2.0))
        # Without a slow part the t of what is new and the t that is simulated are one.
        own = {"sigma_white": math.exp(truth), "sigma_slow": 0.0, "tau_slow": 1.0, "nu": nu}
        residual = simulate(noise_model("student"), own, time, begin, rng)
        values = {"sigma_white": np.exp(log_sigma), "sigma_slow": 0.0 * many, "tau_slow": many}
        values["nu"] = (nu_of_density or nu) * many
        rows = np.tile(residual, (log_sigma.size, 1))
        log_posterior = stats.norm(0, 0.5).logpdf(log_sigma)
        log_posterior += log_density(noise_model("student"), values, rows, 0 * rows, when).sum(axis=1)
        p = np.exp(log_posterior - log_posterior.max())
        cumulative = np.cumsum(p) / p.sum()
        edges = np.append(log_sigma - 0.0125, log_sigma[-1] + 0.0125)
        ranks[k] = np.interp(truth, edges, np.concatenate([[0.0], cumulative]))
    return float(stats.kstest(ranks, "uniform").pvalue)


def test_student_simulator_and_density_are_a_pair() -> None:
    assert student_p_value(None) > 0.005
    assert student_p_value(1000.0) < 1e-6  # the same check with a Gaussian density


# ---- the catalogue ----


def test_words_of_the_catalogue() -> None:
    first, *others = noise_models()
    assert first == DEFAULT == "slow"
    assert others == sorted(others)
    assert {"ar1", "independent", "student"} <= set(others)  # users script against them
    message = f"noise 'independant' is not known; choose one of {', '.join(noise_models())}.*'independent'"
    with pytest.raises(ModelError, match=message):
        noise_model("independant")


def test_a_noise_parameter_means_the_same_in_all_models(
    monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> None:
    parts, decay = noise_model("ar1").parts, noise_model("ar1").decay
    mine = Noise("mine", (NoiseParameter("phi", "s", "a phase"),), parts, decay)
    known = {**noise_models(), "mine": mine}
    monkeypatch.setattr(noise, "noise_models", lambda: known)
    noise_parameters.cache_clear()
    request.addfinalizer(noise_parameters.cache_clear)
    with pytest.raises(ModelError, match="noise model mine: 'phi' is a parameter of another model; rename it"):
        noise_parameters()
