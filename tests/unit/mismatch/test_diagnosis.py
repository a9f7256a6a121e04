"""The diagnosis on devices whose truth is known: nothing to find, one effect, two, one outside the catalogue."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

from shj_bayes.errors import ModelError
from shj_bayes.inference.run import Run
from shj_bayes.mismatch.alias import alias_table
from shj_bayes.mismatch.diagnosis import diagnose
from shj_bayes.mismatch.evidence import evidence_of
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.effects.catalogue import catalogue
from shj_bayes.model.priors import read_priors
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.kinematics import motion_of

ROOT = Path(__file__).parents[3]
spec = importlib.util.spec_from_file_location("trials", ROOT / "benchmarks" / "mismatch.py")
assert spec is not None
trials = importlib.util.module_from_spec(spec)
spec.loader.exec_module(trials)
CONTRACT = {"schema", "verdict", "p_value", "effects", "family", "location", "unknown", "before", "after", "heldout"}
CONTRACT |= {"shift", "aliases", "next_test", "candidates"}


def quick(recordings, **options):
    runs = [Run(recording, motion_of(recording)) for recording in recordings]
    return diagnose(runs, DeviceModel(len(runs), read_priors("afc")), quick=True, **options)


@pytest.fixture(scope="module")
def prying():
    """The flagship: no speed dependence, clamping 17 % lower at full stroke."""
    recordings = trials.simulate({"prying": {"size": 0.17, "power": 2.0}}, 1)
    return recordings, quick(recordings)


def test_nothing_is_found_where_nothing_is_missing():
    for seed in (2, 3):
        record = quick(trials.simulate({}, seed)).record
        assert record["verdict"] == "adequate", record["reason"]
        assert record["effects"] == []
        assert record["p_value"] > 0.02


def test_prying_is_named_and_gives_the_speed_coefficient_back(prying):
    record = prying[1].record
    assert record["verdict"] == "named"
    assert [effect["id"] for effect in record["effects"]] == ["prying"]
    assert record["effects"][0]["parameters"]["size"]["mean"] == pytest.approx(0.17, abs=0.01)
    # seed 1 draws the device's gamma: the published law misses it, the augmented one does not
    rng = np.random.default_rng(1)
    rng.uniform(8, 22), rng.uniform(50, 95), rng.choice([10.0, 100.0]), rng.uniform(0.6, 0.95)
    gamma = float(rng.choice([-1.0, 0.0, 1.0])) / rng.uniform(30, 150)
    before, after = record["shift"]["gamma"]["before"], record["shift"]["gamma"]["after"]
    assert not before["q05"] < gamma < before["q95"]
    assert after["q05"] < gamma < after["q95"]
    assert abs(after["mean"] - gamma) < 0.001
    assert after["sd"] < before["sd"] / 4
    assert record["after"]["heldout_rmse_kN"] < 1.2 * record["after"]["noise_kN"]
    assert record["heldout"]["elpd_gain"] > 10 * record["heldout"]["se"] / 3


def test_prying_is_located_where_it_is(prying):
    coordinates = {where["coordinate"] for where in prying[1].record["location"]}
    assert "position" in coordinates
    assert all(where["p_value"] <= 0.05 for where in prying[1].record["location"])


def test_the_record_keeps_the_contract(prying, tmp_path):
    diagnosis = prying[1]
    assert set(diagnosis.record) >= CONTRACT
    diagnosis.write(tmp_path)
    again = json.loads((tmp_path / "diagnosis.json").read_text(encoding="utf-8"))
    assert again["schema"] == "shj-bayes/diagnosis/1"
    assert len(again["candidates"]) == len(catalogue()) - 1  # all but velocity, which the base law holds
    assert {"rmse_kN", "noise_kN", "heldout_rmse_kN", "energy_error_percent"} <= set(again["before"])
    assert (tmp_path / "diagnosis.nc").exists()


def test_same_seed_same_record(prying):
    recordings, first = prying
    second = quick(recordings).record
    drop = {"seconds"}
    assert {k: v for k, v in first.record.items() if k not in drop} == {
        k: v for k, v in second.items() if k not in drop
    }


@pytest.mark.parametrize("name", ["slack", "asymmetry", "tension_step", "wear"])
def test_effects_are_named(name):
    assert trials.effect_trial((name,), 4) in ("right name", "right family")


def test_two_effects_are_both_found():
    assert trials.effect_trial(("slack", "asymmetry"), 5) in ("right name", "right family")


def test_an_effect_outside_the_catalogue_is_unknown_with_its_period():
    recordings = trials.simulate({}, 6, shape=trials.OUTSIDE["screw ripple, 25 mm"])
    record = quick(recordings).record
    assert record["verdict"] == "unknown"
    assert record["unknown"]["size_kN"] > 1.0
    assert record["unknown"]["period"]["length"] == pytest.approx(25.0, rel=0.05)


def test_a_catalogue_without_the_effect_does_not_name_another_with_confidence():
    record = quick(trials.simulate({"slack": {"size": 2.5, "softness": 0.1}}, 7), without=("slack",)).record
    assert record["verdict"] == "unknown"


def test_the_paper_is_rediscovered_without_velocity():
    """The base law runs without speed dependence on a device that has it (Table 3, Bisalloy 500)."""
    truth = Truth(K=18.0, Fy=80.0, beta=100.0, gamma=1 / 60, ratio=0.875)
    record = quick(simulate_device(truth, seed=8, rate_Hz=5.0), without=("velocity",)).record
    assert "velocity" in {effect["id"] for effect in record["effects"]} | {member["id"] for member in record["family"]}
    speeds = [where for where in record["location"] if where["coordinate"] == "speed"]
    assert max(abs(where["size_kN"]) for where in speeds) > 2.0
    velocity = next(effect for effect in record["effects"] if effect["id"] == "velocity")
    assert velocity["parameters"]["size"]["mean"] == pytest.approx(1 / 60, rel=0.03)


def test_the_displacement_history_alone_tells_what_looks_alike():
    recordings = trials.simulate({}, 9)
    evidence = evidence_of([Run(recording, motion_of(recording)) for recording in recordings])
    device = DeviceModel(2, read_priors("afc"))
    pairs = {frozenset(a.pair) for a in alias_table(evidence, device, tuple(catalogue().values()))}
    assert frozenset(("asymmetry", "load_offset")) in pairs
    assert frozenset(("thermal", "wear")) in pairs
    assert frozenset(("slack", "asymmetry")) not in pairs


def test_unknown_effect_id_is_refused():
    with pytest.raises(ModelError, match="'gravity' is not an effect; known are"):
        quick(trials.simulate({}, 2), without=("gravity",))


def test_a_misfit_that_follows_the_clock_is_seen():
    record = quick(trials.simulate({}, 10, shape=trials.OUTSIDE["mains wave, 40 s"])).record
    assert record["verdict"] == "unknown"
    assert record["unknown"]["period"]["coordinate"] == "time"
    assert record["unknown"]["period"]["length"] == pytest.approx(40.0, rel=0.05)
