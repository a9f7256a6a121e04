"""A device as it was found to be: `fit --effects` and `diagnose` fit the same model and write the same files."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import shj_bayes
from shj_bayes.cli import main
from shj_bayes.errors import CheckpointError, InferenceError, ModelError
from shj_bayes.model.device import DeviceModel, effects_named
from shj_bayes.model.history import histories
from shj_bayes.model.noise import noise_models
from shj_bayes.model.priors import read_priors
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.options import FitOptions
from shj_bayes.recording.motion import Block, exact_motion
from shj_bayes.recording.recording import Recording, write_csv

BLOCKS = (Block(12.0, 0.13, 3), Block(24.0, 0.067, 3), Block(48.0, 0.034, 3))
RATE_HZ = 4.0
LAW = {"K": 18.0, "Fy": 80.0, "beta": 10.0, "gamma": 0.005, "ratio": 0.8}
SLACK = {"slack.size": 3.0, "slack.softness": 0.1, "slack.start": 0.5}
# Not the defaults: every option of a fit is one of a diagnosis.
CHOSEN = {"noise": "ar1", "free": ("K",), "max_steps": 150, "seed": 3, "threads": 1}
NAMES = ["K", "Fy", "beta", "gamma", "ratio", "K_2", *SLACK, "sigma", "phi"]
FILES = {"posterior.nc", "summary.csv", "summary.json", "fit.json", "report.html"}


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two runs of a device with a clearance of 3 mm."""
    time, motion = exact_motion(BLOCKS, RATE_HZ)
    device = DeviceModel(2, read_priors(), effects=effects_named(["slack"]))
    theta = device.laws.natural(np.zeros((1, len(device.names))))
    for name, value in (LAW | SLACK).items():
        theta[0, device.names.index(name)] = value
    folder, rng = tmp_path_factory.mktemp("runs"), np.random.default_rng(1)
    paths = []
    for history in histories([time, time], [motion, motion]):
        force = device.force(theta, history, 0.0)[0] + rng.normal(0, 0.5, time.size)
        recording = Recording(time, motion.displacement_mm + rng.normal(0, 0.01, time.size), force)
        paths.append(write_csv(folder / f"loose-run{history.run}.csv", recording, comment="SIMULATED"))
    return paths


@pytest.fixture(scope="module")
def found(recordings: list[Path], tmp_path_factory: pytest.TempPathFactory) -> shj_bayes.Diagnosis:
    return shj_bayes.diagnose(recordings, tmp_path_factory.mktemp("found"), **CHOSEN)


@pytest.fixture(scope="module")
def fitted(recordings: list[Path], tmp_path_factory: pytest.TempPathFactory) -> shj_bayes.FitResult:
    return shj_bayes.fit(recordings, tmp_path_factory.mktemp("fitted"), effects=("slack",), **CHOSEN)


@pytest.mark.parametrize("words", [("slack", "slack"), ("slack", "wear", "slack")])
def test_an_effect_that_stands_twice_is_refused(words: tuple[str, ...]) -> None:
    with pytest.raises(ModelError, match="the effect 'slack' stands twice"):
        FitOptions(effects=words)


def test_the_slack_is_named(found: shj_bayes.Diagnosis) -> None:
    assert found.verdict in ("named", "family")
    assert found.effects == ("slack",)


def test_the_parameters_are_the_same(found: shj_bayes.Diagnosis, fitted: shj_bayes.FitResult) -> None:
    assert list(fitted.summary.index) == NAMES
    assert list(found.fit.summary.index) == NAMES
    assert list(found.fit.draws.columns) == NAMES
    assert list(found.fit.summary["unit"]) == list(fitted.summary["unit"])
    assert found.fit.record["model"] == fitted.record["model"]
    assert fitted.record["model"]["effects"] == ["slack"]


def test_the_files_are_the_same(found: shj_bayes.Diagnosis, fitted: shj_bayes.FitResult) -> None:
    beside, alone = ({path.name for path in result.folder.iterdir()} for result in (found, fitted))
    assert alone >= FILES
    assert beside >= FILES | {"diagnosis.json", "diagnosis.nc", "diagnosis.html"}
    assert "loose-run1" in (found.folder / "report.html").read_text(encoding="utf-8")


def test_the_numbers_are_the_same_and_near_the_truth(found: shj_bayes.Diagnosis, fitted: shj_bayes.FitResult) -> None:
    one, two = found.fit.summary, fitted.summary
    assert np.all(np.abs(one["mean"] - two["mean"]) < 0.4 * two["sd"])  # two short runs of the sampler
    assert two.loc["slack.size", "mean"] == pytest.approx(3.0, abs=0.1)
    assert two.loc["Fy", "mean"] == pytest.approx(80.0, rel=0.01)


def test_the_diagnosis_shows_the_numbers_of_its_fit(found: shj_bayes.Diagnosis) -> None:
    shown = found.record["effects"][0]["parameters"]["size"]
    row = found.fit.summary.loc["slack.size"]
    assert shown["unit"] == row["unit"] == "mm"
    for key in ("mean", "q05", "q95"):
        assert shown[key] == pytest.approx(row[key], abs=0.2 * row["sd"])  # of some of its draws
    assert found.record["sampling"]["verdict"] == found.fit.verdict
    assert found.fit.record["sampling"]["n_steps_kept"] <= CHOSEN["max_steps"]


