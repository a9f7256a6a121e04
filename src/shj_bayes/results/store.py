"""Files of results: the only place that opens, writes and seals them; and what need not be made again."""

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, fields
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar, get_args, get_type_hints

import numpy as np

import shj_bayes
from shj_bayes._util.files import (
    MAX_JSON,
    check_seal,
    damage_told,
    file_digest,
    json_of,
    read_bytes,
    read_json,
    refuse_packed,
    replacing,
    sealed,
    write_text,
)
from shj_bayes._util.imports import arviz
from shj_bayes._util.processes import vet
from shj_bayes.errors import InferenceError, ShjError
from shj_bayes.results.codec import Stored, from_json, to_json
from shj_bayes.results.diagnosis import DiagnosisRecord
from shj_bayes.results.fit import FitRecord

DIAGNOSIS = "diagnosis"  # in the folder of a device of a campaign: that of its diagnosis
FILES = ("posterior.nc", "summary.csv", "summary.json")  # whose digests stand in fit.json
CHECKPOINT = "checkpoint.h5"  # of a fit that is under way, or has not converged
HELD = 64  # records in memory, as they were read last
CHUNK = 512  # samples that all draws of are compressed together
COMPRESSED = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
SOURCES = ("**/*.py", "**/templates/*", "**/scripts/*")  # of the package
_TRUSTED: set[tuple[str, str]] = set()  # digest, and group or "" for all, of netCDF files written or vetted here
Said = TypeVar("Said")


Kind = TypeVar("Kind", bound=Stored)


def has(kind: type[Stored], folder: Path) -> bool:
    """Whether a folder holds the file of a record."""
    return (folder / kind.FILE).is_file()


def read(kind: type[Kind], folder: Path) -> Kind:
    """Read a record; the error of its kind where the file is missing, damaged, altered or of another schema."""
    path = folder / kind.FILE
    if not path.exists():
        raise kind.ERROR(f"{folder.name} holds no {kind.FILE}; run {kind.COMMAND} first")
    of_kind: Any = kind
    found: Kind = _record(of_kind, path, read_bytes(path, MAX_JSON, kind.ERROR))
    return found


@lru_cache(maxsize=HELD)
def _record(kind: type[Stored], path: Path, raw: bytes) -> Any:
    """Make the record of what was read of its file; a summary asks for those of a device a dozen times."""
    content, where = json_of(raw, path, kind.ERROR), f"{kind.FILE} in {path.parent.name}"
    schemas = get_args(get_type_hints(kind)["schema"])
    if not isinstance(content, dict) or content.get("schema") not in schemas:
        raise kind.ERROR(f"{where} has none of the schemas {', '.join(schemas)}; {_mend(kind)}")
    check_seal(content, path, kind.ERROR)
    try:
        return from_json(kind, content)
    except (ValueError, ShjError) as error:
        raise kind.ERROR(f"{where}: {error}; {_mend(kind)}") from error


def _mend(kind: type[Stored]) -> str:
    return f"restore it, or run {kind.COMMAND} again"


def content_of(path: Path, error: type[ShjError]) -> Any:
    """Read a JSON file as it is."""
    return read_json(path, error)


def find(kind: type[Kind], folder: Path) -> Kind | None:
    """Read a record; None where there is none that can be read."""
    try:
        return read(kind, folder)
    except kind.ERROR:
        return None


def diagnosis_in(folder: Path) -> str:
    """Where the diagnosis of a device lies, below the folder of its fit: beside a fit that it ended in, or alone."""
    return "." if has(DiagnosisRecord, folder) else DIAGNOSIS


def write(record: Any, folder: Path, *, allow_nan: bool = False, ascii_only: bool = True) -> dict[str, Any]:
    """Write a record whole or not at all, and give its content; one that has a digest is sealed."""
    content: dict[str, Any] = to_json(record)
    if any(f.name == "digest" for f in fields(record)):
        content = sealed(content)
    text = json.dumps(content, indent=1, ensure_ascii=ascii_only, allow_nan=allow_nan)
    write_text(folder / record.FILE, text if ascii_only else f"{text}\n")
    return content


def write_arrays(arrays: Mapping[str, Any], path: Path) -> str:
    """Write arrays of numbers, whole or not at all, and give the digest of the file."""
    with replacing(path) as part, part.open("wb") as stream:
        np.savez(stream, **arrays)
    return file_digest(path)


