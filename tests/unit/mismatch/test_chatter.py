"""Teeth on the plateaus are chatter; noise, however rough, and what a model misses are not."""

from types import SimpleNamespace

import numpy as np
import pytest

from shj_bayes.inference.binning import runs_of
from shj_bayes.mismatch.data import ErrorParameters, data_of
from shj_bayes.mismatch.diagnosis import diagnose
from shj_bayes.mismatch.fitter import Fitter
from shj_bayes.mismatch.hypothesis import Dependence
from shj_bayes.mismatch.laplace import laplace_under
from shj_bayes.mismatch.moves import Search
from shj_bayes.mismatch.periodic import SURE, Chatter, _at_scale, chatter_of
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.options import DiagnoseOptions
from shj_bayes.recording.recording import Recording
from shj_bayes.report.diagnosis_words import sentences
from shj_bayes.results.codec import from_json
from shj_bayes.results.diagnosis import DiagnosisRecord

TOOTH_KN = 6.0


def toothed(recordings, *, everywhere=False, height_kN=TOOTH_KN):
    """Teeth that come and go on the plateaus, or on the elastic branches too."""
    out = []
    for r in recordings:
        plateau = np.abs(r.force_kN) > 0.85 * np.percentile(np.abs(r.force_kN), 95)
        burst = np.sin(2 * np.pi * r.time_s / 31.0) > 0.0
        teeth = height_kN * np.sin(2 * np.pi * 2.1 * r.time_s) * burst
        out.append(Recording(r.time_s, r.displacement_mm, r.force_kN + np.where(plateau | everywhere, teeth, 0.0)))
    return out


def beside_the_law(recordings):
    """Chatter beside the base law."""
    runs = runs_of(recordings)
    data = data_of(runs, DeviceModel(len(runs), read_priors("afc")))
    _, state = laplace_under(data, ErrorParameters((0.0, 0.0, 0.0), 0.1), data.device, data.z)
    return data, chatter_of(data, state, data.noise_most_kN)


def test_teeth_on_the_plateaus_are_chatter_of_their_size(trials):
    data, found = beside_the_law(toothed(trials.simulate({}, 3, noise="white")))
    assert found is not None
    assert found.size * data.scale_kN == pytest.approx(TOOTH_KN, rel=0.35)
    assert 0.2 < found.share < 0.6
    assert found.of_strokes.max() >= found.size


@pytest.mark.parametrize("noise", ["white", "ar1 0.8", "student", "heteroscedastic", "quantised"])
def test_noise_is_no_chatter(noise, trials):
    assert beside_the_law(trials.simulate({}, 4, noise=noise))[1] is None


def test_what_scatters_on_the_elastic_branches_too_is_no_chatter(trials):
    assert beside_the_law(toothed(trials.simulate({}, 3, noise="white"), everywhere=True))[1] is None


def test_what_the_law_misses_is_no_chatter(trials):
    missed = {"slack": {"size": 2.0}, "breakaway": {"size": 0.3, "decay": 2.0, "growth": 0.0}}
    assert beside_the_law(trials.simulate(missed, 3, noise="white"))[1] is None


@pytest.mark.parametrize("n_strokes", [1, 2])
def test_what_happens_in_one_stroke_is_no_chatter(n_strokes):
    rng = np.random.default_rng(3)
    load = np.repeat([0.2, 1.0], [40, 60])
    strokes = [(0.05 * rng.standard_normal(100), load, (-1.0) ** i) for i in range(3)]
    for residual, _, _ in strokes[:n_strokes]:
        residual[60:] += 4.0 * (-1.0) ** np.arange(40)
    found = _at_scale(strokes, 50.0, 1.0)
    assert (found is None) == (n_strokes == 1)
    if found is not None:
        assert (found.of_strokes.size, found.apart) == (n_strokes, found.of_strokes.max())
        assert found.lowers == (1.0 if found.of_strokes[0] > found.of_strokes[1] else -1.0)


def test_noise_that_grows_with_the_force_is_no_chatter():
    """Few readings at a time scatter much more than all of them: so they do in all strokes alike."""
    rng = np.random.default_rng(7)
    load = np.repeat([0.2, 1.0], [400, 600])
    strokes = [(0.42 * load * rng.standard_normal(1000), load, (-1.0) ** i) for i in range(8)]
    assert _at_scale(strokes, 50.0, 1.0) is None
    for residual, _, _ in strokes[::2]:
        residual[600:700] += 4.0 * (-1.0) ** np.arange(100)
    found = _at_scale(strokes, 50.0, 1.0)
    assert found is not None
    assert found.share > 0.08


@pytest.fixture(scope="module")
def chattering(trials):
    return toothed(trials.simulate({}, 3))


def test_chatter_is_named_and_hides_no_larger_effect_and_no_law(chattering, look):
    record = look(chattering).content
    assert record["verdict"] == "named", record["reason"]
    (effect,) = record["effects"]
    assert (effect["id"], effect["form"], effect["probability"]) == ("stick_slip", "chatter", SURE)
    row = record["coordinates"][0]
    assert (row["action"], row["coordinate"], row["matches"]) == ("motion", "stick-slip", ["stick_slip"])
    assert record["modelled"] == {}
    (said,) = sentences(from_json(DiagnosisRecord, record))
    assert "it sticks and jumps" in said
    assert next(c for c in record["candidates"] if c["id"] == "stick_slip")["kept"]


def test_chatter_that_is_not_asked_for_is_not_looked_for(chattering):
    runs = runs_of(chattering)
    record = diagnose(
        runs, DeviceModel(2, read_priors("afc")), DiagnoseOptions(quick=True, without=("stick_slip",))
    ).content
    assert "stick_slip" not in {effect["id"] for effect in record["effects"]}


@pytest.mark.parametrize(("action", "coordinate", "size"), [
    ("capacity", "speed", 0.1),
    ("capacity", "speed_by_travel", 0.1),
    ("motion", "second surface", 0.1),
    ("capacity", "travel", 0.06),
    ("capacity", "direction", 0.06),
    ("capacity", "position", 0.01),
    ("added", "time", 0.01),
])  # fmt: skip
def test_beside_chatter_what_its_mean_may_be_must_be_larger_than_it(action, coordinate, size):
    """Within a stroke than the teeth, from stroke to stroke than these differ; an added force is no friction."""
    assert _matters(action, coordinate, -0.1) == size


def test_more_force_where_it_chatters_most_is_not_of_its_making():
    """Teeth lower the mean of the push here."""
    assert (_matters("capacity", "direction", -0.1), _matters("capacity", "direction", 0.1)) == (0.06, 0.01)


def _matters(action, coordinate, value):
    """Size that a class must have beside teeth in push, with a value of its parameter."""
    data = SimpleNamespace(scale_kN=1.0, device=SimpleNamespace(effects=()))
    quiet = SimpleNamespace(fluctuation=0.0, is_rough=False, data=data)
    model = SimpleNamespace(effects=(SimpleNamespace(id="own"),), law_names=("Fy", "own.size"))
    member = SimpleNamespace(of=Dependence(action, coordinate, "1", ()))
    h = SimpleNamespace(members=(member,), state=SimpleNamespace(model=model, z=np.array([0.0, value])))
    return Search(Fitter([], quiet), chatter=Chatter(0.1, 0.5, np.ones(2), 0.06, 1.0)).matters_of(h, 0)