def test_a_fit_beside_a_diagnosis_is_kept(recordings: list[Path], found: shj_bayes.Diagnosis) -> None:
    """The same effects, recordings and options: it is the same fit."""
    stamp = (found.folder / "posterior.nc").stat().st_mtime_ns
    again = shj_bayes.fit(recordings, found.folder, effects=found.effects, **CHOSEN)
    assert (found.folder / "posterior.nc").stat().st_mtime_ns == stamp
    assert again.record == found.fit.record


def test_a_diagnosis_goes_where_a_tentative_fit_lies(recordings: list[Path], tmp_path: Path) -> None:
    """Such a fit keeps its checkpoint, to be gone on from; it must not stop the diagnosis that it advises."""
    short = {"max_steps": 60, "seed": 4, "threads": 1}
    tentative = shj_bayes.fit(recordings, tmp_path, **short)
    assert tentative.verdict != "reliable"
    left = (tmp_path / "checkpoint.h5").read_bytes()
    assert "slack.size" in shj_bayes.fit(recordings, tmp_path, effects=("slack",), **short).summary.index
    # One whose fit was not finished is of an answer that nobody has yet.
    (tmp_path / "fit.json").unlink()
    (tmp_path / "checkpoint.h5").write_bytes(left)
    with pytest.raises(CheckpointError, match="belongs to another problem"):
        shj_bayes.fit(recordings, tmp_path, effects=("slack",), **short)


def test_speed_dependence_that_was_taken_out_and_found_is_fitted(tmp_path: Path) -> None:
    """The law runs without it, so that it is an effect like others."""
    truth = Truth(gamma=1 / 60, sigma=0.4, phi=0.0, displacement_noise_mm=0.0)
    runs = list(simulate_device(truth, seed=8, rate_Hz=4.0, blocks=BLOCKS))
    found = shj_bayes.diagnose(runs, tmp_path, without=("velocity",), max_steps=100, threads=1)
    assert "velocity" in found.effects
    assert "gamma" not in found.fit.summary.index
    assert found.fit.summary.loc["velocity.size", "mean"] == pytest.approx(1 / 60, rel=0.05)
    assert not found.fit.record["model"]["speed"]


def test_a_first_look_writes_no_fit(recordings: list[Path], tmp_path: Path) -> None:
    look = shj_bayes.diagnose(recordings, tmp_path, quick=True)
    assert look.effects == ("slack",)
    assert not FILES & {path.name for path in tmp_path.iterdir()}
    with pytest.raises(InferenceError, match=r"holds no fit\.json"):
        _ = look.fit


def test_what_is_known_is_not_looked_for(recordings: list[Path], tmp_path: Path) -> None:
    look = shj_bayes.diagnose(recordings, tmp_path, quick=True, effects=("slack",))
    assert look.verdict == "adequate"
    assert look.effects == ()
    assert look.record["model"]["given"] == ["slack"]
    assert not {"slack", "velocity"} & set(look.candidates.index)


def test_the_command_takes_the_effects_too(recordings: list[Path], tmp_path: Path) -> None:
    words = ["-o", str(tmp_path), "--effects", "wear, asymmetry", "--max-steps", "200", "--quiet"]
    done = CliRunner().invoke(main, ["fit", str(recordings[0]), *words])
    assert done.exit_code == 0, done.output
    names = list(shj_bayes.load(tmp_path).summary.index)
    assert names == ["K", "Fy", "beta", "gamma", "wear.size", "asymmetry.size", "sigma_white", "sigma_slow", "tau_slow"]
    done = CliRunner().invoke(main, ["fit", str(recordings[0]), "-o", str(tmp_path), "--effects", "slak"])
    assert done.exit_code == 1
    assert "'slak' is not an effect" in done.output
    assert "did you mean 'slack'" in done.output


def test_speed_is_in_the_law_already() -> None:
    with pytest.raises(ModelError, match=r"the base law depends on speed already; take 'velocity' out"):
        FitOptions(effects=("velocity",))


@pytest.mark.parametrize("command", ["fit", "diagnose"])
def test_the_commands_offer_every_noise(command: str) -> None:
    option = next(p for p in main.get_command(None, command).params if p.name == "noise")  # type: ignore[arg-type]
    assert list(option.type.choices) == list(noise_models())
    assert option.default == next(iter(noise_models()))


def test_three_runs_have_two_ratios(tmp_path: Path) -> None:
    """Each against the first run; in the table, the draws and the files."""
    truth = Truth(ratio=0.8, sigma=0.3, phi=0.0, displacement_noise_mm=0.0)
    runs = simulate_device(truth, seed=2, n_runs=3, rate_Hz=4.0, blocks=BLOCKS[:2])
    result = shj_bayes.fit(list(runs), tmp_path, max_steps=200, threads=1)
    table = result.summary
    assert [name for name in table.index if name.startswith("ratio")] == ["ratio", "ratio_3"]
    for name, value in (("ratio", 0.8), ("ratio_3", 0.64)):
        assert table.loc[name, "mean"] == pytest.approx(value, abs=max(5 * table.loc[name, "sd"], 0.003))
        assert result.draws[name].mean() == pytest.approx(table.loc[name, "mean"], abs=0.1 * table.loc[name, "sd"])
    assert "ratio_3" in result.page.read_text(encoding="utf-8")
