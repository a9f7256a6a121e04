"""The search for the classes that a device holds."""

import pytest

from shj_bayes.inference.run import runs_of
from shj_bayes.mismatch.classes import classes
from shj_bayes.mismatch.scene import scene_of
from shj_bayes.mismatch.search import search
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors


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
