import json
from dataclasses import replace

import pytest

from shj_bayes.inference.store import KINDS, SCHEMA
from shj_bayes.margins.diagnosed import LAW_ALONE, Diagnosed, cases, find_diagnosis, stated
from shj_bayes.margins.row import HIGH, LOW, MIDDLE
from shj_bayes.margins.sheet import margins
from shj_bayes.population.hierarchy import fit_population
from shj_bayes.population.tested import PUBLISHED

BEFORE = {"gamma": (-0.01, 0.002), "Fy": (92.0, 1.0), "ratio": (0.75, 0.01)}
AFTER = {"gamma": (0.0, 0.002), "Fy": (96.0, 1.0), "ratio": (0.7, 0.01)}


def write(folder, **change):
    folder.mkdir(parents=True, exist_ok=True)
    inputs = [{"name": "a.csv", "sha256": "00"}]
    record = {
        "schema": "shj-bayes/diagnosis/1",
        "verdict": "named",
        "effects": [{"id": "prying", "title": "Prying"}],
        "family": [],
        "shift": {q: {"before": {"mean": 1, "sd": 1}, "after": {"mean": m, "sd": s}} for q, (m, s) in AFTER.items()},
        "quick": False,
        "inputs": inputs,
    }
    record["shift"]["slack.size"] = record["shift"]["ratio"]  # not a quantity that is pooled
    (folder / "diagnosis.json").write_text(json.dumps({**record, **change}), encoding="utf-8")
    return inputs


@pytest.fixture
def fitted(tmp_path):
    record = {key: kind() for key, kind in KINDS.items()}
    record |= {"schema": SCHEMA, "inputs": [{"name": "a.csv", "sha256": "00"}]}
    (tmp_path / "fit.json").write_text(json.dumps(record), encoding="utf-8")
    return tmp_path


def test_a_diagnosis_is_found_beside_the_fit_or_below_it(fitted):
    assert find_diagnosis(fitted) == (None, "")
    write(fitted / "diagnosis", verdict="family", family=[{"id": "prying"}, {"id": "velocity"}])
    found, why = find_diagnosis(fitted)
    assert (found.verdict, found.found, why) == ("family", ("prying", "velocity"), "")
    write(fitted)
    found, _ = find_diagnosis(fitted)
    assert (found.verdict, found.found, dict(found.after)) == ("named", ("Prying",), AFTER)
    assert dict(found.before) == dict.fromkeys(AFTER, (1.0, 1.0))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"inputs": [{"sha256": "11"}]}, "of other recordings"),
        ({"schema": "else"}, "has the schema 'else'"),
        ({"verdict": "perhaps"}, "cannot be read"),
        ({"shift": None}, "cannot be read"),
    ],
)
def test_a_diagnosis_that_does_not_belong_is_left_out_and_said(fitted, change, words):
    write(fitted, **change)
    found, why = find_diagnosis(fitted)
    assert found is None
    assert words in why


def test_the_augmented_model_replaces_what_it_gives(devices):
    changed = stated(devices[0], AFTER)
    assert changed.point("gamma") == 0.0
    assert changed.error("gamma") == pytest.approx(0.002)
    assert changed.point("K") == devices[0].point("K")
    assert changed.error("Fy") == pytest.approx(1 / 96)


def test_every_finding_keeps_the_law_alone_beside_it(devices):
    key = ("Zinc 70", "1")
    nothing = cases(devices, {key: Diagnosed("adequate", (), BEFORE, AFTER)})
    assert nothing.devices == ()
    assert nothing.words[0].startswith("1 of 5 devices have a diagnosis")
    assert cases(devices, {}, ["y: not used"]).words[0].startswith("No device has a diagnosis")
    named = cases(devices, {key: Diagnosed("named", ("Prying",), BEFORE, AFTER)})
    assert "the less favourable with and without it" in named.words[0]
    both = cases(devices, {key: Diagnosed("family", ("prying", "velocity"), BEFORE, AFTER)}, ["y: not used"])
    for found in (named, both):
        assert [label for label, _ in found.devices] == ["with the physics found", LAW_ALONE]
        assert found.devices[0][1][0].point("gamma") == 0.0
        assert found.devices[1][1][0].point("gamma") == BEFORE["gamma"][0]
    assert "not told apart" in both.words[0]
    assert both.words[-1] == "y: not used"
    others = cases(devices, {("Zinc 70 corroded", "1"): Diagnosed("named", ("Prying",), BEFORE, AFTER)})
    assert others.devices[0][1][0].point("gamma") == devices[0].point("gamma")  # same name, other set


def test_margins_are_the_least_favourable_with_the_law_alone_beside(devices, population):
    found = {("Zinc 70", key): Diagnosed("unknown", (), BEFORE, AFTER) for key in "12"}
    models = cases(devices, found)
    fitted = {label: replace(fit_population(d, seed=3), tested=PUBLISHED) for label, d in models.devices}
    sheet = margins(population, diagnosed=fitted, words=models.words)
    parts = [margins(model) for model in fitted.values()]
    alone = margins(fitted[LAW_ALONE])
    for side, level, pick in ((LOW, 5, min), (HIGH, 95, max)):
        key = ("Zinc 70", "force", f"new device, {level} %", side)
        row = sheet.get(*key)
        assert row.value == pytest.approx(pick(part.get(*key).value for part in parts))
        assert row.without_diagnosis == pytest.approx(alone.get(*key).value)
        assert "the less favourable of" in row.note
    middle = sheet.get("Zinc 70", "force", "new device, 50 %", MIDDLE)
    assert parts[0].get(*middle.key).value != pytest.approx(parts[1].get(*middle.key).value, rel=0.01)
    assert sheet.models == ("with the physics found", LAW_ALONE)
