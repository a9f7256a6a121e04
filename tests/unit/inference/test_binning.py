"""Recordings averaged once: nothing is lost or counted twice, no block crosses what divides, the posterior stays."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from shj_bayes.inference.binning import BinnedRun, Run, histories_of, reduce_runs, runs_of
from shj_bayes.inference.likelihood import Likelihood, make_likelihood
from shj_bayes.inference.start import find_start, polish
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.effects.effect import catalogue
from shj_bayes.model.filter import sd_over_speed, slowness
from shj_bayes.model.law import force_of_laws
from shj_bayes.model.priors import read_priors
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.motion import Block, Motion, exact_motion
from shj_bayes.recording.recording import Recording

BLOCKS = (Block(12.0, 0.13, 2), Block(48.0, 0.034, 2))
LAW = np.array([[15.0, 85.0, 15.0, 0.0]])
TRUTH = Truth(
    K=15, Fy=85, beta=15, gamma=1 / 200, ratio=0.85, sigma=0.8, phi=0, sigma_slow=0.6, tau_slow=3,
    displacement_noise_mm=0.0,
)  # fmt: skip


def law_force(history, start_force_kN):
    return force_of_laws(history.motion, LAW, start_force_kN=start_force_kN)[0]


def exact_runs(rate_Hz: float, blocks: tuple[Block, ...] = BLOCKS, truth: Truth = TRUTH) -> list[Run]:
    """Two runs whose motion is known."""
    motion = exact_motion(blocks, rate_Hz)[1]
    return [Run(r, motion) for r in simulate_device(truth, seed=5, rate_Hz=rate_Hz, blocks=blocks)]


def holed(run: Run) -> Run:
    """Unused samples here and there, unsure ones at the reversals, and a pause of the logger."""
    rng = np.random.default_rng(1)
    n = run.recording.n_samples
    used = rng.random(n) > 0.01
    used[700:760] = False
    unsure = np.zeros(n, dtype=bool)
    for place in run.motion.start[1:-1]:
        unsure[place - 3 : place + 2] = True
    time = run.recording.time_s + np.where(np.arange(n) >= 1500, 20.0, 0.0)
    recording = Recording(time, run.recording.displacement_mm, run.recording.force_kN, used=used)
    return Run(recording, replace(run.motion, unsure=unsure))


def samples_of_blocks(run: Run, part: BinnedRun) -> list[np.ndarray]:
    """Samples of each block: blocks take the used samples one after the other."""
    own = np.flatnonzero(run.used)
    assert part.count.sum() == own.size
    return np.split(own, np.cumsum(part.count[part.count > 0]).astype(int)[:-1])


@pytest.fixture(scope="module", params=["first look", "refined"])
def averaged(request) -> tuple[Run, BinnedRun]:
    """A run with holes, and its averages."""
    run = holed(exact_runs(50.0)[0])
    return run, reduce_runs([run], law_force if request.param == "refined" else None)[0]


def test_every_used_sample_is_in_one_block_whose_force_is_their_mean(averaged):
    run, part = averaged
    force = run.recording.force_kN
    means = np.array([force[own].mean() for own in samples_of_blocks(run, part)])
    np.testing.assert_allclose(part.force_kN[part.count > 0], means, rtol=1e-12)
    assert part.count.max() > 1


def test_a_start_at_rest_has_the_slope_of_the_first_loading_with_a_delay_too():
    """The error of the displacement at which it begins acts through it: without a slope it would be the law's."""
    truth = replace(TRUTH, displacement_noise_mm=0.02)
    runs = []
    for seed, one in enumerate(simulate_device(truth, seed=6, rate_Hz=20.0, blocks=BLOCKS)):
        wobble = 0.02 * np.random.default_rng(seed).standard_normal(100)
        before = np.arange(100) / 20.0
        time = np.append(before, 5.0 + one.time_s - one.time_s[0])
        x = np.append(one.displacement_mm[0] + wobble, one.displacement_mm)
        runs.append(Recording(time, x, np.append(0.3 * wobble, one.force_kN)))
    device = DeviceModel(2, read_priors("afc"))
    late = device.with_effects((catalogue()["sensor_lag"],))
    start = find_start(make_likelihood(runs_of(runs), device))[1]
    z = np.append(start.free[: device.n_law], late.laws[device.n_law].to_free(np.asarray(0.012)))
    for part in reduce_runs(runs_of(runs)):
        for model, at in ((device, z[:-1]), (late, z)):
            force = part.force(model, model.laws.natural(at[None]))
            _, slope = part.residual_and_slope(force)
            resting = part.history.time_s[part.first[:-1]] < 4.0
            assert resting.sum() >= 3
            K = device.law_values(z[:-1])["K"]
            assert np.all((slope[0][resting] > 0.4 * K) & (slope[0][resting] < 1.6 * K))
        for a, b in pairwise(part.history.motion.start):
            assert np.all(np.diff(part.history.time_s[a:b]) >= 0.0)


