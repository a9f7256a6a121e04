"""A finished fit, recognised without what fitting needs: the same command again answers at once."""

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import shj_bayes
from shj_bayes._util.files import file_digest, plain_name
from shj_bayes._util.shipped import shipped
from shj_bayes.errors import InferenceError
from shj_bayes.model.parameters import BASE, base_of
from shj_bayes.recording.reader import by_ending
from shj_bayes.report import words
from shj_bayes.report.force_unit import force_unit
from shj_bayes.results.diagnosis import LeftOver
from shj_bayes.results.fit import FitRecord
from shj_bayes.results.store import check_files, find, has, read


@dataclass(frozen=True, eq=False)
class Done:
    """What a command made."""

    record: Any  # for machines: the record, or content, of the file that it wrote
    text: str  # what a person wants to read at the end
    fresh: bool = True  # False where an earlier, unchanged result was found and kept
    usable: bool = True  # False where no device of a campaign could be used
    note: str = ""  # why an earlier result was not kept although it is of the same fit: which file was damaged


def device_text(folder: Path, record: FitRecord, note: str = "") -> str:
    """Say what a fit found, with what its page, where there is one, says of the residual."""
    shown, left = force_unit(record), find(LeftOver, folder)
    # The word of the calculation does not stand alone: a converged fit of a wrong model is no reliable answer.
    fit = f"; {words.FIT[left.grade][0]}: {words.fit_words(left)}" if left else ""
    lines = [f"{record.device}: {record.verdict}{fit}"]
    lines += [f"  {reason}" for reason in record.reasons]
    said = words.left_words(left, record.model.effects) if left else ""
    lines += [f"  {extra}" for extra in (said, note) if extra]
    units = {row.name: shown.of(row.unit) for row in record.parameters}
    family = record.model.priors
    lines += [f"  warning: {words.remark(r, *units[r.parameter], family=family)}" for r in record.remarks]
    width = max(len(row.name) for row in record.parameters) + 1
    lines += ["", f"  {'':{width}}{'mean':>12}{'sd':>11}{'5 %':>12}{'95 %':>12}  unit"]
    for row in map(shown.row, record.parameters):
        numbers = f"{row.mean:12.5g}{row.sd:11.2g}{row.q05:12.5g}{row.q95:12.5g}"
        numbers += f"  {row.unit}"
        if base_of(row.name) == "gamma":
            numbers += f"  ({words.dep_words(row.q05, row.q95)})"
        if row.name in record.undetermined:
            numbers = f"{'not determined':>47}  {row.unit}"
        lines.append(f"  {row.name:{width}}{numbers}")
    notes = [f for run in record.inputs for f in run.findings if f.severity != "note"]
    lines += dict.fromkeys(f"  {finding.severity}: {finding.message}" for finding in notes)
    return "\n".join([*lines, "", f"report: {folder / 'report.html'}"])


def kept_result(paths: Sequence[Path], folder: Path, options: Mapping[str, Any], name: str | None) -> Done | None:
    """Give the result of the same fit, finished earlier; None where it has to be made, or made whole.

    `options` are all fields of `shj_bayes.commands.options.Options`.
    """
    there = has(FitRecord, folder) and (folder / "report.html").is_file()
    if not there or options["priors_from"] is not None:
        return None
    priors = Path(options["priors"])
    priors = priors if priors.suffix == ".toml" else shipped("priors", f"{priors}.toml")
    try:
        digests = [file_digest(path) for path in (*paths, priors)]
    except (OSError, ValueError):  # told by whoever reads them
        return None
    name = name_of_device(name, paths[0].name)
    record, _ = finished_record(folder, key_of(digests[:-1], options, digests[-1], name))
    return None if record is None else Done(record, device_text(folder, record), fresh=False)


def key_of(
    digests: Sequence[str], options: Mapping[str, Any], priors_sha256: str, name: str, *, speed: bool = True
) -> str:
    """Digest of all that a result depends on: digests of the recordings, in their order, all `Options`, priors, name.

    `speed` says whether the law depends on it.
    """
    # Of a prior file its name and digest count, not where it lies: the folder may be reached by another path.
    chosen = {**options, "priors": Path(options["priors"]).name, "effects": sorted(options["effects"])}
    content = [list(digests), chosen, priors_sha256, name, speed, shj_bayes.__version__, sorted(BASE)]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def name_of_device(given: str | None, file: str) -> str:
    """Name that was given, or that of the first file without its endings (a dot inside the name stays)."""
    endings = "|".join(map(re.escape, (*by_ending(), ".gz")))
    return plain_name(given or re.sub(f"({endings})+$", "", file, flags=re.IGNORECASE))


def finished_record(folder: Path, key: str) -> tuple[FitRecord | None, str]:
    """Record of an unchanged finished fit, or None; and, where files of a fit were damaged, which and how."""
    if not has(FitRecord, folder):
        return None, ""
    try:
        record = read(FitRecord, folder)
        check_files(folder, record)
    except InferenceError as error:
        return None, f"done anew: {error}"
    return (record, "") if record.key == key else (None, "")
