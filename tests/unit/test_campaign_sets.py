"""A campaign that diagnoses: what its sets have in common enters the models of its devices, and the margins."""

import json

import numpy as np
import pytest

from shj_bayes.app.campaign import run_campaign, summarise_campaign
from shj_bayes.app.manifest import read_manifest
from shj_bayes.model.device import force_with_effects
from shj_bayes.model.effects.effect import Base, catalogue
from shj_bayes.model.history import histories
from shj_bayes.recording.motion import Block, exact_motion
from shj_bayes.recording.recording import Recording, write_csv

BLOCKS = (Block(12.0, 0.13, 3), Block(24.0, 0.067, 3), Block(12.0, 0.13, 2))
WORN = {"travel", "heat", "time"}  # in strokes of one speed they go on together
WEAR = 0.1  # 1/m: 5 % of the force over the test


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """A set of three devices that wear, run once; one of another set that is not diagnosed.

    Two that cannot tell travel from heat are not enough: see `test_sets`.
    """
    folder = tmp_path_factory.mktemp("campaign")
    text = 'schema = "shj-bayes/campaign/1"\nname = "small"\n[defaults]\nmax_steps = 200\n'
    time, motion = exact_motion(BLOCKS, 4.0)
    (history,) = histories([time], [motion])
    for number, set_name in enumerate(("bare", "bare", "bare", "other"), start=1):
        rng = np.random.default_rng(number)
        stiffness, capacity = rng.uniform(12, 20), rng.uniform(50, 90)
        base = Base(stiffness, capacity, 10.0, 0.0, capacity)
        force = force_with_effects(history, base, [(catalogue()["wear"], {"size": WEAR})])
        wobble, noise = rng.standard_normal(time.size), rng.standard_normal(time.size)
        worn = Recording(time, motion.displacement_mm + 0.01 * wobble, force + 0.4 * noise)
        name = write_csv(folder / f"d{number}.csv", worn).name
        text += f'[[set]]\nname = "{set_name}"\n' if number in (1, 4) else ""
        text += f'[[set.device]]\nname = "device {number}"\nrecordings = ["{name}"]\n'
    text += 'diagnose = "off"\n'
    (folder / "campaign.toml").write_text(text, encoding="utf-8")
    manifest = read_manifest(folder / "campaign.toml")
    return manifest, folder / "out", run_campaign(manifest, folder / "out", workers=1)


@pytest.mark.slow
def test_what_a_set_has_enters_models_and_margins(campaign):
    _, out, outcomes = campaign
    assert [o.status for o in outcomes] == ["done"] * 4
    assert outcomes[3].diagnosis == "off"
    assert {o.diagnosis for o in outcomes[:3]} <= {"named", "family", "unknown"}
    assert [bool(o.with_set) for o in outcomes] == [True, True, True, False]
    assert not any(o.failures for o in outcomes)
    for o in outcomes[:3]:
        page = (out / o.device.folder / "report.html").read_text(encoding="utf-8")
        assert "The diagnosis of these recordings" in page
        assert 'href="diagnosis/diagnosis.html"' in page
    (together,) = json.loads((out / "campaign.json").read_text(encoding="utf-8"))["together"]
    first = together["classes"][0]
    assert together["set"] == "bare"
    # One of the three is certain; which one, such a test cannot tell.
    assert first["enters"]
    words = {first["coordinate"], *(rival.removeprefix("capacity over ") for rival in first["rivals"])}
    assert first["coordinate"] in words <= WORN
    others = [max(c["of_devices"]) for c in together["classes"] if c["coordinate"] not in WORN]
    assert min(first["of_devices"]) > 0.5 > max(others)
    result = summarise_campaign(outcomes, out, seed=1)
    assert "devices of set bare" in result.text
    assert "What sets have in common" in (out / "report.html").read_text(encoding="utf-8")
    assert any("devices of set bare" in line for line in result.record["margins"]["diagnoses"])


@pytest.mark.slow
def test_a_second_call_keeps_fits_and_diagnoses(campaign):
    manifest, out, outcomes = campaign
    files = sorted(p for p in out.glob("devices/*/**/*") if p.name in ("fit.json", "diagnosis.json"))
    assert len(files) == 4 + 3 + 3
    stamps = [p.stat().st_mtime_ns for p in files]
    before = json.loads((out / "campaign.json").read_text(encoding="utf-8"))["together"]
    again = run_campaign(manifest, out, workers=1)
    assert [o.status for o in again] == ["kept"] * 4
    assert [o.with_set for o in again] == [o.with_set for o in outcomes]
    assert [p.stat().st_mtime_ns for p in files] == stamps
    assert json.loads((out / "campaign.json").read_text(encoding="utf-8"))["together"] == before


@pytest.mark.slow
def test_a_diagnosis_that_is_gone_is_made_again_and_one_without_evidence_stops_nobody(campaign):
    manifest, out, _ = campaign
    one, other, _ = sorted(out.glob("devices/bare*/diagnosis/diagnosis.json"))
    record = json.loads(one.read_text(encoding="utf-8"))
    one.unlink()
    without = json.loads(other.read_text(encoding="utf-8")) | {"evidence": None}
    other.write_text(json.dumps(without), encoding="utf-8")
    outcomes = run_campaign(manifest, out, workers=1)
    assert [o.status for o in outcomes] == ["done", "kept", "kept", "kept"]
    assert outcomes[1].diagnosis == "failed"
    assert "delete that file and run again" in outcomes[1].failures[0]
    assert json.loads(one.read_text(encoding="utf-8"))["evidence"] == record["evidence"]
