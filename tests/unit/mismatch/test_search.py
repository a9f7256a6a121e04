"""The search for the classes that a device holds."""

import numpy as np
import pytest

from shj_bayes.inference.run import runs_of
from shj_bayes.mismatch.classes import classes
from shj_bayes.mismatch.findings import answer_of, curve_band
from shj_bayes.mismatch.scene import scene_of
from shj_bayes.mismatch.search import search
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors


def _searched(trials, effects, coordinates):
    runs = runs_of(trials.simulate(effects, 4))
    scene = scene_of(runs, DeviceModel(len(runs), read_priors("afc")))
    return search(scene, [one for one in classes() if one.coordinate in coordinates])


def test_two_dependences_are_found_that_one_curve_over_another_coordinate_follows(trials):
    """Neither heating nor a swing alone comes near what both do; a curve over time does."""
    swing = {"size": 0.045, "period": 0.18, "phase": 0.2}
    heat = {"size": 0.18, "cooling": 300.0, "spread": 0.6}
    out = _searched(trials, {"tension_step_swing": swing, "thermal": heat}, ("time", "heat", "amplitude"))
    assert {m.variant.effect.id for m in out.best.members} == {"tension_step_swing", "thermal"}
    # Each is drawn beside the other one: a curve over time beside a curve over heat would take most of the heating up.
    drawn = {f.member.of.coordinate: curve_band(out, f)["mean"] for f in answer_of(out).findings}
    assert np.ptp(drawn["time"][10:]) == pytest.approx(2 * 4.5, rel=0.3)
    assert drawn["heat"].min() < -8.0


def test_a_formula_over_position_is_found_beside_one_over_the_distance(trials):
    """To first order worn-out mid-stroke does what prying does; fitted it does not."""
    prying = {"size": 0.043, "gap": 0.08}
    out = _searched(trials, {"taper": {"size": -0.11}, "prying_gap": prying}, ("position", "distance"))
    assert {m.variant.effect.mechanism for m in out.best.members} == {"taper", "prying"}


def test_a_gap_shorter_than_a_block_is_found_as_large_as_it_is(trials):
    """In blocks that follow the base law alone it was found as 0.11 mm, and soft."""
    runs = runs_of(trials.simulate({"slack": {"size": 0.35, "softness": 0.05}}, 4))
    scene = scene_of(runs, DeviceModel(len(runs), read_priors("afc")))
    out = search(scene, [one for one in classes() if one.coordinate == "slack"])
    state = out.best.state
    values = state.model.law_values(state.z)
    assert values["slack.size"] == pytest.approx(0.35, abs=0.03)
    assert values["slack.softness"] < 0.5
    assert out.scene.count.size > scene.count.size