def test_no_block_crosses_a_reversal_a_gap_or_an_unused_sample(averaged):
    run, part = averaged
    half, new = run.motion.half_cycle, np.cumsum(run.recording.restarts)
    assert new[-1] > 1
    for own in samples_of_blocks(run, part):
        assert np.all(np.diff(own) == 1)
        assert np.all(half[own] == half[own[0]])
        assert new[own[-1]] == new[own[0]]
    assert part.timing.half[0] == 0
    by_half = [int(part.count[a:b].sum()) for a, b in zip(part.timing.half, part.timing.half[1:], strict=False)]
    assert by_half == np.bincount(half[run.used], minlength=run.motion.n_half).tolist()


def test_the_two_points_of_a_block_have_the_mean_and_the_variance_of_its_samples(averaged):
    run, part = averaged
    x, at = run.motion.displacement_mm, part.history.motion.displacement_mm
    blocks = np.flatnonzero(part.count > 0)
    for i, own in zip(blocks, samples_of_blocks(run, part), strict=True):
        points = at[part.first[i] : part.first[i + 1]]
        assert points.size == (1 if own.size == 1 else 2)
        assert points.mean() == pytest.approx(x[own].mean(), rel=1e-12, abs=1e-12)
        assert points.std() == pytest.approx(x[own].std(), rel=1e-9, abs=1e-12)
        if points.size == 2:
            assert np.sign(points[1] - points[0]) == run.motion.direction[run.motion.half_cycle[own[0]]]


def test_the_gaps_between_blocks_are_those_of_their_samples(averaged):
    run, part = averaged
    time, new = run.recording.time_s, np.cumsum(run.recording.restarts)
    blocks = samples_of_blocks(run, part)
    told = part.timing.kinds[part.timing.kind[part.count > 0]]
    assert np.array_equal(told[:, 0], [own.size for own in blocks])
    gap = np.array([time[b[0]] - time[a[-1]] for a, b in pairwise(blocks)])
    begins = np.array([new[b[0]] > new[a[-1]] for a, b in pairwise(blocks)])
    np.testing.assert_allclose(told[1:, 2], np.where(begins, np.inf, gap), rtol=0.006)  # half of 1/64 of an octave
    assert told[0, 2] == np.inf


def test_the_white_variance_of_a_block_is_the_mean_of_those_of_its_samples() -> None:
    """Blocks that mix low and high speed; the two points of each have mean and variance of the displacement."""
    runs = exact_runs(50.0)
    posterior = make_likelihood(runs, DeviceModel(len(runs), read_priors("afc"))).with_noise_at_rest(np.log(2.5))
    posterior = replace(posterior, blocks=reduce_runs(runs, law_force)).with_noise_at_rest(posterior.at_rest)
    history, part = posterior.histories[0], posterior.blocks[0]
    samples = sd_over_speed(np.log(2.5), slowness(history.speed_mm_s, history.peak_speed_mm_s)) ** 2
    means = np.array([samples[own].mean() for own in samples_of_blocks(runs[0], part)])
    assert means.min() < 1.05
    assert means.max() > 6.0
    np.testing.assert_allclose(part.timing.rough[part.count > 0], means, rtol=0.05)


