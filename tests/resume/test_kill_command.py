"""The whole command killed and run again; ``make kill`` does it with others, and at more moments."""

import os
import runpy
import shutil
import signal
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

pytestmark = pytest.mark.skipif(not hasattr(os, "killpg"), reason="this system has no process groups")
SCRIPT = Path(__file__).with_name("kill.py")


@pytest.fixture(scope="module")
def kill():
    """Names of the script."""
    before = sys.modules.copy()
    names = runpy.run_path(str(SCRIPT), run_name="kill_script")
    yield names
    for name in set(sys.modules) - set(before):
        if name == "kill_script":
            del sys.modules[name]


@pytest.fixture(scope="module")
def whole(kill, tmp_path_factory):
    """A fit that was never stopped: arguments, folder, seconds."""
    folder = tmp_path_factory.mktemp("kill")
    arguments = kill["make_inputs"](folder, 400)["fit"]
    return arguments, folder / "reference", kill["finish"](arguments, folder / "reference")


@pytest.mark.parametrize("share", [pytest.param(0.5, marks=pytest.mark.slow), 0.8])
def test_a_killed_fit_resumes_to_the_same_bits(kill, whole, tmp_path, share):
    arguments, reference, seconds = whole
    result = kill["kill_and_resume"]("fit", arguments, reference, tmp_path / "killed", share * seconds)
    assert result.same
    assert result.half == ()
    assert result.left == ()


def test_the_comparison_sees_one_draw_that_differs(kill, whole, tmp_path):
    _, reference, _ = whole
    other = Path(shutil.copytree(reference, tmp_path / "other"))
    assert kill["same_bits"](reference, other)
    with h5py.File(other / "posterior.nc", "r+") as file:
        draws = file["posterior/K"]
        draws[0, 0] = np.nextafter(draws[0, 0], np.inf)
    assert not kill["same_bits"](reference, other)


def test_a_full_disk_is_one_line_and_earlier_results_stay(kill, whole, tmp_path):
    arguments, reference, _ = whole
    kept = {p.name: p.read_bytes() for p in reference.iterdir()}
    limited = ["bash", "-c", 'ulimit -f 16; exec "$@"', "bash", *kill["COMMAND"], *arguments, "--seed", "2", "--quiet"]
    done = kill["subprocess"].run([*limited, "--out", str(tmp_path / "full")], capture_output=True, check=False)
    said = done.stderr.decode().strip().splitlines()
    assert done.returncode == 1
    assert len(said) == 1
    assert "check the path, the rights and the free space" in said[0]
    assert not list((tmp_path / "full").rglob("*.part"))
    assert {p.name: p.read_bytes() for p in reference.iterdir()} == kept
    assert signal.SIGKILL
