"""Test with the oldest versions that pyproject.toml allows: ``python tests/minimum.py [-k FOLDER] [PYTEST ARGUMENTS]``.

Makes a virtual environment with every dependency at its lower bound, installs the project into it and runs the tests
that need no browser. The newest versions are what ``make test`` uses, so both ends of every range are tested.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
NEEDED = ("pytest", "hypothesis", "hatchling", "editables")  # to install and to test, at any version
TESTS = ("tests/unit", "tests/oracle", "tests/contract/test_registered_models.py", "tests/security", "tests/resume")


def lower_bounds(requirements: list[str]) -> list[str]:
    """Turn ``numpy>=1.26`` into ``numpy==1.26.*``, and ``emcee>=3.1.6,<4`` into ``emcee==3.1.6``."""
    pinned = []
    for requirement in requirements:
        match = re.match(r"([A-Za-z0-9_.-]+)>=([0-9.]+)", requirement)
        if match is None:
            raise SystemExit(f"{requirement} has no lower bound of the form name>=version; write one")
        name, version = match.groups()
        pinned.append(f"{name}=={version}" if version.count(".") >= 2 else f"{name}=={version}.*")
    return pinned


def main() -> int:
    """Make the environment, then test in it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-k", "--keep", type=Path, help="folder of the environment, kept; a temporary one by default")
    asked, arguments = parser.parse_known_args()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    with tempfile.TemporaryDirectory() as scratch:
        folder = asked.keep or Path(scratch) / "venv"
        python = folder / ("Scripts/python.exe" if sys.platform == "win32" else "bin/python")
        if not python.exists():
            venv.EnvBuilder(with_pip=True).create(folder)
        wanted = [*lower_bounds(project["dependencies"]), *NEEDED]
        pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
        for command in (
            [*pip, *wanted],
            [*pip, "--no-deps", "--no-build-isolation", "--editable", str(ROOT)],
        ):
            if subprocess.run(command, check=False).returncode:
                return 1
        freeze = subprocess.run([str(python), "-m", "pip", "freeze"], capture_output=True, text=True, check=True).stdout
        names = {re.split(r"[=<>]", w)[0].lower() for w in wanted[: -len(NEEDED)]}
        print(" ".join(line for line in freeze.splitlines() if line.split("==")[0].lower() in names), flush=True)
        tests = arguments or [*TESTS, "-m", "not slow", "-q"]
        # Warnings of old libraries about newer ones are not ours to mend, so they are not errors here.
        command = [str(python), "-m", "pytest", "-W", "default", "-p", "no:cacheprovider", *tests]
        return subprocess.run(command, cwd=ROOT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
