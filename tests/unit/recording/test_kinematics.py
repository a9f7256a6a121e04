"""Half-cycles, turning points and speed from noisy displacement."""

import time

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from shj_bayes.errors import RecordingError
from shj_bayes.recording.motion import Block, exact_motion, hysteresis, motion_of, table_1
from shj_bayes.recording.recording import Recording, noise_of, resolution_of
from shj_bayes.recording.smoothing import Samples, bandwidth, find_kinks, local_polynomial

COUNT = 200.0 / 1024


def measured(rate, noise, encoder, seed):
    t, exact = exact_motion(table_1(), rate)
    x = exact.displacement_mm + noise * np.random.default_rng(seed).standard_normal(t.size)
    x = np.round(x / COUNT) * COUNT if encoder else x
    return exact, motion_of(Recording(t, x, np.zeros(t.size)))


@pytest.mark.parametrize("rate", [20.0, 100.0, 1000.0])
@pytest.mark.parametrize(("noise", "encoder"), [(0.0, False), (0.02, False), (0.1, False), (0.0, True), (0.05, True)])
def test_table_1_has_41_half_cycles_whatever_the_noise(rate, noise, encoder):
    exact, motion = measured(rate, noise, encoder, 1)
    assert motion.n_half == exact.n_half == 41
    np.testing.assert_array_equal(motion.direction, exact.direction)
    assert np.abs(motion.start - exact.start).max() <= max(2, 0.02 * rate)
    scale = max(noise, COUNT / 2 if encoder else 0.0)
    np.testing.assert_allclose(motion.turning_mm, exact.turning_mm, atol=max(2e-3, scale))
    error = motion.displacement_mm - exact.displacement_mm
    assert np.sqrt(np.mean(error**2)) < max(1e-3, 0.5 * scale)
    assert np.all(motion.speed_mm_s >= 0)
    assert "-3 dB" in motion.method


