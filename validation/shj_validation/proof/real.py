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
SCHEMA = "shj-bayes/proof-recordings/2"
SURE = (0.05, 0.95)  # probabilities between which the answer leaves open whether something is there
# By folder: what was tested, who published it under which licence, and what they or the data say of it.
SOURCES = {
    "brfd-lehigh": (
        "band-brake rotary friction damper, Lehigh University",
        "D. Coble, P. Huggins, L. Cao, J. Ricles, A. Downey, Dataset-Friction-Damper-with-Backlash, 2022 (CC BY-SA "
        "4.0); device: Downey et al., Engineering Structures 113 (2016) 287-298",
        "free travel of 2.8 to 3.3 mm near zero force, 1.5 mm with the loosest band; push and pull differ, strongly at "
        "36 lb, hardly at 80 lb; a breakaway peak of 1.1 to 1.5 times the plateau in push; stick-slip at 44 to 57 Hz "
        "mostly in pull; little effect of speed",
    ),
    "seals-tud": (
        "piston seal, TU Delft",
        "E. Zillen, MSc thesis, TU Delft, 2021 (CC0)",
        "push and pull differ in all; a breakaway in the first stroke; growth from cycle to cycle in the O-ring at 7 "
        "bar; the others steady; the force rises towards the end of the stroke in PK at 5 bar and in the O-rings",
    ),
    "emps": (
        "ball-screw axis, nonlinear benchmark EMPS",
        "A. Janot, M. Gautier, M. Brunot, 2019 (repository: Apache-2.0)",
        "Coulomb friction 20.4 N, viscous 203.5 N s/m, offset -3.16 N, mass 95.1 kg; a ripple of 2.5 mm, the screw",
    ),
    "mr-damper-utfpr": (
        "magneto-rheological damper on a shaking table",
        "A. N. Vargas, Labcontrol, doi 10.5281/zenodo.4445334 (MIT)",
        "the gas accumulator pushes with 64 to 105 N; viscous and rounded Coulomb friction",
    ),
    "steel-coupons": (
        "cyclic steel coupon",
        "RESSPyLab, EPFL (MIT)",
        "no friction: steel that yields and hardens",
    ),
    "quasistatic": ("steel that yields", "C. Slotboom, hysteresis (Apache-2.0)", "no friction: steel that yields"),
}


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
            lines += [f"{row['id']}: {row['verdict']} ({', '.join(row['found']) or 'nothing named'}){left_out(row)}"]
            lines += [f"  {'agrees' if j['agrees'] else 'DIFFERS'}: {j['words']}" for j in row["judged"]]
        lines += [f"skipped: {name} is not in the folder" for name in self.record["absent"]]
        return "\n".join([*lines, "", agreement(self.record), f"page: {self.page}"])


def agreement(record: dict[str, Any]) -> str:
    """Say how many of all comparisons agree."""
    agrees = [j["agrees"] for row in record["cases"] for j in row["judged"]]
    return f"{sum(agrees)} of {len(agrees)} comparisons agree"


def left_out(row: dict[str, Any]) -> str:
    """Say how far the model is off on cycles that were left out, before and after."""
    if "before_kN" not in row:
        return ""
    before, after = (newton(row[when]) for when in ("before_kN", "after_kN"))
    return f"; {before} off on cycles left out with the law alone, {after} with what was found"


def newton(force_kN: float) -> str:
    """Write a force that may be small."""
    return f"{1000 * force_kN:.3g} N" if force_kN < 1.0 else f"{force_kN:.3g} kN"


def _open(answer: dict[str, Any]) -> list[str]:
    """Say where an answer states that it does not know."""
    out = []
    if answer["verdict"] == "unknown":
        out.append(f"which mechanism it is: {answer['reason']}")
    if answer["verdict"] == "family":
        out.append(f"which of these it is: {', '.join(member['id'] for member in answer['family'])}")
    for row in answer["coordinates"]:
        if SURE[0] < row["probability"] < SURE[1]:
            over = f"{row['action']} over {row['coordinate']}"
            out.append(f"whether there is a dependence of the {over} (P = {row['probability']:.2f})")
    for row in answer["coordinates"]:
        if row["probability"] >= SURE[1] and not row["matches"]:
            out.append(f"what makes the {row['action']} depend on {row['coordinate']}: no known formula has this curve")
    return list(dict.fromkeys(out))


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
    shown = {
        "agreement": agreement(record),
        "left_out": left_out,
        "newton": newton,
        "sources": SOURCES,
        "pictures": pictures,
    }
    write_text(out / PAGE, page.render(**head(), record=record, **shown))
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
        "open": _open(answer),
        "before_kN": answer["before"]["heldout_rmse_kN"],
        "after_kN": answer["after"]["heldout_rmse_kN"],
        "seconds": answer["seconds"],
        "judged": [vars(one) for one in case.judge(answer, folder / case.file, answers)],
    }
