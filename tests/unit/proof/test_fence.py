"""Behind the fence nothing leads to a key: not its file, not the code that draws it, not the process's parent."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from shj_bayes.errors import ProofError
from shj_validation.proof import pool
from shj_validation.proof.cases import draw_keys
from shj_validation.proof.pool import Blind
from shj_validation.proof.run import write_recordings

CHEAT = """
import json, sys
from pathlib import Path
folder, key, home = map(Path, sys.argv[1:4])
from shj_validation.proof.blind import diagnose_blind
from shj_validation.proof.fence import raise_fence
raise_fence(folder)
import os, socket, subprocess
def parent():
    return Path(f"/proc/{os.getppid()}/cmdline").read_bytes()
tries = {
    "the key": lambda: key.read_text(),
    "the key by descriptor": lambda: os.open(key, os.O_RDONLY),
    "the key through a link": lambda: (folder / "link").read_text(),
    "its folder": lambda: os.listdir(home),
    "its folder again": lambda: list(os.scandir(home)),
    "the code of keys": lambda: __import__("shj_validation.proof.cases"),
    "the code of recordings": lambda: __import__("shj_validation.proof.make"),
    "the simulators": lambda: __import__("shj_validation.proof.simulators.bolt"),
    "another process": lambda: subprocess.run([sys.executable, "-c", "print(1)"]),
    "a shell": lambda: os.system("true"),
    "a fork": lambda: os.fork(),
    "the network": lambda: socket.socket(),
    "the parent": parent,
    "writing": lambda: (home / "note").write_text("x"),
    "a link to the key": lambda: os.symlink(key, folder / "own"),
}
out = {}
for name, action in tries.items():
    try:
        action()
        out[name] = "done"
    except PermissionError as error:
        out[name] = "refused"
    except Exception as error:
        out[name] = type(error).__name__
out["recordings"] = (folder / "run1.csv").read_text()[:4]
print(json.dumps(out))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="the attempts are those of POSIX")
def test_every_way_to_a_key_is_refused(tmp_path):
    folder, home = tmp_path / "blind", tmp_path / "proof"
    folder.mkdir()
    home.mkdir()
    key = home / "secret.json"
    key.write_text("{}", encoding="utf-8")
    (folder / "run1.csv").write_text("time", encoding="utf-8")
    (folder / "link").symlink_to(key)
    command = [sys.executable, "-I", "-c", CHEAT, str(folder), str(key), str(home)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    answers = json.loads(done.stdout)
    assert answers.pop("recordings") == "time"
    assert {name: word for name, word in answers.items() if word != "refused"} == {}


def test_the_fence_is_refused_where_keys_are_known(tmp_path):
    code = (
        "import shj_validation.proof.cases, sys, pathlib\n"
        "from shj_validation.proof.fence import raise_fence\n"
        "raise_fence(pathlib.Path(sys.argv[1]))\n"
    )
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode != 0
    assert "must be raised in a fresh process" in done.stderr


def test_the_worker_is_told_nothing_and_answers(tmp_path):
    """Arguments and environment of the process hold a scratch folder and nothing of the trial; it does diagnose."""
    paths = write_recordings(draw_keys(31, 4)[0], tmp_path / "0001")
    blind = Blind()
    try:
        told = [str(word) for word in blind._process.args]
        assert told[1:4] == ["-I", "-m", "shj_validation.proof.worker"]
        assert len(told) == 5
        assert Path(told[4]) == blind.folder
        assert not blind.folder.is_relative_to(tmp_path)
        record = blind.diagnose(paths, intervals=False)
    finally:
        blind.close()
    assert record["schema"] == "shj-bayes/diagnosis/2"
    assert not blind.folder.exists()


def test_what_diagnoses_must_be_what_was_asked_for(tmp_path, monkeypatch):
    """A worker of another installation than the one that scores would prove another engine."""
    (tmp_path / "run1.csv").write_text("nothing\n")
    blind = Blind()
    try:
        assert set(blind.diagnose([tmp_path / "run1.csv"])) == {"error"}
        monkeypatch.setattr(pool, "INSTALLED", "elsewhere")
        with pytest.raises(ProofError, match="this one runs that in elsewhere"):
            blind.diagnose([tmp_path / "run1.csv"])
    finally:
        blind.close()