@pytest.mark.parametrize(("noise", "encoder"), [(0.02, False), (0.1, False), (0.0, True)])
def test_turning_points_and_mid_stroke_speed_are_unbiased(noise, encoder):
    turn, speed = [], []
    for seed in range(1 if encoder else 12):
        exact, motion = measured(20.0, noise, encoder, seed)
        turn.append((motion.turning_mm - exact.turning_mm)[1:] * -exact.direction[1:])
        fast = exact.speed_mm_s > 0.95 * np.repeat(
            np.maximum.reduceat(exact.speed_mm_s, exact.start[:-1]), np.diff(exact.start)
        )
        # Relative error of the mean speed at mid-stroke, by block, so that no block hides another.
        for block in range(6):
            rows = fast & (exact.half_cycle // 6 == block)
            speed.append(motion.speed_mm_s[rows].mean() / exact.speed_mm_s[rows].mean() - 1)
    errors = np.concatenate(turn)
    # Three standard errors of the mean; the single extreme sample would be off by twice the noise.
    assert abs(errors.mean()) < 3 * errors.std() / np.sqrt(errors.size) + 1e-3
    assert abs(np.mean(speed)) < 0.001
    assert np.abs(np.mean(np.reshape(speed, (-1, 6)), axis=0)).max() < 0.005


def test_counts_that_lie_evenly_about_a_top_are_no_corner():
    """Where a top lies in the middle of a count, rounding makes a flat piece with an edge on each side."""
    t, exact = exact_motion((Block(24.0, 0.067, 6),), 100.0)
    count = 0.195
    for place in np.linspace(0.0, count, 8, endpoint=False):
        x = np.round((exact.displacement_mm + place) / count) * count - place
        motion = motion_of(Recording(t, x, np.zeros(t.size)))
        assert "corner" not in motion.method
        assert np.abs(motion.turning_mm - exact.turning_mm)[1:].max() < 0.5 * count


def test_the_single_extreme_sample_would_be_biased():
    """The check above must be able to fail."""
    t, exact = exact_motion(table_1(), 20.0)
    x = exact.displacement_mm + 0.1 * np.random.default_rng(1).standard_normal(t.size)
    naive = np.array([x[max(0, i - 20) : i + 20].max() for i in exact.start[1:-1:2]])
    assert np.mean(naive - exact.turning_mm[1::2]) > 0.05


def triangle(rate, speed=10.0, stroke=40.0, n=10, noise=0.01, rest=0.0, seed=0):
    """Triangles with an optional rest at each end; corners fall between samples."""
    leg = stroke / speed
    times, places = [0.0], [0.0]
    for k in range(n):
        times += [times[-1] + leg, times[-1] + leg + rest]
        places += [stroke * ((k + 1) % 2)] * 2
    t = np.arange(0.013, times[-1], 1 / rate)
    x = np.interp(t, times, places) + noise * np.random.default_rng(seed).standard_normal(t.size)
    return t, x, np.interp(t, times, places)


@pytest.mark.parametrize("rest", [0.0, 3.0])
@pytest.mark.parametrize("noise", [0.01, 0.05])
def test_corners_and_rests_are_kept(rest, noise):
    t, x, exact = triangle(100.0, noise=noise, rest=rest)
    motion = motion_of(Recording(t, x, np.zeros(t.size)))
    assert motion.n_half == 10
    np.testing.assert_allclose(motion.turning_mm[1:], [40.0, 0.0] * 4 + [40.0], atol=max(0.03, noise))
    assert np.abs(motion.displacement_mm - exact).max() < 5 * noise
    moving = (exact > 2) & (exact < 38)
    assert motion.speed_mm_s[moving].mean() == pytest.approx(10.0, rel=0.003)
    if rest:
        still = (exact == 40.0) | (exact == 0.0)
        assert np.median(motion.speed_mm_s[still]) < 0.5
        # A rest belongs to the half-cycle before it: the force stays until the device moves back.
        assert np.allclose(t[motion.start[1:-1]], np.arange(1, 10) * 7.0, atol=0.05)


@pytest.mark.parametrize(("stroke", "speed", "rest"), [(24.0, 1.0, 4.4), (48.0, 1.0, 2.0), (48.0, 5.0, 1.0)])
def test_a_rest_is_one_however_slowly_the_device_comes_and_goes(stroke, speed, rest):
    """The samples near the extreme are then most of them in motion: it turned 0.05 mm too far, and before the rest."""
    t, x, _ = triangle(20.0, speed=speed, stroke=stroke, noise=0.013, rest=rest)
    motion = motion_of(Recording(t, x, np.zeros(t.size)))
    np.testing.assert_allclose(motion.turning_mm[1:], [stroke, 0.0] * 4 + [stroke], atol=0.013)
    np.testing.assert_allclose(t[motion.start[1:-1]], np.arange(1, 10) * (stroke / speed + rest), atol=0.3)


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.03])
def test_a_long_rest_at_the_end_of_a_sine_belongs_to_the_stroke_before_it(noise):
    """However exact the samples are: the published rule jumps when the motion back begins, not before."""
    rate, amplitude, speed = 20.0, 48.0, 10.0
    moving = np.arange(0.0, 3.0 * 2 * np.pi * amplitude / speed, 1.0 / rate)
    sine = amplitude * np.sin(speed / amplitude * moving)
    top = int(0.5 * np.pi * amplitude / speed * rate) + 1
    x = np.concatenate([np.zeros(40), sine[:top], np.full(3000, amplitude), sine[top:]])
    t = np.arange(x.size) / rate
    motion = motion_of(Recording(t, x + noise * np.random.default_rng(1).standard_normal(x.size), np.zeros(x.size)))
    assert motion.n_half == 7
    assert t[motion.start[1]] == pytest.approx(t[40 + top + 3000], abs=0.2)


