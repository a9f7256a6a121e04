"""Curves over coordinates: their words, where they are zero, how large they are before the test, what they add."""

import numpy as np
import pytest

from shj_bayes.errors import ModelError
from shj_bayes.model.coordinates import coordinates
from shj_bayes.model.curve import ACTIONS, SIZES, Curve, components, curve_named
from shj_bayes.model.device import DeviceModel, effect_named, effects_named, meaning_of
from shj_bayes.model.effects.effect import Base
from shj_bayes.model.history import History, histories
from shj_bayes.model.priors import read_priors
from shj_bayes.recording.motion import Block, exact_motion

BASE = Base(18.0, 64.0, 100.0, 0.01, 80.0)
CURVES = [
    Curve("capacity", "travel", 0.5, False, 0.1),
    Curve("capacity", "position", 0.05, False, 0.01),
    Curve("added", "position", 0.15, True, 0.4),
    Curve("capacity", "amplitude", 0.5),
    Curve("capacity", "heat3", 0.5, True, 0.02),
    Curve("added", "time", 0.15, False, 0.2),
    Curve("capacity", "slip", 0.15),
    Curve("capacity", "speed", 0.5, False, 1.0 / 4.0),
]
every_curve = pytest.mark.parametrize("curve", CURVES, ids=[c.id for c in CURVES])


@pytest.fixture(scope="module")
def history() -> History:
    """The second of two runs."""
    time, motion = exact_motion((Block(12.0, 0.13, 2), Block(48.0, 0.034, 2)), 8.0)
    return histories([time, time], [motion, motion])[1]


