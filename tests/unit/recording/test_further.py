"""Further channels without their noise: what serves as a coordinate, and what is refused for which reason."""

import numpy as np
import pytest

from shj_bayes.recording.limits import CHANNEL_CELLS, CHANNEL_NOISE
from shj_bayes.recording.recording import Column
from shj_bayes.recording.smoothing import Channel, Refusal, at_samples, channel_of

TIME = 0.2 * np.arange(3000.0)
FORCE = 60.0 * np.sign(np.sin(2 * np.pi * TIME / 40.0))
WANDERING = 45.0 + 2.0 * np.sin(TIME / 60.0) + 1.5 * np.sin(TIME / 23.0)


def noise(size: float, seed: int = 1) -> np.ndarray:
    return size * np.random.default_rng(seed).standard_normal(TIME.size)


def taken(values: np.ndarray) -> Channel:
    return channel_of(Column("tension", values, "kN"), TIME, FORCE)


def test_the_noise_is_taken_off() -> None:
    own = taken(WANDERING + noise(0.3))
    assert (own.name, own.unit, own.refused) == ("tension", "kN", None)
    error = np.interp(TIME, own.time_s, own.values) - WANDERING
    assert np.sqrt(np.mean(error**2)) < 0.06


def test_a_channel_without_noise_stays_as_it_is() -> None:
    own = taken(WANDERING)
    np.testing.assert_allclose(np.interp(TIME, own.time_s, own.values), WANDERING, atol=1e-5)


def test_a_step_stays_a_step() -> None:
    own = taken(np.where(TIME < 300.0, 45.0, 50.0) + noise(0.05))
    at = np.interp([298.0, 302.0], own.time_s, own.values)
    np.testing.assert_allclose(at, [45.0, 50.0], atol=0.3)


@pytest.mark.parametrize("seed", range(20))
def test_noise_alone_is_constant(seed: int) -> None:
    own = taken(45.0 + noise(0.3, seed))
    assert own.refused is Refusal.CONSTANT
    assert own.share > CHANNEL_NOISE


def test_one_value_is_constant() -> None:
    assert taken(np.full(TIME.size, 45.0)).refused is Refusal.CONSTANT


def test_short_gaps_are_bridged_and_long_ones_refused() -> None:
    short, long = WANDERING.copy(), WANDERING.copy()
    short[1000:1100], long[1000:1200] = np.nan, np.nan
    own = taken(short)
    assert own.refused is None
    error = np.interp(TIME, own.time_s, own.values) - WANDERING
    assert np.abs(error).max() < 1.0
    own = taken(long)
    assert (own.refused, own.values.size) == (Refusal.GAPS, 0)
    assert own.share == pytest.approx(201 / 2999)
    late = WANDERING.copy()
    late[:200] = np.nan
    assert taken(late).refused is Refusal.GAPS
    assert taken(np.full(TIME.size, np.nan)).refused is Refusal.GAPS


def test_a_reaction_to_the_force_is_refused() -> None:
    own = taken(20.0 + 0.4 * FORCE + noise(1.0))
    assert own.refused is Refusal.FOLLOWS_FORCE
    assert own.share > 0.9
    assert taken(WANDERING + 0.01 * FORCE).refused is None


def test_many_samples_are_averaged() -> None:
    time = 0.001 * np.arange(200_000.0)
    values = 20.0 + time + np.random.default_rng(2).standard_normal(time.size)
    own = channel_of(Column("temperature", values, "degC"), time, np.sin(time))
    assert own.time_s.size <= CHANNEL_CELLS + 1
    np.testing.assert_allclose(own.values, 20.0 + own.time_s, atol=0.3)


def test_values_between_known_ones_are_on_straight_lines_and_far_from_any_there_are_none() -> None:
    time = np.linspace(0.0, 100.0, 201)
    known = np.concatenate([np.arange(2.0, 40.0, 2.0), np.arange(50.0, 97.0, 2.0)])
    got = at_samples(known, 3.0 * known, time)
    inside = (time >= 2.0) & (time <= 38.0) | (time >= 50.0) & (time <= 96.0)
    np.testing.assert_allclose(got[inside], 3.0 * time[inside])
    assert np.isnan(got[(time > 38.0) & (time < 50.0)]).all()
    np.testing.assert_allclose(got[time < 2.0], 6.0)  # near its first number
    assert np.isnan(at_samples(np.zeros(0), np.zeros(0), time)).all()