@pytest.mark.parametrize("rate", [5.0, 20.0, 200.0])
def test_a_device_that_leaves_a_rest_slowly_has_turned_before_it_is_beyond_the_noise(rate):
    """It moves by less than the noise for a third of a second, in which the published rule has jumped by 2 kN."""
    amplitude, speed, begins, noise = 95.0, 10.0, 20.0, 0.018
    t = np.arange(0.0, 60.0, 1.0 / rate)
    x = amplitude * np.cos(speed / amplitude * np.maximum(t - begins, 0.0))
    late = []
    for seed in range(6):
        raw = x + noise * np.random.default_rng(seed).standard_normal(t.size)
        before = amplitude * np.sin(0.5 * np.pi * t[t < 15.0] / 15.0)
        motion = motion_of(
            Recording(np.arange(before.size + t.size) / rate, np.append(before, raw), 0.0 * np.append(before, raw))
        )
        assert motion.n_half == 3
        assert motion.turning_mm[1] == pytest.approx(amplitude, abs=0.02)
        late.append(motion.start[1] / rate - before.size / rate - begins)
    assert np.abs(np.mean(late)) < 0.06 + 0.5 / rate
    assert np.abs(late).max() < max(0.15, 2.0 / rate)


def test_a_long_rest_with_noise_and_counts_makes_no_reversals():
    rng = np.random.default_rng(5)
    _, exact = exact_motion((Block(6.0, 0.25, 3),), 50.0)
    still = np.zeros(3000)
    x = np.concatenate([still, exact.displacement_mm, still])
    x = np.round((x + 0.06 * rng.standard_normal(x.size)) / COUNT) * COUNT
    motion = motion_of(Recording(np.arange(x.size) / 50.0, x, np.zeros(x.size)))
    assert motion.n_half == 7
    np.testing.assert_allclose(motion.turning_mm[1:], [6, -6] * 3, atol=0.1)


def test_uneven_sampling_and_a_gap():
    t, exact = exact_motion(table_1(), 100.0)
    rng = np.random.default_rng(1)
    uneven = np.sort(t + 0.003 * rng.uniform(-1, 1, t.size))
    uneven = uneven[(uneven < 200) | (uneven > 200.3)]
    x = np.interp(uneven, t, exact.displacement_mm) + 0.02 * rng.standard_normal(uneven.size)
    motion = motion_of(Recording(uneven, x, np.zeros(x.size)))
    assert motion.n_half == 41
    error = motion.displacement_mm - np.interp(uneven, t, exact.displacement_mm)
    assert np.sqrt(np.mean(error**2)) < 0.01
    speed = motion.speed_mm_s - np.interp(uneven, t, exact.speed_mm_s)
    assert np.sqrt(np.mean(speed**2)) < 0.1


def test_each_half_cycle_lies_between_its_turning_points():
    _, motion = measured(20.0, 0.1, False, 3)
    for k in range(1, motion.n_half - 1):
        x = motion.displacement_mm[motion.start[k] : motion.start[k + 1]]
        low, high = sorted(motion.turning_mm[k : k + 2])
        assert low <= x.min() <= x.max() <= high


def test_elastic_branch_keeps_its_stiffness():
    """K = 20 kN/mm with 0.02 mm noise: the slope against the smoothed displacement is not attenuated."""
    slopes, raw_slopes = [], []
    for seed in range(6):
        t, exact = exact_motion((Block(6.0, 0.27, 8),), 20.0)
        x = exact.displacement_mm + 0.02 * np.random.default_rng(seed).standard_normal(t.size)
        motion = motion_of(Recording(t, x, np.zeros(t.size)))
        slip = np.abs(exact.displacement_mm - exact.turning_mm[exact.half_cycle])
        estimated = np.abs(motion.displacement_mm - motion.turning_mm[motion.half_cycle])
        rows = (slip < 4.0) & (exact.half_cycle > 0) & (motion.half_cycle == exact.half_cycle)
        slopes.append(np.polyfit(estimated[rows], 20 * slip[rows], 1)[0])
        raw_slopes.append(np.polyfit(estimated[rows], 20 * slip[rows], 1)[1])
    assert np.mean(slopes) == pytest.approx(20.0, rel=0.003)
    assert abs(np.mean(raw_slopes)) < 0.1  # kN at zero slip


