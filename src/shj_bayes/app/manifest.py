"""The manifest of a campaign, a TOML file: sets, devices, recordings, and how to fit and diagnose them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, NamedTuple, Union, get_args, get_origin, get_type_hints

from shj_bayes._util.files import folder_name, plain_name, read_toml, toml_line
from shj_bayes.app.resume import check_priors
from shj_bayes.errors import CampaignError, ShjError, did_you_mean, plain_lines, shown
from shj_bayes.model.priors import read_priors
from shj_bayes.options import DIAGNOSES, FitOptions
from shj_bayes.population.device import NO_TAGS, Tags
from shj_bayes.results.campaign import MAX_NOTE, SCHEMA, Connection

MAX_DEVICES = 100_000
MAX_BYTES = 50_000_000
# What stands in a manifest for a kind of value, and how that is called.
_FORMS: dict[Any, tuple[Any, str]] = {
    str: (str, "a text"),
    int: (int, "a whole number"),
    float: (int | float, "a number"),
    bool: (bool, "true or false"),
    tuple: (list, "a list of texts"),
    Literal: (int | str, 'a number of runs, "split" or "one"'),
}


def _form(hint: Any) -> tuple[Any, str]:
    """Give what a manifest may hold for a field of this type."""
    if get_origin(hint) in (Union, UnionType):
        hint = [one for one in get_args(hint) if one is not NoneType][-1]
    return _FORMS[get_origin(hint) or hint]


OPTION_KINDS = {name: _form(hint) for name, hint in get_type_hints(FitOptions).items() if name != "priors_from"}
TAG_KINDS = {name: _form(hint) for name, hint in get_type_hints(Tags).items()}
PARTS = {name: _form(hint) for name, hint in get_type_hints(Connection).items()}


@dataclass(frozen=True)
class Device:
    """One device of a campaign."""

    # name, set_name: its name, unique within its set, and the set's
    name: str
    set_name: str
    recordings: tuple[Path, ...]  # consecutive runs
    options: FitOptions  # how to read and fit it
    tags: Tags = NO_TAGS  # what makes its set what it is: material, coating, coverage, corroded
    connection: Connection | None = None  # as tested; None where the manifest does not say
    # "quick", "full", "off": how to look for what the law leaves out: a first look, with the posterior of what is
    # found, or not at all
    diagnose: str = DIAGNOSES[0]
    # note, set_note: what somebody wrote of it and of its set, for the report
    note: str = ""
    set_note: str = ""
    below: str = ""  # of a fit with what the set has: its folder in that of the device

    @property
    def folder(self) -> str:
        """Results folder below the campaign's, safe on every system."""
        return f"devices/{folder_name(self.set_name, self.name)}{self.below}"


class Manifest(NamedTuple):
    """A campaign: its name and its devices in order."""

    name: str  # title of the report
    devices: tuple[Device, ...]  # all devices of all sets
    simulated: bool = False  # True where the recordings are simulated, so that the report says so


def read_manifest(path: Path) -> Manifest:
    """Read a campaign manifest, and check the whole of it before anything is fitted; ``docs/manifest.md`` has the keys.

    `CampaignError` with the line, the table and the value at fault, and what is allowed.
    """
    for cache in (_priors, _check):
        cache.cache_clear()  # the files may have changed since
    top = _Table(path, "the manifest", read_toml(path, SCHEMA, MAX_BYTES, CampaignError)[0])
    top.know(("schema", "name", "simulated", "diagnose", "defaults", "set"), "[defaults]")
    name = top.text("name") if "name" in top.content else plain_name(path.stem)
    simulated = top.content.get("simulated", False)
    if not isinstance(simulated, bool):
        raise top.error(f"has simulated = {shown(simulated)}; allowed are true and false", "simulated")
    devices = tuple(_devices(top))
    if not 1 <= len(devices) <= MAX_DEVICES:
        raise CampaignError(f"{path.name} names {len(devices)} devices; allowed are 1 to {MAX_DEVICES}")
    folders = Counter(device.folder for device in devices)
    if twice := next((device for device in reversed(devices) if folders[device.folder] > 1), None):
        raise CampaignError(f"{path.name}: device '{twice.name}' stands twice in set '{twice.set_name}'")
    return Manifest(name, devices, simulated)


