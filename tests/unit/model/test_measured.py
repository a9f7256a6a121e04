"""Further channels as coordinates: values at any samples, shares of the range of all runs, words of curves."""

from dataclasses import replace

import numpy as np
import pytest

from shj_bayes.errors import ModelError
from shj_bayes.inference.binning import further_of, histories_of, measured_of, reduce_runs, runs_of
from shj_bayes.mismatch.hypothesis import classes
from shj_bayes.model.coordinates import coordinate_named, coordinates
from shj_bayes.model.curve import Curve, curve_named
from shj_bayes.model.device import DeviceModel, effects_named, meaning_of
from shj_bayes.model.effects.effect import Base
from shj_bayes.model.history import coordinate_of, delayed, on_scales_of
from shj_bayes.model.priors import read_priors
from shj_bayes.recording.motion import exact_motion, table_1
from shj_bayes.recording.recording import Column, Recording
from shj_bayes.recording.smoothing import Refusal

BASE = Base(18.0, 80.0, 100.0, 0.01, 80.0)
TENSION = "measured_tension"
CURVE = Curve("capacity", TENSION, 0.5)


def recording(middle: float = 45.0, **others: np.ndarray) -> Recording:
    """Table 1 with a tension that swings by 3 kN around its middle."""
    time, motion = exact_motion(table_1(), 5.0)
    tension = middle + 3.0 * np.sin(time / 50.0)
    extras = tuple(Column(name, values, "kN") for name, values in {"tension": tension, **others}.items())
    return Recording(time, motion.displacement_mm, 60.0 * np.tanh(motion.displacement_mm), extras=extras)


def test_a_channel_is_followed_at_whatever_samples() -> None:
    runs = runs_of([recording(45.0), recording(50.0)])
    whole = histories_of(runs)
    over = coordinate_named(TENSION)
    for history, middle in zip(whole, (45.0, 50.0), strict=True):
        np.testing.assert_allclose(over.values(history, BASE), middle + 3.0 * np.sin(history.time_s / 50.0), atol=1e-3)
        assert over.reach(history) == pytest.approx((42.0, 53.0), abs=1e-3)
        late = delayed(history, 0.02)
        assert late is not None
        np.testing.assert_allclose(over.values(late[0], BASE)[late[1]], over.values(history, BASE), atol=1e-12)
    for part, middle in zip(reduce_runs(runs), (45.0, 50.0), strict=True):
        assert part.history.time_s.size < whole[0].time_s.size
        values = over.values(part.history, BASE)
        np.testing.assert_allclose(values, middle + 3.0 * np.sin(part.history.time_s / 50.0), atol=1e-3)
    share = np.linspace(0.0, 1.0, 11)
    np.testing.assert_allclose(over.share_of(over.value_of(share, whole[0]), whole[0]), share, atol=1e-12)


def test_a_history_of_other_motion_stands_at_the_reference() -> None:
    tested = histories_of(runs_of([recording(45.0), recording(50.0)]))[0]
    other = on_scales_of(replace(tested, measured={}), tested, tested.position_mm)
    values = coordinate_named(TENSION).values(other, BASE)
    every = np.concatenate([m + 3.0 * np.sin(tested.time_s / 50.0) for m in (45.0, 50.0)])
    np.testing.assert_allclose(values, np.median(every), atol=0.05)
    assert other.measured[TENSION].held(44.0).at(np.array([1.0, 9.0])).tolist() == [44.0, 44.0]


