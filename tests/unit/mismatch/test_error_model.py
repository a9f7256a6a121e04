"""The metric of a search against covariances that are written out, and the ways to the most probable parameters."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from shj_bayes.inference.binning import Blocks, runs_of
from shj_bayes.inference.likelihood import Likelihood
from shj_bayes.mismatch.data import MODEL_ERROR, N_OF_DEVICE, BinnedData, ErrorModel, ErrorParameters, data_of
from shj_bayes.mismatch.heldout import PARTS, Gain, HeldOut, cycles_of, held_out
from shj_bayes.mismatch.hypothesis import (
    FORMS,
    PRIOR_INCLUSION,
    SIZES_OF_STARTS,
    Dependence,
    candidates,
    classes,
    formulas,
    screen,
    size_weights,
    sized,
)
from shj_bayes.mismatch.laplace import Laplace, find_noise, laplace, laplace_under, visible
from shj_bayes.model.curve import SIZES
from shj_bayes.model.device import DeviceModel, force_with_effects, linear_in
from shj_bayes.model.effects.effect import Base
from shj_bayes.model.filter import sd_over_speed
from shj_bayes.model.history import histories
from shj_bayes.model.priors import read_priors
from shj_bayes.recording.motion import motion_of
from shj_bayes.recording.recording import Recording

NOISE = {"sigma_white": 0.8, "sigma_slow": 0.6, "tau_slow": 1.0}


@pytest.fixture(scope="module")
def data(small_device, as_vector) -> BinnedData:
    """Two short runs, at the parameters that they were simulated from."""
    z = small_device.model.laws.unbounded(as_vector(small_device))[0, : small_device.model.n_law]
    return BinnedData(small_device, z)


@pytest.fixture(scope="module")
def metric(data: BinnedData) -> ErrorModel:
    laws = data.device.laws[data.device.n_law :]
    z = tuple(float(law.to_free(np.asarray(NOISE[law.name]))) for law in laws)
    slope = data.likelihood.residual_and_slope(data.z[None])[1][0]
    return ErrorModel(data, ErrorParameters(z, 0.7), slope)


@pytest.fixture(scope="module")
def covariance(data: BinnedData, metric: ErrorModel) -> np.ndarray:
    """Of all that is no parameter, of the blocks that are evidence; `whiten` has its own tests."""
    root = metric.whitened(np.eye(data.blocks.used.size))
    used = data.blocks.used > 0
    noise = np.linalg.inv(root[:, used].T @ root[:, used])
    functions = metric.setting.model_error_kN * data.missed[:, : N_OF_DEVICE - 1][used]
    zero_kN = np.array([part.timing.zero_noise_kN for part in data.blocks])
    run = np.concatenate([np.full(part.n, i) for i, part in enumerate(data.blocks)])[used]
    zeros = np.where(run[:, None] == run, zero_kN[run] ** 2, 0.0)
    memory = data.missed[used, N_OF_DEVICE - 1 : N_OF_DEVICE]
    assert np.abs(memory).max() > 1.0
    starts = (starts_of(data, metric) * data.missed_sizes(0.0)[-2 * len(data.blocks) : -len(data.blocks)])[used]
    assert np.abs(starts).max() > 0.1
    return np.asarray(noise + functions @ functions.T + memory @ memory.T + starts @ starts.T + zeros)


def starts_of(data: BinnedData, metric: ErrorModel) -> np.ndarray:
    """Columns of an error of where each run starts, which stand before those of the zeros."""
    n = len(data.blocks)
    return data.missed_at(metric.slope)[:, -2 * n : -n]


@pytest.fixture(scope="module")
def state(data: BinnedData, metric: ErrorModel) -> Laplace:
    return laplace(metric, data.device, data.z)


def test_the_parameters_of_the_noise_are_read_back(data: BinnedData, metric: ErrorModel) -> None:
    assert metric.setting.values(data) == pytest.approx(NOISE)


def test_noise_may_be_rougher_at_low_speed(data: BinnedData, metric: ErrorModel) -> None:
    """The covariance is scaled on both sides by a factor of the speed; the constant follows it."""
    rough = ErrorModel(data, replace(metric.setting, at_rest=math.log(3.0)), metric.slope)
    used = data.blocks.used > 0
    speed = data.blocks.channel("speed_mm_s")[used]
    more = sd_over_speed(math.log(3.0), data.slow)
    assert more[used][np.argmin(speed)] == pytest.approx(3.0, rel=0.02)
    assert more[used][np.argmax(speed)] == pytest.approx(1.0, abs=0.01)
    still = ErrorModel(data, rough.setting, np.zeros(metric.slope.size))
    plain = ErrorModel(data, metric.setting, np.zeros(metric.slope.size))
    column = np.random.default_rng(3).normal(0, 1, (data.blocks.used.size, 1))
    columns = (column, column / more[:, None])
    own, other = (m.whitened(c) for m, c in zip((still, plain), columns, strict=True))
    np.testing.assert_allclose(own, other, rtol=1e-12)
    (_, log_all), (_, log_plain) = (m.setting.whitened(data, column, m.slope) for m in (still, plain))
    assert log_all - log_plain == pytest.approx(-np.log(more[used]).sum())
    assert rough.fluctuation == pytest.approx(3.0 * metric.fluctuation)
    assert not metric.setting.is_slow(data)


@pytest.mark.parametrize("variant", ["published", "continuous"])
@pytest.mark.parametrize(
    "effects",
    [
        ("capacity_over_position_by_direction_15_05", "added_over_time_15_05"),
        ("slack", "capacity_over_travel_50_05"),
        ("two_stage", "added_over_position_15_05", "capacity_over_distance_15_05"),
        ("frame_compliance", "capacity_over_slip_15_20", "wear"),
        ("capacity_over_speed_felt_15_20", "capacity_over_speed_by_travel_30_05"),
        ("sensor_lag", "capacity_over_heat2_30_40", "capacity_over_position_every_20000_15_05"),
        ("added_over_slip_15_40", "load_offset"),
    ],
    ids="+".join,
)
def test_derivatives_after_the_coefficients_of_curves(make_small, effects, variant) -> None:
    """Against central differences, beside whatever else acts on the law and its motion; some strokes do not slide."""
    posterior = make_small(effects=effects, variant=variant)
    model = posterior.model
    z = 0.3 * np.random.default_rng(4).standard_normal(model.n_law)
    z[model.names.index("K")] = -2.5
    steps = 1e-5 * np.eye(z.size)
    expected = (posterior.residual(z - steps) - posterior.residual(z + steps)).T / 2e-5
    found = posterior.jacobian(z, posterior.residual(z[None])[0])
    linear = linear_in(model)
    assert linear.size > 3
    wrong = np.abs(found - expected)[:, linear].max(axis=0)
    assert np.all(wrong < 5e-3 * np.abs(expected).max(axis=0)[linear] + 1e-6)


def test_noise_under_which_columns_are_one_to_rounding_is_not_the_most_probable(
    data: BinnedData, metric: ErrorModel
) -> None:
    """Columns of such a size that only under large noise something is left of one beside the other."""
    _, state = laplace_under(data, metric.setting, data.device, data.z)
    rng = np.random.default_rng(4)
    columns = 1e9 * rng.normal(0, 1, (data.blocks.used.size, 1)) * data.blocks.used[:, None] * rng.uniform(0.5, 2.0, 12)
    with pytest.raises(np.linalg.LinAlgError):
        _ = metric.gaussian(state.beside(columns)).log_evidence
    found = find_noise(data, state, columns, metric.setting)
    assert np.all(np.isfinite(found.z))


def test_noise_is_remembered_for_a_quarter_of_a_run_at_most(data: BinnedData, metric: ErrorModel) -> None:
    """A force that goes one way throughout is a drift: it is not known to come back."""
    _, state = laplace_under(data, metric.setting, data.device, data.z)
    time = data.blocks.channel("time_s")
    lasts = max(float(np.ptp(part.history.time_s)) for part in data.blocks)
    drifting = replace(state, residual=state.residual + 20.0 * time / lasts * data.blocks.used)
    none = np.zeros((time.size, 0))
    free = find_noise(data, drifting, none, metric.setting).values(data)["tau_slow"]
    assert free == pytest.approx(0.25 * lasts, rel=1e-6)
    assert find_noise(data, state, none, metric.setting).values(data)["tau_slow"] < 0.2 * lasts


def test_products_are_those_of_the_covariance(data: BinnedData, metric: ErrorModel, covariance: np.ndarray) -> None:
    columns = np.random.default_rng(1).normal(0, 3, (data.blocks.used.size, 4))
    own = columns[data.blocks.used > 0]
    np.testing.assert_allclose(metric.products(columns), own.T @ np.linalg.solve(covariance, own), rtol=1e-7)
    assert metric.products(columns)[0, 0] < np.sum(metric.whitened(columns)[:, 0] ** 2)


def test_evidence_is_the_density_with_parameters_and_discrepancy_integrated_out(
    data: BinnedData, metric: ErrorModel, covariance: np.ndarray
) -> None:
    rng = np.random.default_rng(2)
    used = data.blocks.used > 0
    for v in (np.ones(3), np.array([0.3, 4.0, 1.0])):
        y, columns = rng.normal(0, 2, used.size), rng.normal(0, 1, (used.size, 3))
        whole = covariance + columns[used] @ np.diag(v) @ columns[used].T
        relative = 0.7 / (MODEL_ERROR * data.scale_kN)
        prior = -0.5 * float(np.dot(metric.setting.z, metric.setting.z)) - 0.5 * relative**2 + math.log(relative)
        expected = multivariate_normal(np.zeros(used.sum()), whole).logpdf(y[used]) + prior
        got = metric.gaussian(np.column_stack([y, columns])).sized(np.sqrt(v)).log_evidence
        assert got == pytest.approx(float(expected), rel=1e-9)


def test_solving_gives_mean_and_covariance_of_the_parameters(
    data: BinnedData, metric: ErrorModel, covariance: np.ndarray
) -> None:
    rng = np.random.default_rng(3)
    used = data.blocks.used > 0
    y, columns = rng.normal(0, 2, used.size), rng.normal(0, 1, (used.size, 3))
    found = metric.gaussian(np.column_stack([y, columns]))
    a = columns[used]
    inverse = np.linalg.inv(np.eye(3) + a.T @ np.linalg.solve(covariance, a))
    np.testing.assert_allclose(found.covariance, inverse, rtol=1e-7)
    np.testing.assert_allclose(found.mean, inverse @ a.T @ np.linalg.solve(covariance, y[used]), rtol=1e-7)


def test_the_discrepancy_takes_up_what_is_most_probable(
    data: BinnedData, metric: ErrorModel, covariance: np.ndarray
) -> None:
    used = data.blocks.used > 0
    residual = np.random.default_rng(4).normal(0, 2, used.size)
    functions = data.missed[:, : N_OF_DEVICE - 1]
    expected = 0.7**2 * functions @ functions[used].T @ np.linalg.solve(covariance, residual[used])
    np.testing.assert_allclose(metric.integrated_out(residual)[0], expected, rtol=1e-6, atol=1e-9)


def test_a_difference_of_push_and_pull_is_no_discrepancy(data: BinnedData) -> None:
    for sign in (-1.0, 1.0):
        own = (np.sign(data.blocks.channel("direction")) == sign) & (data.blocks.used > 0)
        assert np.abs(data.missed[:, : N_OF_DEVICE - 1][own].mean(axis=0)).max() < 1e-12
    assert np.abs(data.missed[:, : N_OF_DEVICE - 1]).max() > 0.1


def test_an_error_of_the_start_goes_on_where_nothing_slides_before_it_turns() -> None:
    """It was taken for a constant force: the second half-cycle begins with what the first one ends with."""
    time = np.arange(0.0, 60.0, 0.1)
    reaches = np.where(time < 20.0, 2.0, 20.0)  # mm; sliding begins at 5
    motion = motion_of(Recording(time, reaches * np.sin(2 * np.pi * time / 20.0), np.zeros(time.size)))
    (history,) = histories([time], [motion])
    recording = Recording(time, motion.displacement_mm, force_with_effects(history, Base(10, 50, 10, 0, 50), []))
    data = data_of(runs_of([recording]), DeviceModel(1, read_priors("general")))
    (part,), step = data.blocks, 0.05
    moved = Blocks([replace(part, run=replace(part.run, begins_kN=part.run.start_force_kN + step))])
    less = replace(data.likelihood, blocks=moved).residual(data.z[None])[0]
    slope = (data.likelihood.residual(data.z[None])[0] - less) * data.base.K / step
    begins = data.missed_at(data.likelihood.residual_and_slope(data.z[None])[1][0])[:, -2]
    second = np.arange(part.timing.half[1], part.timing.half[2])
    assert np.abs(slope[second]).min() > 0.5 * data.base.K
    np.testing.assert_allclose(begins, slope, atol=0.03 * data.base.K)


def test_derivatives_are_those_of_the_force(data: BinnedData) -> None:
    residual = data.likelihood.residual(data.z[None])[0]
    columns = data.likelihood.jacobian(data.z, residual)
    step = 1e-3
    for i in range(data.z.size):
        away = np.stack([data.z, data.z])
        away[:, i] += [step, -step]
        force = data.blocks.force_kN - data.likelihood.residual(away)
        used = data.blocks.used > 0
        middle = (force[0] - force[1]) / (2 * step)
        assert np.abs(columns[:, i] - middle)[used].max() < 0.01 * np.abs(middle).max()


def test_settling_reaches_the_least_squares_of_a_law(
    data: BinnedData, metric: ErrorModel, covariance: np.ndarray, state: Laplace
) -> None:
    """From afar, against a general minimiser with the covariance written out; and the truth lies near."""
    used = data.blocks.used > 0
    root = np.linalg.cholesky(np.linalg.inv(covariance)).T

    def misfit(z: np.ndarray) -> np.ndarray:
        return np.concatenate([root @ data.likelihood.residual(z[None])[0][used], z])

    best = least_squares(misfit, data.z, method="lm", diff_step=1e-4).x
    far = laplace(metric, data.device, data.z + 0.2 * np.array([1.0, -1, 1, -1, 1][: data.z.size]))
    sd = np.sqrt(np.diag(state.covariance))
    for one in (state, far):
        assert np.all(np.abs(one.z - best) < 0.2 * sd)
        assert np.all(np.abs(one.z - data.z) < 4.0 * sd)
        assert one.evidence == pytest.approx(one.gaussian.log_evidence, abs=0.05)
    np.testing.assert_allclose(state.residual, data.likelihood.residual(state.z[None])[0])


def test_settling_stops_where_steps_like_the_last_would_not_do(
    data: BinnedData, metric: ErrorModel, state: Laplace
) -> None:
    """One that is out of reach costs a step; one within reach changes nothing."""
    start = data.z + 0.2 * np.array([1.0, -1, 1, -1, 1][: data.z.size])
    whole = laplace(metric, data.device, start)
    within, beyond = (laplace(metric, data.device, start, whole.evidence + up) for up in (-10.0, 1e6))
    np.testing.assert_array_equal(within.z, whole.z)
    first = metric.log_constant - 0.5 * float(metric.products(data.likelihood.residual(start[None]).T)[0, 0])
    assert first < beyond.evidence < whole.evidence - 1.0
    np.testing.assert_array_equal(beyond.residual, data.likelihood.residual(beyond.z[None])[0])


def test_what_parameters_can_make_up_for_is_not_visible(data: BinnedData, state: Laplace) -> None:
    follow = state.jacobian @ np.arange(1.0, state.z.size + 1)
    wave = np.sin(data.blocks.channel("position_mm")) * data.scale_kN * 0.1
    sizes = visible(data, state.jacobian, np.column_stack([follow, wave + follow]))
    assert sizes[0] < 1e-9
    assert 0.05 < sizes[1] < 0.15


def test_the_size_of_a_change_is_that_of_99_percent_of_the_samples_not_of_the_blocks(
    data: BinnedData, state: Laplace
) -> None:
    """Blocks lie close where the force bends, and hold many samples where the device is slow."""
    used = data.blocks.used > 0
    order = np.argsort(data.blocks.n_samples)[::-1]
    count = data.blocks.n_samples[order]
    order = order[: int(np.searchsorted(np.cumsum(count), 0.0105 * count.sum())) + 1]
    assert order.size < 0.01 * used.sum()  # a quantile over blocks would not see them
    change = np.zeros(used.size)
    change[order] = data.scale_kN
    assert visible(data, np.zeros((used.size, 0)), change[:, None])[0] == pytest.approx(1.0)


WANTED = ("capacity over travel", "capacity over position", "added over time", "motion over slack",
          "capacity over direction")  # fmt: skip


def wanted() -> tuple[Dependence, ...]:
    return tuple(one for one in classes() if one.id in WANTED)


def test_the_gain_of_a_candidate_is_a_difference_of_evidence(
    data: BinnedData, metric: ErrorModel, state: Laplace
) -> None:
    """Averaged over sizes before the test, with the weight of the variant; each on its own."""
    looked = candidates(data, state, wanted())
    wide = [state.residual + state.jacobian @ state.z, state.jacobian]
    without = metric.gaussian(np.column_stack(wide)).log_evidence
    screened = {id(c.columns): c for c in screen(metric, state, looked)}
    assert {c.of.id for c in looked} == set(WANTED)
    assert len(screened) == len(looked)
    for c in looked:
        curve = c.variant.curve
        sizes = SIZES_OF_STARTS if curve is None else np.array(SIZES) / curve.size
        weights = np.full(sizes.size, 1 / sizes.size) if curve is None else size_weights()
        with_it = [
            metric.gaussian(np.column_stack([*wide, size * c.columns])).log_evidence + math.log(w)
            for size, w in zip(sizes, weights, strict=True)
        ]
        expected = float(logsumexp(with_it)) - without + math.log(c.variant.weight)
        got = screened[id(c.columns)]
        assert got.gain == pytest.approx(expected, abs=1e-6), c.variant.effect.id
        if curve is not None:
            best = SIZES[int(np.argmax(with_it))]
            assert got.variant.curve == sized(curve, best)
            assert got.variant.effect.id == got.model.effects[-1].id == sized(curve, best).id
    gains = [c.gain for c in screen(metric, state, looked)]
    assert gains == sorted(gains, reverse=True)


def test_a_change_is_what_the_larger_model_would_add(data: BinnedData, metric: ErrorModel, state: Laplace) -> None:
    """Of a residual that holds a known curve, to first order."""
    looked = [c for c in candidates(data, state, wanted()) if c.of.id == "added over time" and c.variant.curve]
    one = min(looked, key=lambda c: c.columns.shape[1])
    truth = one.columns @ np.array([2.0, -1.0, *np.zeros(one.columns.shape[1] - 2)])
    got = screen(metric, replace(state, residual=state.residual + truth), [one])[0]
    assert got.gain > 50.0
    assert np.percentile(np.abs(got.change - truth)[data.blocks.used > 0], 90) < 0.35 * np.abs(truth).max()


def test_weights_of_sizes_and_variants_are_probabilities() -> None:
    assert size_weights().sum() == pytest.approx(1.0)
    for one in classes():
        weights = [v.weight for v in one.variants]
        assert min(weights) > 0.0, one.id
        assert sum(weights) <= 1.0 + 1e-12, one.id


def test_more_formulas_make_no_class_more_probable() -> None:
    """Those of a class without a curve have what a curve would have; what is screened has no more than others."""
    for one in classes():
        written = formulas((one.action, one.coordinate))
        curves = any(v.curve for v in one.variants)
        assert sum(v.weight for v in written) == pytest.approx((FORMS if curves else 1.0) if written else 0.0), one.id
        assert {v.weight for v in one.variants if v.curve is None} <= {v.weight for v in written}, one.id


def test_what_needs_two_coordinates_has_the_probability_of_both() -> None:
    """With the probability of one, weak wear would be taken for a speed coefficient that changes."""
    (one,) = (c for c in classes() if c.coordinate == "speed_by_travel")
    assert sum(v.weight for v in one.variants) == pytest.approx(PRIOR_INCLUSION * (1.0 - FORMS))


def test_a_class_goes_when_all_its_mechanisms_are_hidden() -> None:
    whole = {one.id for one in classes()}
    assert {"capacity over travel", "motion over slack", "capacity over heat"} <= whole
    assert whole - {one.id for one in classes(frozenset({"slack"}))} == {"motion over slack"}
    assert whole == {one.id for one in classes(frozenset({"wear"}))}
    assert whole - {one.id for one in classes(frozenset({"wear", "bedding_in"}))} == {"capacity over travel"}


def test_held_out_cycles_are_those_of_a_refit(
    data: BinnedData, metric: ErrorModel, state: Laplace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For a linear model the refit has a closed form: here it is written out with the covariance of what is left."""
    rng = np.random.default_rng(5)
    used = data.blocks.used > 0
    y, columns = rng.normal(0, 2, used.size), rng.normal(0, 1, state.jacobian.shape) * used[:, None]

    def residual_and_slope(self: Likelihood, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return y - z @ columns.T, np.repeat(metric.slope[None], z.shape[0], axis=0)

    monkeypatch.setattr(Likelihood, "residual_and_slope", residual_and_slope)
    monkeypatch.setattr(Likelihood, "jacobian", lambda *_: columns)
    got = held_out(metric, state)
    cycle = cycles_of(data)
    first = {int(cycle[0]), int(cycle[data.blocks[0].n])}
    left_out = [one for one in np.unique(cycle[used]) if one not in first]
    assert got.log_density.size == len(left_out) > 2
    assert got.rmse_kN == pytest.approx(np.sqrt(np.mean(got.residual[np.isin(cycle, left_out) & used] ** 2)))
    white = metric.whitened(np.column_stack([y, columns, metric.missed]))
    n, told = columns.shape[1], N_OF_DEVICE - 1
    parts = min(PARTS, len(left_out))
    for i, one in enumerate(left_out):
        seen = ~np.isin(cycle[used], left_out[i % parts :: parts])
        rest = white[seen]
        gram = rest[:, 1:].T @ rest[:, 1:] + np.eye(rest.shape[1] - 1)
        mean = np.linalg.solve(gram, rest[:, 1:].T @ rest[:, 0])
        mean[n : n + told] = 0.0  # the discrepancy is no prediction
        raw = np.flatnonzero(used & (cycle == one))
        everything = np.column_stack([columns, metric.missed])
        np.testing.assert_allclose(got.residual[raw], y[raw] - everything[raw] @ mean, rtol=1e-3, atol=2e-2)


def test_an_error_of_the_start_moves_the_first_half_cycle(data: BinnedData, metric: ErrorModel) -> None:
    """Against the law itself along a motion whose first turning point lies elsewhere, and with another first force."""
    theta = data.device.laws.natural(data.z[None])
    column = starts_of(data, metric)
    stiffness = data.device.law_values(data.z)["K"]
    for run, part in enumerate(data.blocks):
        motion, step = part.history.motion, 1e-4
        away = np.append(motion.turning_mm[0] + step, motion.turning_mm[1:])
        moved = replace(part.history, motion=replace(motion, turning_mm=away))
        force = [part.residual_and_slope(data.device.force(theta, h, 0.0))[0][0] for h in (moved, part.history)]
        loaded = part.residual_and_slope(data.device.force(theta, part.history, step * stiffness))[0][0]
        place = sum(one.n for one in data.blocks[:run])
        own = column[place : place + part.n, run]
        first = slice(0, int(part.timing.half[1]))
        assert np.abs(own[first]).max() > 0.5 * stiffness
        # The slope of a block also holds the change of the speed within it, which is small.
        np.testing.assert_allclose((force[0] - force[1])[first] / step, own[first], atol=0.3 * stiffness)
        later = (force[1] - loaded)[first.stop :] / step
        np.testing.assert_allclose(own[first.stop :], later, atol=1e-3 * stiffness)
        # Before it slides; in the knee the two part.
        steep = np.abs(own[first]) > 0.9 * stiffness
        got = (force[1] - loaded)[first][steep] / step
        np.testing.assert_allclose(got, np.abs(own[first][steep]), rtol=0.15)


def test_a_gain_has_the_error_of_its_cycles() -> None:
    """The standard error of the difference of two errors is that of a jackknife over cycles."""
    rng = np.random.default_rng(8)
    count = np.full(40, 50.0)
    squares = 50.0 * rng.gamma(4.0, 0.25, (2, 40)) * np.array([[1.0], [0.8]])
    before, after = (HeldOut(np.zeros(1), one, count, -0.5 * one) for one in squares)
    gain = Gain.of(before, after)
    rest = [np.sqrt((squares.sum(1) - squares[:, i]) / (count.sum() - 50.0)) for i in range(40)]
    less = np.diff(np.array(rest), axis=1)[:, 0]
    jackknife = np.sqrt(39 / 40 * np.sum((less - less.mean()) ** 2))
    assert gain.rmse_se_kN == pytest.approx(jackknife, rel=0.02)
    assert (gain.improves, gain.is_worse) == (True, False)
    back = Gain.of(after, before)
    assert (back.improves, back.is_worse) == (False, back.after_kN > back.before_kN + back.rmse_se_kN)
    broken = replace(after, squares=np.full(40, np.inf), log_density=np.full(40, -np.inf))
    with np.errstate(all="ignore"):
        assert Gain.of(before, broken).is_worse
