"""The folder that is worked in: an ordinary campaign folder. A page names files, devices and sets by ids alone.

``campaign.toml`` is the manifest that the commands read. ``bench/memory.json`` holds what they have no use for: files
that belong to no device yet, and the columns that were chosen for each form of file.
"""

import json
import re
import shutil
import tomllib
from collections.abc import Callable, Container, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

import tomlkit

from shj_bayes._util.files import file_digest, plain_name, read_json, write_text
from shj_bayes.errors import CampaignError, plain_lines, plain_text, shown
from shj_bayes.results.campaign import MAX_NOTE, SCHEMA, Connection

MANIFEST, MEMORY, RECORDINGS = "campaign.toml", "bench/memory.json", "recordings"
KEPT = "campaign-before-bench.toml"  # a manifest that somebody wrote by hand, as it was
HEAD = "# Written by shj-bayes bench; the commands read it too.\n"
MOST_FILES, MOST_NAME = 5000, 80
READING = ("columns", "units", "rate_Hz", "sheet", "runs")  # options of reading, which files of a form share
CHOSEN = (*READING, "model", "noise", "priors")  # options that a page may set
CONNECTION = {name: get_args(hint)[0] for name, hint in get_type_hints(Connection).items()}
Found = TypeVar("Found")
_RUN = re.compile(r"^(.*?)[\s_.-]*(?:run|test|lauf|r|t)[\s_.-]*(\d+)$", re.IGNORECASE)
_NUMBERED = re.compile(r"^(?:(.+?)[\s_.-]+|(.{2,}[^\W\d]))\d+$")  # "bare 2" and "bare2", not "s24"
_ENDING = re.compile(r"(\.[A-Za-z0-9]{1,6}){1,2}$")
_UNSAFE = re.compile(r"[^\w .()+-]+")


@dataclass(eq=False)
class BenchDevice:
    """A device of the manifest."""

    id: str
    content: dict[str, Any]  # its table
    files: list[str] = field(default_factory=list)  # ids of its recordings, in the order they were run

    @property
    def name(self) -> str:
        """Its name."""
        return str(self.content["name"])

    def choose(self, options: Mapping[str, Any], known: tuple[str, ...] = CHOSEN) -> None:
        """Choose all of its options that are `known`; empty ones are left out."""
        kept = {name: value for name, value in self.content.get("options", {}).items() if name not in known}
        _put(self.content, "options", kept | _plain_options(options, known))
        self.content.pop("runs", None)

    def describe(self, said: Mapping[str, Any]) -> None:
        """Set what is known of it: options of its fit, and a note."""
        if "options" in said:
            self.choose(said["options"])
        if "note" in said:
            _put(self.content, "note", _note(said["note"]))


@dataclass(eq=False)
class BenchSet:
    """A set of the manifest."""

    id: str
    content: dict[str, Any]  # its table without its devices
    devices: list[BenchDevice] = field(default_factory=list)

    @property
    def name(self) -> str:
        """Its name."""
        return str(self.content["name"])

    def describe(self, said: Mapping[str, Any]) -> None:
        """Set what is known of it: its connection as tested, and a note."""
        connection = {}
        for name, value in dict(said.get("connection") or {}).items():
            if name not in CONNECTION:
                raise CampaignError(f"a connection has no {shown(name, 30)}; known are {', '.join(CONNECTION)}")
            if value in ("", None):
                continue
            try:
                connection[name] = CONNECTION[name](value)
            except (TypeError, ValueError) as error:
                raise CampaignError(f"{name} = {shown(value)} is no number") from error
        _put(self.content, "connection", connection)
        _put(self.content, "note", _note(said.get("note")))


