"""Everyday tasks without make: ``python tasks.py demo`` (Windows: ``py -3.11 tasks.py demo``).

install  install into .venv, and nothing else; every other task does so first
demo     run the whole job on data that ship with the project
test     run the tests
lint     ruff, mypy, and the limits of the tree (tests/house.py)
check    the gates: ruff, mypy, imports, tests
install-docs  install what builds the documentation site
install-reference  install the analysis program that exported materials are tested in
docs     build the documentation site into build/docs; a warning or a link to nowhere is an error
prove    200 concealed-effect trials, sealed, diagnosed, opened, scored (under an hour; goes on where it stopped)
fuzz     read 6000 damaged files of every kind; a traceback, a hang or a garbled refusal is an error (15 minutes)
robust   fit, diagnose, plan and margins on 200 cut, joined, scaled recordings; a traceback is an error (hours; resumes)
kill     kill commands at random moments, run them again, compare every file; full disk, lost folder (30 minutes)
thousand a campaign of 1000 devices, 5 % of them broken, a worker killed midway (about 40 minutes)
calibrate  ranks and coverage of 300 simulated devices, predictions and diagnosed devices (goes on where it stopped);
           the pages are kept in reports
audit    look every pinned package up in the public list of known weaknesses (needs the network)
minimum  the tests with the oldest versions of all dependencies that pyproject.toml allows
recover  fit recordings simulated from the 25 published rows and print where the truth lies (about 15 minutes)
bench    the whole job in the browser (with make: make bench-app)
speed    speed: the law, the likelihood, a fit, proposals, effects, population, other samplers (an hour)

Only the standard library is used here, because this file runs before anything is installed.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
BIN = VENV / ("Scripts" if sys.platform == "win32" else "bin")
PYTHON = BIN / ("python.exe" if sys.platform == "win32" else "python")
TOOL = BIN / ("shj-bayes.exe" if sys.platform == "win32" else "shj-bayes")
STAMP = VENV / "installed-from"

QUIET = ("--quiet", "--disable-pip-version-check", "--no-compile")  # Python compiles what is imported

TASKS: dict[str, list[list[str]]] = {
    "install": [],
    "demo": [[str(TOOL), "demo", "--out", "shj-bayes-demo"]],
    "test": [
        [str(PYTHON), "-m", "pytest", "-m", "not slow", "-n", "2", "--dist", "loadfile", "--no-loadscope-reorder"]
    ],
    "lint": [
        [str(PYTHON), "-m", "ruff", "check", "."],
        [str(PYTHON), "-m", "ruff", "format", "--check", "."],
        [str(PYTHON), "-m", "mypy"],
        [str(PYTHON), "tests/house.py"],
    ],
    "install-docs": [
        [str(PYTHON), "-m", "pip", "install", *QUIET, "--require-hashes", "-r", "requirements-docs.txt"],
    ],
    "install-reference": [
        [str(PYTHON), "-m", "pip", "install", *QUIET, "--require-hashes", "-r", "tests/requirements-reference.txt"],
    ],
    "prove": [[str(TOOL), "prove", "-n", "200", "--workers", "2", "--out", "shj-bayes-proof"]],
    "fuzz": [[str(PYTHON), "tests/fuzz/run.py", "-n", "6000"]],
    "robust": [[str(PYTHON), "tests/robust/robust.py", "-n", "200"]],
    "golden": [[str(PYTHON), "tests/golden/golden.py"]],
    "kill": [[str(PYTHON), "tests/resume/kill.py"]],
    "thousand": [[str(PYTHON), "benchmarks/thousand.py"]],
    "calibrate": [
        [str(PYTHON), "-m", "shj_validation.calibrate", part, "-n", "300", "--seed", seed]
        for part, seed in (("device", "7200"), ("margins", "7000"), ("noise", "7000"))
    ],
    "audit": [
        [str(PYTHON), "-m", "pip", "install", *QUIET, "--target", "build/audit", "pip-audit"],
        [str(PYTHON), "tests/audit.py", "build/audit"],
    ],
    "minimum": [[str(PYTHON), "tests/minimum.py"]],
    "recover": [[str(PYTHON), "benchmarks/recover.py"]],
    "speed": [[str(PYTHON), "benchmarks/bench.py"]],
    "bench": [[str(TOOL), "bench"]],
    "bench-app": [[str(TOOL), "bench"]],
}
TASKS["check"] = [*TASKS["lint"], *TASKS["test"]]
TASKS["docs"] = [
    *TASKS["install-docs"],
    [str(PYTHON), "-m", "sphinx", "-W", "--keep-going", "-q", "docs", "build/docs"],
]


def main() -> int:
    """Install what is missing, then run the task; the first failing command ends it."""
    if sys.version_info < (3, 11):
        print(f"shj-bayes needs Python 3.11 or newer; this is {sys.version.split()[0]}", file=sys.stderr)
        return 1
    if len(sys.argv) != 2 or sys.argv[1] not in TASKS:
        print(__doc__, file=sys.stderr)
        return 2
    install()
    return next((code for code in map(run, TASKS[sys.argv[1]]) if code), 0)


def install() -> None:
    """Create .venv from the hash-pinned requirements; again only when those or the project's metadata change."""
    content = b"".join((ROOT / name).read_bytes() for name in ("requirements.txt", "pyproject.toml"))
    digest = hashlib.sha256(content + sys.version.encode()).hexdigest()
    if STAMP.exists() and STAMP.read_text(encoding="utf-8") == digest:
        return
    print("installing into .venv (a minute or two, once)", file=sys.stderr, flush=True)
    if not PYTHON.exists():
        venv.EnvBuilder(with_pip=True, symlinks=sys.platform != "win32").create(VENV)
    pip = [str(PYTHON), "-m", "pip", "install", *QUIET]
    for command in (
        [*pip, "--require-hashes", "-r", "requirements.txt"],
        [*pip, "--no-deps", "--no-build-isolation", "--editable", "."],
    ):
        if run(command):
            sys.exit("installation failed; the lines above say why. Delete .venv to start anew")
    STAMP.write_text(digest, encoding="utf-8")


def run(command: list[str]) -> int:
    """Run one command in the project's folder; Ctrl-C ends it like any other exit."""
    environment = dict(os.environ)
    # Tests start a hundred processes, and most of the start of one is to compile what it imports.
    if environment.pop("PYTHONDONTWRITEBYTECODE", ""):
        environment["PYTHONPYCACHEPREFIX"] = str(ROOT / "build" / "compiled")
    try:
        return subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
