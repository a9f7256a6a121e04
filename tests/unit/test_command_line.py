"""The commands as users script them: exit status, one clear line for each mistake, JSON and nothing else."""

import json
import os
import subprocess
import sys
import time
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from shj_bayes.app import device
from shj_bayes.app.resume import name_of_device
from shj_bayes.cli import main
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.options import DiagnoseOptions, FitOptions, MarginOptions, PlanOptions
from shj_bayes.recording.motion import Block
from shj_bayes.recording.recording import write_csv

BLOCKS = (Block(12.0, 0.13, 2), Block(24.0, 0.067, 2))


def run(*arguments: object):
    return CliRunner().invoke(main, [str(a) for a in arguments])


@pytest.fixture(scope="module")
def recordings(tmp_path_factory) -> list[Path]:
    """Two short runs of one device."""
    folder = tmp_path_factory.mktemp("recordings")
    runs = simulate_device(Truth(gamma=0.01, phi=0.3), seed=1, rate_Hz=4.0, blocks=BLOCKS)
    return [write_csv(folder / f"run{i}.csv", r, comment="SIMULATED") for i, r in enumerate(runs, start=1)]


@pytest.fixture(scope="module")
def fitted(recordings, tmp_path_factory) -> Path:
    """Results folder of a short fit."""
    folder = tmp_path_factory.mktemp("fit")
    result = run("fit", *recordings, "-o", folder, "--max-steps", 200, "--quiet")
    assert result.exit_code == 0, result.output
    return folder


def test_help_answers_at_once_and_names_the_commands():
    before = set(sys.modules)
    result = run("--help")
    assert result.exit_code == 0
    for command in ("campaign", "check", "compare", "demo", "diagnose", "doctor", "fit", "simulate", "tables"):
        assert command in result.output
    assert "..." not in result.output.partition("Commands:")[2]  # each says in a line what it does
    assert "numba" not in set(sys.modules) - before


@pytest.mark.parametrize("ending", [".csv", ".DAT", ".asc", ".csv.gz", ".hdf5", ".tdms"])
def test_a_device_is_named_by_its_first_file_without_the_ending_of_its_format(ending):
    assert name_of_device(None, f"rig 2.5{ending}") == "rig 2.5"
    assert name_of_device("mine", f"rig{ending}") == "mine"


@pytest.mark.parametrize(
    ("command", "kind"),
    [("fit", FitOptions), ("diagnose", DiagnoseOptions), ("plan", PlanOptions), ("margins", MarginOptions)],
)
def test_every_option_that_is_declared_is_one_of_its_command_and_is_explained(command, kind):
    flags = {parameter.name for parameter in main.commands[command].params}
    names = {one.name for one in fields(kind)}
    assert names - {"runs"} <= flags  # it is given by three
    assert all(f"\n{name} : " in kind.__doc__ for name in names)


def test_the_command_runs_as_a_module():
    out = subprocess.run([sys.executable, "-m", "shj_bayes", "--version"], capture_output=True, text=True, check=True)
    assert out.stdout.startswith("shj-bayes, version")


def test_help_imports_nothing_heavy():
    code = "import sys, shj_bayes.cli; print([m for m in ('numba', 'scipy', 'pandas', 'arviz') if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert out.stdout.strip() == "[]"


