"""All speed measurements, or some of them: ``python benchmarks/bench.py law likelihood fits``.

``make speed`` runs all: commands, law, likelihood, reduction, fits, moves, effects, population, workers,
peers. Each part is a script of its own with its own options.
``peers`` takes half an hour and what ``benchmarks/requirements.txt`` names; peers that are not installed are left out.
"""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

PARTS = ("commands", "law", "likelihood", "reduction", "fits", "moves", "effects", "population", "workers", "peers")


def main() -> int:
    """Run the parts one after the other."""
    chosen = sys.argv[1:] or list(PARTS)
    wrong = [name for name in chosen if name not in PARTS]
    if wrong:
        print(f"'{wrong[0]}' is not a part; choose from {', '.join(PARTS)}", file=sys.stderr)
        return 2
    for name in chosen:
        print(f"\n== {name}", flush=True)
        sys.argv = [f"{name}.py"]
        runpy.run_path(str(Path(__file__).with_name(f"{name}.py")), run_name="__main__")
    return 0


if __name__ == "__main__":
    sys.exit(main())
