"""Real recordings with a concealed answer: the column that records it is withheld, then opened and compared."""

import json
import shutil
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import shj_bayes
from shj_bayes._util.files import alone_in, read_json, write_text
from shj_bayes.errors import ProofError
from shj_bayes.recording.reader import read
from shj_bayes.recording.recording import write_csv
from shj_bayes.report.diagnosis_words import sentences
from shj_bayes.report.page import head
from shj_bayes.results.codec import from_json
from shj_bayes.results.diagnosis import DiagnosisRecord
from shj_validation.proof.answers import CASES, Case, Judged, band_of, clamping_changes
from shj_validation.proof.page import environment
from shj_validation.proof.pictures import clamping
from shj_validation.proof.pool import diagnose_rest, unanswered

RECORD, PAGE = "recordings.json", "recordings.html"
ANSWERS = "answers"  # folder of the diagnoses of a run that has not ended
SCHEMA = "shj-bayes/proof-recordings/1"


@dataclass(frozen=True)
class RealProof:
    """What came out of the real recordings.

    Parameters
    ----------
    record : dict
        Content of ``recordings.json``.
    page : Path
        The page.
    """

    record: dict[str, Any]
    page: Path

    @property
    def text(self) -> str:
        """What a person wants to read at the end."""
        lines = []
        for row in self.record["cases"]:
            lines += [f"{row['id']}: {row['verdict']} ({', '.join(row['found']) or 'nothing named'})"]
            lines += [f"  {'agrees' if j['agrees'] else 'DIFFERS'}: {j['words']}" for j in row["judged"]]
        lines += [f"skipped: {name} is not in the folder" for name in self.record["absent"]]
        return "\n".join([*lines, "", agreement(self.record), f"page: {self.page}"])


def agreement(record: dict[str, Any]) -> str:
    """Say how many of all comparisons agree."""
    agrees = [j["agrees"] for row in record["cases"] for j in row["judged"]]
    return f"{sum(agrees)} of {len(agrees)} comparisons agree"


@alone_in("out")
def prove_recordings(folder: Path, out: Path, *, workers: int = 2, progress: bool = False) -> RealProof:
    """Diagnose real recordings from displacement and force alone, then compare with what was withheld.

    Parameters
    ----------
    folder : Path
        The public recordings, as they lie in the shared folder.
    out : Path
        Folder for the results.
    workers : int
        Processes.
    progress : bool
        Say which recording has been diagnosed.

    Returns
    -------
    RealProof
    """
    if not folder.is_dir():
        raise ProofError(f"{folder} is not a folder; give the folder of the public recordings")
    present = [case for case in CASES if (folder / case.file).is_file()]
    if not present:
        raise ProofError(f"{folder.name} holds none of the recordings looked for, such as {CASES[0].file}")
    out.mkdir(parents=True, exist_ok=True)
    answers = _answers(present, folder, out / ANSWERS, workers, progress)
    record = {
        "schema": SCHEMA,
        "version": shj_bayes.__version__,
        "cases": [_row(case, answers[case.id], folder, answers) for case in present],
        "absent": sorted({case.file for case in CASES} - {case.file for case in present}),
    }
    write_text(out / RECORD, json.dumps(record, indent=1, allow_nan=False))
    pictures = {
        case.id: clamping(band := band_of(folder / case.file), clamping_changes(answers[case.id], band))
        for case in present
        if case.band and "error" not in answers[case.id]
    }
    page = environment().get_template("recordings.html")
    write_text(out / PAGE, page.render(**head(), record=record, agreement=agreement(record), pictures=pictures))
    shutil.rmtree(out / ANSWERS)
    return RealProof(record, out / PAGE)


def _answers(cases: list[Case], folder: Path, kept: Path, workers: int, progress: bool) -> dict[str, dict[str, Any]]:
    """Diagnose what has no answer yet, and give the answers of all."""
    by_id = {case.id: case for case in cases}
    count = len(by_id) - len(unanswered(kept, by_id))
    if progress and count:
        print(f"  {count} of {len(by_id)} were diagnosed before and are not diagnosed again", flush=True)

    def done(name: str) -> None:
        nonlocal count
        count += 1
        if progress:
            print(f"  {name} diagnosed ({count} of {len(by_id)})", flush=True)

    with TemporaryDirectory() as scratch:
        diagnose_rest(kept, by_id, lambda name: _task(by_id[name], folder, Path(scratch)), workers, done)
    return {name: read_json(kept / f"{name}.json", ProofError) for name in by_id}


def _task(case: Case, folder: Path, scratch: Path) -> dict[str, Any]:
    """Write time, displacement and force of a recording, and nothing else of it."""
    own = scratch / case.id
    own.mkdir()
    recording = read(folder / case.file, columns=case.columns, units=case.units, rate_Hz=case.rate_Hz)
    path = write_csv(own / "run1.csv", recording, digits=12)
    return {
        "recordings": [path],
        "model": "continuous",
        "priors": "general",
        "without": list(case.without),
        "intervals": False,
    }


def _row(case: Case, answer: dict[str, Any], folder: Path, answers: dict[str, dict[str, Any]]) -> dict[str, Any]:
    """Open what was withheld and compare."""
    row: dict[str, Any] = {"id": case.id, "file": case.file, "withheld": case.withheld, "without": list(case.without)}
    if "error" in answer:
        judged = [Judged(False, f"no diagnosis: {answer['error']}")]
        return row | {"verdict": "failed", "found": [], "words": [], "judged": [vars(one) for one in judged]}
    return row | {
        "verdict": answer["verdict"],
        "found": [effect["id"] for effect in answer["effects"]],
        "words": sentences(from_json(DiagnosisRecord, answer)),
        "judged": [vars(one) for one in case.judge(answer, folder / case.file, answers)],
    }