@pytest.mark.parametrize(
    "command",
    [
        ("fit", "none.csv", "-o", "out"),
        ("check", "none.csv"),
        ("diagnose", "none.csv", "-o", "out"),
        ("campaign", "none.toml", "-o", "out"),
        ("margins", "none"),
        ("compare", "none", "a", "b"),
        ("export", "none", "--to", "opensees"),
    ],
)
def test_a_missing_file_is_told_before_anything_heavy_is_imported(tmp_path, command):
    code = (
        "import sys, shj_bayes.cli as c\n"
        f"try: c.main({list(command)!r})\n"
        "finally: print([m for m in ('numpy', 'numba', 'scipy', 'pandas', 'arviz') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 1
    assert "none" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert done.stdout.strip() == "[]"
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_is_told_before_the_work(tmp_path, monkeypatch):
    def never(*_, **__):
        raise AssertionError("the work began")

    def denied(*_, **__):
        raise PermissionError(13, "Permission denied", "tmpabc")

    monkeypatch.setattr("shj_bayes.app.design.fit_population", never)
    (tmp_path / "file").write_text("x", encoding="utf-8")
    done = run("tables", "-o", tmp_path / "file" / "below")
    assert (done.exit_code, "rights" in done.output) == (1, True)
    monkeypatch.setattr("shj_bayes._util.files.TemporaryFile", denied)
    done = run("tables", "-o", tmp_path / "locked")
    assert (done.exit_code, "Permission denied (locked)" in done.output) == (1, True)


def test_fit_writes_the_files_of_the_contract(fitted):
    assert {p.name for p in fitted.iterdir()} >= {
        "posterior.nc",
        "summary.csv",
        "summary.json",
        "fit.json",
        "report.html",
    }
    record = json.loads((fitted / "fit.json").read_text(encoding="utf-8"))
    assert record["schema"] == "shj-bayes/fit/2"
    assert record["verdict"] in ("reliable", "tentative", "unusable")
    assert record["reasons"]
    assert all(len(source["sha256"]) == 64 for source in record["inputs"])
    header = (fitted / "summary.csv").read_text(encoding="utf-8").splitlines()[0]
    assert header.startswith("name,unit,mean,sd,q05,q50,q95,ess_bulk,ess_tail,rhat")


def test_unchanged_fit_is_kept_and_json_is_alone_on_standard_output(fitted, recordings):
    stamp = (fitted / "posterior.nc").stat().st_mtime_ns
    result = CliRunner().invoke(main, ["fit", *map(str, recordings), "-o", str(fitted), "--max-steps", "200", "--json"])
    assert result.exit_code == 0
    assert json.loads(result.stdout)["device"] == "run1"
    assert (fitted / "posterior.nc").stat().st_mtime_ns == stamp


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("empty.csv", "", "empty"),
        ("words.csv", "time_s,displacement_mm,force_kN\na,b,c\nd,e,f\n", "words.csv"),
        ("notime.csv", "displacement_mm,force_kN\n1,2\n2,3\n", "time"),
    ],
)
def test_unusable_recordings_give_one_line_and_status_1(tmp_path, name, content, words):
    path = tmp_path / name
    path.write_text(content, encoding="utf-8")
    result = run("fit", path, "-o", tmp_path / "out")
    assert result.exit_code == 1
    assert words in result.output
    assert "Traceback" not in result.output
    assert len(result.output.strip().splitlines()) == 1
    assert run("check", path).exit_code == 1


def test_wrong_scale_is_refused_with_what_to_do(recordings, tmp_path):
    """A force of tens of newtons read as kN is no friction connection."""
    table = np.loadtxt(recordings[0], delimiter=",", skiprows=2)
    table[:, 2] /= 1000
    path = tmp_path / "small.csv"
    np.savetxt(path, table, delimiter=",", header="time_s,displacement_mm,force_kN", comments="")
    result = run("fit", path, "-o", tmp_path / "out")
    assert result.exit_code == 1
    assert "--units" in result.output
    assert "--priors general" in result.output


def test_wrong_usage_is_status_2():
    assert run("fit").exit_code == 2
    assert run("fit", "a.csv", "-o", "x", "--model", "other").exit_code == 2
    assert run("nonsense").exit_code == 2


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--dep", "0"), "dep = 0"),
        (("--Fy", "-5"), "Fy = -5"),
        (("--beta", "0.5"), "beta = 0.5"),
        (("--phi", "1.5"), "phi = 1.5"),
        (("--rate", "1"), "rate 1"),
        (("--last-cycles", "7"), "5 or 6"),
        (("--sigma-slow", "-1"), "sigma_slow = -1 kN"),
        (("--tau-slow", "0"), "tau_slow = 0"),
    ],
)
def test_simulate_refuses_in_words(tmp_path, options, words):
    result = run("simulate", "-o", tmp_path / "x", *options)
    assert result.exit_code == 1
    assert words in result.output
    assert not list(tmp_path.iterdir())


def test_simulate_writes_recordings_and_truth(tmp_path):
    result = run("simulate", "-o", tmp_path / "dev", "--rate", 4, "--dep", -60, "--Fy", 50, "--seed", 3)
    assert result.exit_code == 0
    truth = json.loads((tmp_path / "dev.json").read_text(encoding="utf-8"))
    assert truth["truth"]["Fy"] == 50
    assert truth["truth"]["gamma"] == pytest.approx(-1 / 60)
    assert truth["simulated"] is True
    first = (tmp_path / "dev-run1.csv").read_bytes()
    run("simulate", "-o", tmp_path / "again" / "dev", "--rate", 4, "--dep", -60, "--Fy", 50, "--seed", 3)
    assert (tmp_path / "again" / "dev-run1.csv").read_bytes() == first


