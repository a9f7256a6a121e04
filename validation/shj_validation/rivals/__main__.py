"""``python -m shj_validation.rivals FOLDER``: put the trials of a proof to general methods, and score them beside ours.

The methods run behind the fence of the proof. Their answers are on disk, with a digest, before one is held against a
key; what says "nothing is missing" comes from development trials that no proof uses. Stopped, the same command goes on.
"""

import argparse
import json
from collections.abc import Sequence
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes._util.files import read_json, write_text
from shj_bayes.errors import ProofError
from shj_bayes.recording.recording import write_csv
from shj_validation.proof import seal
from shj_validation.proof.cases import DESIGNS, Key, development_keys, draw_keys
from shj_validation.proof.make import make
from shj_validation.proof.pool import diagnose_rest
from shj_validation.proof.run import SCORE, names
from shj_validation.rivals.methods import METHODS
from shj_validation.rivals.score import OURS, better, median, our_row, rival_rows, summary, table, threshold

DEVELOPMENT_SEED = 6161
PACKAGES = {"sklearn": "scikit-learn", "pysindy": "pysindy", "FoKL": "FoKL"}
ANSWERS, SEALED = "answers", "answers.json"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(prog="python -m shj_validation.rivals", description=__doc__)
    parser.add_argument("folder", type=Path, help="of a proof")
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(METHODS), metavar="METHOD")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--development", type=int, default=100, help="trials with nothing concealed for the thresholds")
    parser.add_argument("--first", type=int, help="only so many trials of the proof, from the first on")
    parser.add_argument("--out", type=Path, help="folder for the answers and the table; beside that of the proof")
    given = parser.parse_args(arguments)
    out = given.out or given.folder.with_name(f"{given.folder.name}-rivals")
    try:
        print(run(given.folder, out, given.methods, given.workers, given.development, given.first))
    except ProofError as error:
        parser.exit(1, f"{error}\n")


def run(
    folder: Path, out: Path, methods: Sequence[str], workers: int = 1, development: int = 100, first: int | None = None
) -> str:
    """Answer, seal the answers, and score them where the proof has been opened; gives what is to be read."""
    missing = [package for package in PACKAGES if find_spec(package) is None]
    if missing:
        raise ProofError(f"{', '.join(missing)} cannot be imported; pip install 'shj-bayes[rivals]'")
    schema, seed, keys = keys_of(folder)
    keys = keys[:first]
    nothing = development_keys(DEVELOPMENT_SEED, development, "nothing", design=DESIGNS[schema])
    ask(out / "development", nothing, methods, workers)
    ask(out / "trials", keys, methods, workers, read_json(folder / seal.COMMITMENT, ProofError)["trials"])
    answered = [out / "development" / ANSWERS / f"{name}.json" for name in names(development)]
    answers = [out / "trials" / ANSWERS / f"{name}.json" for name in names(len(keys))]
    sealed = seal_answers(folder, out, [*answered, *answers])
    if not (folder / SCORE).exists():
        return f"{sealed}\n{folder.name} is not opened yet; run the same command again when it is"
    rows = read_json(folder / SCORE, ProofError)["trials"][: len(keys)]
    gains = [read_json(path, ProofError) for path in answered]
    limits = {name: threshold([one.get(name, {}).get("gain", 0.0) for one in gains]) for name in methods}
    theirs = [
        rival_rows(key, row, read_json(path, ProofError), limits)
        for key, row, path in zip(keys, rows, answers, strict=False)
    ]
    by_name = {OURS: [our_row(row) for row in rows]} | {
        name: [one[name] for one in theirs] for name in dict.fromkeys(n for one in theirs for n in one)
    }
    lines = summary(rows, by_name)
    write_text(out / "rivals.json", json.dumps({"limits": limits, "lines": lines, "trials": by_name}, indent=1))
    text = page(seed, schema, rows, lines, limits, development, sealed)
    write_text(out / f"rivals-{seed}.md", text)
    return text


def seal_answers(folder: Path, out: Path, answers: Sequence[Path]) -> str:
    """Write the digests of all answers; `ProofError` where one is no longer what it was. Gives what to print."""
    digests = {path.relative_to(out).as_posix(): seal.sha256(path) for path in answers}
    before = read_json(out / SEALED, ProofError)["answers"] if (out / SEALED).exists() else {}
    changed = [name for name, digest in before.items() if digests.get(name, digest) != digest]
    if changed:
        raise ProofError(f"{changed[0]} in {out.name} is not what {SEALED} holds; remove both to ask anew")
    commitment = seal.sha256(folder / seal.COMMITMENT)
    write_text(out / SEALED, json.dumps({"commitment_sha256": commitment, "answers": before | digests}, indent=1))
    return f"SHA-256 of {SEALED}, written before any answer was held against a key: {seal.sha256(out / SEALED)}"


