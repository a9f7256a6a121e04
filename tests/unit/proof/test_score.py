"""Counting and judging, on made-up answers whose judgement is known."""

import math
from dataclasses import replace

import numpy as np
import pytest

from shj_bayes.model.history import histories
from shj_bayes.model.law import force
from shj_bayes.model.priors import read_priors
from shj_bayes.proof.cases import draw_keys, stated_key
from shj_bayes.proof.predict import predict
from shj_bayes.proof.score import SHORT_LIST, half_size, outcome, rate
from shj_bayes.proof.summary import summarise
from shj_bayes.proof.truth import effect_truths, truth_of
from shj_bayes.recording.protocol import Block, exact_motion


def answer(verdict, *found, rivals=()):
    return {
        "verdict": verdict,
        "effects": [{"id": name, "rivals": list(rivals)} for name in found],
        "family": [{"id": name} for name in rivals],
    }


ONE = stated_key("prying", 0.1, seed=3)
OUTSIDE = stated_key("pump", 0.1, seed=3)
TWO = next(key for key in draw_keys(61, 60) if key.kind == "two")
NOTHING = next(key for key in draw_keys(61, 60) if key.kind == "nothing")
FIRST, SECOND = (one.id for one in TWO.effects)
MANY = ("wear", "thermal", "drift", "taper", "slack")


@pytest.mark.parametrize(
    ("key", "given", "word"),
    [
        (NOTHING, answer("adequate"), "quiet"),
        (NOTHING, answer("named", "wear"), "false alarm"),
        (NOTHING, answer("unknown"), "false alarm"),
        (ONE, answer("named", "prying"), "right"),
        (ONE, answer("family", "prying", rivals=["centre_wear"]), "right family"),
        (ONE, answer("family", "centre_wear", rivals=["prying"]), "right family"),
        (ONE, answer("family", "prying", rivals=MANY), "vague"),
        (ONE, answer("named", "centre_wear"), "sibling"),
        (ONE, answer("named", "wear"), "wrong"),
        (ONE, answer("named", "prying", "wear"), "wrong"),
        (ONE, answer("family", "wear", rivals=["thermal"]), "wrong"),
        (ONE, answer("unknown", "prying"), "unknown"),
        (ONE, answer("adequate"), "missed"),
        (OUTSIDE, answer("unknown"), "unknown"),
        (OUTSIDE, answer("named", "drift"), "wrong"),
        (TWO, answer("named", FIRST, SECOND), "right"),
        (stated_key("stick_slip", 0.1, seed=3), answer("named", "stribeck"), "right"),
        (stated_key("stribeck", 0.1, seed=3), answer("named", "stick_slip"), "wrong"),
        (TWO, answer("named", FIRST), "part"),
    ],
)
def test_outcomes(key, given, word):
    assert outcome(key, given) == word
    assert len(MANY) + 1 > SHORT_LIST


def test_of_two_effects_only_those_that_can_be_told_from_the_noise_must_be_named():
    assert outcome(TWO, answer("named", FIRST), {FIRST}) == "right"
    assert outcome(TWO, answer("named", FIRST, SECOND), {FIRST}) == "right"
    assert outcome(TWO, answer("named", SECOND), {FIRST}) == "part"
    assert outcome(TWO, answer("named", FIRST), {FIRST, SECOND}) == "part"
    assert outcome(TWO, answer("named", FIRST, "stick_slip"), {FIRST}) == "wrong"
    assert outcome(TWO, answer("family", "stick_slip", rivals=[FIRST]), {FIRST}) == "right family"


def test_a_second_effect_too_small_to_see_is_not_asked_for():
    large, small = ONE.effects[0], stated_key("asymmetry", 0.001, seed=3).effects[0]
    key = replace(ONE, effects=(large, small), kind="two")
    assert truth_of(key, read_priors("afc")).required == {"prying"}
    both = replace(key, effects=(large, replace(small, size=0.1)))
    assert truth_of(both, read_priors("afc")).required == {"prying", "asymmetry"}


@pytest.mark.parametrize(
    ("hits", "n", "low", "high"), [(0, 100, 0.0, 0.0362), (5, 100, 0.0164, 0.1128), (10, 10, 0.6915, 1.0)]
)
def test_intervals_are_those_of_clopper_and_pearson(hits, n, low, high):
    """Tabulated exact binomial limits, 95 %, two-sided."""
    entry = rate(hits, n)
    assert entry["low"] == pytest.approx(low, abs=2e-4)
    assert entry["high"] == pytest.approx(high, abs=2e-4)