def test_noise_and_resolution_estimates():
    t, exact = exact_motion(table_1(), 100.0)
    rng = np.random.default_rng(2)
    assert noise_of(exact.displacement_mm + 0.05 * rng.standard_normal(t.size)) == pytest.approx(0.05, rel=0.05)
    rounded = np.round(exact.displacement_mm / COUNT) * COUNT
    assert resolution_of(rounded) == pytest.approx(COUNT)
    assert resolution_of(exact.displacement_mm) == 0.0
    assert noise_of(rounded) == pytest.approx(COUNT / np.sqrt(12), rel=0.3)
    assert noise_of(np.arange(4.0)) == 0.0


def test_stated_bandwidth_is_the_measured_one():
    half, step = 7, 0.05
    frequency = bandwidth(half, step)
    t = np.arange(4000) * step
    _, velocity = local_polynomial(np.sin(2 * np.pi * frequency * t), half, step)
    gain = np.std(velocity[100:-100]) / (2 * np.pi * frequency / np.sqrt(2))
    assert gain == pytest.approx(np.sqrt(0.5), rel=0.01)


def test_hysteresis_ignores_what_is_below_the_threshold():
    x = np.array([0.0, 1.0, 0.9, 2.0, 0.0, 0.4, 0.3, -2.0, 0.0])
    assert hysteresis(x, 0.5) == [3, 7]
    assert hysteresis(x, 0.05) == [1, 2, 3, 4, 5, 7]
    assert hysteresis(np.ones(5), 0.5) == []


def test_no_motion_is_refused_with_numbers():
    t = np.arange(100.0)
    with pytest.raises(RecordingError, match=r"moves 0 mm in 100 samples.*check column and unit"):
        motion_of(Recording(t, np.zeros(100), t))
    with pytest.raises(RecordingError, match=r"0\.\d+ mm noise"):
        motion_of(Recording(t, np.random.default_rng(1).standard_normal(100), t))


def test_short_recordings_do_not_crash():
    for n in (8, 9, 12, 20, 33):
        t = np.arange(n) * 0.1
        motion = motion_of(Recording(t, 10 * np.sin(t), t))
        assert motion.start[-1] == n


def test_fifty_thousand_samples_in_half_a_second():
    t, exact = exact_motion(table_1(), 84.0)
    x = exact.displacement_mm + 0.05 * np.random.default_rng(0).standard_normal(t.size)
    recording = Recording(t, x, np.zeros(t.size))
    best = np.inf
    for _ in range(3):
        begin = time.perf_counter()
        motion_of(recording)
        best = min(best, time.perf_counter() - begin)
    assert t.size > 50_000
    assert best < 0.5


