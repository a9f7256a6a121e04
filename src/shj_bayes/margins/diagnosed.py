"""What the diagnoses of a campaign's devices change: populations with the physics that was found, beside the law alone.

A diagnosis belongs to a device when its ``diagnosis.json`` lies in the device's results folder or in ``diagnosis``
below it, and names the same recordings (by SHA-256). Two populations are fitted, one with the parameters that each
device has with what was found, one with those of the law alone, and each margin is the less favourable of the two:
parameters taken one by one do not hold what an effect does to the force, so finding more must not make a margin less
safe. The error of a wrong model is the same for every device of a rig; treating it as one more measurement error of
each device would let it average out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from shj_bayes.errors import InferenceError, PopulationError
from shj_bayes.files import read_json
from shj_bayes.inference.store import read_record
from shj_bayes.mismatch.content import SCHEMA
from shj_bayes.population.device import DeviceEstimate
from shj_bayes.population.measurement import Stated
from shj_bayes.population.quantities import QUANTITIES

PLACES = ("diagnosis.json", "diagnosis/diagnosis.json")
OPEN = ("family", "unknown")
LAW_ALONE = "with the law alone"
Key = tuple[str, str]


@dataclass(frozen=True)
class Diagnosed:
    """What a diagnosis says of a device.

    Parameters
    ----------
    verdict : str
        adequate, named, family or unknown.
    found : tuple of str
        What was left out, in words; for a family its members.
    before, after : mapping of str to (mean, sd)
        Parameters of the law alone and of the augmented model, natural units.
    quick : bool
        True for a first look without sampling.
    """

    verdict: str
    found: tuple[str, ...]
    before: Mapping[str, tuple[float, float]]
    after: Mapping[str, tuple[float, float]]
    quick: bool = False


def find_diagnosis(folder: Path) -> tuple[Diagnosed | None, str]:
    """Look for the diagnosis of a device.

    Parameters
    ----------
    folder : Path
        Results folder of the device's fit.

    Returns
    -------
    Diagnosed or None
        None where there is none, or one that does not belong to this fit.
    str
        Why one that is there was not used; empty otherwise.
    """
    path = next((folder / place for place in PLACES if (folder / place).is_file()), None)
    if path is None:
        return None, ""
    try:
        record = read_json(path, PopulationError)
        if record["schema"] != SCHEMA:
            return None, f"its diagnosis has the schema {record['schema']!r}; run shj-bayes diagnose again"
        digests = [str(entry["sha256"]) for entry in record["inputs"]]
        fitted = [str(entry["sha256"]) for entry in read_record(folder)["inputs"]]
        result = _diagnosed(record)
    except (ValueError, KeyError, TypeError, AttributeError, InferenceError, PopulationError) as error:
        return None, f"its diagnosis cannot be read ({error}); run shj-bayes diagnose again"
    if digests != fitted:
        return None, "its diagnosis is of other recordings; run shj-bayes diagnose on those of the fit"
    return result, ""


def _diagnosed(record: Mapping[str, Any]) -> Diagnosed:
    titles = [str(e.get("title", e["id"])) for e in record["effects"]]
    family = [str(e["id"]) for e in record["family"]]
    before, after = (
        {
            q: (float(values[stage]["mean"]), float(values[stage]["sd"]))
            for q, values in record["shift"].items()
            if q in QUANTITIES
        }
        for stage in ("before", "after")
    )
    verdict = str(record["verdict"])
    if verdict not in ("adequate", "named", *OPEN):
        raise ValueError(f"verdict {verdict!r}")
    return Diagnosed(
        verdict, tuple(family if verdict == "family" else titles), before, after, bool(record.get("quick"))
    )


def stated(device: DeviceEstimate, values: Mapping[str, tuple[float, float]]) -> DeviceEstimate:
    """Device with the parameters (mean, sd) that a diagnosis gives, where it gives them."""
    known = dict(device.measurements)
    for q, (mean, sd) in values.items():
        if q in known and sd > 0 and (mean > 0 or not QUANTITIES[q].logarithmic):
            known[q] = Stated(mean, sd)
    return replace(device, measurements=known)


@dataclass(frozen=True)
class Cases:
    """The populations that margins are taken over.

    Parameters
    ----------
    devices : tuple of (label, devices)
        With what was found, and with the law alone; none where no diagnosis changes anything.
    words : tuple of str
        What was found, device by device, and what could not be used.
    """

    devices: tuple[tuple[str, tuple[DeviceEstimate, ...]], ...]
    words: tuple[str, ...]


def cases(devices: Iterable[DeviceEstimate], found: Mapping[Key, Diagnosed], notes: Iterable[str] = ()) -> Cases:
    """Give the populations to fit beside that of the law alone; none where the diagnoses change nothing.

    Parameters
    ----------
    devices : iterable of DeviceEstimate
        As fitted.
    found : mapping of (set, device) to Diagnosed
        Per device.
    notes : iterable of str
        Diagnoses that could not be used.

    Returns
    -------
    Cases
    """
    devices = tuple(devices)
    notes = (_how_many(len(found), len(devices)), *notes)
    changed = {key: d for key, d in found.items() if d.verdict != "adequate" and d.after}
    if not changed:
        return Cases((), notes)
    words = [_words(f"{key[0]}, {key[1]}", d) for key, d in changed.items()]

    def at(stage: str) -> tuple[DeviceEstimate, ...]:
        known = ((d, changed.get((d.set_name, d.name))) for d in devices)
        return tuple(device if found is None else stated(device, getattr(found, stage)) for device, found in known)

    return Cases((("with the physics found", at("after")), (LAW_ALONE, at("before"))), (*words, *notes))


def _how_many(diagnosed: int, devices: int) -> str:
    if diagnosed == 0:
        return (
            "No device has a diagnosis: the margins rest on the law as published (shj-bayes diagnose looks beyond it)."
        )
    return f"{diagnosed} of {devices} devices have a diagnosis; the others rest on the law as published."


def _words(name: str, diagnosis: Diagnosed) -> str:
    what = ", ".join(diagnosis.found) or "something without a name"
    tail = " (first look, not sampled)" if diagnosis.quick else ""
    return {
        "named": f"{name}: {what}; margins are the less favourable with and without it{tail}",
        "family": f"{name}: one of {what}, not told apart; margins are the less favourable with and without{tail}",
    }.get(
        diagnosis.verdict,
        f"{name}: left out and not explained by the catalogue; margins are the less favourable of the law alone and of "
        f"the best model found ({what}){tail}",
    )
