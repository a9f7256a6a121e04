"""Everyday tasks without make: ``python tasks.py demo`` (Windows: ``py -3.11 tasks.py demo``).

demo     install into .venv and run the whole job on data that ship with the project
test     install and run the tests
check    the gates: ruff, mypy, imports, tests
recover  fit recordings simulated from the 25 published rows and print where the truth lies (about 15 minutes)
bench    the law, the moves and the population model, measured

Only the standard library is used here, because this file runs before anything is installed.
"""

from __future__ import annotations

import hashlib
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

TASKS: dict[str, list[list[str]]] = {
    "demo": [[str(TOOL), "demo", "--out", "shj-bayes-demo"]],
    "test": [[str(PYTHON), "-m", "pytest", "-m", "not slow", "-n", "2"]],
    "check": [
        [str(PYTHON), "-m", "ruff", "check", "."],
        [str(PYTHON), "-m", "ruff", "format", "--check", "."],
        [str(PYTHON), "-m", "mypy"],
        [str(PYTHON), "-m", "pytest", "-m", "not slow", "-n", "2"],
    ],
    "recover": [[str(PYTHON), "benchmarks/recover.py"]],
    "bench": [[str(PYTHON), f"benchmarks/{name}.py"] for name in ("law", "moves", "population")],
}


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
    pip = [str(PYTHON), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    for command in (
        [*pip, "--require-hashes", "-r", "requirements.txt"],
        [*pip, "--no-deps", "--no-build-isolation", "--editable", "."],
    ):
        if run(command):
            sys.exit("installation failed; the lines above say why. Delete .venv to start anew")
    STAMP.write_text(digest, encoding="utf-8")


def run(command: list[str]) -> int:
    """Run one command in the project's folder; Ctrl-C ends it like any other exit."""
    try:
        return subprocess.run(command, cwd=ROOT, check=False).returncode
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
