"""The folder that is worked in: an ordinary campaign folder. A page names files, devices and sets by ids alone.

``campaign.toml`` is the manifest that the commands read. ``bench/memory.json`` holds what they have no use for: files
that belong to no device yet, and the columns that were chosen for each form of file.
"""

import json
import re
import shutil
import tomllib
from collections import Counter
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
MOST_FILES, MOST_NAME, MOST_TEXT = 5000, 80, 400
READING = ("columns", "units", "rate_Hz", "sheet", "runs")  # options of reading, which files of a form share
CHOSEN = (*READING, "model", "noise", "priors")  # options that a page may set
CONNECTION = {name: get_args(hint)[0] for name, hint in get_type_hints(Connection).items()}
Found = TypeVar("Found")
_RUN = re.compile(r"^(.*?)[\s_.-]*(?:run|test|lauf|r|t)[\s_.-]*(\d+)$", re.IGNORECASE)
_NUMBERED = re.compile(r"^(?:(.+?)[\s_.-]+|(.{2,}[^\W\d]))\d+$")  # "bare 2" and "bare2", not "s24"
_ENDING = re.compile(r"(\.[A-Za-z0-9]{1,6}){1,2}$")
_UNSAFE = re.compile(r"[^\w .()+-]+")


@dataclass(eq=False)
class Entry:
    """A set of the manifest with its devices, or a device with its recordings."""

    id: str
    content: dict[str, Any]  # its table without what is below it
    files: list[str] = field(default_factory=list)  # ids of the recordings of a device, in the order they were run
    devices: "list[Entry]" = field(default_factory=list)

    @property
    def name(self) -> str:
        """Its name."""
        return str(self.content["name"])

    def choose(self, options: Mapping[str, Any], known: tuple[str, ...] = CHOSEN) -> None:
        """Choose all of its options that are `known`; empty ones are left out."""
        kept = {name: value for name, value in self.content.get("options", {}).items() if name not in known}
        self._put("options", kept | _given(options, dict.fromkeys(known, _plain)))
        self.content.pop("runs", None)

    def describe(self, said: Mapping[str, Any]) -> None:
        """Set what is said of it: options of the fit of a device, connection as tested of a set, and a note."""
        if "options" in said:
            self.choose(said["options"])
        if "connection" in said:
            self._put("connection", _given(said["connection"] or {}, CONNECTION))
        if "note" in said:
            self._put("note", plain_lines(str(said["note"] or ""))[:MAX_NOTE].strip())

    def _put(self, key: str, value: Any) -> None:
        self.content.pop(key, None)
        if value:
            self.content[key] = value


def _new(numbers: Iterator[int], kind: str, content: dict[str, Any], files: Iterable[str] = ()) -> Entry:
    return Entry(f"{kind}{next(numbers)}", content, [*files])


