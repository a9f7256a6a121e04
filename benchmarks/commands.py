"""What users wait for, whole commands: ``python benchmarks/commands.py`` (names of rows choose some of them).

Wall and processor time of each, the latter of all its processes, as the shortest of some runs; and the processor time
in units of a least squares that this machine solves before and after, since seconds alone do not carry over.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from timing import best, of_children

from shj_bayes._util.files import shipped

PYTHON = (sys.executable, "-P")
COMMAND = (*PYTHON, "-m", "shj_bayes")
IMPORTS = "import shj_bayes.app.device, shj_bayes.report.figures.device"  # what a fit loads before it begins
LEAST_SQUARES, COLUMNS = 60_000, 100  # rows and unknowns of the reference work
DEMO = str(shipped("data", "examples", "campaign.toml"))
MADE = {  # name, and words of `simulate`: two runs of Table 1, 24 000 samples and 1.2 million rows of the same noise
    "short": ("--rate", "20", "--dep", "60", "--phi", "0.8"),
    "long": ("--rate", "1000", "--dep", "60", "--phi", "0.99555"),
}
ROWS = {  # name: repeats, and words; names of `MADE` stand for their two files
    "start": (5, (*PYTHON, "-c", IMPORTS)),
    "check": (3, (*COMMAND, "check", "short")),
    "fit": (3, (*COMMAND, "fit", "short")),
    "fit-long": (1, (*COMMAND, "fit", "long")),
    "diagnose": (1, (*COMMAND, "diagnose", "--quick", "short")),
    "campaign": (1, (*COMMAND, "campaign", DEMO, "--diagnose", "quick")),
    "demo": (1, (*COMMAND, "demo")),
    "tables": (1, (*COMMAND, "tables")),
}


def least_squares() -> float:
    """Seconds of the reference work."""
    table = np.random.default_rng(1).standard_normal((LEAST_SQUARES, COLUMNS + 1))
    return best(lambda: np.linalg.lstsq(table[:, 1:], table[:, 0]), 3)


def timed(words: list[str]) -> tuple[float, float]:
    """Wall and processor time of a command, s."""
    before, begin = of_children(), time.perf_counter()
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return time.perf_counter() - begin, of_children() - before


def row(name: str, made: Path) -> str:
    """Time a command; its line of the table."""
    (repeats, words), unit, times, out = ROWS[name], least_squares(), [], made / name
    files = {stem: [str(made / f"{stem}-run{run}.csv") for run in (1, 2)] for stem in MADE}
    asked = [part for word in words for part in files.get(word, [word])]
    for number in range(repeats):
        out = made / f"{name}-{number}"
        times.append(timed(asked if name in ("start", "check") else [*asked, "-o", str(out)]))
    unit, (wall, processor) = min(unit, least_squares()), map(min, zip(*times, strict=True))
    page = next(out.glob("*.html"), None)
    size = f"{page.stat().st_size / 1e6:.1f}" if page else ""
    return f"| {name} | {wall:.1f} | {processor:.1f} | {processor / unit:.1f} | {size} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(ROWS), help=f"of {', '.join(ROWS)}; all by default")
    names = parser.parse_args().names
    with TemporaryDirectory() as scratch:
        made = Path(scratch)
        os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1", PYTHONPYCACHEPREFIX=str(made / "compiled"))
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # an installed package is compiled
        for stem, words in MADE.items():
            timed([*COMMAND, "simulate", "-o", str(made / stem), *words])
        timed([*COMMAND, "diagnose", "--quick", str(made / "short-run1.csv"), "-o", str(made / "warm")])
        timed([*COMMAND, "fit", str(made / "short-run1.csv"), "-o", str(made / "warm")])
        print("| command | wall, s | processor, s | over a least squares | page, MB |\n|---|---|---|---|---|")
        for name in names:
            print(row(name, made), flush=True)


if __name__ == "__main__":
    main()
