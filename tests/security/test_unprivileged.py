"""A user who may write nearly nowhere, and a clock that was set back: one line at most, and nothing lost."""

import os
import shutil
import subprocess
import sys
import time

import pytest

from shj_bayes._util import imports
from shj_bayes.app.device import fit_device
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.options import FitOptions
from shj_bayes.recording.motion import Block
from shj_bayes.recording.recording import write_csv

BLOCKS = (Block(12.0, 0.13, 2), Block(24.0, 0.067, 2))
DROP = ("setpriv", "--inh-caps=-all", "--bounding-set=-all")  # root without the right to write everywhere
ROOT = hasattr(os, "geteuid") and os.geteuid() == 0
pytestmark = pytest.mark.skipif(
    not hasattr(os, "geteuid") or (ROOT and not shutil.which("setpriv")), reason="needs a user without rights"
)


@pytest.fixture
def run(tmp_path):
    return write_csv(tmp_path / "run.csv", simulate_device(Truth(phi=0.3), seed=1, rate_Hz=4.0, blocks=BLOCKS)[0])


@pytest.fixture
def locked(tmp_path):
    folder = tmp_path / "locked"
    folder.mkdir()
    folder.chmod(0o555)
    yield folder
    folder.chmod(0o755)


def fit(run, out, locked):
    command = [sys.executable, "-c", "from shj_bayes.cli import main; main()", "fit", str(run), "-o", str(out)]
    command = [*(DROP if ROOT else ()), *command, "--quiet", "--max-steps", "200"]
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("XDG_", "MPL"))}
    environment |= {"HOME": str(locked), "NUMBA_CACHE_DIR": str(locked)}
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


def test_a_home_and_a_cache_that_cannot_be_written_into(run, tmp_path, locked):
    done = fit(run, tmp_path / "out", locked)
    assert (tmp_path / "out" / "report.html").exists()
    assert done.stderr.count("\n") <= 1  # the verdict of so short a fit
    assert "Traceback" not in done.stderr
    assert not list(locked.iterdir())


def test_an_output_folder_that_cannot_be_written_into(run, locked):
    for out in (locked, locked / "x"):
        done = fit(run, out, locked)
        assert done.returncode == 1
        assert (
            done.stderr == f"shj-bayes: Permission denied ({out.name}); check the path, the rights and the free space\n"
        )


def test_numba_has_a_cache_of_its_own_where_it_finds_none(monkeypatch):
    class Numba:
        @staticmethod
        def njit(cache):
            raise RuntimeError("no locator available")

    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    imports._cache_somewhere(Numba)
    folder = os.environ["NUMBA_CACHE_DIR"]
    assert os.stat(folder).st_mode & 0o077 == 0
    monkeypatch.setenv("NUMBA_CACHE_DIR", "")


def test_a_clock_that_was_set_back_loses_nothing(run, tmp_path):
    out = tmp_path / "out"
    first = fit_device([run], out, FitOptions(max_steps=60))
    later = time.time() + 86_400
    for path in (run, *out.iterdir()):
        os.utime(path, (later, later))
    kept = fit_device([run], out, FitOptions(max_steps=60))
    assert not kept.fresh
    assert kept.record == first.record
    other = fit_device([run], out, FitOptions(max_steps=60, seed=2))
    assert other.fresh
    assert other.record.key != first.record.key
    for path in out.iterdir():
        os.utime(path, (later, later))
    fit_device([run], out, FitOptions(max_steps=60), page=False)  # as one that is killed before it draws
    assert not (out / "report.html").exists()  # else the page of the other one would be kept: it seems newer
