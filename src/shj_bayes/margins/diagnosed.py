"""The diagnoses of a campaign's devices: where they are, whether they belong, and what they found in words.

A diagnosis belongs to a device when its ``diagnosis.json`` lies in the device's results folder or in ``diagnosis``
below it, and names the same recordings (by SHA-256). The fit that it ended in lies beside it; the virtual test drives
the device with that model and with the law alone.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from shj_bayes.errors import InferenceError, ReportError
from shj_bayes.results.diagnosis import NOTHING_MISSING, DiagnosisRecord, DiagnosisVerdict
from shj_bayes.results.fit import FitRecord
from shj_bayes.results.store import diagnosis_in, has, read

Key = tuple[str, str]


@dataclass(frozen=True)
class Diagnosed:
    """What a diagnosis says of a device."""

    verdict: DiagnosisVerdict  # what it found
    found: tuple[str, ...]  # what was left out, in words; for a family its members
    fit: Path | None = None  # folder of the fit that it ended in; None for a first look, which has none


def find_diagnosis(folder: Path) -> tuple[Diagnosed | None, str]:
    """Look for the diagnosis of a device in the folder of its fit.

    None where there is none, or one that does not belong to this fit; and why one that is there was not used.
    """
    place = folder / diagnosis_in(folder)
    if not has(DiagnosisRecord, place):
        return None, ""
    try:
        record, fitted = read(DiagnosisRecord, place), read(FitRecord, folder)
    except (InferenceError, ReportError) as error:
        return None, f"its diagnosis cannot be read ({error}); run shj-bayes diagnose again"
    if record.sha256_of_inputs != fitted.sha256_of_inputs:
        return None, "its diagnosis is of other recordings; run shj-bayes diagnose on those of the fit"
    found = [e.title or e.id for e in record.effects]
    if record.verdict is DiagnosisVerdict.FAMILY:
        nothing = [NOTHING_MISSING] if any(not one.classes for one in record.sets) else []
        found = [*(e.id for e in record.family), *nothing]
    return Diagnosed(record.verdict, tuple(found), place if has(FitRecord, place) and not record.quick else None), ""


def words_of(found: Mapping[Key, Diagnosed], n_devices: int, notes: Iterable[str] = ()) -> tuple[str, ...]:
    """Say what the diagnoses found, by (set, device), of how many devices, and what could not be used (`notes`)."""
    changed = [
        _words(f"{key[0]}, {key[1]}", d) for key, d in found.items() if d.verdict is not DiagnosisVerdict.ADEQUATE
    ]
    return (*changed, _how_many(len(found), n_devices), *notes)


def _how_many(diagnosed: int, devices: int) -> str:
    if diagnosed == 0:
        return (
            "No device has a diagnosis: the margins rest on the law as published (shj-bayes diagnose looks beyond it)."
        )
    others = "; the others rest on the law as published" if diagnosed < devices else ""
    return f"{diagnosed} of {devices} devices have a diagnosis{others}."


def _words(name: str, diagnosis: Diagnosed) -> str:
    what = ", ".join(diagnosis.found) or "something without a name"
    tail = (
        ""
        if diagnosis.fit
        else " (first look without a posterior: bounds rest on the law alone and on what was measured)"
    )
    return {
        DiagnosisVerdict.NAMED: f"{name}: {what}{tail}",
        DiagnosisVerdict.FAMILY: f"{name}: one of {what}, not told apart{tail}",
    }.get(diagnosis.verdict, f"{name}: left out and not explained by the catalogue; best model found: {what}{tail}")