def _devices(top: _Table) -> Iterator[Device]:
    """Devices of all sets; what a set or a device does not say, the table above it says."""
    defaults, diagnose = top.options(FitOptions(), "defaults"), top.diagnose(DIAGNOSES[0])
    for group in top.tables("set", "has no [[set]] table; each set needs a name and [[set.device]] tables"):
        set_name = group.text("name")
        at = group._replace(words=f"set '{set_name}'")
        at.know(("name", "note", "diagnose", "options", "device", "connection", *TAG_KINDS), "[set.options]")
        tags, for_set, connection = at.tags(), at.diagnose(diagnose), at.connection()
        members = at.tables("device", "has no [[set.device]] table (mind the double brackets)")
        own = at.options(defaults)
        for member in members:
            name = member._replace(words=at.words).text("name")
            here = member._replace(words=f"{at.words}, device '{name}'")
            here.know(("name", "note", "recordings", "runs", "diagnose", "options"), "[set.device.options]")
            recordings, options = here.recordings(), own
            if "runs" in here.content:
                options = here.with_option(own, "runs", here.content["runs"], "runs")
            options = here.options(options)
            try:
                _check(options, len(recordings))
            except ShjError as error:
                raise here.error(f"cannot be fitted: {error}", "recordings") from error
            notes = here.note(), at.note()
            yield Device(name, set_name, recordings, options, tags, connection, here.diagnose(for_set), *notes)


# What cannot be read or fitted is refused once for all devices that name it: a thousand share their options.
_priors = lru_cache(read_priors)
_check = lru_cache(check_priors)