def test_every_run_must_have_a_channel_that_serves() -> None:
    time = recording().time_s
    steady, noisy = np.full(time.size, 20.0), 20.0 + np.random.default_rng(3).standard_normal(time.size)
    holes = np.where(time < 200.0, np.nan, np.sin(time / 50.0))
    first = recording(45.0, steady=steady, noisy=noisy, holes=np.sin(time / 50.0), only=np.sin(time / 50.0))
    second = recording(50.0, steady=steady, noisy=noisy, holes=holes)
    runs = runs_of([first, second])
    assert {one.name: one.refused for one in further_of(runs)} == {
        "tension": None,
        "steady": Refusal.CONSTANT,
        "noisy": Refusal.CONSTANT,
        "holes": Refusal.GAPS,
        "only": Refusal.MISSING,
    }
    assert [set(one) for one in measured_of(runs)] == [{TENSION}, {TENSION}]
    # Steady in each run, but not the same: a coordinate all the same.
    lifted = runs_of([recording(45.0, steady=steady), recording(45.0, steady=steady + 5.0 + 0.1 * np.sin(time / 50.0))])
    assert "measured_steady" in measured_of(lifted)[0]
    assert measured_of(lifted)[0]["measured_steady"].low == pytest.approx(20.0, abs=1e-6)


def test_a_recording_without_further_channels_has_none() -> None:
    time, motion = exact_motion(table_1(), 5.0)
    runs = runs_of([Recording(time, motion.displacement_mm, 60.0 * np.tanh(motion.displacement_mm))])
    assert [dict(one) for one in measured_of(runs)] == [{}]
    history = histories_of(runs)[0]
    with pytest.raises(ModelError, match=r"run 1 has no such channel.*--columns tension="):
        coordinate_named(TENSION).values(history, BASE)


@pytest.mark.parametrize("name", ["tension", "Bolt load (north)", "x_by_direction", "t_50", "temperatur_öl", "every_5"])
@pytest.mark.parametrize("length", [0.15, 0.5])
def test_curves_over_any_name_are_found_again_by_their_word(name: str, length: float) -> None:
    curve = Curve("capacity", coordinate_of(name), length, size=0.2)
    assert curve_named(curve.id) == curve
    assert effects_named([curve.id])[0].id == curve.id
    assert coordinate_of(name) not in coordinates()
    assert meaning_of(f"{curve.id}.c1").unit == "1"
    assert curve.effect().mechanism == coordinate_of(name)
    said = curve.effect().statement.format(change=-0.1, low=41.0, high=49.0, unit=" kN")
    assert "-10.0%" in said
    assert said.endswith("from 41 to 49 kN.")


def test_the_force_is_that_of_the_curve() -> None:
    runs = runs_of([recording()])
    history = histories_of(runs)[0]
    rng = np.random.default_rng(5)
    values = {f"c{i}": float(v) for i, v in enumerate(rng.standard_normal(CURVE.n), start=1)}
    share = (coordinate_named(TENSION).values(history, BASE) - 42.0) / 6.0
    wanted = 1.0 + CURVE.rows(np.clip(share, 0.0, 1.0), np.ones(share.size)) @ np.array(list(values.values()))
    np.testing.assert_allclose(CURVE.act(history, values, BASE).clamping, wanted, atol=1e-4)
    device = DeviceModel(1, read_priors("afc"), effects=(CURVE.effect(),))
    theta = np.array([[*(18.0, 80.0, 100.0, 0.0), *values.values(), *(1.0,) * len(device.noise.parameters)]])
    plain = replace(device, effects=()).force(np.delete(theta, np.s_[4 : 4 + CURVE.n], axis=1), history, 0.0)[0]
    sliding = history.slip_mm > 20.0
    np.testing.assert_allclose(device.force(theta, history, 0.0)[0][sliding], (plain * wanted)[sliding], rtol=0.02)


def test_each_channel_is_a_class_of_its_own() -> None:
    measured = measured_of(runs_of([recording()]))[0]
    new = [one for one in classes(measured=measured) if one.id not in {c.id for c in classes()}]
    assert [(one.id, one.unit) for one in new] == [(f"capacity over {TENSION}", "kN")]
    assert sum(variant.weight for variant in new[0].variants) == pytest.approx(1.0)
    assert not [one for one in classes(frozenset({TENSION}), measured) if one.coordinate == TENSION]
