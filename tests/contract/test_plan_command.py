"""``shj-bayes plan``: from a folder of results to a plan, its displacement history and its page, and back in Python."""

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

import shj_bayes
from shj_bayes.cli import main
from shj_bayes.errors import OptionError, ShjError
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.planning import protocol
from shj_bayes.planning.protocol import Rig, read_rig
from shj_bayes.recording.motion import Block
from shj_bayes.recording.reader import read
from shj_bayes.recording.recording import write_csv
from shj_bayes.results.store import DIAGNOSIS

TRUTH = Truth(gamma=1 / 60, phi=0.0)
BLOCKS = (Block(12.0, 0.13, 2), Block(24.0, 0.067, 2), Block(48.0, 0.034, 2))


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("device")
    made = simulate_device(TRUTH, seed=3, rate_Hz=3.0, blocks=BLOCKS)
    runs = [write_csv(folder / f"a-run{i}.csv", run) for i, run in enumerate(made, start=1)]
    shj_bayes.fit(runs[:1], folder / "results", max_steps=200, threads=1)
    return folder / "results"


def test_a_plan_is_written_printed_and_loaded(fitted: Path, tmp_path: Path) -> None:
    out = tmp_path / "next"
    words = ["plan", str(fitted), "-o", str(out), "--question", "gamma", "--max-minutes", "4", "--max-speed", "15"]
    done = CliRunner().invoke(main, [*words, "--json"])
    assert done.exit_code == 0, done.output
    record = json.loads(done.stdout)
    assert record == json.loads((out / "plan.json").read_text(encoding="utf-8"))
    assert record["schema"] == "shj-bayes/plan/1"
    best, table = record["candidates"][0], record["compared"][0]
    assert best["sd"] < record["now"]["sd"]
    assert (best["minutes"], best["fastest_mm_s"]) <= (4.0, 15.0)
    assert table["name"] == "Table 1"
    assert any("time" in words for words in table["limits_broken"])
    # The history is a file that the readers take, at the rate of the tests, and moves as the plan says.
    history = pd.read_csv(out / best["file"])
    assert np.diff(history["time_s"]) == pytest.approx(1 / 3, abs=1e-3)
    assert np.abs(history["displacement_mm"]).max() == pytest.approx(best["largest_mm"], rel=0.02)
    history.assign(force_kN=history["displacement_mm"]).to_csv(tmp_path / "as-run.csv", index=False)
    assert read(tmp_path / "as-run.csv").n_samples == len(history)
    page = (out / "plan.html").read_text(encoding="utf-8")
    assert "Which test next" in page or "which test next" in page
    assert best["file"] in page
    loaded = shj_bayes.load(out)
    assert isinstance(loaded, shj_bayes.NextTest)
    assert loaded.page == out / "plan.html"
    assert loaded.history.equals(history)
    assert list(loaded.compared["name"])[-1] == "Table 1"


def test_a_first_look_below_its_fit_is_planned_from(
    fitted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a campaign leaves them; alone it has no recordings, and of other recordings it says nothing of this fit."""
    monkeypatch.setattr(protocol, "PATTERNS", dict(list(protocol.PATTERNS.items())[:2]))
    device = tmp_path / "device"
    shutil.copytree(fitted, device)
    run = fitted.parent / "a-run1.csv"
    look = shj_bayes.diagnose(run, device / DIAGNOSIS, quick=True).record
    rig = {"max_minutes": 4.0, "max_speed_mm_s": 15.0}
    plans = [shj_bayes.plan(one, tmp_path / "next", **rig).record for one in (device, device / DIAGNOSIS)]
    assert plans[0]["question"] == plans[1]["question"]
    states = [{frozenset(one["classes"]) for one in plan["devices"][0]["sets"]} for plan in plans]
    assert states[0] == states[1]
    assert {frozenset(row["classes"]) for row in look["sets"] if row["probability"] > 0.01} <= states[0]
    (device / "fit.json").unlink()
    (device / "checkpoint.h5").unlink(missing_ok=True)
    with pytest.raises(ShjError, match="holds a first look and no fit"):
        shj_bayes.plan(device / DIAGNOSIS, tmp_path / "next")
    shj_bayes.fit(fitted.parent / "a-run2.csv", device, max_steps=60, threads=1)
    with pytest.raises(ShjError, match="is of other recordings than the fit"):
        shj_bayes.plan(device, tmp_path / "next")


def test_what_cannot_be_planned_is_said_in_one_line(fitted: Path, tmp_path: Path) -> None:
    def said(*words: str) -> tuple[int, str]:
        done = CliRunner().invoke(main, ["plan", *words])
        return done.exit_code, done.output.strip()

    assert said(str(fitted))[0] == 2  # no -o
    assert said("-o", str(tmp_path / "a"))[0] == 2  # neither a device nor priors
    code, text = said(str(fitted), "-o", str(tmp_path / "a"), "--question", "force", "--quiet")
    assert (code, text.count("\n")) == (1, 0)
    assert "two or more devices" in text
    code, text = said(str(tmp_path / "gone"), "-o", str(tmp_path / "a"))
    assert code == 1
    assert "no such file" in text
    with pytest.raises(OptionError, match="did you mean 'max_minutes'"):
        shj_bayes.plan(fitted, tmp_path / "a", max_minute=3.0)


def test_further_devices_are_planned_from_a_set(fitted: Path, tmp_path: Path) -> None:
    result = shj_bayes.plan([fitted, fitted], tmp_path / "set", question="force")
    assert result.record["further_devices"]["n_tested"] == 2
    assert result.record["now"]["force_kN"] == pytest.approx(80.0, rel=0.05)
    assert "further devices" in result.page.read_text(encoding="utf-8")


def test_the_example_rig_is_one_that_can_be_read(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    assert CliRunner().invoke(main, ["plan", "--example-rig", str(path)]).exit_code == 0
    assert Rig(**read_rig(path)).max_stroke_mm > 0
