"""Coordinates on the paper's loading history: shares within their range, and back; words; heat in closed form."""

import numpy as np
import pytest

from shj_bayes.errors import ModelError
from shj_bayes.model.coordinates import STROKES, Coordinate, coordinate_named, coordinates
from shj_bayes.model.effects.effect import FAMILIES, Base
from shj_bayes.model.effects.sliding import slid_since_mm
from shj_bayes.model.history import History, histories
from shj_bayes.recording.motion import exact_motion, table_1

BASE = Base(18.0, 64.0, 100.0, 0.01, 80.0)
every_coordinate = pytest.mark.parametrize("one", coordinates().values(), ids=list(coordinates()))


@pytest.fixture(scope="module")
def runs() -> tuple[History, ...]:
    """Table 1, twice."""
    time, motion = exact_motion(table_1(), 4.0)
    return histories([time, time], [motion, motion])


@every_coordinate
def test_shares_lie_in_the_range_and_reach_through_most_of_it(one: Coordinate, runs: tuple[History, ...]) -> None:
    shares = np.concatenate([one.share(h, BASE) for h in runs])
    assert np.isfinite(shares).all()
    assert shares.min() >= 0.0
    assert shares.max() <= 1.0
    assert np.ptp(shares) > 0.2
    beyond = np.concatenate([one.values(h, BASE) for h in runs])
    low, high = one.reach(runs[0])
    near = 1e-6 * (high - low)
    # Small amplitudes are accelerated more than the range of the large ones holds.
    allowed = 0.15 if one.id == "acceleration" else 0.01
    assert np.mean((beyond < low - near) | (beyond > high + near)) < allowed


@every_coordinate
def test_values_and_shares_are_inverse(one: Coordinate, runs: tuple[History, ...]) -> None:
    share = np.linspace(0.0, 1.0, 41)
    for history in runs:
        value = one.value_of(share, history)
        assert np.all(np.diff(value) > 0)
        assert (value[0], value[-1]) == pytest.approx(one.reach(history))
        np.testing.assert_allclose(one.share_of(value, history), share, atol=1e-12)
        outside = one.share_of(np.array([value[0] - 1.0, value[-1] + 1.0]), history)
        np.testing.assert_array_equal(outside, [0.0, 1.0])


@every_coordinate
def test_words(one: Coordinate) -> None:
    assert coordinate_named(one.id) is one
    assert one.family in FAMILIES
    assert one.unit
    assert one.title.startswith("the ")
    assert one.zero_share in (0.0, 0.5, 1.0)
    assert all(0.0 < length < 1.0 for length in one.lengths)
    assert sum(one.lengths.values()) == pytest.approx(1.0)


def test_travel_and_time_go_on_from_run_to_run(runs: tuple[History, ...]) -> None:
    for name in ("travel", "time"):
        one = coordinates()[name]
        first, second = one.values(runs[0], BASE._replace(Fy=BASE.Fy_first)), one.values(runs[1], BASE)
        assert first[0] == 0.0
        assert second[0] == pytest.approx(first[-1], rel=0.01)
        assert second[-1] == pytest.approx(2.0 * first[-1], rel=0.03)  # of less force, the second slides more
        assert np.all(np.diff(np.concatenate([first, second])) >= -1e-12)


def test_the_travel_of_all_tests_is_known_in_each(runs: tuple[History, ...]) -> None:
    assert runs[0].tested_m == runs[1].tested_m == pytest.approx(runs[1].travel_m[-1])
    assert runs[0].tested_m > 1.9 * runs[0].travel_m[-1]


def test_heat_comes_with_sliding_and_goes_with_time(runs: tuple[History, ...]) -> None:
    """Against the sum of decaying exponentials, written out."""
    history = runs[0]
    one = coordinates()["heat2"]
    got = one.values(history, BASE)
    tau = 0.1 * STROKES * history.half_stroke_mm / history.peak_speed_mm_s
    slid = slid_since_mm(history, BASE)
    t = history.time_s
    dt = np.diff(t)
    gained = np.append(0.0, slid[1:] * tau / dt * -np.expm1(-dt / tau))
    for i in (0, 10, t.size // 2, t.size - 1):
        exact = np.sum(gained[: i + 1] * np.exp(-(t[i] - t[: i + 1]) / tau))
        exact *= BASE.Fy / BASE.Fy_first / (STROKES * history.half_stroke_mm)
        assert got[i] == pytest.approx(exact, rel=1e-9, abs=1e-12)
    assert got.max() > 0.04


def test_an_unknown_coordinate_is_refused_in_words() -> None:
    with pytest.raises(ModelError, match=r"'travle' is not a coordinate; known are position, .*did you mean 'travel'"):
        coordinate_named("travle")
