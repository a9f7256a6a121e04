"""Effects that act on the motion: slack, second surface, compliance, lag, and what follows the slip."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import lsim

from shj_bayes.model.device import force_with_effects
from shj_bayes.model.effects.effect import Base, catalogue
from shj_bayes.model.effects.sliding import passes, slid_m, slid_mm, slid_since_mm
from shj_bayes.model.history import ARRAYS, DELAYED, History, delayed, histories, turn_s
from shj_bayes.recording.motion import Block, Motion, exact_motion

K, FY = 20.0, 80.0
BASE = Base(K, FY, 200.0, 0.0, FY)


def ramps(turning: list[float], step: float = 0.01) -> History:
    """Constant speed of 1 mm/s from one turning point to the next."""
    return in_runs(turning, 1, step)[0]


def in_runs(turning: list[float], n: int, step: float = 0.01) -> tuple[History, ...]:
    """So many runs of the same ramps."""
    legs, start, x = list(pairwise(turning)), [0], []
    for k, (a, b) in enumerate(legs):
        leg = a + np.sign(b - a) * np.arange(0 if k == 0 else step, abs(b - a) + step / 2, step)
        x.append(leg)
        start.append(start[-1] + leg.size)
    where = np.concatenate(x)
    direction = np.array([int(np.sign(b - a)) for a, b in legs])
    motion = Motion(where, np.ones(where.size), np.array(start), np.array(turning[:-1]), direction)
    return histories([np.arange(where.size) * step] * n, [motion] * n)


def run(history: History, variant: str = "continuous", base: Base = BASE, **values: dict[str, float]) -> np.ndarray:
    acting = [(catalogue()[name], own) for name, own in values.items()]
    return force_with_effects(history, base, acting, variant=variant)


@pytest.mark.parametrize("variant", ["published", "continuous"])
def test_the_loop_is_as_wide_at_zero_force_as_the_slack(variant: str):
    h = ramps([0.0, 30.0, -30.0, 30.0])
    f = run(h, variant, slack={"size": 3.0, "softness": 0.02, "start": 0.5})
    for k in (1, 2):
        inside = slice(h.motion.start[k], h.motion.start[k + 1])
        flat = h.position_mm[inside][np.abs(f[inside]) < 1e-9]
        assert np.ptp(flat) == pytest.approx(3.0, abs=0.05)


@pytest.mark.parametrize("start", [0.0, 0.3, 1.0])
def test_a_reversal_within_the_slack_leads_back_over_what_was_crossed(start: float):
    """Moved to and fro without touching, then on: all that is crossed is the clearance, whatever came before."""
    h = ramps([0.0, 0.2, -0.1, 12.0])
    f = run(h, slack={"size": 3.0, "softness": 0.02, "start": start})
    last = slice(h.motion.start[2], h.motion.start[3])
    free = h.motion.displacement_mm[last][np.abs(f[last]) < 1e-9]
    assert free.max() == pytest.approx(3.0 * start, abs=0.06)


def test_a_test_that_begins_unloaded_but_for_noise_begins_in_the_clearance():
    """A reading of a few kN before the first motion is no contact with one end of the clearance."""
    h = ramps([0.0, 2.0, -2.0, 30.0])
    acting = [(catalogue()["slack"], {"size": 3.0, "softness": 0.02, "start": 0.5})]
    unloaded, read, loaded = (
        force_with_effects(h, BASE, acting, start_force_kN=f) for f in (0.0, -0.05 * FY, 0.5 * FY)
    )
    np.testing.assert_array_equal(read, unloaded)
    assert np.abs(loaded - unloaded).max() > 0.2 * FY


def test_slack_opens_only_where_the_force_passes_zero():
    h = ramps([0.0, 30.0, 29.0, 40.0])  # a small reversal under load: 80 kN down to 60 kN and up again
    f = run(h, slack={"size": 3.0, "softness": 0.02, "start": 0.5})
    again = f[h.motion.start[2] :]
    assert again[0] == pytest.approx(60.0, abs=0.5)
    assert np.all(np.diff(again) > -1e-9)


def test_second_surface_unloads_crosses_its_clearance_and_follows():
    h = ramps([0.0, 30.0, -30.0])
    f = run(h, two_stage={"size": 0.4, "delay": 2.0, "bolts": 1.0})
    back = f[h.motion.start[1] :]
    slip = h.slip_mm[h.motion.start[1] :]
    free = FY / K  # both surfaces have come down to zero
    parts = (
        (slip < free - 0.1),
        (slip > free + 0.1) & (slip < free + 1.9),
        (slip > free + 2.1) & (slip < 2 * free - 0.1),
    )
    slopes = [np.polyfit(slip[w], back[w], 1)[0] for w in parts]
    assert slopes == pytest.approx([-K, -0.6 * K, -K], rel=0.01)
    assert f.min() == pytest.approx(-FY, rel=1e-3)


def test_compliance_works_in_series_with_the_stiffness():
    h = ramps([0.0, 30.0, -30.0])
    f = run(h, frame_compliance={"size": 0.02})
    slip, back = h.slip_mm[h.motion.start[1] :], f[h.motion.start[1] :]
    slope = np.polyfit(slip[slip < 4], back[slip < 4], 1)[0]
    assert slope == pytest.approx(-1 / (1 / K + 0.02), rel=1e-3)


def by_bisection(turning: list[float], x: np.ndarray, half: np.ndarray, base: Base, parts: dict[str, float]):
    """Force behind an elastic part and a clearance, each sample on its own by halving an interval of forces."""
    gap, take_up, series, smooth = parts["gap"], parts["softness"] * parts["gap"], parts["series"], parts["smooth"]
    ahead, reset, out = gap * parts["start"], 0.0, np.empty(x.size)

    def one(travel: float, sense: float) -> float:
        def law(f: float) -> float:
            e = reset + base.K * sense * max(travel - sense * series * (f - reset), 0.0)
            if e * sense > 0 and reset * sense <= 0:
                past = max(e * sense - base.K * ahead, 0.0)
                full = base.K * take_up
                e = sense * (0.4 * past if past < full else past - 0.6 * full)
            held = e / (1 + abs(e / base.Fy) ** base.beta) ** (1 / base.beta)
            return held if e * sense > 0 else held + smooth * (e - held)

        low, high = -4 * base.Fy, 4 * base.Fy
        for _ in range(80):
            f = (low + high) / 2
            low, high = (f, high) if law(f) > f else (low, f)
        return f

    for k, (begin, end) in enumerate(pairwise(turning)):
        sense = float(np.sign(end - begin))
        for i in np.flatnonzero(half == k):
            out[i] = one((x[i] - begin) * sense, sense)
        before, reset = reset, one(abs(end - begin), sense)
        if abs(reset) < 1e-9 * base.Fy and before * sense <= 0:
            reset = 0.0
            crossed = abs(end - begin) + series * before * sense + before * sense / base.K
            ahead = max(gap - ahead + min(max(crossed, 0.0), ahead), 0.0)
        else:
            ahead = gap
    return out


@pytest.mark.parametrize(("smooth", "variant"), [(0.0, "published"), (1.0, "continuous")])
@pytest.mark.parametrize("softness", [0.05, 0.9])
def test_a_frame_and_a_clearance_together_agree_with_bisection(smooth: float, variant: str, softness: float):
    """With stops inside the clearance and reversals under load; strong compliance, where steps could jump the gap."""
    turning = [0.0, 24.0, -25.0, -24.0, -26.0, 20.0, 12.5, 14.0, 11.0, 26.0, -20.0]
    h = ramps(turning, step=0.05)
    for beta, series, start in ((8.0, 0.01, 0.3), (60.0, 0.08, 0.9), (1.5, 0.03, 0.0)):
        base = Base(K, FY, beta, 0.0, FY)
        f = run(
            h,
            variant,
            base,
            slack={"size": 3.0, "softness": softness, "start": start},
            frame_compliance={"size": series},
        )
        parts = {"gap": 3.0, "softness": softness, "series": series, "smooth": smooth, "start": start}
        oracle = by_bisection(turning, h.motion.displacement_mm, h.motion.half_cycle, base, parts)
        np.testing.assert_allclose(f, oracle, atol=1e-9 * FY)


@pytest.mark.parametrize("lag", [0.07, -0.23])
def test_the_motion_of_a_moment_ago_lies_on_a_spline(lag: float):
    time, motion = exact_motion((Block(48.0, 0.034, 2), Block(20.0, 0.1, 1)), 5.0)
    h = histories([time], [motion])[0]
    late, own = delayed(h, lag)
    then = np.clip(h.time_s - lag, h.time_s[0], h.time_s[-1])
    spline = CubicHermiteSpline(h.time_s, h.motion.displacement_mm, h.direction * h.speed_mm_s)
    away = np.min(np.abs(then[:, None] - turn_s(h)), axis=1) > 0.2  # beside a reversal each half-cycle keeps its side
    np.testing.assert_array_equal(late.time_s[own], h.time_s)
    np.testing.assert_allclose(late.motion.displacement_mm[own][away], spline(then)[away], atol=1e-9)
    np.testing.assert_allclose(late.speed_mm_s[own][away], np.abs(spline(then, 1))[away], atol=1e-9)
    np.testing.assert_allclose(late.travel_m[own], np.interp(then, h.time_s, h.travel_m), atol=1e-12)
    np.testing.assert_allclose(late.acceleration_mm_s2[own], np.interp(then, h.time_s, h.acceleration_mm_s2), atol=1e-9)
    where = late.motion.turning_mm[late.motion.half_cycle] + late.direction * late.slip_mm
    np.testing.assert_allclose(late.motion.displacement_mm, where, atol=1e-12)
    assert not any(array.flags.writeable for array in (late.slip_mm, late.motion.displacement_mm, late.position_mm))


@pytest.mark.parametrize("lag", [0.0, 0.07])
def test_each_half_cycle_is_followed_to_its_turning_point(lag: float):
    time, motion = exact_motion((Block(48.0, 0.034, 2), Block(20.0, 0.1, 1)), 5.0)
    h = histories([time], [motion])[0]
    whole, own = h.turned if lag == 0 else delayed(h, lag)
    if lag == 0:
        for name in ARRAYS:
            np.testing.assert_allclose(getattr(whole, name)[own], getattr(h, name), rtol=1e-13, atol=1e-13)
    ends = whole.motion.start[1:-1] - 1
    assert not np.isin(ends, own).any()
    np.testing.assert_array_equal(whole.motion.displacement_mm[ends], motion.turning_mm[1:])
    np.testing.assert_array_equal(whole.speed_mm_s[ends], 0.0)
    np.testing.assert_allclose(whole.time_s[ends], turn_s(h) + lag, atol=1e-12)
    assert np.all(np.diff(whole.time_s) >= 0)
    assert np.all(np.diff(whole.travel_m) >= (-1e-12 if lag == 0 else -1e-4))  # straight between samples, also there
    for a, b in pairwise(whole.motion.start):
        assert np.all(np.diff(whole.slip_mm[a:b]) >= -1e-9)


def test_the_force_at_a_turning_point_does_not_depend_on_the_sampling():
    """Friction that rises with the logarithm of falling speed, at 5 samples a second and at 500."""
    values = {"size": -0.05, "corner": 0.003, "memory": 0.0}
    out = []
    for rate in (5.0, 500.0):
        time, motion = exact_motion((Block(6.0, 0.27, 3), Block(24.0, 0.067, 2)), rate)
        out.append((time, run(histories([time], [motion])[0], base=Base(K, FY, 60.0, 0.0, FY), velocity_law=values)))
    fine = np.interp(out[0][0], *out[1])
    assert np.max(np.abs(out[0][1] - fine)) < 0.003 * FY


def test_a_positive_lag_records_the_force_later():
    h = ramps([0.0, 30.0, -30.0])
    plain, late, early = run(h), run(h, sensor_lag={"size": 0.5}), run(h, sensor_lag={"size": -0.5})
    np.testing.assert_allclose(late[50:], plain[:-50], atol=1e-6)
    np.testing.assert_allclose(early[:-50], plain[50:], atol=1e-6)


@pytest.mark.parametrize("share", [0.4, 1.0])
def test_a_filter_with_two_poles_rounds_corners(share):
    h = ramps([0.0, 30.0, -30.0, 10.0])
    late, whole = run(h, sensor_lag_filtered={"size": 0.4, "share": share}), run(h, sensor_lag={"size": 0.4})
    pole = [0.2 * share, 1.0]
    exact = lsim(([1.0], np.convolve(pole, pole)), run(h, sensor_lag={"size": 0.4 * (1.0 - share)}), h.time_s)[1]
    assert np.abs(late - exact).max() < 0.005 * FY
    assert np.abs(whole - exact).max() > 0.01 * share * FY
    np.testing.assert_allclose(run(h, sensor_lag_filtered={"size": 0.4, "share": 0.0}), whole, atol=1e-9)


def test_velocity_is_gamma_on_the_plateau():
    time, motion = exact_motion((Block(48.0, 0.034, 2),), 10.0)
    h = histories([time], [motion])[0]
    gamma = run(h, base=Base(K, FY, 200.0, 0.012, FY))
    own = run(h, velocity={"size": 0.012})
    plateau = h.slip_mm > 14
    np.testing.assert_allclose(own[plateau], gamma[plateau], rtol=1e-4)


def test_bend_of_the_speed_law_is_as_large_as_its_size():
    time, motion = exact_motion((Block(48.0, 0.034, 2),), 200.0)
    h = histories([time], [motion])[0]
    for corner in (0.001, 0.05, 1.5):
        bent = catalogue()["velocity_law"].act(h, {"size": 0.1, "corner": corner, "memory": 0.0}, BASE)
        assert np.max(bent.clamping + bent.gamma_s_per_mm * h.speed_mm_s) == pytest.approx(1.1, abs=1e-3)


def test_end_bearing_can_be_at_one_end_only():
    h = ramps([0.0, 30.0, -30.0, 30.0])
    values = {"size": 0.05, "contact": 0.9, "side": 1.0, "returned": 0.25}
    added = np.asarray(catalogue()["end_bearing"].act(h, values, BASE).added_kN)
    assert np.max(added) == pytest.approx(2 * 0.05 * FY * 3.0)
    assert np.all(added[h.position_mm < 0] == 0)
    out, back = h.position_mm[h.direction > 0], h.position_mm[h.direction < 0]
    np.testing.assert_allclose(added[h.direction > 0], 2 * 0.05 * FY * np.maximum(out - 27.0, 0.0), atol=1e-9)
    np.testing.assert_allclose(added[h.direction < 0], 0.25 * 2 * 0.05 * FY * np.maximum(back - 27.0, 0.0), atol=1e-9)


def test_stick_slip_has_one_tooth_per_wave_length():
    h = ramps([0.0, 30.0, -30.0])
    factor = np.asarray(catalogue()["stick_slip"].act(h, {"size": 0.1, "wave": 4.0}, BASE).clamping)
    back = slice(h.motion.start[1], None)
    slid = h.slip_mm[back] - 2 * FY / K
    assert np.all(np.abs(factor[back][slid <= -0.5] - 1.0) < 1e-6)
    drops = slid[1:][np.diff(np.sign(np.diff(factor[back], prepend=1.0))) < 0]
    np.testing.assert_allclose(np.diff(drops[drops > 0]), 4.0, atol=0.03)
    assert np.max(factor) == pytest.approx(1.1, abs=0.002)


@pytest.mark.parametrize(
    ("name", "own", "sticks"),
    [("stribeck", {"speed": 5.0, "shape": 1.0}, 1.1), ("velocity_law", {"corner": 0.01}, 1.0)],
)
def test_a_contact_follows_its_speed_over_its_memory(name, own, sticks):
    """At once for 0 mm, as in a fit without that parameter; in a long stroke as much later as it is long.

    What slides begins at the force that holds at rest.
    """
    time, motion = exact_motion((Block(48.0, 0.034, 2),), 200.0)
    (h,) = histories([time], [motion])

    def law(memory):
        return np.asarray(catalogue()[name].act(h, {"size": 0.1, **own, "memory": memory}, BASE).clamping)

    slid, stroke = slid_mm(h, BASE.sliding_from(sticks)), slice(h.motion.start[2], h.motion.start[3])
    moving = stroke.start + np.flatnonzero((slid[stroke] > 5.0) & (slid[stroke] < 60.0))
    at_once, late = law(0.0), law(1.0)
    assert np.ptp(at_once[moving]) > 0.01
    np.testing.assert_allclose(np.interp(slid[moving] - 1.0, slid[stroke], at_once[stroke]), late[moving], atol=5e-4)
    elastic = stroke.start + np.flatnonzero(slid[stroke] < 1e-6)
    assert np.ptp(late[elastic]) < 1e-6 < np.ptp(at_once[elastic])  # nothing slides, so nothing changes


def test_friction_memory_goes_on_from_run_to_run():
    """Nothing slides between two runs: the second one begins with the speed that the first one ended with."""
    time, motion = exact_motion((Block(48.0, 0.034, 1),), 50.0)
    runs = histories([time, time], [motion, motion])
    parts = [catalogue()["friction_memory"].act(h, {"size": 0.1, "length": 20.0}, BASE) for h in runs]
    first, second = (np.asarray(part.clamping) for part in parts)
    assert first[0] == 1.0
    assert second[0] == pytest.approx(first[-1], abs=2e-4)
    assert second[0] < 0.95


def test_friction_memory_lags_by_its_length():
    """In a sine stroke much longer than the memory, u - m is nearly L du/ds: 0.1 x 5 mm / 48 mm at its start."""
    time, motion = exact_motion((Block(48.0, 0.034, 2),), 200.0)
    h = histories([time], [motion])[0]
    memory = catalogue()["friction_memory"].act(h, {"size": 0.1, "length": 5.0}, BASE)
    factor = np.asarray(memory.clamping) - 1.0 + memory.gamma_s_per_mm * h.speed_mm_s
    speed, half = h.speed_mm_s / h.peak_speed_mm_s, h.motion.half_cycle
    late = (half == 2) & (h.slip_mm > 25.0) & (h.slip_mm < 70.0)  # the law is steep in slip near both ends
    rate = np.gradient(speed[late], h.slip_mm[late])
    np.testing.assert_allclose(factor[late][5:-200], 0.1 * 5.0 * rate[5:-200], atol=3e-3)
    assert factor[late][5] > 0.0 > factor[late][-50]


def test_friction_memory_does_not_depend_on_the_sampling():
    values = {"size": 0.1, "length": 5.0}
    out = []
    for rate in (5.0, 100.0):
        time, motion = exact_motion((Block(48.0, 0.034, 2),), rate)
        h = histories([time], [motion])[0]
        out.append((time, np.asarray(catalogue()["friction_memory"].act(h, values, BASE).clamping)))
    np.testing.assert_allclose(out[0][1], np.interp(out[0][0], *out[1]), atol=1e-3)


def test_a_small_reversal_under_load_leads_back_to_the_capacity_of_its_own_direction():
    """Push slides at 100 kN, pull at 60: 0.5 mm back and on again, push slides at 100 at once."""
    h = ramps([0.0, 30.0, 29.5, 40.0])
    f = run(h, asymmetry={"size": 0.25})
    again = f[h.motion.start[2] :]
    assert again[0] == pytest.approx(100.0 - 0.5 * K, abs=0.5)
    assert again[h.slip_mm[h.motion.start[2] :] > 0.6].min() == pytest.approx(100.0, abs=0.5)


def test_sliding_begins_where_the_force_of_the_reversal_lets_it():
    """After a full stroke 2 Fy/K, after a reversal under load what it came down by, at first Fy/K."""
    h = ramps([0.0, 30.0, 29.0, 40.0, 38.0])
    slid = slid_mm(h, BASE)
    begins = [h.slip_mm[a:b][slid[a:b] > 0.05] for a, b in pairwise(h.motion.start)]
    assert [round(float(s.min()), 1) if s.size else None for s in begins] == [4.0, None, 1.1, None]
    assert np.sum(slid_since_mm(h, BASE)) == pytest.approx(26.0 + 10.0, abs=0.1)


@pytest.mark.parametrize("beta", [5.0, 20.0, 200.0])
def test_what_is_slid_is_what_the_force_does_not_take_up(beta):
    """Slip since the reversal less the change of force over K, under the rule that has no jump, after full strokes."""
    h = ramps([0.0, 40.0, -40.0, 30.0])
    base = Base(K, FY, beta, 0.0, FY)
    f = run(h, base=base, variant="continuous")
    at_reversal = np.append(0.0, f[h.motion.start[1:-1] - 1])[h.motion.half_cycle]
    elastic = np.abs(f - at_reversal) / K
    np.testing.assert_allclose(slid_mm(h, base), h.slip_mm - elastic, atol=2e-3)


def test_noise_of_the_displacement_at_rest_is_no_motion():
    """After 30 mm the device rests for 200 s, its displacement off by 0.01 mm here and there."""
    still = ramps([0.0, 30.0])
    rng = np.random.default_rng(5)
    where = np.append(still.position_mm, 30.0 + 0.01 * rng.standard_normal(4000))
    time = np.append(still.time_s, still.time_s[-1] + 0.05 * np.arange(1, 4001))
    speed = np.append(np.ones(still.time_s.size), np.zeros(4000))
    motion = Motion(where, speed, np.array([0, where.size]), np.array([0.0]), np.array([1]))
    (h,) = histories([time], [motion])
    assert np.sum(slid_since_mm(h, BASE)) == pytest.approx(26.0, abs=0.1)
    hot = run(h, thermal={"size": 0.3, "cooling": 20.0, "spread": 0.1})
    rises = hot[still.time_s.size + 100 :].max() - hot[still.time_s.size - 1]
    assert rises <= 0.05 * K  # the spring over the largest error, not the capacity of plates that have cooled


def test_the_distance_slid_goes_on_from_run_to_run_without_what_was_elastic():
    runs = in_runs([0.0, 30.0, -30.0, 30.0], 2)
    first, second = (slid_m(h, BASE) for h in runs)
    done = np.array([26.0, 52.0, 52.0]) / 1000.0  # all but Fy/K of the first stroke, then all but 2 Fy/K
    assert first[-1] == pytest.approx(done.sum(), abs=1e-4) == pytest.approx(second[0], abs=1e-4)
    assert second[-1] == pytest.approx(2 * done.sum(), abs=2e-4)
    bounded = replace(runs[1], travel_m=0.5 * runs[1].travel_m)
    np.testing.assert_allclose(slid_m(bounded, BASE), 0.5 * second)


def test_a_place_counts_what_has_slid_over_it():
    """Against the bell summed over every step; a place that no stroke reaches counts none."""
    runs = in_runs([0.0, 60.0, -30.0, 50.0], 2)
    width = 0.1
    place = np.concatenate([h.position_mm for h in runs])
    slid = np.concatenate([slid_since_mm(h, BASE) for h in runs])
    middle = place - 0.5 * slid * np.concatenate([h.direction for h in runs])
    sd = width * runs[0].half_stroke_mm
    got = np.concatenate([passes(h, BASE, width) for h in runs])
    for i in (50, 400, 900, place.size - 1):
        bell = np.exp(-0.5 * ((place[i] - middle[: i + 1]) / sd) ** 2) / (sd * np.sqrt(2.0 * np.pi))
        assert got[i] == pytest.approx(np.sum(bell * slid[: i + 1]), abs=0.03)
    assert got.max() == pytest.approx(5.5, abs=0.1)  # mid-stroke, in the middle of the sixth stroke


def test_a_moment_ago_is_worked_out_once_and_few_are_kept():
    """Slopes of a model ask for the same delays again and again; a search asks for many in turn."""
    time, motion = exact_motion((Block(48.0, 0.034, 2),), 5.0)
    h = histories([time], [motion])[0]
    once = delayed(h, 0.07)
    assert delayed(h, 0.07) is once
    for lag in np.linspace(0.08, 0.2, 3 * DELAYED):
        delayed(h, float(lag))
    assert len(h.late) <= DELAYED
    again = delayed(h, 0.07)
    assert again is not once
    np.testing.assert_array_equal(again[0].motion.displacement_mm, once[0].motion.displacement_mm)
