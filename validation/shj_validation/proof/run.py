"""The proof from seed to page: make, commit, diagnose, open, score. It can be stopped at any moment and goes on."""

import json
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import takewhile
from pathlib import Path
from typing import Any

from tqdm import tqdm

from shj_bayes._util.files import alone_in, read_json, write_text
from shj_bayes._util.processes import Workers, program
from shj_bayes.errors import ProofError
from shj_bayes.inference.store import versions
from shj_bayes.recording.recording import write_csv
from shj_validation.proof import seal
from shj_validation.proof.cases import PROOF_1, PROOF_2, Key, draw_keys
from shj_validation.proof.make import make
from shj_validation.proof.page import render
from shj_validation.proof.pool import diagnose_rest, unanswered
from shj_validation.proof.score import score_trial
from shj_validation.proof.summary import summarise

SCORE, TRANSCRIPT, TABLE = "score.json", "transcript.json", "trials.csv"


@dataclass(frozen=True)
class Proof:
    """A finished proof.

    Parameters
    ----------
    score : dict
        Content of ``score.json``.
    page : Path
        The page.
    """

    score: dict[str, Any]
    page: Path

    @property
    def text(self) -> str:
        """What a person wants to read at the end."""
        lines = [f"{t['words']:58} {t['value']:>22}  aim {t['aim']:<28} {t['verdict']}" for t in self.score["targets"]]
        for setting in ("protocol", "displacement", "rate_Hz"):
            lines += ["", f"{setting.removesuffix('_Hz'):58} {'false alarms':>22}  coordinate right, of the visible"]
            for name, entry in self.score["settings"][setting].items():
                alarms, right = (f"{entry[of]['hits']} of {entry[of]['n']}" for of in ("alarms", "coordinate"))
                lines.append(f"{name:58} {alarms:>22}  {right}: {entry['told']}")
        return "\n".join([*lines, "", f"page: {self.page}"])


@alone_in("folder")
def prove(
    folder: Path,
    *,
    n: int,
    seed: int,
    workers: int = 2,
    quick: bool = True,
    open_now: bool = False,
    earlier: bool = False,
    progress: bool = False,
) -> Proof:
    """Run (or go on with) a proof.

    Parameters
    ----------
    folder : Path
        Results folder; a finished proof in it is only scored again.
    n : int
        Number of trials.
    seed : int
        What is concealed follows from it.
    workers : int
        Processes.
    quick : bool
        Whether the search uses fewer samples, and only the posterior of what was found is sampled.
    open_now : bool
        Whether to open a proof that was stopped, with the trials that are diagnosed without a gap from the first on.
    earlier : bool
        Whether to make the earlier kind of proof: Table 1 and a test of several speeds only.
    progress : bool
        Show progress bars.

    Returns
    -------
    Proof

    Raises
    ------
    ProofError
        If the folder holds another proof, or one without a diagnosis that is to be opened.
    """
    folder.mkdir(parents=True, exist_ok=True)
    schema = PROOF_1 if earlier else PROOF_2
    if not (folder / seal.OPENED).exists():
        secret = seal.write_secret(folder, seed, n, schema)
        keys = draw_keys(seed, n, schema)
        _commit(folder, keys, secret, progress)
        if not open_now:
            _diagnose(folder, keys, workers, quick, progress)
        _transcribe(folder, n)
        seal.open_seal(folder)
    opened = seal.read_opened(folder)
    if (opened.seed, len(opened.keys), opened.schema) != (seed, n, schema):
        raise ProofError(
            f"{folder.name} holds a finished proof of {len(opened.keys)} trials, seed {opened.seed}"
            f"{seal.words_of(opened.schema)}; choose another folder"
        )
    return score(folder, opened, workers, progress)


def names(n: int) -> list[str]:
    """Names of the trials: their number and nothing else."""
    return [f"{number:04d}" for number in range(1, n + 1)]


def score(folder: Path, opened: seal.Opened, workers: int, progress: bool) -> Proof:
    """Score an opened proof and write page, table and JSON."""
    n = diagnosed(folder)
    rows = score_rows(folder, opened.keys[:n], workers, progress)
    commitment = read_json(folder / seal.COMMITMENT, ProofError)
    result = summarise(rows) | {
        "schema": opened.schema,
        "seed": opened.seed,
        "n": n,
        "sealed": len(opened.keys),
        "commitment_sha256": seal.sha256(folder / seal.COMMITMENT),
        "transcript_sha256": seal.sha256(folder / TRANSCRIPT),
        "committed": commitment["made"],
        "commit": commitment["commit"],
        "trials": rows,
    }
    write_text(folder / SCORE, json.dumps(result, indent=1, allow_nan=False))
    return Proof(result, render(folder, result))


def diagnosed(folder: Path) -> int:
    """Give the number of trials that were diagnosed before the keys were opened: the first ones."""
    return len(read_json(folder / TRANSCRIPT, ProofError)["diagnoses"])