class Session:
    """Files, devices and sets of a folder; what is changed is written at once, but for what entries are told."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.files: dict[str, Path] = {}
        self.sets: list[BenchSet] = []
        self.forms = _forms(folder)
        self.top: dict[str, Any] = {"schema": SCHEMA, "name": plain_name(folder.name)}
        self._numbers = count(1)
        manifest = folder / MANIFEST
        if manifest.is_file():
            text = manifest.read_text(encoding="utf-8")
            try:
                content = tomllib.loads(text)
                self.top = {key: value for key, value in content.items() if key != "set"}
                self.take(content.get("set", ()), lambda name: folder / name)
            except (tomllib.TOMLDecodeError, KeyError, TypeError, AttributeError) as error:
                raise CampaignError(
                    f"{MANIFEST} in {folder.name} is none that the bench can go on with "
                    f"({type(error).__name__}: {plain_text(str(error))[:200]}); mend it, or open another folder"
                ) from error
            if not text.startswith(HEAD):
                shutil.copyfile(manifest, folder / KEPT)
        known = {path.resolve() for path in self.files.values()}
        loose = sorted((folder / RECORDINGS).iterdir()) if (folder / RECORDINGS).is_dir() else []
        for path in loose:
            if path.is_file() and not path.name.startswith(".") and path.resolve() not in known:
                self._id_of(path)

    def take(self, sets: Iterable[Mapping[str, Any]], place: Callable[[str], Path]) -> None:
        """Take tables of a manifest in; `place` gives the path of a recording by how they name it."""
        for table in sets:
            own = BenchSet(f"s{next(self._numbers)}", {k: v for k, v in table.items() if k != "device"})
            for device in table.get("device", ()):
                files = [self._id_of(place(str(name))) for name in device["recordings"]]
                one = BenchDevice(f"d{next(self._numbers)}", dict(device), files)
                assert one.name
                own.devices.append(one)
            assert own.name
            self.sets.append(own)

    def _id_of(self, path: Path) -> str:
        known = next((key for key, one in self.files.items() if one == path), None)
        key = known or f"f{next(self._numbers)}"
        self.files[key] = path
        return key

    @property
    def devices(self) -> Iterator[tuple[BenchSet, BenchDevice]]:
        """All devices, each with its set."""
        return ((group, device) for group in self.sets for device in group.devices)

    def device(self, key: str) -> tuple[BenchSet, BenchDevice]:
        """Find a device by its id, with its set; `CampaignError` where there is none."""
        return _here(next((pair for pair in self.devices if pair[1].id == key), None), "device", key)

    def group(self, key: str) -> BenchSet:
        """Find a set by its id; `CampaignError` where there is none."""
        return _here(next((one for one in self.sets if one.id == key), None), "set", key)

    def file(self, key: str) -> Path:
        """Find a file by its id; `CampaignError` where there is none."""
        return _here(self.files.get(key), "file", key)

    def add(self, path: Path, form: str = "") -> str:
        """Take a file in: a run of the device that its name belongs to, or a new device. Give its id.

        A file of a form whose columns were chosen before is read with them.
        """
        key = self._id_of(path)
        stem = path.name.removesuffix(".gz").rpartition(".")[0] or path.name
        parts = _RUN.match(stem)
        name = plain_name(parts[1] if parts and parts[1] else stem)
        if parts:
            mine = next((device for _, device in self.devices if device.name == name), None)
            if mine is not None and all(self.files[one].parent == self.folder / RECORDINGS for one in mine.files):
                mine.files = sorted([*mine.files, key], key=lambda one: _number(self.files[one]))
                self.write()
                return key
        numbered, taken = _NUMBERED.match(name), {device.name for _, device in self.devices}
        set_name = plain_name(numbered[1] or numbered[2]) if numbered else "Set 1"
        own = next((one for one in self.sets if one.name == set_name), None)
        if own is None:
            own = BenchSet(f"s{next(self._numbers)}", {"name": set_name})
            self.sets.append(own)
        own.devices.append(BenchDevice(f"d{next(self._numbers)}", {"name": _free_name(name, taken)}, [key]))
        if form in self.forms:
            self.set_reading(key, self.forms[form])
        self.write()
        return key

    def remove(self, key: str) -> None:
        """Take a file out of the folder, and its device where that has no other."""
        path = self.file(key)
        for group in self.sets:
            for device in group.devices:
                device.files = [one for one in device.files if one != key]
            group.devices = [device for device in group.devices if device.files]
        self.sets = [group for group in self.sets if group.devices]
        if path.parent == self.folder / RECORDINGS:
            path.unlink(missing_ok=True)
        del self.files[key]
        self.write()

    def set_reading(self, key: str, options: Mapping[str, Any], form: str = "") -> None:
        """Choose how the device of a file is read, and files of the same form that come later."""
        for _, device in self.devices:
            if key in device.files:
                device.choose(options, READING)
        if form:
            self.forms[form] = _plain_options(options, READING)
        self.write()

    def arrange(self, wanted: Any) -> None:
        """Put files into devices and devices into sets, as a list of sets with ids says; names come with it."""
        try:
            sets = [
                (
                    str(entry.get("id")),
                    plain_name(str(entry["name"])),
                    [
                        (str(one.get("id")), plain_name(str(one["name"])), [str(key) for key in one["files"]])
                        for one in entry["devices"]
                    ],
                )
                for entry in wanted
            ]
        except (TypeError, KeyError, AttributeError) as error:
            raise CampaignError(f"an arrangement that cannot be read ({type(error).__name__})") from error
        _check([(name, devices) for _, name, devices in sets], self.files)
        known, groups = {device.id: device for _, device in self.devices}, {one.id: one for one in self.sets}
        self.sets = []
        for key, name, wanted_devices in sets:
            own = groups.get(key) or BenchSet(f"s{next(self._numbers)}", {})
            own.content["name"], own.devices = name, []
            for device_key, device_name, files in wanted_devices:
                device = known.get(device_key) or BenchDevice(f"d{next(self._numbers)}", {})
                device.content["name"], device.files = device_name, files
                own.devices += [device] if files else []
            self.sets += [own] if own.devices else []
        self.write()

    def write(self) -> None:
        """Write the manifest and what the bench remembers."""
        (self.folder / MEMORY).parent.mkdir(parents=True, exist_ok=True)
        write_text(self.folder / MEMORY, json.dumps({"forms": self.forms}, indent=1))
        if not self.sets:
            (self.folder / MANIFEST).unlink(missing_ok=True)
            return

        def written(device: BenchDevice) -> list[str]:
            """Paths below the folder, with forward slashes; others as they are."""
            paths = [self.files[key] for key in device.files]
            return [str(p.relative_to(self.folder).as_posix() if p.is_relative_to(self.folder) else p) for p in paths]

        tables = [
            group.content | {"device": [one.content | {"recordings": written(one)} for one in group.devices]}
            for group in self.sets
        ]
        write_text(self.folder / MANIFEST, HEAD + tomlkit.dumps({**self.top, "set": tables}))


def reading_of(session: Session, key: str) -> dict[str, Any]:
    """Options with which a file is read: those of the device that it belongs to."""
    for group, device in session.devices:
        if key in device.files:
            given = {**session.top.get("defaults", {}), **group.content.get("options", {})}
            given |= device.content.get("options", {})
            given |= {"runs": device.content["runs"]} if "runs" in device.content else {}
            return {name: value for name, value in given.items() if name in READING}
    return {}


def place_for(session: Session, name: str) -> Path:
    """Give the path for a file that comes in under a name, which is used as a name alone."""
    if len(session.files) >= MOST_FILES:
        raise CampaignError(f"{MOST_FILES} files are in this folder already; begin another one")
    base = _UNSAFE.sub("_", plain_text(name.replace("\\", "/").rpartition("/")[2])).strip(" .")[-MOST_NAME:]
    stem, dot, endings = (base or "recording").partition(".")
    folder = session.folder / RECORDINGS
    folder.mkdir(parents=True, exist_ok=True)
    tries = (f"{stem or 'recording'}{f'-{n}' if n else ''}{dot}{endings}" for n in count())
    return next(folder / one for one in tries if not (folder / one).exists())


def same_as(session: Session, path: Path) -> str | None:
    """Find a file of the folder with the same content, by its id."""
    size, digest = path.stat().st_size, file_digest(path)
    for key, one in session.files.items():
        if one != path and one.is_file() and one.stat().st_size == size and file_digest(one) == digest:
            return key
    return None


def bring(session: Session, manifest: Path) -> None:
    """Copy the recordings of a manifest that ships with the program, with its sets and devices."""

    def copied(name: str) -> Path:
        target = place_for(session, name)
        shutil.copyfile(manifest.parent / name, target)
        return target

    tables, taken = tomllib.loads(manifest.read_text(encoding="utf-8"))["set"], {one.name for one in session.sets}
    for table in tables:
        table["name"] = _free_name(table["name"], taken)
        taken.add(table["name"])
    session.take(tables, copied)
    session.write()


def history_in(folder: Path) -> Path | None:
    """Find the history of displacement that was dropped in; None where there is none."""
    return next(iter(sorted((folder / "bench").glob("history.*"))), None)


def place_for_history(folder: Path, name: str) -> Path:
    """Give the path for a history, in the place of the one before; its name tells its format alone."""
    if before := history_in(folder):
        before.unlink()
    ending = _ENDING.search(name)
    return folder / "bench" / f"history{ending[0] if ending else '.csv'}"


def _forms(folder: Path) -> dict[str, dict[str, Any]]:
    """Read the options that were chosen for each form of file."""
    memory = read_json(folder / MEMORY, CampaignError) if (folder / MEMORY).is_file() else {}
    forms = (memory.get("forms") if isinstance(memory, dict) else None) or {}
    tables = {str(form): chosen if isinstance(chosen, dict) else {} for form, chosen in forms.items()}
    return {form: {name: value for name, value in own.items() if name in READING} for form, own in tables.items()}


def _check(sets: list[tuple[str, list[tuple[Any, str, list[str]]]]], known: Mapping[str, Path]) -> None:
    """Refuse an arrangement that no manifest could hold, before anything of it is taken."""
    for set_name, devices in sets:
        names = [name for _, name, files in devices if files]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice:
            raise CampaignError(f"two devices of the set '{set_name}' are called '{twice}'; rename one of them")
    if len({name for name, _ in sets}) < len(sets):
        raise CampaignError("two sets have the same name; rename one of them")
    used = [key for _, devices in sets for *_, files in devices for key in files]
    for key in used:
        _here(known.get(key), "file", key)
    if len(set(used)) < len(used):
        raise CampaignError("a file belongs to one device alone")


def _here(found: Found | None, what: str, key: str) -> Found:
    """Give what was found by its id; `CampaignError` where nothing was."""
    if found is None:
        raise CampaignError(f"there is no {what} {shown(key, 20)} here any more; load the page again")
    return found


def _free_name(name: str, taken: Container[str]) -> str:
    return next(one for n in count(1) if (one := name if n == 1 else f"{name} ({n})") not in taken)


def _number(path: Path) -> tuple[int, str]:
    parts = _RUN.match(path.name.removesuffix(".gz").rpartition(".")[0])
    return int(parts[2][:9]) if parts else 0, path.name


def _put(table: dict[str, Any], key: str, value: Any) -> None:
    """Put a value into a table, or take the key out where there is none."""
    table.pop(key, None)
    if value:
        table[key] = value


def _note(said: Any) -> str:
    return plain_lines(str(said or ""))[:MAX_NOTE].strip()


def _plain_options(options: Any, known: tuple[str, ...]) -> dict[str, Any]:
    """Options as a manifest holds them; empty ones are left out."""
    chosen: dict[str, Any] = {}
    for name, value in dict(options).items():
        if name not in known:
            raise CampaignError(f"{shown(name, 30)} is no option here; known are {', '.join(known)}")
        if value in ("", None):
            continue
        if not isinstance(value, str | int | float) or isinstance(value, bool):
            raise CampaignError(f"{name} = {shown(value)}; it needs a text or a number")
        chosen[name] = plain_text(value)[:400] if isinstance(value, str) else value
    return chosen