def some(curve: Curve, seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(curve.n)


def values(coefficients: np.ndarray) -> dict[str, float]:
    return {f"c{i}": float(c) for i, c in enumerate(coefficients, start=1)}


@every_curve
def test_a_curve_is_known_by_its_word(curve: Curve) -> None:
    assert curve_named(curve.id) == curve
    assert effect_named(curve.id).names == tuple(f"c{i}" for i in range(1, curve.n + 1))


@pytest.mark.parametrize("action", ACTIONS)
@pytest.mark.parametrize("size", SIZES)
def test_every_curve_of_a_search_is_known_by_its_word(action: str, size: float) -> None:
    for one in coordinates().values():
        for length in one.lengths:
            curve = Curve(action, one.id, length, False, size)
            assert curve_named(curve.id) == curve


@pytest.mark.parametrize(
    "word",
    ["wear", "added_over_time_every_0_15_05", "added_over_time_every_15_05",
     "capacity_over_travel", "capacity_over_travel_5_10", "capacity_over_trevel_50_10", "pull_over_time_50_10",
     "capacity_over_travel_50_10x", "capacity_over_travel_by_side_50_10"],
)  # fmt: skip
def test_other_words_are_no_curves(word: str) -> None:
    assert curve_named(word) is None
    if word != "wear":
        with pytest.raises(ModelError, match=f"'{word}' is not an effect; known are"):
            effects_named([word])


@every_curve
def test_a_curve_is_zero_where_the_base_law_holds(curve: Curve) -> None:
    zero = np.array([curve.over.zero_share])
    for direction in (np.ones(1), -np.ones(1)):
        assert np.abs(curve.rows(zero, direction)).max() < 0.01 * curve.size
    far = np.array([0.0 if curve.over.zero_share > 0.5 else 1.0])
    assert np.linalg.norm(curve.rows(far, np.ones(1))) > 0.5 * curve.size


@every_curve
def test_the_size_is_the_spread_before_the_test(curve: Curve) -> None:
    """A process that is pinned at one place: the variance of the difference to that place."""
    at = np.linspace(0.0, 1.0, 201)
    variance = np.sum(curve.rows(at, np.ones(at.size)) ** 2, axis=1)
    distance = (at - curve.over.zero_share) / curve.length
    np.testing.assert_allclose(
        variance, 2 * curve.size**2 * (1 - np.exp(-0.5 * distance**2)), atol=0.02 * curve.size**2
    )


@pytest.mark.parametrize(("length", "zero"), [(0.05, 0.5), (0.15, 0.0), (0.5, 1.0)])
def test_components_make_the_covariance_of_the_pinned_process(length: float, zero: float) -> None:
    at = np.linspace(0.0, 1.0, 57)
    basis = components(length, zero)(at)

    def kernel(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return np.exp(-0.5 * ((a[:, None] - b[None]) / length) ** 2)

    pin = np.array([zero])
    exact = kernel(at, at) - kernel(at, pin) - kernel(pin, at) + 1.0
    np.testing.assert_allclose(basis @ basis.T, exact, atol=0.03)
    assert components(length, zero) is not components(length, zero + 0.01)


@every_curve
def test_what_it_does_is_its_rows_times_the_coefficients(curve: Curve, history: History) -> None:
    c = some(curve)
    f = curve.rows(curve.over.share(history, BASE), history.direction) @ c
    done = curve.act(history, values(c), BASE)
    if curve.action == "capacity":
        np.testing.assert_allclose(done.clamping, 1.0 + f, rtol=0, atol=1e-12)
        assert np.all(np.asarray(done.added_kN) == 0.0)
    else:
        np.testing.assert_allclose(done.added_kN, BASE.Fy_first * f, rtol=0, atol=1e-10)
        assert np.all(np.asarray(done.clamping) == 1.0)
    assert np.abs(f).max() > 0.1 * curve.size


AGAIN = [Curve("added", "time", 0.15, False, 0.05, 15.564), Curve("capacity", "position", 0.15, False, 0.1, 36.191)]


@pytest.mark.parametrize("curve", AGAIN, ids=[c.id for c in AGAIN])
def test_a_curve_may_come_again(curve: Curve, history: History) -> None:
    """Alike a period later, as large as its size says, and made of its rows."""
    assert curve_named(curve.id) == curve
    place = np.linspace(0.0, 1.0, 40)
    rows = curve.rows(place, np.ones(40))
    np.testing.assert_allclose(rows, curve.rows(place + 7.0, np.ones(40)), atol=1e-12)
    np.testing.assert_allclose(np.sum(rows**2, axis=1), curve.size**2, rtol=1e-12)
    c = some(curve)
    done = curve.act(history, values(c), BASE)
    own = curve.over.values(history, BASE) / curve.period
    f = curve.rows(own, history.direction) @ c
    made = done.added_kN / BASE.Fy_first if curve.action == "added" else np.asarray(done.clamping) - 1.0
    np.testing.assert_allclose(made, f, atol=1e-12)


def test_a_history_forgets_what_it_recalled_when_it_is_too_much(history: History) -> None:
    calls = []
    for key in (*range(40), 39):
        history.recall(key, lambda key=key: calls.append(key) or np.full(2, key))  # type: ignore[misc]
    assert calls == list(range(40))
    assert history.recall(39, lambda: np.zeros(2))[0] == 39
    history.recall(0, lambda: calls.append(0) or np.zeros(2))  # type: ignore[arg-type, return-value]
    assert calls[-1] == 0


def test_what_the_speed_does_may_change_with_the_distance_slid(history: History) -> None:
    """A curve over the distance slid, as large as it is drawn at peak speed, and nothing at rest."""
    changing, plain = (Curve("capacity", name, 0.5, size=0.1) for name in ("speed_by_travel", "travel"))
    c = some(changing)
    drawn = np.asarray(plain.act(history, values(c), BASE).clamping) - 1.0
    done = np.asarray(changing.act(history, values(c), BASE).clamping) - 1.0
    np.testing.assert_allclose(done, drawn * history.speed_mm_s / history.peak_speed_mm_s, rtol=0, atol=1e-12)
    assert np.abs(done).max() > 0.01


def test_push_and_pull_have_curves_of_their_own(history: History) -> None:
    curve = Curve("added", "position", 0.15, True, 0.1)
    assert curve.n == 2 * Curve("added", "position", 0.15, False, 0.1).n
    c = some(curve)
    c[curve.n // 2 :] = 0.0
    added = np.asarray(curve.act(history, values(c), BASE).added_kN)
    push = history.direction > 0
    assert np.abs(added[push]).max() > 1.0
    assert np.all(added[~push] == 0.0)


def test_a_device_may_hold_a_curve(history: History) -> None:
    """By its word, beside effects of the catalogue, which come first; with zero coefficients it is the law without."""
    bare = DeviceModel(2, read_priors("afc"), effects=effects_named(["wear"]))
    model = bare.with_effects(effects_named(["capacity_over_travel_50_10", "wear"]))
    assert [effect.id for effect in model.effects] == ["wear", "capacity_over_travel_50_10"]
    own = [name for name in model.names if name.startswith("capacity_over_travel_50_10.")]
    assert own[:2] == ["capacity_over_travel_50_10.c1", "capacity_over_travel_50_10.c2"]
    assert meaning_of(own[0]).unit == "1"
    z = np.zeros((1, len(model.names)))
    less = np.zeros((1, len(bare.names)))
    plain = bare.force(bare.laws.natural(less), history, 0.0)
    np.testing.assert_allclose(model.force(model.laws.natural(z), history, 0.0), plain, atol=1e-9)
    z[0, model.names.index(own[0])] = 1.0
    assert np.abs(model.force(model.laws.natural(z), history, 0.0) - plain).max() > 1.0
