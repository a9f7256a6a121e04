"""What the whole chain says today, to six digits, held against what it said: ``python tests/golden/golden.py``.

Demonstration campaign, margins of the published tables, first looks at twelve development trials and at three public
recordings (where they are beside the project). Numbers that moved are listed and end it with 1; ``--write`` accepts
them, in the same commit as the reason. Names of parts choose some: ``golden.py trials demo``.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes.inference.binning import runs_of
from shj_bayes.mismatch.diagnosis import diagnose
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.options import DiagnoseOptions
from shj_bayes.recording.reader import read
from shj_validation.proof.answers import CASES
from shj_validation.proof.cases import DESIGNS, PROOF_1, development_keys
from shj_validation.proof.make import make

HERE = Path(__file__).resolve().parent
RECORDINGS = HERE.parents[2] / "shared" / "recordings"
SEED = 57  # of the development trials
# kind, protocol (None: as drawn), effect (None: as drawn), number of trials
TRIALS = (
    ("nothing", None, None, 2),
    ("one", None, None, 4),
    ("two", None, None, 2),
    ("outside", None, None, 2),
    ("one", None, "stick_slip", 1),
    ("nothing", "triangles", None, 1),
)
PUBLIC = ("brfd ds1_0.5Hz25lb", "brfd ds2_0.5Hz36lb1in", "seal KDN_3bar")  # of the recordings that the proof reads
SOME = 12  # numbers of a list that are kept one by one; of a longer one mean, deviation, first and last
LONG = 40  # letters of a word that is kept
LEFT_OUT = ("made", "summary", "residual", "loops")  # caches, and what stands in the other files as well
CHANGES = ("seconds", "created", "version", "made", "digest", "platform", "date", "sha", "_id", "started", "finished")


def numbers(value: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """Every number, short word and truth value of a record with its place, to six digits; long lists in brief."""
    if isinstance(value, dict):
        for key in sorted(value):
            if not any(word in key.lower() for word in CHANGES):
                yield from numbers(value[key], f"{path}/{key}")
    elif isinstance(value, list) and len(value) > SOME:
        yield from in_brief(value, path)
    elif isinstance(value, list):
        for k, one in enumerate(value):
            yield from numbers(one, f"{path}/{k}")
    elif isinstance(value, float):
        yield path, f"{value:.6g}"
    elif isinstance(value, int | bool) or (isinstance(value, str) and len(value) < LONG):
        yield path, str(value)


def in_brief(value: list[Any], path: str) -> Iterator[tuple[str, str]]:
    """Columns of a list of records; mean, deviation and ends of numbers; a digest of anything else."""
    if all(isinstance(one, dict) for one in value):
        columns: dict[str, list[Any]] = {}
        for one in value:
            for key, entry in one.items():
                columns.setdefault(key, []).append(entry)
        yield from numbers({key: column if len(column) > SOME else [column] for key, column in columns.items()}, path)
        return
    known = [one for one in np.array(value, dtype=object).ravel() if one is not None]
    if known and all(isinstance(one, int | float) for one in known):
        array = np.array(known, dtype=float)
        brief = [array.mean(), array.std(), array[0], array[-1], array.size]
        yield f"{path}/brief", " ".join(f"{one:.6g}" for one in brief)
    else:
        yield (
            f"{path}/digest",
            hashlib.sha256(json.dumps([dict(numbers(one)) for one in value]).encode()).hexdigest()[:12],
        )


def table(path: Path) -> dict[str, Any]:
    """Columns of a CSV file, as numbers where they are."""
    with path.open(encoding="utf-8-sig", newline="") as stream:
        head, *rows = [row for row in csv.reader(stream) if row and not row[0].startswith("#")]
    return {name: [number(one) for one in column] for name, *column in zip(head, *rows, strict=True)}


def number(text: str) -> float | str:
    """Give a number where it is one."""
    try:
        return float(text)
    except ValueError:
        return text


def files_of(folder: Path) -> dict[str, Any]:
    """All numbers of the JSON and CSV files of a folder."""
    found: dict[str, Any] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.suffix == ".json" and not any(word in name for word in LEFT_OUT):
            found[name] = json.loads(path.read_text(encoding="utf-8"))
        elif path.suffix == ".csv" and path.stem not in LEFT_OUT:
            found[name] = table(path)
    return found


def command(*words: str) -> None:
    """Run a command of the project; what it prints is shown where it fails."""
    tool = Path(sys.executable).with_name("shj-bayes")
    done = subprocess.run([tool, *words], capture_output=True, text=True, check=False)
    if done.returncode not in (0, 3):
        sys.exit(f"{' '.join(words)} ended with {done.returncode}: {done.stderr[-2000:]}")


def demo(folder: Path) -> dict[str, Any]:
    """Give what the demonstration writes, of the first device of each set."""
    command("demo", "--out", str(folder))
    return {
        name: read for name, read in files_of(folder).items() if "/" not in name or re.search(r"-1-[0-9a-f]+/", name)
    }


def tables(folder: Path) -> dict[str, Any]:
    """Give population and margins of the published tables."""
    command("tables", "-o", str(folder))
    command("margins", str(folder))
    return files_of(folder)


def trials(_: Path) -> dict[str, Any]:
    """First looks at development trials."""
    found = {}
    for kind, protocol, effect, n in TRIALS:
        usual = DESIGNS[PROOF_1]
        design = replace(usual, protocols=(protocol,)) if protocol else usual
        for key in development_keys(SEED, n, kind, effect=effect, design=design):
            runs = [one.recording for one in make(key)]
            found[f"{kind} {protocol or effect or 'drawn'} {key.number}"] = look(runs, key.reversal)
    return found


def recordings(_: Path) -> dict[str, Any]:
    """First looks at public recordings."""
    found = {}
    for case in (case for case in CASES if case.id in PUBLIC):
        given = read(RECORDINGS / case.file, columns=case.columns, units=case.units, rate_Hz=case.rate_Hz)
        found[case.id] = look([given], "continuous", "general", case.without)
    return found


def look(recorded: list[Any], variant: str, priors: str = "afc", without: tuple[str, ...] = ()) -> dict[str, Any]:
    """Give the record of a first look."""
    runs = runs_of(recorded)
    device = DeviceModel(len(runs), read_priors(priors), variant=variant)
    return diagnose(runs, device, DiagnoseOptions(without, quick=True)).content


PARTS: dict[str, Callable[[Path], dict[str, Any]]] = {f.__name__: f for f in (demo, tables, trials, recordings)}


def main() -> int:
    """Compare, or accept."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("parts", nargs="*", choices=[*PARTS, []], default=list(PARTS))
    parser.add_argument("--write", action="store_true", help="keep what is said now")
    asked = parser.parse_args()
    moved = 0
    for part in asked.parts:
        if part == "recordings" and not RECORDINGS.is_dir():
            print("recordings: not beside the project, left out")
            continue
        with tempfile.TemporaryDirectory() as folder:
            now = dict(numbers(PARTS[part](Path(folder) / part)))
        kept = HERE / f"{part}.txt"
        if asked.write:
            kept.write_text("".join(f"{place}\t{value}\n" for place, value in now.items()), encoding="utf-8")
        before = dict(line.split("\t") for line in kept.read_text(encoding="utf-8").splitlines())
        others = [place for place in {**before, **now} if before.get(place) != now.get(place)]
        for place in others[:40]:
            print(f"{part}{place}: {before.get(place, 'absent')} -> {now.get(place, 'absent')}")
        print(f"{part}: {len(others)} of {len(now)} numbers moved", flush=True)
        moved += len(others)
    return 1 if moved else 0


if __name__ == "__main__":
    sys.exit(main())
