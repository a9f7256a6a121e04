"""Effects that act on the motion: slack, second surface, compliance, lag, and what follows the slip."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from shj_bayes.model.augmented import force_with_effects
from shj_bayes.model.effects.catalogue import catalogue
from shj_bayes.model.effects.effect import Base
from shj_bayes.model.history import History, histories
from shj_bayes.recording.motion import Motion
from shj_bayes.recording.protocol import Block, exact_motion

K, FY = 20.0, 80.0
BASE = Base(K, FY, 200.0, 0.0, FY)


def ramps(turning: list[float], step: float = 0.01) -> History:
    """Constant speed of 1 mm/s from one turning point to the next."""
    legs, start, x = list(pairwise(turning)), [0], []
    for k, (a, b) in enumerate(legs):
        leg = a + np.sign(b - a) * np.arange(0 if k == 0 else step, abs(b - a) + step / 2, step)
        x.append(leg)
        start.append(start[-1] + leg.size)
    where = np.concatenate(x)
    direction = np.array([int(np.sign(b - a)) for a, b in legs])
    motion = Motion(where, np.ones(where.size), np.array(start), np.array(turning[:-1]), direction)
    return histories([np.arange(where.size) * step], [motion])[0]


def run(history: History, variant: str = "continuous", base: Base = BASE, **values: dict[str, float]) -> np.ndarray:
    effects = [catalogue()[name] for name in values]
    return force_with_effects(history, base, effects, values, variant=variant)


@pytest.mark.parametrize("variant", ["seed", "continuous"])
def test_the_loop_is_as_wide_at_zero_force_as_the_slack(variant: str):
    h = ramps([0.0, 30.0, -30.0, 30.0])
    f = run(h, variant, slack={"size": 3.0, "softness": 0.02})
    for k in (1, 2):
        inside = slice(h.motion.start[k], h.motion.start[k + 1])
        flat = h.position_mm[inside][np.abs(f[inside]) < 1e-9]
        assert np.ptp(flat) == pytest.approx(3.0, abs=0.05)


def test_slack_opens_only_where_the_force_passes_zero():
    h = ramps([0.0, 30.0, 29.0, 40.0])  # a small reversal under load: 80 kN down to 60 kN and up again
    f = run(h, slack={"size": 3.0, "softness": 0.02})
    again = f[h.motion.start[2] :]
    assert again[0] == pytest.approx(60.0, abs=0.5)
    assert np.all(np.diff(again) > -1e-9)


def test_second_surface_doubles_the_stiffness_after_its_delay():
    h = ramps([0.0, 30.0, -30.0])
    f = run(h, two_stage={"size": 0.4, "delay": 2.0})
    back = f[h.motion.start[1] :]
    slip = h.slip_mm[h.motion.start[1] :]
    early, late = (np.polyfit(slip[w], back[w], 1)[0] for w in ((slip < 1.9), (slip > 2.1) & (slip < 3.9)))
    assert early == pytest.approx(-0.6 * K, rel=0.01)
    assert late == pytest.approx(-K, rel=0.01)
    assert f.min() == pytest.approx(-FY, rel=1e-3)


def test_compliance_works_in_series_with_the_stiffness():
    h = ramps([0.0, 30.0, -30.0])
    f = run(h, frame_compliance={"size": 0.02})
    slip, back = h.slip_mm[h.motion.start[1] :], f[h.motion.start[1] :]
    slope = np.polyfit(slip[slip < 4], back[slip < 4], 1)[0]
    assert slope == pytest.approx(-1 / (1 / K + 0.02), rel=1e-3)


def test_a_positive_lag_records_the_force_later():
    h = ramps([0.0, 30.0, -30.0])
    plain, late, early = run(h), run(h, sensor_lag={"size": 0.5}), run(h, sensor_lag={"size": -0.5})
    np.testing.assert_allclose(late[50:], plain[:-50], atol=1e-6)
    np.testing.assert_allclose(early[:-50], plain[50:], atol=1e-6)


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
    for power in (0.05, 0.3, 0.9):
        factor = catalogue()["velocity_law"].act(h, {"size": 0.1, "power": power}, BASE).clamping
        assert np.max(factor) == pytest.approx(1.1, abs=1e-3)


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
    assert np.all(factor[back][slid <= 0] == 1.0)
    drops = slid[1:][np.diff(np.sign(np.diff(factor[back], prepend=1.0))) < 0]
    np.testing.assert_allclose(np.diff(drops), 4.0, atol=0.03)
    assert np.max(factor) == pytest.approx(1.1, abs=0.002)


def test_friction_memory_runs_from_start_to_end_of_a_stroke():
    time, motion = exact_motion((Block(48.0, 0.034, 2),), 10.0)
    h = histories([time], [motion])[0]
    factor = np.asarray(catalogue()["friction_memory"].act(h, {"size": 0.1}, BASE).clamping)
    stroke = slice(h.motion.start[1], h.motion.start[2])
    assert factor[stroke][1] == pytest.approx(1.1, abs=0.003)
    assert factor[stroke][-2] == pytest.approx(0.9, abs=0.003)
    assert np.all(np.diff(factor[stroke][2:-2]) < 0)
