"""Two processes never write into one results folder at the same time."""

import os
import signal
import socket
import subprocess
import sys

import pytest
from click.testing import CliRunner

from shj_bayes._util.files import LOCK, alone, write_text
from shj_bayes.cli import main
from shj_bayes.errors import ShjError
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.motion import Block
from shj_bayes.recording.recording import write_csv

HOLDER = """
import pathlib, sys, time
from shj_bayes._util.files import alone
with alone(pathlib.Path(sys.argv[1])):
    print(flush=True)
    time.sleep(60)
"""
MANIFEST = """schema = "shj-bayes/campaign/1"
diagnose = "off"
[[set]]
name = "a"
[[set.device]]
name = "b"
recordings = ["run.csv"]
"""
BLOCKS = (Block(12.0, 0.13, 2), Block(24.0, 0.067, 2))


@pytest.fixture
def holder(tmp_path):
    """Another process that is at work in a folder."""
    command = [sys.executable, "-c", HOLDER, str(tmp_path / "out")]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline()
        yield process
        process.kill()


def test_the_second_is_told_who_is_at_work(tmp_path, holder):
    run = str(write_csv(tmp_path / "run.csv", simulate_device(Truth(), seed=1, rate_Hz=6.0, blocks=BLOCKS)[0]))
    manifest = tmp_path / "c.toml"
    manifest.write_text(MANIFEST, encoding="utf-8")
    for words in (["fit", run], ["diagnose", "--quick", run], ["campaign", str(manifest)], ["tables"]):
        result = CliRunner().invoke(main, [*words, "-o", str(tmp_path / "out")])
        assert result.exit_code == 1
        said = f"out is being written into by process {holder.pid} on {socket.gethostname()}, since 20"
        assert said in result.output, words
        assert result.output.count("\n") == 1
    assert [path.name for path in (tmp_path / "out").iterdir()] == [LOCK]


def test_what_a_killed_process_left_is_taken_over(tmp_path, holder):
    holder.send_signal(getattr(signal, "SIGKILL", signal.SIGTERM))
    holder.wait()
    assert (tmp_path / "out" / LOCK).exists()
    with alone(tmp_path / "out"):
        assert str(os.getpid()) in (tmp_path / "out" / LOCK).read_text(encoding="utf-8")
    assert not list((tmp_path / "out").iterdir())


def test_threads_of_one_process_keep_each_other_out(tmp_path):
    with alone(tmp_path), pytest.raises(ShjError, match=f"written into by process {os.getpid()}"), alone(tmp_path):
        pass


def test_a_holder_that_has_not_said_who_it_is(tmp_path):
    with alone(tmp_path):
        (tmp_path / LOCK).write_bytes(b"[" * 100_000)
        with pytest.raises(ShjError, match="written into by another process"), alone(tmp_path):
            pass


def test_folders_that_stayed_empty_are_taken_away(tmp_path):
    with alone(tmp_path / "a" / "b"):
        assert (tmp_path / "a" / "b").is_dir()
    assert not (tmp_path / "a").exists()
    with alone(tmp_path / "a" / "b"):
        (tmp_path / "a" / "result").touch()
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["result"]


@pytest.mark.skipif(not hasattr(os, "O_NOFOLLOW"), reason="this system follows links")
def test_a_link_in_a_results_folder_is_not_written_through(tmp_path):
    (tmp_path / "mine").write_text("kept", encoding="utf-8")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / LOCK).symlink_to(tmp_path / "mine")
    with pytest.raises(OSError, match="symbolic"), alone(tmp_path / "out"):
        pass
    assert (tmp_path / "mine").read_text(encoding="utf-8") == "kept"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes in the file system")
@pytest.mark.parametrize("kind", ["hard link", "pipe"])
def test_what_is_no_file_of_its_own_is_not_written_into(tmp_path, kind):
    (tmp_path / "mine").write_text("kept", encoding="utf-8")
    (tmp_path / "out").mkdir()
    if kind == "pipe":
        os.mkfifo(tmp_path / "out" / LOCK)
    else:
        (tmp_path / "out" / LOCK).hardlink_to(tmp_path / "mine")
    with pytest.raises(ShjError, match=r"shj-bayes\.lock in out is no file of its own"), alone(tmp_path / "out"):
        pass
    assert (tmp_path / "mine").read_text(encoding="utf-8") == "kept"


@pytest.mark.parametrize("link", ["symlink_to", "hardlink_to"])
def test_what_is_written_beside_a_result_goes_through_no_link(tmp_path, link):
    (tmp_path / "mine").write_text("kept", encoding="utf-8")
    getattr(tmp_path / f"fit.json.{os.getpid()}.part", link)(tmp_path / "mine")
    write_text(tmp_path / "fit.json", "new")
    assert (tmp_path / "mine").read_text(encoding="utf-8") == "kept"
    assert (tmp_path / "fit.json").read_text(encoding="utf-8") == "new"
    assert {path.name for path in tmp_path.iterdir()} == {"mine", "fit.json"}
