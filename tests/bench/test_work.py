"""What the processes of a bench do is what the commands do; a check says what recordings can tell."""

import json
import os
import shutil
import signal
import time
from pathlib import Path

import numpy as np
import pytest
from serving import Served, write_device

from shj_bayes.app.manifest import read_manifest
from shj_bayes.bench import work
from shj_bayes.bench.session import Session, place_for
from shj_bayes.cli import main
from shj_bayes.errors import ReportError
from shj_bayes.results.device import read_group
from shj_bayes.results.store import content_of


def quiet(share: float | None, words: str) -> None:
    """Tell nobody."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bench with one device of two runs, in the folder of a set."""
    place = tmp_path_factory.mktemp("work") / "bench"
    session = Session(place)
    for path in write_device(tmp_path_factory.mktemp("given"), "a-1", seed=3):
        target = place_for(session, path.name)
        shutil.copyfile(path, target)
        session.add(target)
    return place


def test_a_check_foretells_the_fit(folder: Path) -> None:
    told = work.check(folder, "a", "a-1", quiet)
    assert told["passed"]
    assert [row["name"] for row in told["rows"]][:5] == ["K", "Fy", "beta", "gamma", "ratio"]
    assert set(told["viewer"]["runs"][0]) >= {"t", "x", "measured", "before"}
    assert len(told["viewer"]["runs"]) == 2
    assert json.loads(json.dumps(told)) == told
    assert {row["test"] != "" for row in told["confusions"]} <= {True}


def test_what_never_slides_does_not_pass(tmp_path: Path) -> None:
    session = Session(tmp_path)
    t = np.arange(0, 60, 0.1)
    x = 0.5 * np.sin(0.6 * t)
    rows = "\n".join(f"{a:.2f},{b:.4f},{18 * b:.4f}" for a, b in zip(t, x, strict=True))
    path = place_for(session, "elastic.csv")
    path.write_text(f"time_s,displacement_mm,force_kN\n{rows}\n", encoding="utf-8")
    session.add(path)
    told = work.check(tmp_path, "Set 1", "elastic", quiet)
    assert not told["passed"]
    assert told["reasons"]


def test_the_same_device_through_bench_and_command(folder: Path, tmp_path: Path) -> None:
    steps: list[tuple[float | None, str]] = []
    work.fit(folder, "a", "a-1", 1, lambda share, words: steps.append((share, words)))
    shares = [share for share, _ in steps if share is not None]
    assert shares
    assert shares == sorted(shares)
    other = tmp_path / "by-command"
    with pytest.raises(SystemExit) as ended:
        main(["campaign", str(folder / "campaign.toml"), "-o", str(other), "--quiet", "--workers", "1"])
    assert ended.value.code == 0
    place = read_manifest(folder / "campaign.toml").devices[0].folder
    for name in ("summary.csv", "residual.json"):
        assert (folder / place / name).read_bytes() == (other / place / name).read_bytes()
    mine, theirs = (read_group(one / place, "posterior") for one in (folder, other))
    assert all(np.array_equal(mine[name], theirs[name]) for name in theirs)
    for name in ("fit.json", "diagnosis/diagnosis.json"):
        mine_said, their_said = (content_of(one / place / name, ReportError) for one in (folder, other))
        for said in (mine_said, their_said):
            for times in ("created", "digest", "files", "seconds", "timing"):
                said.pop(times, None)
        assert mine_said == their_said
    pooled = work.pool(folder, 1, quiet)
    assert pooled["usable"]
    assert (folder / "margins.csv").read_bytes() == (other / "margins.csv").read_bytes()
    card = work.card(folder, {"connections": 7}, quiet)
    assert any("7 connections" in line["use"] for line in card["cards"][0]["lines"])
    state = work.overview(folder, quiet)
    assert state["pooled"]
    assert state["devices"][0]["fit"]
    assert state["devices"][0]["pages"] == ["report", "diagnosis"]


def test_a_recording_without_units_shows_its_columns(tmp_path: Path) -> None:
    path = tmp_path / "bare.csv"
    path.write_text("a;b;c\n" + "\n".join(f"{i};{i % 7};{i % 5}" for i in range(100)), encoding="utf-8")
    told = work.read_file(tmp_path, path, {}, quiet)
    assert told["error"]
    assert told["columns"] == ["a", "b", "c"]
    assert len(told["rows"]) == work.FIRST_ROWS
    assert told["form"]


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL here")
def test_killed_it_leaves_no_process_and_opens_again(tmp_path: Path) -> None:
    bench = Served.on(tmp_path / "killed")
    bench.enter()
    for path in write_device(tmp_path, "k-1", seed=4):
        assert bench.ask("PUT", f"/api/files?name={path.name}", path.read_bytes())[0] == 200
    device = bench.ask("GET", "/api/state")[1]["sets"][0]["devices"][0]
    assert bench.ask("POST", f"/api/devices/{device['id']}/fit")[0] == 200
    time.sleep(0.5)
    children = _children(bench.process.pid)
    assert children
    bench.process.kill()
    bench.process.communicate(timeout=30)
    for _ in range(100):
        if not any(map(_runs, children)):
            break
        time.sleep(0.1)
    assert not any(map(_runs, children))
    again = Served.on(tmp_path / "killed")
    again.enter()
    state = again.ask("GET", "/api/state")[1]
    assert [one["name"] for one in state["files"]] == ["k-1-run1.csv", "k-1-run2.csv"]
    assert again.ask("GET", "/api/state", Cookie=bench.cookie)[0] == 403
    again.end()


def _children(pid: int) -> list[int]:
    told = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(word) for one in told for word in one.read_text(encoding="ascii").split()]


def _runs(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    state = Path(f"/proc/{pid}/stat")
    return not (state.exists() and state.read_text(encoding="ascii").rsplit(")", 1)[1].split()[0] == "Z")
