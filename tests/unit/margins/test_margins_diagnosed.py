import json
from dataclasses import replace
from types import SimpleNamespace

import pytest
from made_diagnosis import made
from page_tools import read_old

from shj_bayes.app import design
from shj_bayes.margins.specimen import Diagnosed, find_diagnosis, words_of
from shj_bayes.results import store
from shj_bayes.results.campaign import CampaignRecord, DeviceEntry, SetEntry, SetTogether
from shj_bayes.results.codec import to_json
from shj_bayes.results.diagnosis import DiagnosisVerdict

SHA256 = "00" * 32


def write(folder, **change):
    folder.mkdir(parents=True, exist_ok=True)
    record = to_json(made("named", inputs=[{"name": "a.csv", "sha256": SHA256}]))
    record["effects"][0]["title"] = "Prying"
    (folder / "diagnosis.json").write_text(json.dumps({**record, **change}), encoding="utf-8")


@pytest.fixture
def fitted(tmp_path):
    record = read_old()
    store.write(replace(record, inputs=(replace(record.inputs[0], sha256=SHA256),)), tmp_path)
    return tmp_path


def test_a_diagnosis_is_found_beside_the_fit_or_below_it(fitted):
    assert find_diagnosis(fitted) == (None, "")
    write(
        fitted / "diagnosis",
        verdict="family",
        family=[{"id": name, "probability": 0.5} for name in ("prying", "velocity")],
    )
    found, why = find_diagnosis(fitted)
    assert (found.verdict, found.found, why) == ("family", ("prying", "velocity"), "")
    write(fitted)
    found, _ = find_diagnosis(fitted)
    assert (found.verdict, found.found, found.fit) == ("named", ("Prying",), fitted)
    write(fitted, quick=True)
    assert find_diagnosis(fitted)[0].fit is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"inputs": [{"name": "a.csv", "sha256": "11" * 32}]}, "of other recordings"),
        ({"schema": "else"}, "has none of the schemas"),
        ({"verdict": "perhaps"}, "cannot be read"),
        ({"effects": None}, "cannot be read"),
    ],
)
def test_a_diagnosis_that_does_not_belong_is_left_out_and_said(fitted, change, words):
    write(fitted, **change)
    found, why = find_diagnosis(fitted)
    assert found is None
    assert words in why


def test_what_was_found_is_said_device_by_device(tmp_path):
    key = ("Zinc 70", "1")
    assert words_of({}, 5, ["y: not used"]) == (words_of({}, 5)[0], "y: not used")
    assert words_of({}, 5)[0].startswith("No device has a diagnosis")
    assert words_of({key: Diagnosed(DiagnosisVerdict.ADEQUATE, (), tmp_path)}, 5)[0].startswith(
        "1 of 5 devices have a diagnosis"
    )
    assert words_of({key: Diagnosed(DiagnosisVerdict.NAMED, ("Prying",), tmp_path)}, 5)[0] == "Zinc 70, 1: Prying"
    assert (
        "not told apart" in words_of({key: Diagnosed(DiagnosisVerdict.FAMILY, ("prying", "velocity"), tmp_path)}, 5)[0]
    )
    assert "without a posterior" in words_of({key: Diagnosed(DiagnosisVerdict.UNKNOWN, ())}, 5)[0]


def test_a_first_look_that_was_fitted_with_its_set_rests_on_that_fit(fitted, monkeypatch):
    write(fitted / "device" / "diagnosis", quick=True)
    (fitted / "fit.json").replace(fitted / "device" / "fit.json")
    device = DeviceEntry(name="A1", folder="device", status="done", reason="", verdict="", with_set="reliable")
    store.write(CampaignRecord(name="c", sets=(SetEntry(name="bare", devices=(device,)),)), fitted)
    monkeypatch.setattr(design, "read_specimen", lambda folder, name, of_set, better: better)
    population = SimpleNamespace(sets=[SimpleNamespace(name="bare", devices=["A1"])])
    _, specimens, words = design.read_devices(fitted, population)
    assert specimens == (fitted / "device" / "with-set",)
    assert words == ("bare, A1: Prying", "1 of 1 devices have a diagnosis.")


def test_what_diagnoses_found_is_told_of_the_sets_that_are_asked_for(fitted, monkeypatch):
    sets = []
    for name in ("bare", "zinc"):
        write(fitted / name / "diagnosis", quick=True)
        (fitted / name / "fit.json").write_bytes((fitted / "fit.json").read_bytes())
        devices = [
            DeviceEntry(name=number, folder=place, status="done", reason="", verdict="")
            for number, place in (("1", name), ("2", f"{name}-2"))
        ]
        sets.append(SetEntry(name=name, devices=tuple(devices)))
    together = [SetTogether(set=name, devices=("1", "2"), classes=()) for name in ("", "bare", "zinc")]
    store.write(CampaignRecord(name="c", sets=tuple(sets), together=tuple(together)), fitted)
    monkeypatch.setattr(design, "statements", lambda told: tuple(one.set for one in told))
    monkeypatch.setattr(design, "read_specimen", lambda folder, *rest: folder.name)
    population = SimpleNamespace(sets=[SimpleNamespace(name=name, devices=["1", "2"]) for name in ("bare", "zinc")])
    _, specimens, words = design.read_devices(fitted, population, ("zinc",))
    assert specimens == ("bare", "bare-2", "zinc", "zinc-2")
    assert words[0] == "zinc"
    assert words[1].startswith("zinc, 1: Prying")
    assert words[2].startswith("1 of 2 devices have a diagnosis")