def test_a_half_cycle_without_evidence_keeps_its_place() -> None:
    run = exact_runs(50.0)[0]
    used = run.motion.half_cycle != 2
    gone = Run(replace(run.recording, used=used), run.motion)
    part = reduce_runs([gone], law_force)[0]
    a, b = part.timing.half[2:4]
    assert (b - a, part.count[a], part.timing.kind[a]) == (1, 0.0, -1)
    residual, _ = part.residual_and_slope(np.full((1, part.first[-1]), 7.0))
    assert residual[0, a] == 0.0
    assert np.all(residual[0, part.count > 0] == part.force_kN[part.count > 0] - 7.0)


def test_means_of_a_cubic_are_exact_and_slopes_are_right() -> None:
    """Evenly spread samples in each block, on a motion of constant speed."""
    n = 401
    x = np.concatenate([np.linspace(0, 40, n), np.linspace(39.9, -40, 2 * n)])
    motion = Motion(x, np.ones(x.size), [0, n, 3 * n], [0.0, 40.0], [1, -1])

    def cubic(at):
        return 3.0 + 0.5 * at - 0.02 * at**2 + 1e-3 * at**3

    run = Run(Recording(np.arange(x.size) / 50.0, x, cubic(x)), motion)
    part = reduce_runs([run], lambda history, _: cubic(history.position_mm))[0]
    at = part.history.motion.displacement_mm
    residual, slope = part.residual_and_slope(cubic(at)[None])
    assert part.count.max() > 4
    assert np.abs(residual).max() < 1e-10
    middle = np.array([at[a:b].mean() for a, b in zip(part.first, part.first[1:], strict=False)])
    np.testing.assert_allclose(slope[0], 0.5 - 0.04 * middle + 3e-3 * middle**2, atol=0.01)


@pytest.mark.parametrize("beta", [5.0, 50.0, 300.0])
def test_the_number_of_blocks_does_not_grow_with_the_sampling_rate(beta: float) -> None:
    law = LAW.copy()
    law[0, 2] = beta

    def force_at(history, start_force_kN):
        return force_of_laws(history.motion, law, start_force_kN=start_force_kN)[0]

    slow, fast, faster = (
        sum(part.n for part in reduce_runs(exact_runs(rate, truth=replace(TRUTH, beta=beta)), force_at))
        for rate in (20.0, 200.0, 1000.0)
    )
    assert slow < sum(run.recording.n_samples for run in exact_runs(20.0)) / 2
    assert fast < 2.0 * slow
    assert faster < 1.15 * fast


def test_blocks_are_smaller_where_the_force_bends() -> None:
    """The knee, 2 Fy/K behind a reversal, has finer blocks than the plateau behind it."""
    run = exact_runs(200.0)[0]
    part = reduce_runs([run], law_force)[0]
    motion = part.history.motion
    slip = np.abs(motion.displacement_mm - motion.turning_mm[motion.half_cycle])[part.first[:-1]]
    amplitude = part.history.half_stroke_mm
    late = np.arange(part.n) >= part.timing.half[6]  # blocks of the largest amplitude
    elastic = 2 * LAW[0, 1] / LAW[0, 0]
    knee = late & (np.abs(slip - elastic) < 3.0)
    plateau = late & (slip > elastic + 10.0) & (slip < 2 * amplitude - 10.0)
    width = np.diff(np.append(slip, np.nan))
    assert 2.0 * np.nanmedian(width[knee]) < np.nanmedian(width[plateau])