def refuse_altered(path: Path, kind: type[Stored], sha256: str | None) -> None:
    """Refuse a file beside a record that is missing, or has another digest than the record says, where it does."""
    if not path.is_file():
        raise kind.ERROR(f"{path.name} is missing in {path.parent.name}; {_mend(kind)}")
    if sha256 not in (None, file_digest(path)):
        raise kind.ERROR(
            f"{path.name} in {path.parent.name} was cut short or altered after it was written (its SHA-256 is not the "
            f"one in {kind.FILE}); {_mend(kind)}"
        )


def check_files(folder: Path, record: FitRecord) -> None:
    """Refuse files of a fit that are missing or altered; a fit of an earlier version has no digests."""
    for name in FILES:
        refuse_altered(folder / name, FitRecord, record.files.get(name))


def read_arrays(path: Path, kind: type[Stored], sha256: str | None) -> dict[str, Any]:
    """Read back what `write_arrays` wrote beside a record; the error of its kind where the file is not that one."""
    refuse_altered(path, kind, sha256)
    with damage_told(f"{kind.FILE} or {path.name} in {path.parent.name}", kind.ERROR):
        refuse_packed(path, kind.ERROR)
        with np.load(path, allow_pickle=False) as archive:
            return {key: archive[key] for key in archive.files}


def packed(arrays: Mapping[str, Any]) -> dict[str, Any]:
    """Arrays as one of each kind, with an index of them: hundreds of small ones take long to find in a file."""
    kinds: dict[str, list[tuple[str, Any]]] = {}
    for name, array in arrays.items():
        kinds.setdefault(array.dtype.name, []).append((name, array))
    index = json.dumps({kind: [(name, array.shape) for name, array in own] for kind, own in kinds.items()})
    whole = {kind: np.concatenate([array.ravel() for _, array in own]) for kind, own in kinds.items()}
    return {"index": np.frombuffer(index.encode(), np.uint8), **whole}


def unpacked(whole: Mapping[str, Any]) -> dict[str, Any]:
    """Undo `packed`."""
    out: dict[str, Any] = {}
    for kind, own in json.loads(whole["index"].tobytes()).items():
        parts = np.split(whole[kind], np.cumsum([math.prod(shape) for _, shape in own])[:-1])
        out |= {name: part.reshape(shape) for (name, shape), part in zip(own, parts, strict=True)}
    return out


class Group(NamedTuple):
    """One group of a netCDF file, as `xarray.Dataset` takes it: what it holds by name, and words on all of it."""

    arrays: Mapping[str, tuple[tuple[str, ...], Any, dict[str, Any]]]  # names of its dimensions, numbers, words on them
    words: Mapping[str, Any]


def write_netcdf(path: Path, groups: Mapping[str, Group], words: Mapping[str, Any] | None = None) -> None:
    """Write groups as netCDF, long arrays compressed; the group without a name is that at the top.

    Through xarray that took half a second more, and the second of importing it and pandas.
    """
    import h5netcdf  # noqa: PLC0415  (who reads only records need not load it)

    with h5netcdf.File(path, "w") as file:
        file.attrs.update(words or {})
        for name, group in groups.items():
            place = file.create_group(name) if name else file
            place.attrs.update(group.words)
            arrays = group.arrays.values()
            place.dimensions = {d: n for names, values, _ in arrays for d, n in zip(names, values.shape, strict=True)}
            # What dimensions are counted by comes first: it would make the library attach all along them anew.
            ordered = sorted(group.arrays.items(), key=lambda named: named[1][0] != (named[0],))
            for variable, (dimensions, values, own) in ordered:
                chunks = (*values.shape[:2], min(CHUNK, values.shape[2])) if values.ndim > 2 else None
                how = COMPRESSED if values.size > CHUNK else {}
                made = place.create_variable(variable, dimensions, data=values, chunks=chunks, **how)
                made.attrs.update(own)
    _TRUSTED.add((file_digest(path), ""))


@contextmanager
def netcdf_file(path: Path, group: str = "") -> Iterator[Any]:
    """Open a netCDF file to read one group of, or all; `ValueError` where it is no result of ours, see `vet`.

    This process trusts what it wrote, and what it vetted.
    """
    import h5py  # noqa: PLC0415  (as above)

    digest = file_digest(path)
    if _TRUSTED.isdisjoint({(digest, ""), (digest, group)}):
        vet(path, group)
        _TRUSTED.add((digest, group))
    with h5py.File(path, "r") as file:
        yield file