def test_simulated_slow_noise_is_on_top_of_the_rest(tmp_path):
    series = {}
    for name, options in (("plain", ()), ("slow", ("--sigma-slow", 1.5, "--tau-slow", 4))):
        assert run("simulate", "-o", tmp_path / name, "--rate", 4, "--seed", 3, *options).exit_code == 0
        series[name] = np.loadtxt(tmp_path / f"{name}-run1.csv", delimiter=",", skiprows=2)
    assert np.array_equal(series["plain"][:, :2], series["slow"][:, :2])
    added = series["slow"][:, 2] - series["plain"][:, 2]
    assert 0.9 < added.std() < 2.1
    assert np.corrcoef(added[:-4], added[4:])[0, 1] > 0.6  # one second later
    truth = json.loads((tmp_path / "slow.json").read_text(encoding="utf-8"))
    assert (truth["truth"]["sigma_slow"], truth["truth"]["tau_slow"]) == (1.5, 4)
    assert (truth["units"]["sigma_slow"], truth["units"]["tau_slow"]) == ("kN", "s")


@pytest.fixture(scope="module")
def both_runs(recordings, tmp_path_factory) -> Path:
    """Two runs in one file, whose clock goes on after a rest without samples."""
    runs = [np.loadtxt(path, delimiter=",", skiprows=2) for path in recordings]
    runs[1][:, 0] += runs[0][-1, 0] + 60.0
    path = tmp_path_factory.mktemp("both") / "both.csv"
    np.savetxt(path, np.vstack(runs), delimiter=",", header="time_s,displacement_mm,force_kN", comments="")
    return path


def test_two_runs_in_one_file_are_refused_until_somebody_says(both_runs, tmp_path):
    refused = run("fit", both_runs, "-o", tmp_path / "out")
    assert refused.exit_code == 1
    assert "--runs 2, --split or --one-run" in refused.output
    assert run("check", both_runs, "--quiet").exit_code == 1
    assert run("check", both_runs, "--quiet", "--one-run").exit_code == 0
    assert run("check", both_runs, "--runs", 3).exit_code == 1
    assert run("check", both_runs, "--runs", 2, "--split").exit_code == 2
    checked = json.loads(run("check", both_runs, "--split", "--json").output)
    assert [facts["name"] for facts in checked] == ["both.csv run 1", "both.csv run 2"]


def test_two_runs_in_one_file_fit_as_two_files_do(both_runs, fitted, tmp_path):
    done = run("fit", both_runs, "-o", tmp_path, "--runs", 2, "--max-steps", 200, "--json")
    assert done.exit_code == 0, done.output
    record, apart = json.loads(done.stdout), json.loads((fitted / "fit.json").read_text(encoding="utf-8"))
    assert record["device"] == "both"
    assert [source["name"] for source in record["inputs"]] == ["both.csv run 1", "both.csv run 2"]
    assert len({source["sha256"] for source in record["inputs"]}) == 1
    for row, other in zip(record["parameters"], apart["parameters"], strict=True):
        assert row["name"] == other["name"]
        assert row["mean"] == pytest.approx(other["mean"], abs=0.5 * other["sd"])


def test_a_folder_of_another_device_is_refused_unless_forced(recordings, tmp_path):
    first, second = recordings
    assert run("fit", first, "-o", tmp_path, "--max-steps", 200, "--quiet").exit_code == 0
    before = (tmp_path / "fit.json").read_bytes()
    for command in ("fit", "diagnose"):
        refused = run(command, second, "-o", tmp_path)
        assert refused.exit_code == 1
        assert "another device, 'run1'" in refused.output
        assert "--force" in refused.output
    assert (tmp_path / "fit.json").read_bytes() == before
    assert run("fit", first, "-o", tmp_path, "--name", "renamed", "--max-steps", 200, "--quiet").exit_code == 0
    assert run("fit", second, "-o", tmp_path, "--force", "--max-steps", 400, "--quiet").exit_code == 0
    assert json.loads((tmp_path / "fit.json").read_text(encoding="utf-8"))["device"] == "run2"


def test_long_steps_are_told_before_they_begin_and_to_a_terminal_alone(recordings, capsys, monkeypatch):
    told = []
    device.read_device(recordings, FitOptions(), told.append)
    assert told == [f"reading {path.name}" for path in recordings]
    device.step_told("drawing the page")
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    device.step_told("drawing the page")
    assert capsys.readouterr().err == "  drawing the page\n"


