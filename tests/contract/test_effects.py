"""Every effect of the catalogue passes the same checks.

A new effect needs its line in FAMILY, and one in PARITY where it has a sign under the mirrorings.
"""

from __future__ import annotations

import itertools
import pickle
import subprocess
import sys
from functools import cache

import numpy as np
import pytest

from shj_bayes.model.coordinates import coordinates
from shj_bayes.model.curve import ACTIONS
from shj_bayes.model.device import force_with_effects
from shj_bayes.model.effects.effect import FAMILIES, Base, Effect, catalogue
from shj_bayes.model.history import ARRAYS, History, histories
from shj_bayes.model.law import force
from shj_bayes.recording.motion import Block, exact_motion

# Ids and families keep their meaning: users script against them.
FAMILY = {
    "velocity": "even_in_position",
    "prying": "even_in_position",
    "centre_wear": "even_in_position",
    "velocity_law": "low_speed",
    "stribeck": "low_speed",
    "breakaway": "start_of_stroke",
    "two_stage": "start_of_stroke",
    "slack": "start_of_stroke",
    "frame_compliance": "start_of_stroke",
    "sensor_lag": "start_of_stroke",
    "reversal_form": "start_of_stroke",
    "end_bearing": "end_of_stroke",
    "wear": "slow_change",
    "local_wear": "slow_change",
    "bedding_in": "slow_change",
    "thermal": "slow_change",
    "tension_step": "slow_change",
    "amplitude": "slow_change",
    "drift": "slow_change",
    "asymmetry": "even_in_direction",
    "load_offset": "even_in_direction",
    "taper": "odd_in_position",
    "restoring": "odd_in_position",
    "friction_memory": "odd_in_position",
    "inertia": "odd_in_position",
    "stick_slip": "oscillation",
}
# Signs under C: (x, q) -> (-x, -q) and M: x -> -x.
PARITY = {
    **dict.fromkeys(("velocity", "prying", "centre_wear", "velocity_law", "stribeck"), (-1, 1)),
    **dict.fromkeys(("asymmetry", "load_offset", "drift"), (1, 1)),
    **dict.fromkeys(("restoring", "friction_memory", "inertia"), (-1, -1)),
    "taper": (1, -1),
}
BLOCKS = (Block(12.0, 0.13, 2), Block(48.0, 0.034, 2))
BASES = (Base(18.0, 80.0, 100.0, 0.01, 80.0), Base(18.0, 64.0, 100.0, 0.01, 80.0))
EFFECTS = catalogue()
every_effect = pytest.mark.parametrize("effect", EFFECTS.values(), ids=list(EFFECTS))


@cache
def runs() -> tuple[History, ...]:
    time, motion = exact_motion(BLOCKS, 10.0)
    return histories([time, time], [motion, motion])


