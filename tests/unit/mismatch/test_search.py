"""The search for the classes that a device holds."""

from dataclasses import replace

import numpy as np
import pytest

from shj_bayes.inference.binning import runs_of
from shj_bayes.mismatch.data import ErrorModel, data_of
from shj_bayes.mismatch.findings import answer_of, curve_band, that_matter
from shj_bayes.mismatch.fitter import Fitter
from shj_bayes.mismatch.hypothesis import CONSTANT, DIRECTION, PRIOR_INCLUSION, cancel, classes, replaced
from shj_bayes.mismatch.moves import RIVAL, moving, refit_noise, replace_by_formula
from shj_bayes.mismatch.periodic import follows_cycles, of_whole_cycles
from shj_bayes.mismatch.search import search
from shj_bayes.model.curve import Curve
from shj_bayes.model.device import DeviceModel, force_with_effects
from shj_bayes.model.effects.effect import Base, catalogue
from shj_bayes.model.history import histories
from shj_bayes.model.priors import read_priors
from shj_bayes.recording.motion import motion_of
from shj_bayes.recording.recording import Recording


def _searched(trials, effects, coordinates):
    runs = runs_of(trials.simulate(effects, 4))
    data = data_of(runs, DeviceModel(len(runs), read_priors("afc")))
    return search(data, [one for one in classes() if one.coordinate in coordinates])


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


def test_a_class_has_the_weight_of_all_formulas_that_do_as_well(trials):
    """Wear that is small is the same by three formulas: that there are three makes it no less probable."""
    out = _searched(trials, {"wear": {"size": 0.004}}, ("travel",))
    (worn,) = (i for i, m in enumerate(out.best.members) if m.of.coordinate == "travel")
    forms = out.fitter.forms(out.best, worn)
    ones: dict[str, float] = {}
    for form in forms:
        one = out.fitter.fitted(replaced(out.best, worn, form), form.start)
        if one is not None:
            ones[form.variant.effect.id] = max(ones.get(form.variant.effect.id, -np.inf), one.log_weight)
    assert out.best.members[worn].variant.effect.id == max(ones, key=ones.get)
    whole = float(np.logaddexp.reduce(list(ones.values())))
    assert max(ones.values()) + 0.2 < whole
    assert out.best.log_weight == pytest.approx(whole, abs=0.15)


def test_a_formula_over_position_is_found_beside_one_over_the_distance(trials):
    """To first order worn-out mid-stroke does what prying does; fitted it does not."""
    prying = {"size": 0.043, "gap": 0.08}
    out = _searched(trials, {"taper": {"size": -0.11}, "prying_gap": prying}, ("position", "distance"))
    assert {m.variant.effect.mechanism for m in out.best.members} == {"taper", "prying"}


def _brake(effects, period_s=2.0, noise_kN=0.3, growing_cycles=2.5):
    """Scene of a band brake over seven cycles of 25 mm, of which the first ones grow."""
    rng, time = np.random.default_rng(5), np.arange(0.0, 7 * period_s, 0.005 * period_s)
    growing = np.minimum(time / (growing_cycles * period_s), 1.0) if growing_cycles else 1.0
    motion = motion_of(Recording(time, 25.0 * growing * np.sin(2 * np.pi * time / period_s), np.zeros(time.size)))
    (history,) = histories([time], [motion])
    acting = [(catalogue()[name], values) for name, values in effects.items()]
    force = force_with_effects(history, Base(6.5, 10.0, 20.0, 0.0, 10.0), acting)
    recording = Recording(time, motion.displacement_mm, force + noise_kN * rng.standard_normal(time.size))
    return data_of(runs_of([recording]), DeviceModel(1, read_priors("general"), variant="published"))


BRAKE = {
    "slack": {"size": 3.0, "softness": 0.7, "start": 0.5},
    "asymmetry": {"size": 0.3},
    "breakaway": {"size": 0.6, "decay": 4.0, "growth": 0.2},
    "taper": {"size": 0.2},
    "tension_step": {"size": 0.4, "begin": 0.25, "length": 0.35, "side": 0.9},
}


@pytest.mark.slow
def test_five_effects_in_a_test_of_seven_cycles_are_told_apart():
    """Curves over time that change within a cycle did what three of them do, beside an Fy of 21 kN for 10."""
    out = search(_brake(BRAKE), classes())
    assert {m.variant.effect.id for m in out.best.members} == set(BRAKE)
    values = out.best.state.model.law_values(out.best.state.z)
    assert values["Fy"] == pytest.approx(10.0, rel=0.03)
    assert values["slack.size"] == pytest.approx(3.0, abs=0.1)