def test_slips_of_one_fit_are_said(recordings, tmp_path):
    copy, rows = tmp_path / "copy.csv", np.loadtxt(recordings[0], delimiter=",", skiprows=2)
    rows[:, 0] += 500.0  # on another clock
    np.savetxt(copy, rows, delimiter=",", header="time_s,displacement_mm,force_kN", comments="", fmt="%.17g")
    twice = run("fit", recordings[0], copy, "-o", tmp_path / "twice", "--max-steps", 200)
    assert "run 2 (copy.csv) holds the same samples as run 1 (run1.csv)" in twice.output
    idle = run("fit", recordings[0], "-o", tmp_path / "idle", "--free", "K,beta", "--max-steps", 200)
    assert "K, beta cannot differ between runs where there is one run" in idle.output
    record = json.loads((tmp_path / "idle" / "fit.json").read_text(encoding="utf-8"))
    assert "free-without-effect" in {f["code"] for f in record["inputs"][0]["findings"]}


def test_unwritable_folder_is_one_line(recordings, tmp_path):
    (tmp_path / "file").write_text("x", encoding="utf-8")
    result = run("fit", recordings[0], "-o", tmp_path / "file" / "below", "--max-steps", 200)
    assert result.exit_code == 1
    assert "Traceback" not in result.output


def test_compare_without_a_population_says_what_to_run(tmp_path):
    result = run("compare", tmp_path, "a", "b")
    assert result.exit_code == 1
    assert "shj-bayes tables" in result.output


@pytest.mark.skipif(os.name == "nt", reason="sends a POSIX signal")
def test_an_interrupt_that_python_drops_stops_the_command_all_the_same(monkeypatch):
    """Python prints and ignores what is raised in a finalizer; Ctrl-C may come just there."""

    class Finalized:
        def __del__(self) -> None:
            raise KeyboardInterrupt

    def examine():
        Finalized()
        for _ in range(1000):
            time.sleep(0.01)

    monkeypatch.setattr("shj_bayes.app.device.examine", examine)
    begin = time.monotonic()
    result = run("doctor")
    assert result.exit_code == 1
    assert "stopped; the same command again begins anew" in result.output
    assert "Traceback" not in result.output
    assert time.monotonic() - begin < 5.0  # of ten


def test_interrupted_fit_says_how_to_go_on(recordings, tmp_path):
    command = "from shj_bayes.cli import main; main()"
    process = subprocess.Popen(
        [
            sys.executable,
            "-c",
            command,
            "fit",
            *map(str, recordings),
            "-o",
            str(tmp_path / "out"),
            "--max-steps",
            "900000",
        ],
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    checkpoint = tmp_path / "out" / "checkpoint.h5"
    for _ in range(600):
        if checkpoint.exists() or process.poll() is not None:
            break
        try:
            process.wait(0.1)
        except subprocess.TimeoutExpired:
            continue
    if process.poll() is None:
        process.send_signal(2)
    error = process.communicate(timeout=60)[1]
    if process.returncode != 0:  # a very fast machine may finish first
        assert process.returncode == 1
        assert "goes on from the last checkpoint" in error


@pytest.mark.parametrize(
    ("module", "unneeded"),
    [
        ("resume", {"scipy", "numba", "pandas", "xarray", "matplotlib"}),
        ("campaign", {"scipy.stats", "matplotlib", "openpyxl"}),
        ("design", {"scipy.stats", "matplotlib", "openpyxl", "xarray"}),
    ],
)
def test_commands_do_not_wait_for_libraries_that_they_may_not_need(module, unneeded):
    code = f"import sys, shj_bayes.app.{module}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not unneeded & set(done.stdout.split())


def test_a_recording_is_checked_without_scipy(tmp_path):
    """But for one whose motion has corners."""
    time_s = np.arange(0.0, 60.0, 0.05)
    force = np.clip(40.0 * np.cos(0.5 * time_s), -30.0, 30.0) + np.random.default_rng(1).normal(0.0, 0.1, time_s.size)
    path = tmp_path / "smooth.csv"
    rows = np.stack([time_s, 20.0 * np.sin(0.5 * time_s), force], axis=1)
    np.savetxt(path, rows, delimiter=",", header="time (s),displacement (mm),force (kN)", comments="")
    code = (
        "import sys, shj_bayes.cli as c\n"
        f"try: c.main(['check', {str(path)!r}, '--quiet'])\n"
        "finally: print([m for m in ('scipy', 'numba', 'pandas') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"
