"""What users wait for, whole commands: ``python benchmarks/commands.py`` (names of rows choose some of them).

Wall and processor time of each, the latter of all its processes, as the shortest of some runs; and the wall time in
units of a least squares that this machine solves between the commands, since seconds alone do not carry over.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from timing import best

from shj_bayes._util.files import shipped

COMMAND = (sys.executable, "-P", "-m", "shj_bayes")
IMPORTS = "import shj_bayes.app.device, shj_bayes.report.device"  # what a fit loads before it reads a recording
LEAST_SQUARES, COLUMNS = 60_000, 100  # rows and unknowns of the reference work


def rows(made: Path, out: Path) -> dict[str, tuple[int, tuple[str, ...]]]:
    """Repeats and words of each command."""
    short, long = ([str(made / f"{stem}-run{run}.csv") for run in (1, 2)] for stem in ("short", "long"))
    manifest, new = str(shipped("data", "examples", "campaign.toml")), ("-o", str(out))
    return {
        "start of a fit": (5, (sys.executable, "-P", "-c", IMPORTS)),
        "check": (3, (*COMMAND, "check", *short)),
        "fit": (3, (*COMMAND, "fit", *short, *new)),
        "fit-long": (1, (*COMMAND, "fit", *long, *new)),
        "diagnose-quick": (1, (*COMMAND, "diagnose", "--quick", *short, *new)),
        "campaign": (1, (*COMMAND, "campaign", manifest, "--diagnose", "off", *new)),
        "campaign-quick": (1, (*COMMAND, "campaign", manifest, "--diagnose", "quick", *new)),
        "demo": (1, (*COMMAND, "demo", *new)),
    }


def least_squares() -> float:
    """Seconds of the reference work."""
    table = np.random.default_rng(1).standard_normal((LEAST_SQUARES, COLUMNS + 1))
    return best(lambda: np.linalg.lstsq(table[:, 1:], table[:, 0]), 3)


def timed(words: tuple[str, ...]) -> tuple[float, float]:
    """Wall and processor time of a command, s."""
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="rows; all by default")
    names = parser.parse_args().names
    os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
    with TemporaryDirectory() as scratch:
        made = Path(scratch)
        for stem, rate in (("short", "20"), ("long", "1000")):
            subprocess.run([*COMMAND, "simulate", "-o", made / stem, "--rate", rate, "--dep", "60"], check=True)
        subprocess.run([*COMMAND, "fit", made / "short-run1.csv", "-o", made / "warm", "--quiet"], check=True)
        print("| command | wall s | processor s | wall over least squares | page MB |\n|---|---|---|---|---|")
        for name, (repeats, _) in rows(made, made).items():
            if names and name not in names:
                continue
            unit, times, page = least_squares(), [], Path()
            for i in range(repeats):
                times.append(timed(rows(made, made / f"{name}-{i}")[name][1]))
                page = next((made / f"{name}-{i}").glob("*.html"), Path())
            unit = min(unit, least_squares())
            wall, processor = min(times), min(p for _, p in times)
            size = f"{page.stat().st_size / 1e6:.1f}" if page.is_file() else ""
            print(f"| {name} | {wall[0]:.2f} | {processor:.1f} | {wall[0] / unit:.1f} | {size} |", flush=True)


if __name__ == "__main__":
    main()