def test_curves_over_time_do_not_change_within_a_cycle():
    data = _brake({"asymmetry": {"size": -0.15}})
    for one in classes():
        own = of_whole_cycles(data, one)
        if one.coordinate != "time":
            assert own is one
            continue
        assert sum(v.weight for v in own.variants) == pytest.approx(sum(v.weight for v in one.variants))
        assert {v.curve.length for v in own.variants if v.curve} == {0.15, 0.5}  # a cycle is 1/7 of the test


@pytest.mark.parametrize(
    ("effects", "either"),
    [
        ({"wear_power": {"size": 0.15, "power": 3.0}}, True),  # late: most of it within the last third of the travel
        ({"tension_step": {"size": -0.1, "begin": 0.45, "length": 2.0, "side": 0.0}}, True),
        ({"tension_step_swing": {"size": 0.06, "period": 0.2, "phase": 0.1}}, False),
    ],
)
def test_travel_and_time_are_told_apart_only_by_what_curves_of_equal_freedom_show(trials, effects, either):
    """A test goes on in both; that time has a step among its formulas makes it no more probable."""
    out = _searched(trials, effects, ("travel", "time"))
    inclusion = answer_of(out).inclusion
    least = min(inclusion.get(f"capacity over {name}", 0.0) for name in ("travel", "time"))
    assert (least > 0.05) == either
    assert sum(inclusion.values()) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("period_mm", [2.6, 5.3])
def test_a_ripple_shorter_than_the_blocks_is_position_with_its_period(period_mm):
    """And no stick-slip: it comes again at the same places."""
    ripple = Curve("capacity", "position", 0.15, period=period_mm).effect()
    values = dict.fromkeys(ripple.names, 0.0) | {"c1": 3.0}
    rng, time = np.random.default_rng(6), np.arange(0.0, 140.0, 0.05)
    motion = motion_of(Recording(time, 25.0 * np.sin(2 * np.pi * time / 20.0), np.zeros(time.size)))
    (history,) = histories([time], [motion])
    force = force_with_effects(history, Base(6.5, 10.0, 20.0, 0.0, 10.0), [(ripple, values)])
    recording = Recording(time, motion.displacement_mm, force + 0.05 * rng.standard_normal(time.size))
    data = data_of(runs_of([recording]), DeviceModel(1, read_priors("general"), variant="published"))
    out = search(data, [one for one in classes() if one.coordinate in ("position", "stick-slip", "slip")])
    assert all(member.of.coordinate == "position" for member in out.best.members)
    assert out.best.members[0].variant.curve.period == pytest.approx(period_mm, rel=0.01)
    assert out.chatter is None


@pytest.mark.parametrize(("size", "alone"), [(0.1, True), (0.02, False)])
def test_a_constant_force_is_weighed_against_push_and_pull_that_differ(trials, size, alone):
    """Both shift the loops; a second run of less friction tells them apart where its zero cannot make up for it."""
    answer = answer_of(_searched(trials, {"asymmetry_shift": {"size": size}}, ("direction", "constant")))
    sets = dict(answer.sets)
    assert sets[frozenset({DIRECTION})] > (0.95 if alone else 0.05)
    assert (sets[frozenset({CONSTANT})] > 0.05) != alone
    assert answer.verdict == ("named" if alone else "family")


def test_a_constant_and_a_difference_of_push_and_pull_that_cancel_are_no_hypothesis(trials):
    out = _searched(trials, {"asymmetry_shift": {"size": 0.1}}, ("direction", "constant"))
    both = [out.fitter.candidates_of(name)[0] for name in (DIRECTION, CONSTANT)]
    state = out.fitter.fitted(tuple(both), np.concatenate([out.data.z, [1.0, 0.5]])).state
    for size, other, expected in ((0.3, -0.27, True), (0.3, -0.1, False), (0.3, 0.27, False)):
        z = state.z.copy()
        for effect, value in zip(state.model.effects, (size, other), strict=True):
            z[state.model.law_names.index(f"{effect.id}.size")] = effect.parameters[0].to_free(np.asarray(value))
        assert cancel(replace(state, z=z), tuple(both)) == expected


