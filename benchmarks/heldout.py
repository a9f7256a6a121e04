"""Error on cycles left out, before and after, for development trials and the public recordings.

    python benchmarks/heldout.py trials --seed 151 -n 40
    python benchmarks/heldout.py recordings ../shared/recordings

Each trial or recording is a line of ``build/heldout/*.jsonl``; the same command goes on where it stopped.
``python benchmarks/heldout.py table`` writes ``reports/heldout.md``. Only first looks are taken.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from shj_bayes._util.files import write_text
from shj_bayes.errors import ShjError
from shj_bayes.inference.binning import runs_of
from shj_bayes.mismatch.diagnosis import diagnose
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.options import DiagnoseOptions
from shj_bayes.recording.reader import read
from shj_validation.proof.answers import CASES
from shj_validation.proof.cases import development_keys
from shj_validation.proof.make import make
from shj_validation.proof.truth import truth_of

ROOT = Path(__file__).resolve().parents[1]
BUILD, PAGE = ROOT / "build" / "heldout", ROOT / "reports" / "heldout.md"
Task = tuple[str, Callable[[], dict[str, Any]]]


def main() -> None:
    """Take the looks that are missing, or write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("what", choices=("trials", "recordings", "table"))
    parser.add_argument("folder", nargs="?", type=Path, help="of the public recordings")
    parser.add_argument("--seed", type=int, default=151, help="of development")
    parser.add_argument("-n", type=int, default=40, help="number of trials")
    asked = parser.parse_args()
    BUILD.mkdir(parents=True, exist_ok=True)
    if asked.what == "table":
        write_text(PAGE, table())
        print(PAGE)
    elif asked.what == "trials":
        look_at(BUILD / f"trials-seed{asked.seed}.jsonl", trials(asked.seed, asked.n))
    else:
        look_at(BUILD / "recordings.jsonl", recordings(asked.folder))


def look_at(file: Path, tasks: Iterable[Task]) -> None:
    """Diagnose what is not in a file yet, and add a line to it for each."""
    done = {row["name"] for row in rows_of(file)}
    for name, task in tasks:
        if name in done:
            continue
        begin = time.perf_counter()
        row = {"name": name, **task(), "seconds": time.perf_counter() - begin}
        with file.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(row) + "\n")
        print(line(row), flush=True)


def rows_of(file: Path) -> list[dict[str, Any]]:
    """Lines of a file that are there."""
    if not file.exists():
        return []
    return [json.loads(text) for text in file.read_text(encoding="utf-8").splitlines()]


def trials(seed: int, n: int) -> Iterable[Task]:
    """Development trials of every kind that conceal something, and some that do not."""
    for kind, share in (("one", 2), ("two", 1), ("outside", 1), ("nothing", 1)):
        for key in development_keys(seed, max(n * share // 5, 1), kind):

            def task(key: Any = key) -> dict[str, Any]:
                made = make(key)
                truth = sorted(truth_of(key, made).required)
                return said([one.recording for one in made], key.reversal, "afc") | {"concealed": truth}

            yield f"{kind} {key.number}", task


def recordings(folder: Path) -> Iterable[Task]:
    """Public recordings that are in a folder, as the proof with recordings reads them."""
    for case in (case for case in CASES if (folder / case.file).is_file()):

        def task(case: Any = case) -> dict[str, Any]:
            found = read(folder / case.file, columns=case.columns, units=case.units, rate_Hz=case.rate_Hz)
            return said([found], "continuous", "general", case.without)

        yield case.id, task


def said(given: list[Any], rule: str, priors: str, without: tuple[str, ...] = ()) -> dict[str, Any]:
    """Give what a first look says of recordings."""
    try:
        runs = runs_of(given)
        model = DeviceModel(len(runs), read_priors(priors), variant=rule)
        record = diagnose(runs, model, DiagnoseOptions(without, quick=True)).content
    except (ShjError, ArithmeticError, ValueError) as error:
        return {"verdict": f"failed: {type(error).__name__}: {error}"}
    kept = {"verdict": record["verdict"], "heldout": record["heldout"]}
    named = [effect["id"] for effect in record["effects"]]
    members = [member["id"] for member in record["family"] if member["id"] not in named]
    errors = [record[stage]["heldout_rmse_kN"] for stage in ("before", "after")]
    return kept | {"said": named, "or": members, "before_kN": errors[0], "after_kN": errors[1]}


def line(row: dict[str, Any]) -> str:
    """One look as a row of the table."""
    if "before_kN" not in row:
        return f"| {row['name']} | {row['verdict']} | | | | |"
    held = row["heldout"]
    words = " + ".join(row["said"]) + (f" (or {', '.join(row['or'])})" if row["or"] else "")
    dropped = ", ".join(one["class"] for one in held["dropped"])
    errors = f"{row['before_kN']:.3g} | {row['after_kN']:.3g} | {held['rmse_se_kN']:.2g}"
    return f"| {row['name']} | {row['verdict']} | {words} | {errors} | {dropped} |"


def table() -> str:
    """Give the page."""
    out = ["# Error on cycles that were left out", "", "Written by `python benchmarks/heldout.py table`.", ""]
    for file in sorted(BUILD.glob("*.jsonl")):
        rows = rows_of(file)
        told = [row for row in rows if row["verdict"] in ("named", "family")]
        worse = [row for row in told if row["after_kN"] > row["before_kN"] + row["heldout"]["rmse_se_kN"]]
        source = "the public recordings" if file.stem == "recordings" else f"development {file.stem}"
        counts = f"{len(told)} of {len(rows)} named or in a family, {len(worse)} of them worse"
        out += [
            f"## {source[:1].upper()}{source[1:]}: {counts}",
            "",
            "| | verdict | named | before, kN | after, kN | standard error of the difference | dropped |",
            "|---|---|---|---|---|---|---|",
            *map(line, rows),
            "",
        ]
    return "\n".join(out)


if __name__ == "__main__":
    main()