def keys_of(folder: Path) -> tuple[str, int, list[Key]]:
    """Keys of a proof; of one that is still sealed they only make motions here, as they make recordings in `prove`."""
    if (folder / seal.SECRET).exists():
        secret = read_json(folder / seal.SECRET, ProofError)
        return secret["schema"], secret["seed"], draw_keys(secret["seed"], secret["n"], secret["schema"])
    opened = seal.read_opened(folder)
    return opened.schema, opened.seed, opened.keys


def ask(
    folder: Path, keys: Sequence[Key], methods: Sequence[str], workers: int, committed: Sequence[dict[str, Any]] = ()
) -> None:
    """Have trials answered behind the fence, from recordings, a motion without forces, and the reversal rule.

    Raises
    ------
    ProofError
        If a recording is not the one that a proof has `committed`.
    """
    rest = [name for name in names(len(keys)) if not (folder / ANSWERS / f"{name}.json").exists()]
    by_name = dict(zip(names(len(keys)), keys, strict=True))
    files = {name: written(folder / "recordings" / name, by_name[name]) for name in rest}

    for trial in committed:
        for one, path in zip(trial["files"], files.get(trial["name"], []), strict=False):
            if seal.sha256(path) != one["sha256"]:
                raise ProofError(
                    f"{path.name} of trial {trial['name']} is not that of the proof: other libraries round"
                )

    def task_of(name: str) -> dict[str, Any]:
        return {"recordings": files[name], "model": by_name[name].reversal, "methods": list(methods)}

    (folder / ANSWERS).mkdir(parents=True, exist_ok=True)
    diagnose_rest(folder / ANSWERS, rest, task_of, workers, print, "shj_validation.rivals.worker")


def written(folder: Path, key: Key) -> list[Path]:
    """Write recordings, as the proof did, and the displacement of the history that follows, without its force."""
    motion = folder / "motion.csv"
    if not motion.exists():
        folder.mkdir(parents=True, exist_ok=True)
        *tested, shaken = (one.recording for one in make(key, heldout=True))
        for one in tested:
            write_csv(folder / one.source.name, one)
        np.savetxt(motion, np.column_stack([shaken.time_s, shaken.displacement_mm]), delimiter=",", fmt="%.6f")
    return [*sorted(path for path in folder.iterdir() if path != motion), motion]


def page(
    seed: int,
    schema: str,
    rows: Sequence[dict[str, Any]],
    lines: Sequence[dict[str, Any]],
    limits: dict[str, float],
    development: int,
    sealed: str,
) -> str:
    """Report in Markdown."""
    seen, null = sum(row["detectable"] for row in rows), sum(row["kind"] == "nothing" for row in rows)
    gains = ", ".join(f"{name} {100 * limit:.1f} %" for name, limit in limits.items())
    ahead = "; ".join(better(lines)) or "nowhere"
    law = [
        median([row["heldout"][what] for row in rows if row["detectable"] and row["outcome"] != "failed"])[0]
        for what in ("cycles_before", "earthquake_before")
    ]
    return f"""# General methods on the trials of proof {seed}

{len(rows)} trials of kind `{schema}`, {seen} with something detectable, {null} with nothing concealed. Shares with 95 %
Clopper-Pearson intervals; errors as multiples of the noise: medians of the detectable trials with 95 % intervals.
Seconds: median of the trials; ours by the clock, rivals by the processor, the fit of the base law included.

{table(lines)}

The base law alone: {law[0]:.2f} on cycles left out, {law[1]:.2f} on the earthquake; a method that says that nothing is
missing is scored by it.

Where a rival is ahead of ours: {ahead}.

What all are scored by: the one coordinate that leads, whatever it acts on; of two effects either is right; position and
distance from the middle count as one, and physics of the motion (slack, delay) is right by any input that shows it.
A method says that something is missing when it explains more of the square error on cycles left out than in 97 % of
{development} development trials with nothing concealed: {gains}.

{", ".join(f"{name} {version(name)}" for name in PACKAGES.values())}. {sealed}
"""


if __name__ == "__main__":
    main()
