"""What the formulas of an answer may miss widens the intervals of a first look."""

from dataclasses import replace

import numpy as np
import pytest

from shj_bayes.inference.binning import runs_of
from shj_bayes.mismatch.data import ErrorModel, ErrorParameters, data_of
from shj_bayes.mismatch.findings import _missed_instead, answer_of
from shj_bayes.mismatch.fitter import Fitter, noise_of_size
from shj_bayes.mismatch.hypothesis import beside_missed, candidates, classes, curves_of, joined, missed_by
from shj_bayes.mismatch.laplace import find_noise, laplace_under
from shj_bayes.mismatch.moves import Search
from shj_bayes.mismatch.search import search
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors


def answered(recordings, *coordinates):
    runs = runs_of(recordings)
    data = data_of(runs, DeviceModel(len(runs), read_priors("afc")))
    out = search(data, [one for one in classes() if one.coordinate in coordinates])
    return out, answer_of(out)


def found(answer):
    return [(f.member, f.size) for f in answer.findings]


@pytest.fixture(scope="module")
def prying(trials):
    return answered(trials.simulate({"prying": {"size": 0.17, "power": 2.0}}, 1), "distance")


def test_what_a_formula_may_miss_widens_the_parameters_that_it_could_be(prying):
    out, answer = prying
    state = answer.shown.state
    wide = beside_missed(out.metric, state, found(answer))
    ratio = np.sqrt(np.diag(wide.covariance) / np.diag(state.covariance))
    assert np.all(ratio > 1.0 - 1e-9)
    names = state.model.law_names
    assert ratio[names.index("Fy")] > 1.1
    assert ratio[names.index("ratio")] < 1.1  # prying is alike in both runs
    assert wide.z is state.z


def test_what_acts_on_the_motion_has_no_curve_that_it_could_miss(trials):
    out, answer = answered(trials.simulate({"slack": {"size": 0.8}}, 4), "slack")
    assert [f.member.of.coordinate for f in answer.findings] == ["slack"]
    assert curves_of(out.data, answer.shown.state, answer.shown.members[0].of) is None


@pytest.mark.parametrize("name", ["added over constant", "capacity over direction"])
def test_a_constant_has_no_form_that_could_miss_something(prying, name):
    """A load cell's zero and a factor for each direction are one number each."""
    out, answer = prying
    one = next(c for c in classes() if c.id == name)
    assert missed_by(out.data, answer.shown.state, one, 0.1) is None


def test_a_class_too_small_to_matter_widens_the_parameters_that_it_moves(trials):
    out, answer = answered(trials.simulate({"prying": {"size": 0.007, "power": 2.0}}, 2), "distance")
    assert not answer.findings
    state = out.found[frozenset()].state
    wide = beside_missed(out.metric, state, (), tuple(out.fitter.classes.values()))
    ratio = np.sqrt(np.diag(wide.covariance) / np.diag(state.covariance))
    assert np.all(ratio > 1.0 - 1e-6)
    assert ratio.max() > 1.2


def test_a_class_that_is_not_there_widens_nothing(trials):
    out, _ = answered(trials.simulate({}, 3), "position")
    state = out.found[frozenset()].state
    wide = beside_missed(out.metric, state, (), tuple(out.fitter.classes.values()))
    assert np.sqrt(np.diag(wide.covariance) / np.diag(state.covariance)).max() < 1.1


@pytest.mark.parametrize(
    ("other", "coordinate", "missed"),
    [
        ({"tension_step_swing": {"size": 0.02, "period": 1.5, "phase": 0.0}}, "time", True),
        ({"taper": {"size": 0.02}}, "position", False),
    ],
)
def test_what_a_formula_may_miss_over_its_own_coordinate_is_no_other_class(trials, other, coordinate, missed):
    """A slow swing beside wear is wear that its formula misses, to all that can be seen; a taper is not."""
    runs = runs_of(trials.simulate({"wear": {"size": 0.1}} | other, 5))
    data = data_of(runs, DeviceModel(len(runs), read_priors("afc")))
    travel, over = (next(c for c in classes() if c.id == f"capacity over {name}") for name in ("travel", coordinate))
    metric, rough = laplace_under(data, ErrorParameters(noise_of_size(data.device, 1.0), 0.1), data.device, data.z)
    fitter = Fitter(candidates(data, rough, (travel, over)), metric)
    form = next(form for form in fitter.forms_of(travel, (), data.z) if form.variant.effect.id == "wear")
    rest = fitter.fitted((form,), form.start)
    noise = find_noise(data, rest.state, np.zeros((rest.state.residual.size, 0)))
    fitter = replace(fitter, metric=ErrorModel(data, noise, rough.slope))
    rest = fitter.fitted((form,), rest.state.z)
    curve = next(c for c in fitter.screen(rest) if c.of.id == over.id)
    both = fitter.fitted((form, curve), joined(rest, curve))
    assert both.log_weight > rest.log_weight + 5.0
    assert (_missed_instead(Search(fitter), both, rest, {travel.id: 0.2}) > 0.0) == missed
