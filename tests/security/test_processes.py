"""Nothing that lies beside a recording is run, and no process outlives the one that started it."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

import shj_bayes
from shj_bayes._util import imports, processes
from shj_bayes._util.processes import PYTHON, Workers

# As pip writes it for the entry point of pyproject.toml.
INSTALLED = "import sys\nfrom shj_bayes.cli import main\nif __name__ == '__main__':\n    sys.exit(main())\n"
SHADOWED = ("h5py", "html", "multiprocessing", "json", "numpy", "pickle", "shj_bayes", "nptdms", "sitecustomize")
MANIFEST = """schema = "shj-bayes/campaign/1"
[[set]]
name = "a"
[[set.device]]
name = "b"
recordings = ["run.h5"]
"""
ENDS_WITHIN_S = 2.0


@pytest.fixture
def folder(tmp_path):
    """Recordings with programs beside them that say so when they are run."""
    place = tmp_path / "recordings"
    place.mkdir()
    with h5py.File(place / "run.h5", "w") as file:
        for name in ("time_s", "displacement_mm", "force_kN"):
            file[name] = np.arange(60.0)
    (place / "campaign.toml").write_text(MANIFEST, encoding="utf-8")
    for name in SHADOWED:
        (place / f"{name}.py").write_text(f"import os\nos.close(os.open('{name}.ran', os.O_CREAT))\n", encoding="utf-8")
    return place


@pytest.fixture
def command(tmp_path):
    """The installed command."""
    script = tmp_path / "bin" / "shj-bayes"
    script.parent.mkdir()
    script.write_text(INSTALLED, encoding="utf-8")
    return [sys.executable, str(script)]


@pytest.mark.parametrize("arguments", [["check", "run.h5"], ["campaign", "campaign.toml", "-o", "out", "--quiet"]])
def test_nothing_beside_a_recording_is_run(folder, command, arguments):
    done = subprocess.run([*command, *arguments], cwd=folder, capture_output=True, text=True, check=False, timeout=300)
    assert sorted(path.name for path in folder.glob("*.ran")) == []
    assert done.returncode == 1, done.stderr
    said = done.stdout if arguments[0] == "check" else (folder / "out/campaign.json").read_text(encoding="utf-8")
    assert "run.h5" in said
    assert "gave up" not in said  # it was read, and refused for what it holds


def test_no_process_is_started_without_leaving_out_the_current_folder():
    """Every start of this Python in the source goes through `PYTHON`, `Workers`, or is isolated."""
    source = Path(shj_bayes.__file__).parent
    texts = {path.name: path.read_text(encoding="utf-8") for path in source.rglob("*.py")}
    starts = [name for name, text in texts.items() if "sys.executable" in text and '"-I"' not in text]
    assert starts == [name for name, text in texts.items() if "get_context" in text] == ["processes.py"]


def test_only_our_own_processes_leave_the_current_folder_out(monkeypatch):
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    with Workers(1) as pool:
        assert pool.submit(os.getenv, "PYTHONSAFEPATH").result() == "1"
    assert "PYTHONSAFEPATH" not in os.environ  # what a user's script starts is its own affair


SETTINGS = """
import shj_bayes.model.law, matplotlib, numba, os
from shj_bayes._util.imports import arviz
numba.njit(lambda x: x + 1)(1)
saved = arviz().rcParams["data.save_warmup"]
print(os.getcwd(), matplotlib.rcParams["text.usetex"], saved, repr(numba.config.CACHE_DIR))
"""


def test_settings_of_libraries_beside_a_recording_do_not_hold(tmp_path, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    (tmp_path / ".numba_config.yaml").write_text("cache_dir: evil\n", encoding="utf-8")
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\n", encoding="utf-8")
    (tmp_path / "arvizrc").write_text("data.save_warmup: True\n", encoding="utf-8")
    done = subprocess.run(
        [*PYTHON, "-c", SETTINGS], cwd=tmp_path, capture_output=True, text=True, check=True, timeout=300
    )
    assert done.stdout.split() == [str(tmp_path), "False", "False", "''"]


def test_a_folder_that_is_gone_stops_no_import(tmp_path, monkeypatch):
    def gone():
        raise FileNotFoundError

    monkeypatch.setattr(os, "getcwd", gone)
    with imports._moved():
        pass


def test_programs_are_not_taken_from_the_current_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    git = tmp_path / "git"
    git.write_text("#!/bin/sh\n", encoding="utf-8")
    git.chmod(0o755)
    monkeypatch.setenv("PATH", os.pathsep.join(["", ".", str(tmp_path / "none")]))
    assert shutil.which("git") is not None  # as on Windows with any path
    assert processes.program("git") is None
    monkeypatch.setenv("PATH", str(tmp_path))
    assert processes.program("git") == str(git)


# ---- the end of a parent ----

POOL = """
import os, sys, time
from shj_bayes._util.processes import Workers
if __name__ == "__main__":
    with Workers(2) as pool:
        begun = set()
        while len(begun) < 2:  # one that is killed while it starts has Python tell so
            begun |= {one.result() for one in [pool.submit(os.getpid) for _ in range(4)]}
        print(*begun, flush=True)
        list(pool.map(time.sleep, [60, 60]))
"""
CHILD = """
import os, time
from shj_bayes._util.processes import end_with_input
end_with_input()
print(os.getpid(), flush=True)
time.sleep(60)
"""
TETHER = f"""
import subprocess
from shj_bayes._util.processes import PYTHON, tether
with tether() as end:
    subprocess.run([*PYTHON, "-c", {CHILD!r}], stdin=end)
"""


def alive(pid: int) -> bool:
    """Whether a process runs (one that has ended and waits to be collected does not)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes in /proc")
@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
@pytest.mark.parametrize("script", [POOL, TETHER], ids=["pool", "tether"])
def test_children_end_with_their_parent(tmp_path, script, end):
    path = tmp_path / "parent.py"
    path.write_text(script, encoding="utf-8")
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, str(path)], **pipes, text=True) as parent:
        children = [int(word) for word in parent.stdout.readline().split()]
        assert children
        assert all(map(alive, children))
        parent.send_signal(end)
        deadline = time.monotonic() + ENDS_WITHIN_S
        while any(map(alive, children)) and time.monotonic() < deadline:
            time.sleep(0.02)
        left = [pid for pid in children if alive(pid)]
        for pid in left:
            os.kill(pid, signal.SIGKILL)
        said = parent.stderr.read()
    assert left == []
    assert said == ""  # no library tells what it cleaned up


def test_the_worker_of_the_proof_ends_with_its_input_in_the_midst_of_a_trial(tmp_path):
    (tmp_path / "run1.csv").write_text("time_s,displacement_mm,force_kN\n", encoding="utf-8")
    slow = "import time, shj_validation.proof.worker as w; w.serve(lambda *_: time.sleep(60))"
    command = [*PYTHON, "-c", slow]
    with subprocess.Popen([*command, str(tmp_path)], stdin=subprocess.PIPE, cwd=tmp_path) as process:
        process.stdin.write(b'{"files": ["run1.csv"]}\n')
        process.stdin.close()
        begin = time.monotonic()
        try:
            assert process.wait(60) == 0
        finally:
            process.kill()
    assert time.monotonic() - begin < 50
