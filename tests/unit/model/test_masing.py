"""The law as a material with memory: equal to Eq. (1) after full sliding, Masing's rule elsewhere."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from shj_bayes.model.law import force_of_laws, masing_force
from shj_bayes.recording.motion import motion_of
from shj_bayes.recording.recording import Recording

K, FY = 18.0, 80.0


def _force(displacement_mm, beta=20.0, gamma=0.0):
    x = np.asarray(displacement_mm, dtype=float)
    motion = motion_of(Recording(np.arange(x.size) * 0.1, x, np.zeros(x.size)))
    law = np.array([K, FY, beta, gamma])
    return motion, masing_force(motion, law), force_of_laws(motion, law[None], variant="continuous")[0]


def _way(*turns_mm, step=0.1):
    parts = [np.linspace(a, b, max(int(abs(b - a) / step), 2) + 1) for a, b in itertools.pairwise(turns_mm)]
    return np.concatenate([parts[0], *(part[1:] for part in parts[1:])])


@pytest.mark.parametrize("beta", [5.0, 20.0, 100.0])
def test_branch_after_full_sliding_is_that_of_eq_1(beta):
    motion, other, own = _force(_way(0.0, 40.0, -40.0, 40.0), beta)
    behind = slice(motion.start[1], None)
    assert np.abs(other - own)[behind].max() < 0.02 * FY


def test_cycle_that_turns_early_follows_the_first_loading_at_twice_the_scale():
    turned = 0.7 * FY / K
    _, up, _ = _force(_way(0.0, turned, step=0.02), 5.0)
    motion, both, own = _force(_way(0.0, turned, -turned, step=0.02), 5.0)
    first = np.interp(np.abs(motion.displacement_mm - turned) / 2.0, _way(0.0, turned, step=0.02), up)
    behind = slice(motion.start[1] + 3, None)
    assert both[behind] == pytest.approx((up[-1] - 2.0 * first)[behind], abs=0.01 * FY)
    assert np.abs(both - own)[behind].max() > 0.02 * FY  # Eq. (1) goes another way


def test_small_loop_closes_where_it_was_left():
    motion, force, _ = _force(_way(0.0, 6.0, 3.0, 20.0, step=0.05), 8.0)
    _, without, _ = _force(_way(0.0, 20.0, step=0.05), 8.0)
    later = motion.displacement_mm[motion.start[2] :] > 6.2
    at = motion.displacement_mm[motion.start[2] :][later]
    assert force[motion.start[2] :][later] == pytest.approx(np.interp(at, _way(0.0, 20.0, step=0.05), without), abs=0.8)


def test_speed_multiplies_the_whole_force():
    motion, slow, _ = _force(_way(0.0, 40.0, -40.0))
    _, fast, _ = _force(_way(0.0, 40.0, -40.0), gamma=0.01)
    assert fast == pytest.approx(slow * (1.0 + 0.01 * motion.speed_mm_s))
