"""A bench as one file: data, options, results and notes, with checksums and RO-Crate metadata; and back.

RO-Crate 1.1 (Soiland-Reyes et al. 2022, Data Science 5, 97): a JSON-LD file names every file, its size and digest, so
that others can tell what is in it without this program.
"""

import json
import os
import zipfile
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

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
    """Write a folder into a file, with its metadata; no link is followed."""
    files = [
        Path(root, name)
        for root, _, names in sorted(os.walk(folder))
        for name in sorted(names)
        if not (name.endswith(LEFT_OUT) or name == CRATE or Path(root, name).is_symlink())
    ]
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
    crate = {"@context": f"{SPECIFICATION}/context", "@graph": graph}
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED, compresslevel=3) as archive:
        archive.writestr(CRATE, json.dumps(crate, indent=1, ensure_ascii=False))
        for path, entry in zip(files, entries, strict=True):
            archive.write(path, entry["@id"])


def unpack(source: Path, folder: Path) -> None:
    """Write the content of an archive into a new folder; whole, or not at all.

    `CampaignError` where it is none, would write outside of the folder, holds links, is larger than any bench, was
    altered, or names recordings that are not in it.
    """
    if folder.exists() and any(folder.iterdir()):
        raise CampaignError(
            f"{folder.name} is there already and is not empty; open it, or move it away to unpack {source.name} again"
        )
    with TemporaryDirectory(dir=folder.parent, prefix=".unpacked-") as scratch:
        made = Path(scratch, folder.name)
        try:
            with zipfile.ZipFile(source) as archive:
                entries = [entry for entry in archive.infolist() if not entry.is_dir()]
                _refuse(source.name, entries)
                digests = _digests(archive, source.name)
                if {entry.filename for entry in entries} != {*digests, CRATE}:
                    raise CampaignError(f"{source.name}: its files are not those that {CRATE} names")
                archive.extractall(made, entries)  # of each no more than the archive says
        except zipfile.BadZipFile as error:
            raise CampaignError(f"{source.name} is no archive of a bench ({error})") from error
        for name, digest in digests.items():
            if not (made / name).is_file() or file_digest(made / name) != digest:
                raise CampaignError(f"{source.name}: {shown(name)} was altered after the archive was made")
        root = made.resolve()
        if not all(path.resolve().is_relative_to(root) for path in Session(made).files.values()):
            raise CampaignError(f"{source.name}: its {MANIFEST} names recordings that are not in the archive")
        if folder.exists():
            folder.rmdir()
        made.replace(folder)


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
