"""Effects with a memory of travel, time, heat or rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import optimize

from shj_bayes.model.effects.effect import Base, catalogue
from shj_bayes.model.effects.friction import _ages
from shj_bayes.model.effects.sliding import slid_m
from shj_bayes.model.history import History, histories
from shj_bayes.recording.motion import Block, Motion, exact_motion

BASES = (Base(18.0, 80.0, 10.0, 0.0, 80.0), Base(18.0, 60.0, 10.0, 0.0, 80.0))
ELASTIC = BASES[0].Fy / BASES[0].K  # from zero force to sliding, mm
BLOCKS = (Block(24.0, 0.067, 3), Block(48.0, 0.034, 3))


def two_runs() -> tuple[History, ...]:
    time, motion = exact_motion(BLOCKS, 10.0)
    return histories([time, time], [motion, motion])


def with_pause(seconds: float) -> tuple[History, int, int]:
    """A pause at a turning point: history, last sample before and last sample of the pause."""
    motion = exact_motion(BLOCKS, 10.0)[1]
    cut = int(motion.start[4])
    n = int(seconds * 10)
    x = np.insert(motion.displacement_mm, cut, np.full(n, motion.turning_mm[4]))
    v = np.insert(motion.speed_mm_s, cut, np.zeros(n))
    start = motion.start + np.where(motion.start > cut, n, 0)
    paused = Motion(x, v, start, motion.turning_mm, motion.direction)
    return histories([np.arange(x.size) / 10.0], [paused])[0], cut - 1, cut + n - 1


def clamping(name: str, history: History, base: Base = BASES[0], **values: float) -> np.ndarray:
    factor = catalogue()[name].act(history, values, base).clamping
    return np.asarray(np.broadcast_to(factor, history.time_s.shape))


def test_wear_goes_on_where_the_first_run_ended():
    first, second = two_runs()
    a, b = clamping("wear", first, size=0.1), clamping("wear", second, BASES[1], size=0.1)
    assert a[0] == 1.0
    assert b[0] == pytest.approx(a[-1], rel=1e-3)
    assert b[-1] == pytest.approx(np.exp(-0.1 * slid_m(second, BASES[1])[-1]))


def test_drift_and_bedding_in_go_on_too():
    first, second = two_runs()
    values = {"size": 0.05, "warming": 2.0}
    drift = [catalogue()["drift"].act(h, values, b).added_kN for h, b in zip(two_runs(), BASES, strict=True)]
    assert drift[1][0] == pytest.approx(drift[0][-1]) == pytest.approx(0.05 * 80.0)
    rise = [clamping("bedding_in", h, size=0.2, travel=0.3) for h in (first, second)]
    assert rise[1][0] == pytest.approx(rise[0][-1], rel=1e-3)


def test_heat_leaves_in_a_rest_and_wear_does_not():
    history, before, after = with_pause(600.0)
    warm = clamping("thermal", history, size=0.2, cooling=100.0, spread=0.5)
    assert warm[0] == 1.0
    assert warm[before] < 0.98
    assert 1 - warm[after] == pytest.approx((1 - warm[before]) * np.exp(-6.0), rel=0.02)
    worn = clamping("wear", history, size=0.1)
    assert worn[after] == pytest.approx(worn[before], rel=1e-3)


def test_heat_follows_the_heat_equation():
    """Finite volumes through a plate that is rubbed on one face and gives heat off at the other (Biot number 1.4)."""
    history = two_runs()[0]
    thickness, biot, cells, diffusivity = 23.0, 1.4, 46, 14.0
    width, h = thickness / cells, 0.005
    root = optimize.brentq(lambda m: m * np.tan(m) - biot, 1e-3, 1.5)
    cooling = thickness**2 / (diffusivity * root**2)
    warm = 1 - clamping("thermal", history, size=0.2, cooling=cooling, spread=thickness**2 / (np.pi**2 * diffusivity))
    t, face = np.zeros(cells), np.zeros(history.time_s.size)
    slid = np.maximum(np.diff(np.maximum(history.slip_mm - ELASTIC * (1 + (history.motion.half_cycle > 0)), 0.0)), 0.0)
    for i, power in enumerate(slid / 0.1):
        for _ in range(round(0.1 / h)):
            flow = np.concatenate(
                [[power], diffusivity / width * -np.diff(t), [biot * diffusivity / thickness * t[-1]]]
            )
            t = t - h / width * np.diff(flow)
        face[i + 1] = t[0]
    scale = float(face @ warm) / float(face @ face)
    np.testing.assert_allclose(warm, scale * face, atol=0.03 * warm.max())


def test_heat_does_not_depend_on_the_sampling():
    even = exact_motion(BLOCKS, 10.0)
    fine = exact_motion(BLOCKS, 40.0)
    a, b = (histories([time], [motion])[0] for time, motion in (even, fine))
    coarse, dense = (clamping("thermal", h, size=0.2, cooling=60.0, spread=0.5) for h in (a, b))
    np.testing.assert_allclose(np.interp(a.time_s, b.time_s, dense), coarse, atol=5e-4)


def test_a_weaker_run_heats_less():
    """With as much sliding in both: the second is softer by as much as it is weaker."""
    bases = BASES[0], BASES[1]._replace(K=0.75 * BASES[0].K)
    hot, mild = (
        1 - clamping("thermal", h, b, size=0.2, cooling=60.0, spread=0.5)
        for h, b in zip(two_runs(), bases, strict=True)
    )
    np.testing.assert_allclose(mild, 0.75 * hot, rtol=1e-6)


def test_breakaway_peaks_where_sliding_starts_and_grows_with_rest():
    values = {"size": 0.2, "decay": 2.0, "growth": 0.5}
    history, _, after = with_pause(600.0)
    factor = clamping("breakaway", history, **values)
    stroke = slice(history.motion.start[6], history.motion.start[7])
    begins = 2 * 80.0 / 18.0
    slid = history.slip_mm[stroke] - begins
    assert np.all(np.abs(np.diff(factor[stroke][slid < -0.25 * begins])) < 1e-3)
    at = int(np.argmin(np.abs(slid - 2.0)))
    expected = 1 + (factor[stroke][0] - 1) * np.exp(-slid[at] / 2.0)
    assert factor[stroke][at] == pytest.approx(expected, abs=1e-3)  # the knee slides a little before
    rested = history.rest_s[after + 1]
    assert rested > 290
    assert factor[after + 1] == pytest.approx(1 + 0.2 * (1 + 0.5 * np.log10(1 + rested)))
    assert factor[after + 1] > factor[stroke][0]


def test_an_aged_contact_is_renewed_by_sliding():
    """Where it slides at an even speed the age has a closed form: T = D/v + (T0 - D/v) exp(-d/D)."""
    slid, speed, length, rest = np.linspace(0.0, 6.0, 121)[1:], 5.0, 1.5, 800.0
    rate = np.full(120, speed / length)
    ages = _ages(np.diff(slid, prepend=0.0) / length, rate, np.full(120, 0.05 / speed), rest)
    np.testing.assert_allclose(ages, length / speed + (rest - length / speed) * np.exp(-slid / length), rtol=1e-9)
    assert _ages(np.zeros(3), np.zeros(3), np.full(3, 2.0), 1.0).tolist() == [3.0, 5.0, 7.0]


def test_the_age_of_a_contact_is_the_same_however_far_samples_are_apart():
    """A rest of 3.7 s, then 5 mm/s: where sliding begins within a step the contact ages first and is renewed then."""
    fine, coarse = np.linspace(0.0, 6.0, 6001), np.linspace(0.0, 6.0, 7)
    both = []
    for time in (fine, coarse):
        slid = 5.0 * np.maximum(time - 3.7, 0.0)
        rate = np.where(slid > 0.0, 5.0 / 1.5, 0.0)
        both.append(_ages(np.diff(slid, prepend=0.0) / 1.5, rate, np.diff(time, prepend=0.0), 20.0))
    np.testing.assert_allclose(both[1], both[0][::1000], rtol=1e-9)


def test_the_peak_of_an_aged_contact_grows_with_the_logarithm_of_rest():
    peaks = []
    for pause in (60.0, 600.0):
        history, _, after = with_pause(pause)
        factor = clamping("breakaway_aged", history, size=0.02, length=1.0, rest=300.0)
        begin = int(np.searchsorted(history.motion.start, after, side="right"))
        stroke = slice(after, history.motion.start[begin])
        peaks.append(factor[stroke].max())
        assert factor[stroke][-1] < 1.005
    rested = np.array([60.0, 600.0])
    assert peaks[1] - peaks[0] == pytest.approx(0.02 * np.log(rested[1] / rested[0]), rel=0.1)


def test_tension_step_counts_shares_of_the_testing_time_and_may_be_one_sided():
    first, second = two_runs()
    values = {"size": -0.2, "begin": 0.25, "length": 0.4, "side": 0.0}
    a, b = clamping("tension_step", first, **values), clamping("tension_step", second, **values)
    share = first.time_s / first.time_s[-1]
    assert np.all(np.abs(a[share < 0.4] - 1.0) < 1e-4)
    np.testing.assert_allclose(a[share > 0.6], 0.8, atol=1e-4)
    np.testing.assert_allclose(b[share < 0.2], 0.8, atol=1e-4)
    np.testing.assert_allclose(b[share > 0.4], 1.0, atol=1e-4)
    one_sided = clamping("tension_step", first, **(values | {"side": 1.0}))
    late = share > 0.6
    np.testing.assert_allclose(one_sided[late & (first.direction < 0)], 1.0)
    np.testing.assert_allclose(one_sided[late & (first.direction > 0)], 0.6, atol=1e-3)


def test_what_is_remembered_of_the_amplitude_goes_on_from_run_to_run():
    """A run that ends before the contact has got used to its last block leaves it there."""
    first, second = (clamping("amplitude_gradual", h, size=0.1, length=2000.0) for h in two_runs())
    assert second[0] == pytest.approx(first[-1], abs=2e-3)
    assert abs(second[0] - 1.0) > 0.05  # the last block is the largest, of which it would be 1


def test_amplitude_compares_with_the_largest_block():
    history = two_runs()[0]
    factor = clamping("amplitude", history, size=0.1)
    assert factor[10] == pytest.approx(0.9, abs=1e-4)
    assert factor[-10] == pytest.approx(1.0, abs=1e-4)


def test_what_a_contact_got_used_to_goes_on_from_run_to_run():
    """The second run begins with the large block at the end of the first one, and comes down to the small one."""
    first, second = (clamping("amplitude_gradual", history, size=0.1, length=50.0) for history in two_runs())
    assert first[0] == pytest.approx(0.9, abs=1e-3)
    assert second[0] == pytest.approx(first[-1], abs=1e-3) == pytest.approx(1.0, abs=0.01)
    assert second.min() == pytest.approx(0.9, abs=0.005)


def test_a_further_run_goes_on_from_the_tested_ones_whatever_its_duration():
    """A short third run: the channel has warmed for two tests and a bit, and the clamping is as it was at the end."""
    motion = exact_motion(BLOCKS, 10.0)[1]
    n = int(motion.start[3])
    short = Motion(motion.displacement_mm[:n], motion.speed_mm_s[:n], motion.start[:4], *ends_of(motion, 3))
    time = np.arange(motion.displacement_mm.size) / 10.0
    tested = histories([time, time], [motion, motion])
    third = histories([time, time, time[:n]], [motion, motion, short])[2]
    third = replace(third, tested_s=tested[0].tested_s, n_runs=2)
    warm = catalogue()["drift"].act(third, {"size": 0.05, "warming": 2.0}, BASES[0]).added_kN
    tests = (2 * time[-1] + third.time_s) / time[-1]
    np.testing.assert_allclose(warm, 80.0 * 0.05 * np.expm1(-tests / 2.0) / np.expm1(-0.5))
    loose = {"size": -0.2, "begin": 0.8, "length": 0.3, "side": 0.0}
    np.testing.assert_allclose(clamping("tension_step", third, **loose), 0.8, atol=1e-3)


def ends_of(motion: Motion, n_half: int) -> tuple[np.ndarray, np.ndarray]:
    """Turning points and directions of the first half-cycles."""
    return motion.turning_mm[:n_half], motion.direction[:n_half]