def typical(effect: Effect) -> dict[str, float]:
    values = {prior.name: float(prior.distribution.median()) for prior in effect.parameters}
    return values | {name: starts[len(starts) // 2] for name, starts in effect.start.items()}


def forces(effects: list[Effect], values: dict[str, dict[str, float]], variant: str = "published") -> np.ndarray:
    pairs = zip(runs(), BASES, strict=True)
    acting = [(effect, values[effect.id]) for effect in effects]
    return np.concatenate([force_with_effects(h, b, acting, variant=variant) for h, b in pairs])


def change(effect: Effect, values: dict[str, float]) -> np.ndarray:
    return forces([effect], {effect.id: values}) - forces([], {})


def joined(name: str) -> np.ndarray:
    return np.concatenate([getattr(h, name) for h in runs()])


def test_catalogue_holds_the_effects_of_the_interface_in_order():
    assert {effect.mechanism: effect.family for effect in EFFECTS.values()} == FAMILY
    first = [id for id, effect in EFFECTS.items() if not effect.form]
    assert first == sorted(FAMILY, key=lambda id: (FAMILIES.index(FAMILY[id]), id))


def test_forms_stand_behind_their_mechanism():
    """Each under the id of the mechanism and the word for the formula, acting on the same coordinate."""
    order = list(EFFECTS)
    seen = 0
    for effect in EFFECTS.values():
        for place, form in enumerate(effect.forms, start=1):
            assert order[order.index(effect.id) + place] == form.id == f"{effect.id}_{form.form}"
            assert (form.mechanism, form.family, form.acts) == (effect.id, effect.family, effect.acts)
            assert form.equation != effect.equation
            seen += 1
    assert seen == sum(bool(effect.form) for effect in EFFECTS.values()) > 0


@every_effect
def test_acts_on_a_known_coordinate(effect: Effect):
    assert effect.acts
    for action, coordinate in effect.acts:
        assert action in (*ACTIONS, "motion")
        # The heat state has several coordinates, one for each time constant; of a sign or a constant there is no curve.
        assert action == "motion" or coordinate in {*coordinates(), "heat", "direction", "constant"}


def test_the_catalogue_survives_a_fresh_interpreter():
    script = "import pickle, sys; from pathlib import Path; e = pickle.loads(sys.stdin.buffer.read()); print(e.act)"
    run = subprocess.run(
        [sys.executable, "-c", script], input=pickle.dumps(EFFECTS["prying"]), capture_output=True, check=True
    )
    assert b"function _prying" in run.stdout


@every_effect
def test_words_units_and_sources(effect: Effect):
    for text in (effect.title, effect.equation, effect.cause, effect.shows, effect.next_test, effect.source):
        assert text.strip()
    assert effect.names[0] == "size"
    assert "size" in effect.neutral
    for prior in effect.parameters:
        assert prior.unit
        assert prior.source.strip()
    said = effect.statement.format(**typical(effect))
    assert said.endswith(".")
    assert "{" not in said


@every_effect
def test_few_starts_inside_the_prior(effect: Effect):
    assert np.prod([len(values) for values in effect.start.values()]) <= 300
    for prior in effect.parameters:
        for value in effect.start.get(prior.name, ()):
            assert abs(prior.to_free(np.float64(value))) < 3.5
            assert effect.neutral.get(prior.name) != value


@every_effect
@pytest.mark.parametrize("variant", ["published", "continuous"])
def test_neutral_is_the_base_law(effect: Effect, variant: str):
    values = typical(effect) | dict(effect.neutral)
    bare = forces([], {}, variant)
    np.testing.assert_array_equal(forces([effect], {effect.id: values}, variant), bare)
    own = [
        force(h.motion, K=b.K, Fy=b.Fy, beta=b.beta, gamma=b.gamma, variant=variant)
        for h, b in zip(runs(), BASES, strict=True)
    ]
    np.testing.assert_allclose(bare, np.concatenate(own), rtol=0, atol=1e-8)


@every_effect
@pytest.mark.parametrize("variant", ["published", "continuous"])
def test_finite_for_draws_of_the_prior_and_repeatable(effect: Effect, variant: str):
    rng = np.random.default_rng(20)
    for _ in range(15):
        values = {effect.id: {p.name: float(p.distribution.rvs(random_state=rng)) for p in effect.parameters}}
        first = forces([effect], values, variant)
        assert np.isfinite(first).all()
        np.testing.assert_array_equal(first, forces([effect], values, variant))


@every_effect
def test_history_is_left_alone(effect: Effect):
    before = [np.array(getattr(h, name)) for h in runs() for name in ARRAYS]
    for h, b in zip(runs(), BASES, strict=True):
        effect.act(h, typical(effect), b)
    after = [getattr(h, name) for h in runs() for name in ARRAYS]
    for old, new in zip(before, after, strict=True):
        np.testing.assert_array_equal(old, new)


@every_effect
def test_pickles(effect: Effect):
    assert pickle.loads(pickle.dumps(effect)) == effect


@every_effect
def test_more_size_is_more_change(effect: Effect):
    values = typical(effect)
    rms = [np.sqrt(np.mean(change(effect, values | {"size": values["size"] * f}) ** 2)) for f in (0.3, 0.6, 1.0, 1.5)]
    assert rms[0] > 0
    assert np.all(np.diff(rms) > 0), rms


def test_any_two_effects_combine():
    values = {id: typical(effect) for id, effect in EFFECTS.items()}
    for a, b in itertools.combinations(EFFECTS.values(), 2):
        assert np.isfinite(forces([a, b], values)).all(), (a.id, b.id)
    assert np.isfinite(forces(list(EFFECTS.values()), values)).all()


@pytest.mark.parametrize("id", PARITY)
def test_plateau_parity(id: str):
    """Difference to the base in the last full cycle, on the plateau, split into the four classes of sign."""
    h = runs()[0]
    moved = change(EFFECTS[id], typical(EFFECTS[id]))[: h.time_s.size]
    reach = 0.75 * h.half_stroke_mm  # the plateau starts 9 mm after the reversal
    grid = np.linspace(-reach, reach, 61)
    start = h.motion.start
    up, down = (slice(start[k], start[k + 1]) for k in (h.motion.n_half - 3, h.motion.n_half - 2))
    x = h.position_mm
    push, pull = np.interp(grid, x[up], moved[up]), np.interp(grid, x[down][::-1], moved[down][::-1])
    if h.motion.direction[h.motion.n_half - 3] < 0:
        push, pull = np.interp(grid, x[down], moved[down]), np.interp(grid, x[up][::-1], moved[up][::-1])
    share = {}
    for c, m in itertools.product((1, -1), repeat=2):
        part = push + m * push[::-1] + c * (pull[::-1] + m * pull)
        share[c, m] = float(np.sum(part**2))
    # The speed that is remembered begins low, where sliding does, and is lower than that of the moment: that is even.
    least = 0.4 if id == "friction_memory" else 0.9
    assert share[PARITY[id]] > least * sum(share.values()), share


@pytest.mark.parametrize("id", [id for id, family in FAMILY.items() if family == "start_of_stroke"])
def test_start_of_stroke_effects_leave_the_plateau_alone(id: str):
    effect = EFFECTS[id]
    power = change(effect, typical(effect)) ** 2
    assert power[joined("slip_mm") < 25.0].sum() > 0.9 * power.sum()


def test_end_bearing_shows_at_the_ends_only():
    effect = EFFECTS["end_bearing"]
    moved = change(effect, typical(effect))
    assert np.all(moved[np.abs(joined("position_mm")) < 0.5 * 48] == 0)
    assert np.abs(moved).max() > 1


@pytest.mark.parametrize("id", [id for id, family in FAMILY.items() if family == "slow_change"])
def test_slow_changes_differ_between_strokes_more_than_within(id: str):
    effect = EFFECTS[id]
    moved = change(effect, typical(effect)) * (1 if id == "drift" else joined("direction"))
    h = runs()[0]
    half = np.concatenate([run.motion.half_cycle + 100 * run.run for run in runs()])
    plateau = (joined("slip_mm") > 12) | (np.arange(half.size) % h.time_s.size < h.motion.start[1])
    groups = [moved[plateau & (half == k)] for k in np.unique(half[plateau])]
    between = np.var([g.mean() for g in groups])
    assert between > 2 * np.mean([g.var() for g in groups])


def test_stick_slip_swings_about_the_plateau():
    effect = EFFECTS["stick_slip"]
    moved = change(effect, {"size": 0.05, "wave": 5.0})[joined("slip_mm") > 15]
    assert abs(moved.mean()) < 0.1 * np.abs(moved).max()
    assert np.sum(np.diff(np.sign(moved)) != 0) > 40
