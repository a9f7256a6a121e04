"""The functions for scripts and notebooks: the same results as the commands, shown and loaded again."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import shj_bayes
from shj_bayes.app.device import write_simulated
from shj_bayes.errors import ModelError, RecordingError, ReportError
from shj_bayes.model.simulate import Truth

SHORT = {"max_steps": 60, "threads": 1}
pytestmark = pytest.mark.usefixtures("no_workers")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("runs")
    return [p for p in write_simulated(folder / "a", Truth(gamma=1 / 60), seed=3, rate_Hz=3.0) if p.suffix == ".csv"]


@pytest.fixture(scope="module")
def fitted(runs: list[Path]) -> shj_bayes.FitResult:
    return shj_bayes.fit(runs, **SHORT)


def test_public_names_are_there_in_order_and_say_what_they_are() -> None:
    assert set(shj_bayes.__all__) <= set(dir(shj_bayes))
    for name in shj_bayes.__all__:
        assert getattr(shj_bayes, name).__doc__
    with pytest.raises(AttributeError, match="no attribute 'fitt'"):
        _ = shj_bayes.fitt


def test_importing_the_package_imports_no_heavy_room() -> None:
    code = "import sys, shj_bayes; print([m for m in ('numpy', 'arviz', 'matplotlib', 'pandas') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_recording_is_read_and_shown(runs: list[Path]) -> None:
    recording = shj_bayes.Recording.read(runs[0])
    assert "a-run1.csv" in recording._repr_html_()
    with pytest.raises(RecordingError):
        shj_bayes.Recording.read(runs[0].with_name("none.csv"))


def test_a_fit_is_a_table_draws_and_an_arviz_object(fitted: shj_bayes.FitResult) -> None:
    assert fitted.verdict in ("reliable", "tentative", "unusable")
    assert list(fitted.summary.index)[:2] == ["K", "Fy"]
    row = fitted.summary.loc["Fy"]  # of all draws that were kept; fewer are stored
    assert fitted.draws["Fy"].mean() == pytest.approx(row["mean"], abs=0.1 * row["sd"])
    assert fitted.data.posterior["K"].ndim == 2
    html = fitted._repr_html_()
    assert fitted.verdict in html
    assert "<table" in html
    assert fitted.page.is_file()
    assert shj_bayes.load(fitted.folder).record == fitted.record


def test_recordings_in_memory_give_the_numbers_of_their_files(
    runs: list[Path], fitted: shj_bayes.FitResult, tmp_path: Path
) -> None:
    read = [shj_bayes.Recording.read(path) for path in runs]
    again = shj_bayes.fit(read, tmp_path / "out", **SHORT)
    assert np.array_equal(again.summary["mean"], fitted.summary["mean"])
    # A changed recording keeps the name and the digest of its file, and must not be taken for it.
    changed = [shj_bayes.Recording(r.time_s, r.displacement_mm, 1.1 * r.force_kN, source=r.source) for r in read]
    third = shj_bayes.fit(changed, tmp_path / "other", **SHORT)
    assert third.record["key"] != again.record["key"]
    assert third.summary.loc["Fy", "mean"] > 1.05 * again.summary.loc["Fy", "mean"]


def test_a_temporary_folder_goes_with_its_result(runs: list[Path]) -> None:
    result = shj_bayes.fit(runs[0], **SHORT)
    folder = result.folder
    assert folder.is_dir()
    del result
    assert not folder.exists()


def test_wrong_words_name_the_nearest_right_one(runs: list[Path]) -> None:
    with pytest.raises(ModelError, match="did you mean 'published'"):
        shj_bayes.fit(runs, model="publishd")
    with pytest.raises(ModelError, match="did you mean 'slow'"):
        shj_bayes.fit(runs, noise="slo")
    with pytest.raises(ModelError, match="did you mean 'slack'"):
        shj_bayes.fit(runs, effects=("slak",))
    with pytest.raises(ModelError, match="did you mean 'gamma'"):
        shj_bayes.fit(runs, free=("gama",))
    with pytest.raises(ModelError, match="did you mean 'prying'"):
        shj_bayes.diagnose(runs[0], without=("pryng",), quick=True)


def test_an_option_that_there_is_not_is_told_as_python_tells_one(runs: list[Path]) -> None:
    with pytest.raises(TypeError, match=r"'prior' is not an option.*did you mean 'priors'") as told:
        shj_bayes.fit(runs, prior="general")
    assert isinstance(told.value, ModelError)


def test_a_diagnosis_is_shown_and_loaded(runs: list[Path], tmp_path: Path) -> None:
    found = shj_bayes.diagnose(runs, tmp_path / "look", quick=True)
    assert found.verdict in ("adequate", "named", "family", "unknown")
    assert {"Fy", "gamma"} <= set(found.shift.index)
    assert found.verdict in found._repr_html_()
    assert found.page.name == "diagnosis.html"
    assert isinstance(shj_bayes.load(tmp_path / "look"), shj_bayes.Diagnosis)


def test_nothing_to_load_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(ReportError, match="no finished result"):
        shj_bayes.load(tmp_path)


def test_a_campaign_runs_compares_and_loads(runs: list[Path], tmp_path: Path) -> None:
    sets = "\n".join(
        f'[[set]]\nname = "{name}"\n[[set.device]]\nname = "{name} 1"\nrecordings = ["{runs[0].as_posix()}"]'
        for name in ("bare", "zinc")
    )
    manifest = tmp_path / "c.toml"
    manifest.write_text(
        f'schema = "shj-bayes/campaign/1"\nname = "c"\n[defaults]\nmax_steps = 60\n{sets}\n', encoding="utf-8"
    )
    result = shj_bayes.Campaign.read(manifest).run(tmp_path / "out", workers=1, diagnose="off")
    assert set(result.bands["set"]) >= {"bare", "zinc"}
    assert ("bare", "bare 1") in result.devices
    assert "Fy" in set(result.compare("bare", "zinc")["quantity"])
    assert "zinc" in result._repr_html_()
    loaded = shj_bayes.load(tmp_path / "out")
    assert isinstance(loaded, shj_bayes.CampaignResult)
    assert loaded.bands.equals(result.bands)