class Session:
    """Files, devices and sets of a folder; what is changed is written at once, but for what entries are told."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.files: dict[str, Path] = {}
        self.sets: list[Entry] = []
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
        for path in sorted((folder / RECORDINGS).glob("*")):
            if path.is_file() and not path.name.startswith(".") and path.resolve() not in known:
                self._id_of(path)

    def take(self, sets: Iterable[Mapping[str, Any]], place: Callable[[str], Path]) -> None:
        """Take tables of a manifest in; `place` gives the path of a recording by how they name it."""
        for table in sets:
            content = {key: value for key, value in table.items() if key != "device"}
            own = _new(self._numbers, "s", content | {"name": str(table["name"])})
            for one in table.get("device", ()):
                files = [self._id_of(place(str(name))) for name in one["recordings"]]
                own.devices.append(_new(self._numbers, "d", one | {"name": str(one["name"])}, files))
            self.sets.append(own)

    def _id_of(self, path: Path) -> str:
        known = next((key for key, one in self.files.items() if one == path), None)
        key = known or f"f{next(self._numbers)}"
        self.files[key] = path
        return key

    @property
    def devices(self) -> Iterator[tuple[Entry, Entry]]:
        """All devices, each with its set."""
        return ((group, device) for group in self.sets for device in group.devices)

    def device(self, key: str) -> tuple[Entry, Entry]:
        """Find a device by its id, with its set; `CampaignError` where there is none."""
        return _here(next((pair for pair in self.devices if pair[1].id == key), None), "device", key)

    def group(self, key: str) -> Entry:
        """Find a set by its id; `CampaignError` where there is none."""
        return _here(next((one for one in self.sets if one.id == key), None), "set", key)

    def file(self, key: str) -> Path:
        """Find a file by its id; `CampaignError` where there is none."""
        return _here(self.files.get(key), "file", key)

    def add(self, path: Path, form: str = "") -> str:
        """Take a file in: a run of the device that its name belongs to, or a new device. Give its id.

        A file of a form whose columns were chosen before is read with them.
        """
        key, stem = self._id_of(path), _stem(path) or path.name
        parts = _RUN.match(stem)
        name = plain_name(parts[1] if parts and parts[1] else stem)
        mine = next((device for _, device in self.devices if parts and device.name == name), None)
        if mine is not None and all(self.files[one].parent == self.folder / RECORDINGS for one in mine.files):
            mine.files = sorted([*mine.files, key], key=lambda one: _number(self.files[one]))
        else:
            numbered, taken = _NUMBERED.match(name), {device.name for _, device in self.devices}
            set_name = plain_name(numbered[1] or numbered[2]) if numbered else "Set 1"
            own = next((one for one in self.sets if one.name == set_name), None)
            if own is None:
                own = _new(self._numbers, "s", {"name": set_name})
                self.sets.append(own)
            own.devices.append(_new(self._numbers, "d", {"name": _free_name(name, taken)}, [key]))
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
            self.forms[form] = _given(options, dict.fromkeys(READING, _plain))
        self.write()

    def arrange(self, wanted: Any) -> None:
        """Put files into devices and devices into sets, as a list of sets with ids says; names come with it.

        An arrangement that no manifest could hold is refused before anything of it is taken.
        """
        known = {one.id: one for pair in self.devices for one in pair}

        def entry(kind: str, said: Any, files: Iterable[str] = ()) -> Entry:
            key, name = str(said.get("id")), {"name": plain_name(str(said["name"]))}
            old = known.get(key) if key.startswith(kind) else None
            return Entry(key, old.content | name, [*files]) if old else _new(self._numbers, kind, name, files)

        try:
            sets = [(entry("s", one), [entry("d", d, map(str, d["files"])) for d in one["devices"]]) for one in wanted]
        except (TypeError, KeyError, AttributeError) as error:
            raise CampaignError(f"an arrangement that cannot be read ({type(error).__name__})") from error
        for group, devices in sets:
            group.devices = [device for device in devices if device.files]
            if twice := _twice(device.name for device in group.devices):
                raise CampaignError(f"two devices of the set '{group.name}' are called '{twice}'; rename one of them")
        if _twice(group.name for group, _ in sets):
            raise CampaignError("two sets have the same name; rename one of them")
        used = [key for _, devices in sets for device in devices for key in device.files]
        for key in used:
            self.file(key)
        if _twice(used):
            raise CampaignError("a file belongs to one device alone")
        self.sets = [group for group, _ in sets if group.devices]
        self.write()

    def write(self) -> None:
        """Write the manifest and what the bench remembers."""
        (self.folder / MEMORY).parent.mkdir(parents=True, exist_ok=True)
        write_text(self.folder / MEMORY, json.dumps({"forms": self.forms}, indent=1))
        if not self.sets:
            (self.folder / MANIFEST).unlink(missing_ok=True)
            return

        def written(device: Entry) -> list[str]:
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
        return Path(shutil.copyfile(manifest.parent / name, place_for(session, name)))

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
    forms = read_json(folder / MEMORY, CampaignError).get("forms", {}) if (folder / MEMORY).is_file() else {}
    return {form: {name: value for name, value in own.items() if name in READING} for form, own in forms.items()}


def _here(found: Found | None, what: str, key: str) -> Found:
    """Give what was found by its id; `CampaignError` where nothing was."""
    if found is None:
        raise CampaignError(f"there is no {what} {shown(key, 20)} here any more; load the page again")
    return found


def _twice(words: Iterable[str]) -> str | None:
    """Find a word that is there more than once."""
    return next((word for word, n in Counter(words).items() if n > 1), None)


def _free_name(name: str, taken: Container[str]) -> str:
    return next(one for n in count(1) if (one := name if n == 1 else f"{name} ({n})") not in taken)


def _stem(path: Path) -> str:
    return path.name.removesuffix(".gz").rpartition(".")[0]


def _number(path: Path) -> tuple[int, str]:
    parts = _RUN.match(_stem(path))
    return int(parts[2][:9]) if parts else 0, path.name


def _given(said: Any, known: Mapping[str, Callable[[Any], Any]]) -> dict[str, Any]:
    """Give what a page says of `known` names, as a manifest holds it; empty values are left out."""
    out = {}
    for name, value in dict(said).items():
        if name not in known:
            raise CampaignError(f"{shown(name, 30)} is not known here; known are {', '.join(known)}")
        if value not in ("", None):
            try:
                out[name] = known[name](value)
            except (TypeError, ValueError) as error:
                raise CampaignError(f"{name} = {shown(value)} is neither a number nor a text that it may be") from error
    return out


def _plain(value: Any) -> str | int | float:
    """Value of an option: a text without control characters, or a number."""
    if isinstance(value, str):
        return plain_text(value)[:MOST_TEXT]
    if isinstance(value, int | float) and not isinstance(value, bool):
        return value
    raise TypeError