@contextmanager
def posterior_file(folder: Path, group: str = "") -> Iterator[Any]:
    """Open ``posterior.nc`` to read one group of, or all; `InferenceError` where it is missing, damaged or altered."""
    if has(FitRecord, folder):
        check_files(folder, read(FitRecord, folder))
    try:
        with netcdf_file(folder / FILES[0], group) as file:
            yield file
    except Exception as error:  # the readers raise dozens of kinds for damaged files; all mean the same
        raise InferenceError(
            f"posterior.nc in {folder.name} cannot be read ({str(error)[:200]}); run the fit again"
        ) from error


def read_whole(folder: Path) -> Any:
    """``posterior.nc`` as the installed ArviZ reads it."""
    with posterior_file(folder) as file:
        data = arviz().from_netcdf(file.filename, engine="h5netcdf")
        data.load()  # and close: an open file cannot be replaced on Windows
        data.close()
    return data


def taken_out(value: Any, arrays: dict[str, Any]) -> Any:
    """Give values as JSON holds them, with the name of each array in its place, which goes to `arrays`."""
    if isinstance(value, Mapping):
        return {key: taken_out(part, arrays) for key, part in value.items()}
    if isinstance(value, tuple | list):
        return [taken_out(part, arrays) for part in value]
    if not hasattr(value, "tobytes"):
        return value
    name = f"array-{len(arrays)}"
    arrays[name] = value
    return {"array": name}


def put_back(value: Any, arrays: Mapping[str, Any]) -> Any:
    """Undo `taken_out`."""
    if isinstance(value, dict):
        if value.keys() == {"array"}:
            return arrays[value["array"]]
        return {key: put_back(part, arrays) for key, part in value.items()}
    return [put_back(part, arrays) for part in value] if isinstance(value, list) else value


def digest_of(value: Any) -> str:
    """SHA-256 of records, values that JSON holds, and arrays among them."""
    arrays: dict[str, Any] = {}
    own = hashlib.sha256(json.dumps(taken_out(to_json(value), arrays), sort_keys=True).encode())
    for array in arrays.values():
        own.update(array.tobytes())
    return own.hexdigest()


@dataclass(frozen=True, kw_only=True)
class StageCache(Stored, file="made.json", command="the command", error=ShjError):
    """Content of ``made.json``: by stage the digest of what it rests on, those of its files, and what it said."""

    schema: Literal["shj-bayes/made/1"] = "shj-bayes/made/1"
    stages: Mapping[str, Mapping[str, Any]]
    digest: str = ""


def digests(folder: Path, patterns: Sequence[str]) -> dict[str, str]:
    """SHA-256 of every file of a folder that one of the patterns fits, by its path below the folder."""
    files = {path for pattern in patterns for path in folder.glob(pattern) if path.is_file()}
    return {path.relative_to(folder).as_posix(): file_digest(path) for path in sorted(files)}


def made(folder: Path, stage: str, rests_on: Any, writes: Sequence[str], make: Callable[[], Said]) -> Said:
    """Give what a stage says, values that JSON holds: from its last run where that still holds, else by running it.

    `rests_on` is everything that the result depends on besides the package; `writes` are patterns of all files below
    `folder` that the stage writes. A file that was altered, taken away or added makes the stage run again, and so does
    a package whose own files are others: an updated checkout has the same version number.
    """
    inputs = hashlib.sha256(json.dumps([package(), rests_on], sort_keys=True).encode()).hexdigest()
    known = _stages(folder).get(stage, {})
    if known.get("rests_on") == inputs and known.get("files") == digests(folder, writes):
        said: Said = deepcopy(known["said"])
        return said
    said = json.loads(json.dumps(make()))  # as it will be read
    new = {"rests_on": inputs, "files": digests(folder, writes), "said": said}
    write(StageCache(stages={**_stages(folder), stage: new}), folder, allow_nan=True)  # `make` may have added some
    return said


def _stages(folder: Path) -> Mapping[str, Mapping[str, Any]]:
    """Stages of a folder; none where nothing is known or the record cannot be trusted."""
    known = find(StageCache, folder)
    return known.stages if known else {}


@cache
def package() -> str:
    """Digest of the files of the package that runs."""
    files = digests(Path(shj_bayes.__file__).parent, SOURCES)
    return hashlib.sha256(json.dumps([shj_bayes.__version__, files]).encode()).hexdigest()