def _blocks_and_a_rest(rate_Hz: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fast small cycles, a rest eased into at a stroke's end, slow large ones: time, displacement, turning points."""
    fine = np.arange(0.0, 120.0, 0.01)
    fast = 24.0 * np.sin(40.0 / 24.0 * fine)
    end = 4 * 2 * np.pi * 24.0 / 40.0
    slow = 48.0 * np.sin(10.0 / 48.0 * (fine - end))
    rest = end + np.pi / 2 * 48.0 / 10.0
    x = np.where(fine < end, fast, slow)
    x = np.where((fine > rest) & (fine < rest + 30.0), 48.0, x)
    later = fine >= rest + 30.0
    x[later] = 48.0 * np.sin(10.0 / 48.0 * (fine[later] - 30.0 - end))
    x = gaussian_filter1d(x, 30, mode="nearest")
    every = round(100 / rate_Hz)
    return fine[::every], x[::every], x[hysteresis(x, 1.0)]


@pytest.mark.parametrize("rate_Hz", [5.0, 10.0, 20.0])
def test_motion_where_the_speed_changes_within_a_half_cycle(rate_Hz: float) -> None:
    """Errors were 0.7 mm and 1.5 mm/s where a block began, and 0.1 to 0.3 mm at the turning points after a rest."""
    t, x, turning = _blocks_and_a_rest(rate_Hz)
    noise = 0.02
    recorded = x + np.random.default_rng(5).normal(0.0, noise, x.size)
    motion = motion_of(Recording(t, recorded, np.zeros(t.size)))
    assert motion.turning_mm.size == turning.size + 1
    limit = 0.15 if rate_Hz == 5.0 else 0.08  # nine samples in a fast half-cycle at 5 Hz
    assert np.abs(motion.displacement_mm - x).max() < limit
    assert np.abs(motion.turning_mm[1:] - turning).max() < limit


@pytest.mark.parametrize("rate_Hz", [20.0, 1000.0])
def test_turning_times_are_right_to_a_sample(rate_Hz: float) -> None:
    """At 1 kHz a cycle of a minute has a thousand samples near its reversal; one on the wrong side is off by kN."""
    time_s, exact = exact_motion((Block(95.0, 0.017, 1),), rate_Hz)
    found = motion_of(Recording(time_s, exact.displacement_mm, np.sign(exact.displacement_mm)))
    assert np.abs(found.start - exact.start).max() <= 1
    assert np.abs(found.turning_mm - exact.turning_mm).max() < 2e-4


def test_corners_in_a_long_recording_cost_no_more_than_its_length():
    """A zigzag of 25 000 corners, as of a recording resampled along straight lines: a second, not minutes.

    The least of two runs, in processor time, so that a busy machine does not count.
    """
    n, half = 1_000_000, 10
    grid = Samples(np.arange(n) * 1e-3, np.interp(np.arange(n) % 80, [0, 40, 80], [0.0, 1.0, 0.0]), 1e-4, 1e-3)
    spent = []
    for _ in range(2):
        begin = time.process_time()
        corners = find_kinks(grid, half, 1e-3)
        spent.append(time.process_time() - begin)
    np.testing.assert_array_equal(np.unique(np.diff(corners)), 40)
    assert corners.size > 24_000
    assert min(spent) < 5.0


@pytest.mark.parametrize("rate_Hz", [5.0, 20.0, 100.0])
@pytest.mark.parametrize("rounding_s", [0.0, 0.1])
def test_a_triangle_turns_where_it_does_though_few_samples_show_it(rate_Hz: float, rounding_s: float) -> None:
    """Half-cycles of 1.2 to 16 s, with sharp corners or as an actuator rounds them."""
    fine, noise = 2000.0, 0.005
    ends = [e for a, n in ((6.0, 2), (12.0, 2), (40.0, 2), (6.0, 2)) for e in (a, -a) * n]
    places = np.array([0.0, *ends, 0.0])
    times = np.cumsum([0.0, *np.abs(np.diff(places)) / np.repeat([10.0, 5.0], [9, 8])])
    sharp = np.interp(np.arange(int(times[-1] * fine)) / fine, times, places)
    exact = gaussian_filter1d(sharp, rounding_s * fine, mode="nearest") if rounding_s else sharp
    every = int(fine / rate_Hz)
    time, x = np.arange(exact[::every].size) / rate_Hz, exact[::every]
    noisy = x + noise * np.random.default_rng(3).standard_normal(x.size)
    found = motion_of(Recording(time, noisy, np.zeros(time.size)))
    turns = exact[np.flatnonzero(np.diff(np.sign(np.diff(exact))) != 0) + 1]
    assert found.n_half == turns.size + 1
    short = (turns - found.turning_mm[1:]) * np.sign(turns)
    assert np.median(np.abs(short)) < 0.02
    assert np.sqrt(np.mean((found.displacement_mm - x) ** 2)) < 0.03
