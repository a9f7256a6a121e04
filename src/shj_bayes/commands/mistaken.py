"""Slips that spoil a result without a trace: the same recording twice, another device's folder, an idle option."""

import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from shj_bayes.errors import InferenceError
from shj_bayes.recording.recording import Finding, Recording
from shj_bayes.results.diagnosis import DiagnosisRecord
from shj_bayes.results.fit import FitRecord
from shj_bayes.results.store import find


def content_digest(recording: Recording) -> str:
    """Digest of what a recording holds, whatever its file is called."""
    extras = [extra.values for extra in recording.extras]
    return _digest(recording.time_s, recording.displacement_mm, recording.force_kN, recording.used, *extras)


def _digest(*arrays: object) -> str:
    return hashlib.sha256(b"".join(np.asarray(values).tobytes() for values in arrays)).hexdigest()


def remarked(recordings: Sequence[Recording], free: Sequence[str] = ()) -> list[Recording]:
    """Warn where one of a device's recordings comes again, and where an option can have no effect.

    Such as `free`, the parameters that each run has for itself, where there is one run.
    """
    if len(recordings) == 1 and free:
        message = f"{', '.join(free)} cannot differ between runs where there is one run: --free has no effect"
        return [recordings[0].with_findings(Finding("free-without-effect", "warning", message))]
    first: dict[str, int] = {}
    out = []
    for number, recording in enumerate(recordings, start=1):
        samples = _digest(recording.displacement_mm, recording.force_kN)  # whatever clock they were copied onto
        earlier = first.setdefault(samples, number)
        if earlier == number:
            out.append(recording)
            continue
        message = (
            f"run {number} ({recording.source.name}) holds the same samples as run {earlier} "
            f"({recordings[earlier - 1].source.name}): the device would look as if a run changed nothing; name each "
            "recording once"
        )
        out.append(recording.with_findings(Finding("same-recording", "warning", message)))
    return out


def refuse_used_folder(folder: Path, name: str, recordings: Sequence[Recording]) -> None:
    """Refuse a folder that holds the result of another device: neither its name nor any recording is the same."""
    mine = {recording.source.sha256 for recording in recordings}
    # A damaged file is told of, and replaced, by whoever reads it.
    for record in (find(FitRecord, folder), find(DiagnosisRecord, folder)):
        if record and record.device != name and not mine & {str(sha256) for sha256 in record.sha256_of_inputs}:
            word = record.FILE.removesuffix(".json")
            raise InferenceError(
                f"{folder.name} holds the {word} of another device, '{record.device}'; give '{name}' a folder of its "
                "own with -o, or replace what is there with --force"
            )


def repeated(inputs: Iterable[tuple[str, str, str]]) -> list[str]:
    """Say which recordings belong to several devices, from device with its set, name of the file and its digest."""
    places: dict[str, dict[str, str]] = {}
    for device, name, digest in inputs:
        places.setdefault(digest, {}).setdefault(device, name)
    return [
        f"The same recording is in {len(where)} devices, which counts one test as several: "
        + ", ".join(f"{device} ({name})" for device, name in list(where.items())[:5])
        + (f" and {len(where) - 5} more." if len(where) > 5 else ".")
        for digest, where in places.items()
        if digest and len(where) > 1
    ]
