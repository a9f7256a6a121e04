"""Work that is done again only where what it rests on, or what it wrote, is no longer the same: make, by content.

``made.json`` in a results folder holds for each stage a digest of what it rests on, the digests of the files that it
wrote, and what it said. A file that was altered, taken away or added makes the stage run again, and so does a package
whose own files are others: an updated checkout has the same version number.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import shj_bayes
from shj_bayes._util.files import check_seal, file_digest, read_json, sealed, write_text
from shj_bayes.errors import ShjError

FILE, SCHEMA = "made.json", "shj-bayes/made/1"
SOURCES = ("**/*.py", "**/templates/*", "**/scripts/*")
Said = TypeVar("Said")


def digests(folder: Path, patterns: Sequence[str]) -> dict[str, str]:
    """SHA-256 of every file of a folder that one of the patterns fits, by its path below the folder."""
    files = {path for pattern in patterns for path in folder.glob(pattern) if path.is_file()}
    return {path.relative_to(folder).as_posix(): file_digest(path) for path in sorted(files)}


def made(folder: Path, stage: str, rests_on: Any, writes: Sequence[str], make: Callable[[], Said]) -> Said:
    """Give what a stage says, values that JSON holds: from its last run where that still holds, else by running it.

    `rests_on` is everything that the result depends on besides the package; `writes` are patterns of all files below
    `folder` that the stage writes.
    """
    inputs = hashlib.sha256(json.dumps([package(), rests_on], sort_keys=True).encode()).hexdigest()
    known = _read(folder).get(stage)
    if known and known["rests_on"] == inputs and known["files"] == digests(folder, writes):
        said: Said = known["said"]
        return said
    said = json.loads(json.dumps(make()))  # as it will be read
    # Read again: `make` may have run stages of its own.
    stages = _read(folder) | {stage: {"rests_on": inputs, "files": digests(folder, writes), "said": said}}
    write_text(folder / FILE, json.dumps(sealed({"schema": SCHEMA, "stages": stages})))
    return said


@cache
def package() -> str:
    """Digest of the files of the package that runs."""
    files = digests(Path(shj_bayes.__file__).parent, SOURCES)
    return hashlib.sha256(json.dumps([shj_bayes.__version__, files]).encode()).hexdigest()


def _read(folder: Path) -> dict[str, Any]:
    """Stages of a folder; none where nothing is known or the record cannot be trusted."""
    path = folder / FILE
    try:
        record = read_json(path, ShjError)
        check_seal(record, path, ShjError)
        return dict(record["stages"]) if record["schema"] == SCHEMA else {}
    except (ShjError, KeyError, TypeError, ValueError):
        return {}
