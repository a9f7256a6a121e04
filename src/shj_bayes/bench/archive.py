"""A bench as one file: data, options, results and notes, with checksums and RO-Crate metadata; and back.

RO-Crate 1.1 (Soiland-Reyes et al. 2022, Data Science 5, 97): a JSON-LD file names every file, its size and digest, so
that others can tell what is in it without this program.
"""

import json
import os
import shutil
import zipfile
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Any

import shj_bayes
from shj_bayes._util.files import file_digest
from shj_bayes.bench.session import MANIFEST, Session
from shj_bayes.errors import CampaignError, shown

CRATE = "ro-crate-metadata.json"
LEFT_OUT = (".part", ".lock", "checkpoint.h5")  # ends of names: what is under way, and locks
MOST_FILES = 50_000
MOST_BYTES = 4 * 1024**3  # unpacked
MOST_RATIO = 200  # unpacked over packed; recordings as text reach about 10
SPECIFICATION = "https://w3id.org/ro/crate/1.1"


def pack(folder: Path, target: Path) -> None:
    """Write a folder into a file, with its metadata."""
    files = list(_files(folder))
    crate = json.dumps(_crate(folder, files), indent=1, ensure_ascii=False)
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=3) as archive:
        archive.writestr(CRATE, crate)
        for path in files:
            archive.write(path, path.relative_to(folder).as_posix())


def _files(folder: Path) -> Iterator[Path]:
    """Files of a folder that belong into an archive; no link is followed."""
    for root, names, files in os.walk(folder):
        names.sort()
        for name in sorted(files):
            path = Path(root) / name
            if not path.is_symlink() and not name.endswith(LEFT_OUT) and name != CRATE:
                yield path


def _crate(folder: Path, files: list[Path]) -> dict[str, Any]:
    entries = [
        {
            "@id": path.relative_to(folder).as_posix(),
            "@type": "File",
            "name": path.name,
            "contentSize": str(path.stat().st_size),
            "sha256": file_digest(path),
        }
        for path in files
    ]
    made = datetime.now(UTC).isoformat(timespec="seconds")
    program = {"@id": "#shj-bayes", "@type": "SoftwareApplication", "name": "shj-bayes"}
    root = {
        "@id": "./",
        "@type": "Dataset",
        "name": folder.name,
        "description": f"Recordings, options, results, notes; `shj-bayes campaign {MANIFEST} -o .` makes them again.",
        "datePublished": made,
        "hasPart": [{"@id": entry["@id"]} for entry in entries],
        "mentions": {"@id": program["@id"]},
    }
    about = {"@id": CRATE, "@type": "CreativeWork", "conformsTo": {"@id": SPECIFICATION}, "about": {"@id": "./"}}
    graph = [about, root, program | {"softwareVersion": shj_bayes.__version__}, *entries]
    return {"@context": f"{SPECIFICATION}/context", "@graph": graph}


def unpack(source: Path, folder: Path) -> None:
    """Write the content of an archive into a new folder; whole, or not at all.

    `CampaignError` where it is none, would write outside of the folder, holds links, is larger than any bench, was
    altered, or names recordings that are not in it.
    """
    if folder.exists() and any(folder.iterdir()):
        raise CampaignError(
            f"{folder.name} is there already and is not empty; open it, or move it away to unpack {source.name} again"
        )
    there = folder.exists()
    try:
        with zipfile.ZipFile(source) as archive:
            entries = [entry for entry in archive.infolist() if not entry.is_dir()]
            _refuse(source.name, entries)
            digests = _digests(archive, source.name)
            if {entry.filename for entry in entries} != {*digests, CRATE}:
                raise CampaignError(f"{source.name}: its files are not those that {CRATE} names")
            folder.mkdir(parents=True, exist_ok=True)
            for entry in entries:
                _extract(archive, entry, folder / entry.filename)
        for name, digest in digests.items():
            if file_digest(folder / name) != digest:
                raise CampaignError(f"{source.name}: {shown(name)} was altered after the archive was made")
        root = folder.resolve()
        if not all(path.resolve().is_relative_to(root) for path in Session(folder).files.values()):
            raise CampaignError(f"{source.name}: its {MANIFEST} names recordings that are not in the archive")
    except BaseException as error:
        shutil.rmtree(folder, ignore_errors=True)
        if there:
            folder.mkdir()
        if isinstance(error, zipfile.BadZipFile):
            raise CampaignError(f"{source.name} is no archive of a bench ({error})") from error
        raise


def _refuse(name: str, entries: list[zipfile.ZipInfo]) -> None:
    """Refuse what no archive of ours holds."""
    if len(entries) > MOST_FILES or sum(entry.file_size for entry in entries) > MOST_BYTES:
        raise CampaignError(f"{name} holds more than {MOST_FILES} files or {MOST_BYTES // 1024**3} GiB")
    for entry in entries:
        place = PurePosixPath(entry.filename)
        mode = entry.external_attr >> 16
        link = (mode & 0o170000) not in (0, 0o100000)
        strange = "\\" in entry.filename or ":" in entry.filename or "\x00" in entry.filename
        if place.is_absolute() or ".." in place.parts or link or strange:
            raise CampaignError(f"{name} holds {shown(entry.filename)}, which is no file of a bench; it is not opened")
        if entry.file_size > MOST_RATIO * max(entry.compress_size, 1000):
            raise CampaignError(f"{name}: {shown(entry.filename)} unpacks to more than {MOST_RATIO} times its size")


def _digests(archive: zipfile.ZipFile, name: str) -> dict[str, str]:
    """Digests by file, from the metadata."""
    try:
        graph = json.loads(archive.read(CRATE))["@graph"]
        return {str(one["@id"]): str(one["sha256"]) for one in graph if "sha256" in one}
    except (KeyError, TypeError, ValueError) as error:
        raise CampaignError(f"{name} has no readable {CRATE}; only archives that a bench made are opened") from error


def _extract(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, target: Path) -> None:
    """Write one file; no more of it than the archive says."""
    target.parent.mkdir(parents=True, exist_ok=True)
    left = entry.file_size
    with archive.open(entry) as packed, target.open("xb") as stream:
        while left > 0 and (part := packed.read(min(left, 2**20))):
            stream.write(part)
            left -= len(part)