@pytest.mark.parametrize("middle_mm", [0.0, 40.0])
def test_a_spring_may_be_free_where_the_displacement_is_zero(middle_mm):
    """About mid-stroke it is the same with a constant force beside it; to one side no test tells which it is."""
    rng, time = np.random.default_rng(8), np.arange(0.0, 200.0, 0.1)
    x = middle_mm * np.clip(time / 20.0, 0.0, 1.0) + 40.0 * np.sin(2 * np.pi * time / 25.0) * np.clip(time / 20.0, 0, 1)
    motion = motion_of(Recording(time, x, np.zeros(time.size)))
    (history,) = histories([time], [motion])
    force = force_with_effects(history, Base(6.5, 20.0, 20.0, 0.0, 20.0), [], variant="continuous")
    force += 0.03 * x + (0.0 if middle_mm else 2.0) + 0.05 * rng.standard_normal(time.size)
    data = data_of(runs_of([Recording(time, x, force)]), DeviceModel(1, read_priors("general"), variant="continuous"))
    out = search(data, [one for one in classes() if str(one.id) in ("added over position", CONSTANT)])
    assert out.best.key == {"added over position", CONSTANT}
    constant = dict(answer_of(out).sets)[out.best.key]
    assert constant == pytest.approx(PRIOR_INCLUSION if middle_mm else 1.0, abs=1e-3)
    zeros = (-0.999 * out.best.state.values_of(catalogue()["load_offset"])["size"] * data.scale_kN, 0.01)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("shj_bayes.mismatch.findings.zero_of", lambda *_: zeros)
        assert that_matter(out, out.best) == {"added over position"}


@pytest.fixture
def sine():
    """Push and pull 15 % off their mean."""
    return _brake({"asymmetry": {"size": -0.15}}, period_s=4.0, noise_kN=0.1, growing_cycles=0)


def test_what_is_the_same_in_each_cycle_is_no_dependence_on_time(sine):
    """A wave of the period of the strokes, and a curve that follows them, do what the direction does."""
    out = search(sine, [one for one in classes() if one.coordinate in ("time", "direction")])
    assert out.best.key == {"capacity over direction"}


def test_a_wave_is_told_from_the_strokes_by_its_period(sine):
    swing = catalogue()["tension_step_swing"]
    for period, same in ((4.0, True), (2.0, True), (5.6, False), (9.3, False), (3.1, False)):
        values = {"size": 0.1, "period": period / 28.0, "phase": 0.1}
        assert follows_cycles(sine, swing, values) == same, period


def test_a_gap_shorter_than_a_block_is_found_as_large_as_it_is(trials):
    """In blocks that follow the base law alone it was found as 0.11 mm, and soft."""
    runs = runs_of(trials.simulate({"slack": {"size": 0.35, "softness": 0.05}}, 4))
    data = data_of(runs, DeviceModel(len(runs), read_priors("afc")))
    out = search(data, [one for one in classes() if one.coordinate == "slack"])
    state = out.best.state
    values = state.model.law_values(state.z)
    assert values["slack.size"] == pytest.approx(0.35, abs=0.03)
    assert values["slack.softness"] < 0.5
    assert out.data.blocks.used.size > data.blocks.used.size


def test_a_fit_that_is_singular_to_rounding_is_no_fit(monkeypatch):
    """A hypothesis with absurd parameters ended the diagnosis of a recording."""
    data = _brake({"asymmetry": {"size": -0.15}})
    out = search(data, [one for one in classes() if one.coordinate == "direction"])
    given = out.best.state.gaussian
    steep = replace(given, inner=given.inner - 2.0 * given.inner.max() * np.eye(given.along.size))
    monkeypatch.setattr("shj_bayes.mismatch.fitter.laplace", lambda *_: replace(out.best.state, gaussian=steep))
    assert out.fitter.fitted(out.best.members, out.best.state.z) is None


def test_formulas_are_tried_from_a_place_on(trials, monkeypatch):
    """Beside what a search for two in the place of a curve is given, they stand already."""
    out = _searched(trials, {"sensor_lag": {"size": 0.1}, "taper": {"size": -0.11}}, ("delay", "position"))
    h = out.best
    assert len(h.members) == 2
    tried: list[int] = []
    monkeypatch.setattr(Fitter, "forms", lambda fitter, _, place: tried.append(place) or [])
    replace_by_formula(out, h, 1, again=True)
    replace_by_formula(out, h, again=True)
    assert tried == [1, 0, 1]


def test_what_acts_on_the_motion_is_followed_while_the_noise_is_capped(trials, monkeypatch):
    """A gap beside push and pull that differ was left behind curves that did more, and never came again."""
    out = _searched(trials, {"sensor_lag": {"size": 0.05}, "taper": {"size": -0.3}}, ("delay", "position"))
    moves, tapers = (out.found[frozenset({name})] for name in ("motion over delay", "capacity over position"))
    assert moves.log_weight < tapers.log_weight - RIVAL
    monkeypatch.setattr("shj_bayes.mismatch.moves.noise_beside", lambda *_: out.metric)
    ahead = replace(out, found={key: h for key, h in out.found.items() if len(key) < 2}, curves={})
    assert ahead.best is tapers
    for capped in (True, False):
        monkeypatch.setattr(ErrorModel, "is_capped", capped)
        assert moving(ahead, 1) == ([moves] if capped else [])
        assert (moves.key in refit_noise(ahead).found) == capped