@pytest.mark.parametrize("variant", ["published", "continuous"])
def test_the_posterior_is_that_of_all_samples(variant: str) -> None:
    """Blocks of one sample each are no reduction at all."""
    runs = runs_of(simulate_device(TRUTH, seed=5, rate_Hz=20.0, variant=variant))
    model = DeviceModel(2, read_priors("afc"), variant=variant)
    reduced, start = find_start(make_likelihood(runs, model))
    whole = reduced.refined(start.free, longest_s=0.0)
    assert whole.blocks.used.size == sum(int(run.used.sum()) for run in runs)
    assert reduced.blocks.used.size < 0.5 * whole.blocks.used.size
    full = polish(whole, [start.free])
    sd, own = (np.sqrt(np.diag(top.covariance)) for top in (full, start))
    shift = np.abs(start.free - full.free)
    law = slice(0, model.n_law)
    assert (shift / sd)[law].max() < 0.3
    np.testing.assert_allclose((own / sd)[law], 1.0, atol=0.08)
    # What samples scatter within their block is not kept: the noise is known less well, and says so.
    assert (shift / own)[model.n_law :].max() < 3.0
    assert np.all((own / sd)[model.n_law :] > 0.97)


def test_a_recording_and_its_averages_give_the_same_posterior() -> None:
    """1 kHz against the same averaged to 20 Hz before it was read; the motion is known for both."""
    truth = replace(TRUTH, sigma=3.0)
    fast = exact_runs(1000.0, truth=truth)
    motion = fast[0].motion
    width = 50
    n = motion.displacement_mm.size // width
    ends = []
    for run in fast:
        half = motion.half_cycle[: n * width].reshape(n, width)
        used = half[:, 0] == half[:, -1]
        time, x, force, speed = (
            values[: n * width].reshape(n, width).mean(axis=1)
            for values in (run.recording.time_s, motion.displacement_mm, run.recording.force_kN, motion.speed_mm_s)
        )
        start = np.append(np.searchsorted(half[:, width // 2], np.arange(motion.n_half)), n)
        coarse = Motion(x, speed, start, motion.turning_mm, motion.direction)
        ends.append(Run(Recording(time, x, force, used=used), coarse))
    model = DeviceModel(2, read_priors("afc"))
    (one, a), (_, b) = (find_start(make_likelihood(runs, model)) for runs in (fast, ends))
    law = slice(0, one.model.n_law)
    sd = np.sqrt(np.diag(a.covariance))[law]
    assert np.abs((a.free - b.free)[law] / sd).max() < 0.3
    np.testing.assert_allclose(np.sqrt(np.diag(b.covariance))[law] / sd, 1.0, atol=0.08)


def test_turning_points_are_known_as_well_as_the_samples_beside_them() -> None:
    """Ten times the rate, a tenth of the variance; none without noise. The first half-cycle has no turn."""
    errors = []
    for rate in (20.0, 200.0):
        run = exact_runs(rate)[0]
        noisy = Run(run.recording, replace(run.motion, noise_mm=0.02))
        errors.append(reduce_runs([noisy])[0].timing.turning_noise_mm)
        assert reduce_runs([run])[0].timing.turning_noise_mm[1:].max() == 0.0
        assert errors[-1][0] == run.start_noise_mm > 0.0
    assert np.all(errors[0][1:] <= 0.02)
    np.testing.assert_allclose(errors[0][1:] / errors[1][1:], np.sqrt(10.0), rtol=0.25)


def test_histories_keep_what_the_reduction_needs(make_small: Callable[..., Likelihood]) -> None:
    small = make_small()
    whole = histories_of(small.runs)
    for history, part in zip(whole, small.blocks, strict=True):
        assert part.history.run == history.run
        assert part.history.half_stroke_mm == history.half_stroke_mm
        assert np.array_equal(part.history.motion.turning_mm, history.motion.turning_mm)
