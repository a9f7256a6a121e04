"""Look the pinned packages up in the public list of known weaknesses: ``python tests/audit.py [FOLDER OF PIP-AUDIT]``.

pip-audit is not among the pinned packages, because it needs the network anyway and brings many packages of its own;
``make audit`` installs it into a folder beside the environment.
"""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def main() -> int:
    """Run pip-audit on the pinned requirements; without an answer for every package it is no audit, hence --strict."""
    extra = [str(Path(folder).resolve()) for folder in sys.argv[1:]]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(extra)}
    lists = [path for path in (ROOT / "requirements.txt", ROOT / "requirements-docs.txt") if path.exists()]
    given = [word for path in lists for word in ("--requirement", str(path))]
    command = [sys.executable, "-m", "pip_audit", "--strict", "--disable-pip", "--require-hashes", *given]
    return subprocess.run(command, env=environment, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
