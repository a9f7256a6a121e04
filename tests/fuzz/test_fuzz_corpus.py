"""A short run of the corpus (``python tests/fuzz/run.py`` is the long one), and the cases that once were breaches."""

import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
READ = """
import resource, sys, time
from pathlib import Path
from shj_bayes.errors import RecordingError
from shj_bayes.recording.reader import read
for name in sys.argv[2:]:
    bound = resource.RLIM_INFINITY if name.endswith(".h5") else 3 * 2**29  # what reads HDF5 has a bound of its own
    resource.setrlimit(resource.RLIMIT_AS, (bound, resource.RLIM_INFINITY))
    begin = time.process_time()
    try:
        read(Path(sys.argv[1]) / name)
        said = "read"
    except RecordingError as error:
        said = str(error)
    taken = time.process_time() - begin
    print(name, said if taken < 10 else f"{taken:.0f} s", sep="\\t", flush=True)
largest = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss  # KB
print("memory", "bounded" if largest < 1_500_000 else f"{largest} KB", sep="\\t")
"""


@pytest.fixture
def runner(monkeypatch):
    """The runner, with its folder on the path as when it is started by hand."""
    monkeypatch.syspath_prepend(str(HERE))
    import run  # noqa: PLC0415

    yield run
    for name in ("run", "corpus", "damage", "originals", "attack", "bombs"):
        sys.modules.pop(name, None)


@pytest.mark.skipif(sys.platform == "win32", reason="the runner bounds memory as POSIX systems do")
def test_no_breach_in_a_short_run(runner):
    assert runner.run(300, seed=2, results=False, show=False) == []


@pytest.mark.skipif(sys.platform == "win32", reason="the bound on the memory is that of POSIX systems")
def test_small_files_that_would_take_all_are_refused_for_what_they_are(runner, tmp_path):
    """In a process that may take 1.5 GB, within 10 s of work each."""
    import bombs  # noqa: PLC0415

    for name, content in bombs.bombs(tmp_path).items():
        (tmp_path / name).write_bytes(content)
    done = subprocess.run(
        [sys.executable, "-c", READ, str(tmp_path), *bombs.SAID],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    said = dict(line.split("\t") for line in done.stdout.splitlines())
    assert said.get("memory", done.stderr) == "bounded"
    assert {name: words for name, words in bombs.SAID.items() if words not in said.get(name, done.stderr)} == {}


def test_the_attack_sees_a_breach(runner, tmp_path, monkeypatch):
    """A corpus that could find nothing would prove nothing."""
    import attack  # noqa: PLC0415
    from corpus import Case  # noqa: PLC0415

    case = Case(0, "recording", "run.csv", b"time_s,displacement_mm,force_kN\n1,2,3\n", {})

    def broken(*_, **__):
        raise ZeroDivisionError("as in a reader that divides by what a file says")

    monkeypatch.setattr(attack, "check_recording", broken)
    assert attack.attack(case, tmp_path).startswith("BREACH ZeroDivisionError")
    said = "run.csv: \x1b]0;title\x07 is no number"
    monkeypatch.setattr(attack, "check_recording", lambda *_, **__: [({"error": said, "usable": False}, said)])
    assert attack.attack(case, tmp_path).startswith("BREACH control characters")


def test_a_process_that_dies_or_hangs_is_a_breach(runner, tmp_path, monkeypatch):
    script = tmp_path / "worker.py"
    monkeypatch.setattr(runner, "__file__", str(script))
    monkeypatch.setattr(runner, "HANG_S", 0.5)
    for body, words in (("import os; os.abort()", "died with status"), ("import time; time.sleep(60)", "no answer")):
        script.write_text(f"print('7\\tbegin\\trecording\\trun.csv', flush=True)\n{body}\n")
        breaches = []
        assert runner._watched(1, 7, 10, tmp_path, __import__("collections").Counter(), breaches) == 8
        assert breaches[0][0] == 7
        assert words in breaches[0][2]
