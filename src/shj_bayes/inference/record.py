"""``fit.json``, and what is read without the libraries that fit: results are looked at far more often than made."""

from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes._util.files import check_seal, file_digest, read_json
from shj_bayes._util.vetting import vet
from shj_bayes.errors import InferenceError
from shj_bayes.model.parameters import FloatArray

SCHEMA, READABLE = "shj-bayes/fit/2", ("shj-bayes/fit/1", "shj-bayes/fit/2")
EXTRA = "extra_"  # before the names of further channels in posterior.nc
FILES = ("posterior.nc", "summary.csv", "summary.json")  # whose digests stand in fit.json
KINDS: dict[str, type] = {
    **{"device": str, "verdict": str, "reasons": list, "versions": dict, "model": dict},
    **{"prior_laws": list, "inputs": list, "sampling": dict, "parameters": list},
}


class Trust(StrEnum):
    """How far the draws of a fit may be trusted."""

    RELIABLE = "reliable"
    TENTATIVE = "tentative"
    UNUSABLE = "unusable"


USABLE = frozenset(Trust) - {Trust.UNUSABLE}


class Remark(StrEnum):
    """What the data do not say of a parameter."""

    UNDETERMINED = "undetermined"
    AGAINST_PRIOR = "against-prior"
    AGAINST_EARLIER = "against-earlier"


def read_record(folder: Path) -> dict[str, Any]:
    """Read ``fit.json`` of a results folder; `InferenceError` where it is missing, altered or not ours."""
    path = folder / "fit.json"
    if not path.exists():
        raise InferenceError(f"{folder.name} holds no finished fit (no {path.name} in it); run shj-bayes fit")
    record = read_json(path, InferenceError)
    if not isinstance(record, dict) or record.get("schema") not in READABLE:
        raise InferenceError(
            f"{path.name} in {folder.name} has none of the schemas {', '.join(READABLE)}; run the fit again"
        )
    check_seal(record, path, InferenceError)
    for key, kind in KINDS.items():
        if not isinstance(record.get(key), kind):
            raise InferenceError(f"{path.name} in {folder.name} lacks a proper {key!r}; run the fit again")
    return record


def check_files(folder: Path, record: dict[str, Any]) -> None:
    """Refuse files of a fit that are missing or altered; a fit of an earlier version has no digests."""
    for name in FILES:
        path = folder / name
        if not path.is_file():
            raise InferenceError(f"{name} is missing in {folder.name}; run the fit again")
        wanted = record.get("files", {}).get(name)
        if wanted is not None and file_digest(path) != wanted:
            raise InferenceError(
                f"{name} in {folder.name} was cut short or altered after it was written (its SHA-256 is not the one "
                "in fit.json); restore it or run the fit again"
            )


def read_group(folder: Path, group: str) -> dict[str, FloatArray]:
    """Read the arrays of one group of ``posterior.nc``, by variable in the shape in which they are stored.

    A campaign's summary asks three times for a little of every device; all groups with their coordinates through
    xarray took a third of a second each time. `InferenceError` where the file is missing or damaged.
    """
    import h5py  # noqa: PLC0415

    with whole(folder, group) as path, h5py.File(path, "r") as file:
        return {name: np.asarray(part) for name, part in file[group].items() if isinstance(part, h5py.Dataset)}


@contextmanager
def whole(folder: Path, group: str = "") -> Iterator[Path]:
    """Give ``posterior.nc`` to read one group of, or all; a damaged one is told in one line."""
    if (folder / "fit.json").exists():
        check_files(folder, read_record(folder))
    try:
        vet(folder / "posterior.nc", group)
        yield folder / "posterior.nc"
    except Exception as error:  # the readers raise dozens of kinds for damaged files; all mean the same
        raise InferenceError(
            f"posterior.nc in {folder.name} cannot be read ({str(error)[:200]}); run the fit again"
        ) from error


def is_simulated(entry: dict[str, Any]) -> bool:
    """Whether a recording among the inputs of ``fit.json`` says that it is simulated."""
    return entry["format"] == "simulated" or any(f["code"] == "simulated" for f in entry["findings"])
