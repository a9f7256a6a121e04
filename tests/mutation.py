"""Break the package on purpose, one line at a time, and show which tests notice: ``python tests/mutation.py``.

Each breakage is made in a temporary copy of the checkout; the checkout itself is not touched. The tests of the rooms
concerned run there (a minute or two each on two processors), and a table of the failures is printed. Exit status 1 when
a breakage goes unnoticed, or when tests fail without one. ``--only NAME`` runs one, ``--list`` shows them.
Not collected by pytest: it runs pytest.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

TOP = Path(__file__).resolve().parents[1]
TESTS = (
    "tests/oracle/test_law.py",
    "tests/oracle/test_loop_energy.py",
    "tests/unit/model",
    "tests/unit/inference/test_posterior_density.py",
    "tests/unit/inference/test_binning.py",
    "tests/unit/inference/test_starting_point.py",
    "tests/unit/inference/test_floor.py",
    "tests/contract/test_registered_models.py",
)
READER_TESTS = ("tests/unit/recording",)
IGNORE = r"ignore:\s*ArviZ is undergoing a major refactor:FutureWarning"


@dataclass(frozen=True)
class Breakage:
    """One line changed."""

    name: str
    file: str
    old: str
    new: str
    tests: tuple[str, ...] = TESTS


BREAKAGES = (
    Breakage(
        "law: exponent 1/beta left out",
        "model/law.py",
        "    b = 1.0 / beta\n",
        "    b = 1.0\n",
    ),
    Breakage(
        "law: signed v instead of |v|",
        "model/law.py",
        "_span(out[j, a:b], x[a:b], speed[a:b], part,",
        "_span(out[j, a:b], x[a:b], direction[k] * speed[a:b], part,",
    ),
    Breakage(
        "noise: normalising constant left out",
        "model/filter.py",
        "value = work[TOTAL + lane] - 0.5 * math.log(work[PRODUCT + lane])",
        "value = work[TOTAL + lane]",
    ),
    Breakage(
        "noise: nothing is remembered",
        "model/filter.py",
        "work[STATE + lane] = f * work[STATE + lane] + gain * new",
        "work[STATE + lane] = 0.0",
    ),
    Breakage(
        "noise: an average remembered as if it were one sample",
        "model/filter.py",
        "h, f = before[c, j] * average, before[c, j] * last",
        "h, f = before[c, j] * average, before[c, j]",
    ),
    Breakage(
        "noise: averages as noisy as single samples",
        "model/filter.py",
        "one = 1.0 / np.maximum(self.kinds[self.kind, 0], 1.0)",
        "one = np.ones(self.kind.size)",
    ),
    Breakage(
        "noise: as rough at low speed as at speed",
        "model/filter.py",
        "np.stack([one * self.rough, one], axis=1)",
        "np.stack([one, one], axis=1)",
    ),
    Breakage(
        "noise: error of the turning points left out",
        "model/filter.py",
        "left = work[ACROSS + lane] - noise_turn[k] * work[ALONG + lane] * work[ALONG + lane] / spread",
        "left = work[ACROSS + lane]",
    ),
    Breakage(
        "reduction: unused samples averaged too",
        "inference/binning.py",
        "            if not used[i]:\n",
        "            if not used[i] and i < 0:\n",
    ),
    Breakage(
        "reduction: one point in the middle of each block",
        "inference/binning.py",
        "    double = (count > 1) & (spread > 1e-9 * stroke)\n",
        "    double = (count > 1) & (spread > 1e9 * stroke)\n",
    ),
    Breakage(
        "floor: the posterior is always believed",
        "inference/convergence.py",
        "np.where(told & (ratio > limit), ratio, 1.0)",
        "np.where(told & (ratio > 1e9), ratio, 1.0)",
    ),
    Breakage(
        "runs: ratio of the third run against the second",
        "model/device.py",
        '            capacity = capacity * theta[:, self.index(run_name("ratio", run))]\n',
        "            for i in range(2, run + 1):\n"
        '                capacity = capacity * theta[:, self.index(run_name("ratio", i))]\n',
    ),
    Breakage(
        "prior: Jacobian of the free space left out",
        "model/priors.py",
        "        return np.asarray(-0.5 * z**2 - 0.5 * np.log(2 * np.pi))",
        "        return np.asarray(0.0 * z)",
    ),
    Breakage(
        "reader: kip read as kN",
        "recording/units.py",
        "    return known[1]",
        '    return 1.0 if text == "kip" else known[1]',
        READER_TESTS,
    ),
    Breakage(
        "motion: the sampled extreme instead of the turning point",
        "recording/motion.py",
        "turning_mm=np.concatenate([[0.0], turning])",
        "turning_mm=np.concatenate([[0.0], (amplitude * np.sin(phase))[start[1:-1] - 1]])",
    ),
)


def failures(package: Path, tests: tuple[str, ...]) -> tuple[dict[str, int], str]:
    """Failed tests (function name to number of failed cases) in a copy, and the last line of pytest."""
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join((str(package / "src"), str(package / "validation"))),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    arguments = ["-q", "--tb=no", "-m", "not slow", "-p", "no:cacheprovider", "-o", f"filterwarnings=error\n{IGNORE}"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *arguments, *tests],
        cwd=package,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    found: dict[str, int] = {}
    for name in re.findall(r"^(?:FAILED|ERROR) \S*?::(?:\w+::)?(\w+)", done.stdout, flags=re.MULTILINE):
        found[name] = found.get(name, 0) + 1
    if done.returncode not in (0, 1) or (done.returncode == 1 and not found):
        found[f"pytest itself (exit {done.returncode})"] = 1
    return found, (done.stdout.strip().splitlines() or ["no output"])[-1]


def copy_of_checkout(folder: Path) -> Path:
    """What the tests need, without caches: a cached compilation would hide a change."""
    skip = shutil.ignore_patterns("__pycache__", "*.pyc")
    for part in ("src", "validation", "tests", "priors", "data"):
        shutil.copytree(TOP / part, folder / part, ignore=skip)
    shutil.copy(TOP / "pyproject.toml", folder)
    return folder


def trial(breakage: Breakage | None) -> tuple[dict[str, int], str]:
    """Copy, break, test."""
    with tempfile.TemporaryDirectory() as folder:
        package = copy_of_checkout(Path(folder))
        if breakage is None:
            return failures(package, (*TESTS, *READER_TESTS))
        path = package / "src" / "shj_bayes" / breakage.file
        text = path.read_text(encoding="utf-8")
        if text.count(breakage.old) != 1:
            return {}, f"the line to break is in {breakage.file} {text.count(breakage.old)} times; mend this script"
        path.write_text(text.replace(breakage.old, breakage.new), encoding="utf-8")
        return failures(package, breakage.tests)


def main() -> int:
    """Run the trials and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", metavar="NAME", help="breakages whose name contains this")
    parser.add_argument("--list", action="store_true", help="show the breakages and stop")
    options = parser.parse_args()
    chosen = [b for b in BREAKAGES if not options.only or options.only in b.name]
    if options.list:
        print("\n".join(b.name for b in chosen))
        return 0
    whole, last = trial(None)
    print(f"unbroken: {last}", flush=True)
    missed = bool(whole)
    for breakage in chosen:
        found, last = trial(breakage)
        missed |= not found
        print(f"\n{breakage.name}  [{breakage.file}]\n  {last if found else 'NOT NOTICED: ' + last}")
        for name, count in sorted(found.items(), key=lambda item: -item[1])[:6]:
            print(f"    {name}" + (f"  ({count} cases)" if count > 1 else ""))
        if len(found) > 6:
            print(f"    and {len(found) - 6} more")
        sys.stdout.flush()
    return int(missed)


if __name__ == "__main__":
    sys.exit(main())