def score_rows(folder: Path, keys: list[Key], workers: int, progress: bool) -> list[dict[str, Any]]:
    """Hold every diagnosis against its key."""
    jobs = [
        (key.to_dict(), read_json(folder / "diagnoses" / f"{name}.json", ProofError))
        for key, name in zip(keys, names(len(keys)), strict=True)
    ]
    with tqdm(total=len(jobs), desc="opening and scoring", disable=None if progress else True, unit="trial") as bar:
        rows = []
        if workers < 2 or len(jobs) < 4:  # starting processes takes longer than a few trials
            for job in jobs:
                rows.append(_score_one(job))
                bar.update()
            return rows
        with Workers(workers) as pool:
            for row in pool.map(_score_one, jobs):
                rows.append(row)
                bar.update()
    return rows


def _score_one(job: tuple[dict[str, Any], dict[str, Any]]) -> dict[str, Any]:
    return score_trial(Key.from_dict(job[0]), job[1])


def write_recordings(key: Key, folder: Path) -> list[Path]:
    """Write what the diagnosis will see of one trial: columns and nothing else."""
    folder.mkdir(parents=True, exist_ok=True)
    return [write_csv(folder / one.recording.source.name, one.recording) for one in make(key)]


def _commit(folder: Path, keys: list[Key], secret: Mapping[str, Any], progress: bool) -> None:
    """Write the recordings, and the digests of recordings and keys; nothing is diagnosed before this stands."""
    path, nonces = folder / seal.COMMITMENT, secret["nonces"]
    if path.exists():
        recorded = [trial["key_sha256"] for trial in read_json(path, ProofError)["trials"]]
        if recorded != [seal.digest_of(key, nonce) for key, nonce in zip(keys, nonces, strict=True)]:
            raise ProofError(f"{seal.COMMITMENT} in {folder.name} belongs to other keys; choose another folder")
        return
    trials = []
    shown = tqdm(
        list(zip(names(len(keys)), keys, nonces, strict=True)),
        desc="making",
        disable=None if progress else True,
        unit="trial",
    )
    for name, key, nonce in shown:
        files = write_recordings(key, folder / "recordings" / name)
        trials.append(
            {
                "name": name,
                "key_sha256": seal.digest_of(key, nonce),
                "files": [{"name": file.name, "sha256": seal.sha256(file)} for file in files],
            }
        )
    record = {
        "schema": secret["schema"],
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "commit": _git_commit(),
        "versions": versions(),
        "trials": trials,
    }
    write_text(path, json.dumps(record, indent=1))
    tqdm.write(
        f"keys sealed before any diagnosis; SHA-256 of {seal.COMMITMENT}: {seal.sha256(path)}"
    ) if progress else None


def _diagnose(folder: Path, keys: list[Key], workers: int, quick: bool, progress: bool) -> None:
    """Diagnose what has no diagnosis yet.

    Of a key only the reversal rule is told, as ``--model``.
    """
    rules = dict(zip(names(len(keys)), (key.reversal for key in keys), strict=True))
    target = folder / "diagnoses"

    def task_of(name: str) -> dict[str, Any]:
        recordings = sorted((folder / "recordings" / name).iterdir())
        return {"recordings": recordings, "quick": quick, "model": rules[name]}

    with tqdm(
        total=len(rules),
        initial=len(rules) - len(unanswered(target, rules)),
        desc="diagnosing",
        disable=None if progress else True,
        unit="trial",
    ) as bar:
        diagnose_rest(target, rules, task_of, workers, lambda _: bar.update())


def _transcribe(folder: Path, n: int) -> None:
    """Write the digests of all diagnoses without a gap from the first on, before the keys are opened."""
    done = list(takewhile(lambda name: (folder / "diagnoses" / f"{name}.json").exists(), names(n)))
    if not done:
        raise ProofError(f"nothing in {folder.name} is diagnosed yet: there is nothing to open")
    record = {
        "schema": read_json(folder / seal.COMMITMENT, ProofError)["schema"],
        "commitment_sha256": seal.sha256(folder / seal.COMMITMENT),
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "diagnoses": [{"name": name, "sha256": seal.sha256(folder / "diagnoses" / f"{name}.json")} for name in done],
    }
    write_text(folder / TRANSCRIPT, json.dumps(record, indent=1))


def _git_commit() -> str | None:
    """Commit of the source, with a + where files differ from it; None outside a repository."""
    git = program("git")
    if git is None:
        return None
    here = Path(__file__).parent
    answers = [
        subprocess.run([git, *words], cwd=here, capture_output=True, text=True, check=False)
        for words in (("rev-parse", "HEAD"), ("status", "--porcelain", "--untracked-files=no"))
    ]
    if any(answer.returncode for answer in answers):
        return None
    return answers[0].stdout.strip()[:12] + ("+" if answers[1].stdout.strip() else "")