def test_the_half_way_size_is_found_again():
    rng = np.random.default_rng(1)
    sizes = np.exp(rng.uniform(np.log(0.002), np.log(0.1), 400))
    seen = rng.uniform(size=400) < 1 / (1 + np.exp(-3 * np.log(sizes / 0.015)))
    half, slope = half_size(sizes, seen)
    assert half == pytest.approx(0.015, rel=0.12)
    assert slope == pytest.approx(3.0, rel=0.3)
    assert half_size([0.1] * 5, [True] * 5) is None


def test_the_truth_of_a_device_without_effect_is_the_device():
    key = stated_key("load_offset", 0.05, seed=9, gamma=0.01)
    truth = truth_of(key, read_priors("afc"))
    for name in ("K", "Fy", "ratio"):
        assert truth.base[name] == pytest.approx(getattr(key.device, name), rel=0.02)
    assert truth.base["gamma"] == pytest.approx(0.01, abs=0.0005)
    assert truth.bare_share < 0.01
    assert truth.visible_share == pytest.approx(0.05, abs=0.02)
    assert truth.detectable
    assert effect_truths(key)["load_offset"]["size"] == pytest.approx(0.05 + key.nuisance.offset_kN / key.device.Fy)


def test_a_tiny_effect_is_not_counted_as_detectable():
    assert not truth_of(stated_key("load_offset", 1e-4, seed=9), read_priors("afc")).detectable


def test_prediction_carries_the_device_on_from_its_last_run():
    time, motion = exact_motion((Block(20.0, 0.05, 2),), 20.0)
    _, new = exact_motion((Block(12.0, 0.1, 2),), 20.0)
    new_time = np.arange(new.displacement_mm.size) / 20.0
    shift = {"K": 18.0, "Fy": 80.0, "beta": 10.0, "gamma": 0.01, "ratio": 0.8}
    record = {
        "shift": {name: {"before": {"mean": v}, "after": {"mean": v}} for name, v in shift.items()},
        "effects": [{"id": "wear", "parameters": {"size": {"mean": 0.1}}}],
        "model": {"variant": "seed"},
    }
    tested = [(time, motion), (time, motion)]
    plain = force(new, K=18.0, Fy=64.0, beta=10.0, gamma=0.01)
    assert predict(record, tested, (new_time, new), "before") == pytest.approx(plain, abs=1e-9)
    after = predict(record, tested, (new_time, new), "after")
    travelled = sum(float(h.travel_m[-1] - h.travel_m[0]) for h in histories([time, time], [motion, motion]))
    index = int(np.argmax(plain))
    assert after[index] / plain[index] == pytest.approx(math.exp(-0.1 * travelled), rel=0.01)


def test_targets_are_met_and_missed_as_counted():
    held = dict.fromkeys(("cycles_before", "cycles_after", "earthquake_before", "earthquake_after"), 1.1)
    covered = {"K": {"before": False, "after": True}}
    base = {
        "sizes": [0.1],
        "protocol": "paper",
        "noise": "ar1",
        "visible_share": 0.05,
        "located": None,
        "heldout": held,
    }
    quiet = base | {"number": 1, "kind": "nothing", "truth": [], "detectable": False, "verdict": "adequate"}
    named = base | {
        "number": 2,
        "kind": "one",
        "truth": ["wear"],
        "detectable": True,
        "verdict": "named",
        "found": ["wear"],
    }
    rows = [quiet | {"outcome": "quiet", "coverage": covered} for _ in range(60)]
    rows += [named | {"outcome": "right", "coverage": covered} for _ in range(19)]
    rows += [named | {"outcome": "wrong", "coverage": covered, "found": ["drift"]}]
    good = {t["words"]: t["verdict"] for t in summarise(rows)["targets"]}
    assert good["false alarms, of devices with nothing concealed"] == "met"
    assert good["name or family right, of the detectable"] == "met"
    assert good["coverage of 90 % intervals after, rightly named"] == "NOT MET"  # 100 % is too wide an interval
    rows += [quiet | {"outcome": "false alarm", "coverage": covered, "verdict": "named"} for _ in range(6)]
    rows += [named | {"outcome": "wrong", "coverage": covered, "found": ["drift"]} for _ in range(3)]
    bad = {t["words"]: t["verdict"] for t in summarise(rows)["targets"]}
    assert bad["false alarms, of devices with nothing concealed"] == "NOT MET"
    assert bad["upper 95 % limit of that rate"] == "NOT MET"
    assert bad["name or family right, of the detectable"] == "NOT MET"