class _Table(NamedTuple):
    """A table of a manifest, which may hold anything: what a message calls it, its content, and the way to it."""

    path: Path
    words: str
    content: Any
    keys: tuple[str | int, ...] = ()

    def error(self, said: str, *key: str) -> CampaignError:
        """Say what is wrong with the table, or with a key of it and on which line that stands."""
        line = toml_line(self.path, (*self.keys, *key)) if key else None
        return CampaignError(f"{self.path.name}{f', line {line}' if line else ''}: {self.words} {said}")

    def tables(self, key: str, without: str) -> list[_Table]:
        """Tables of a list of at least one."""
        found = self.content.get(key)
        if not isinstance(found, list) or not found:
            raise self.error(without)
        return [
            _Table(self.path, f"[[{key}]] number {i}", one, (*self.keys, key, i - 1))
            for i, one in enumerate(found, start=1)
        ]

    def know(self, allowed: tuple[str, ...], options: str) -> None:
        """Refuse keys that would be silently without effect, with the table where they belong."""
        if not isinstance(self.content, dict):
            raise self.error(f"must be a table, not {shown(self.content)}")
        for key in self.content:
            if key in allowed:
                continue
            if key in OPTION_KINDS:
                place = f"it is an option: put it into a table {options}"
            elif key in TAG_KINDS:
                place = "it describes a set: put it directly below [[set]]"
            else:
                place = f"known are {', '.join(allowed)}{did_you_mean(key, allowed)}"
            raise self.error(f"has the key '{key}', which has no effect there; {place}", key)

    def text(self, key: str) -> str:
        """Text that must be there."""
        value = self.content.get(key) if isinstance(self.content, dict) else None
        if not isinstance(value, str) or not value.strip():
            raise self.error(f"has {key} = {shown(value)}; it needs a text", *([] if value is None else [key]))
        return plain_name(value)

    def note(self) -> str:
        """Give what somebody wrote, which changes no number."""
        value = self.content.get("note", "")
        if not isinstance(value, str) or len(value) > MAX_NOTE:
            raise self.error(f"has note = {shown(value)}; it needs a text of at most {MAX_NOTE} characters", "note")
        return plain_lines(value).strip()

    def recordings(self) -> tuple[Path, ...]:
        """Files of a device."""
        files = self.content.get("recordings")
        if not isinstance(files, list) or not files or not all(isinstance(f, str) and f for f in files):
            said = 'needs recordings = ["run1.csv", ...] in the order they were run'
            raise self.error(said, *(["recordings"] if files else []))
        if "\x00" in "".join(files):
            raise self.error("names a file with a NUL character", "recordings")
        return tuple(self.path.parent / f for f in files)

    def values(self, kinds: Mapping[str, tuple[Any, str]]) -> dict[str, Any]:
        """Values of the keys that there are, each of its kind."""
        values: dict[str, Any] = {}
        for key, value in self.content.items():
            if key in kinds:
                kind, words = kinds[key]
                if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
                    raise self.error(f"has {key} = {shown(value)}; it needs {words}", key)
                values[key] = plain_name(value) if isinstance(value, str) else value
        return values

    def tags(self) -> Tags:
        """Read what makes a set what it is, for contrasts between sets."""
        values = self.values(TAG_KINDS)
        percent = values.get("coverage_percent")
        if percent is not None:
            if not 0 <= percent <= 100:
                raise self.error(f"has coverage_percent = {shown(percent)}; allowed is 0 to 100", "coverage_percent")
            values["coverage_percent"] = float(percent)
        return Tags(**values)

    def connection(self) -> Connection | None:
        """Read the connection as tested; None where nothing is said of it."""
        if (entry := self.content.get("connection")) is None:
            return None
        place = self._replace(words=f"{self.words}, its connection", content=entry, keys=(*self.keys, "connection"))
        place.know((*PARTS,), "[set.options]")
        try:
            return Connection(**place.values(PARTS))
        except ValueError as error:
            raise place.error(f"cannot be: {error}") from error

    def diagnose(self, otherwise: str) -> str:
        """How the devices of the table are to be diagnosed."""
        value = self.content.get("diagnose", otherwise)
        if value in DIAGNOSES:
            return str(value)
        hint = did_you_mean(value, DIAGNOSES) if isinstance(value, str) else ""
        allowed = ", ".join(f'"{word}"' for word in DIAGNOSES)
        raise self.error(f"has diagnose = {shown(value)}; allowed are {allowed}{hint}", "diagnose")

    def options(self, base: FitOptions, key: str = "options") -> FitOptions:
        """Options with those of a table in this one put over them, one by one, so that a message can name the line."""
        entry = self.content.get(key, {})
        if not isinstance(entry, dict):
            raise self.error(f"{key} must be a table, not {shown(entry)}", key)
        # The rate last: columns of the same table may take away the time column that it would contradict.
        for name, value in sorted(entry.items(), key=lambda item: item[0] == "rate_Hz"):
            base = self.with_option(base, name, value, key, name)
        return base

    def with_option(self, base: FitOptions, name: str, value: Any, *where: str) -> FitOptions:
        """Options with one more of the manifest, which stands at `where`."""
        if name == "diagnose":
            places = "the top of the manifest, below [[set]] or below [[set.device]]"
            raise self.error(f"has the option 'diagnose', which is no option of a fit: put it at {places}", *where)
        if name not in OPTION_KINDS:
            known = f"known are {', '.join(OPTION_KINDS)}{did_you_mean(name, OPTION_KINDS)}"
            raise self.error(f"has the option '{name}'; {known}", *where)
        kind, words = OPTION_KINDS[name]
        if not isinstance(value, kind) or isinstance(value, bool):
            raise self.error(f"option {name} = {shown(value)}; it needs {words}", *where)
        if name == "priors" and value.endswith(".toml"):
            value = str(self.path.parent / value)
        change: dict[str, Any] = {name: tuple(map(str, value)) if isinstance(value, list) else value}
        try:
            base = replace(base, **change)
            if name == "priors":
                _priors(base.priors)
        except ShjError as error:
            raise self.error(f"option {error}", *where) from error
        return base
