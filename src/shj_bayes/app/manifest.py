"""The manifest of a campaign, a TOML file: sets, devices, recordings, and how to fit and diagnose them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
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


class _Form(NamedTuple):
    """What a manifest may hold for a key."""

    kind: Any  # for isinstance; a truth value is no number
    words: str
    allowed: Callable[[Any], object] = lambda _: True


_FORMS: dict[Any, _Form] = {
    str: _Form(str, "a text"),
    int: _Form(int, "a whole number"),
    float: _Form(int | float, "a number"),
    bool: _Form(bool, "true or false"),
    tuple: _Form(list, "a list of texts"),
    dict: _Form(dict, "a table"),
    Literal: _Form(int | str, 'a number of runs, "split" or "one"'),
}


def _forms(kind: type) -> dict[str, _Form]:
    """Give what a manifest may hold for the fields of a class."""
    forms = {}
    for name, hint in get_type_hints(kind).items():
        known = [one for one in get_args(hint) if one is not NoneType] if get_origin(hint) in (Union, UnionType) else ()
        form = known[-1] if known else hint
        forms[name] = _FORMS[get_origin(form) or form]
    return forms


OPTIONS = {name: form for name, form in _forms(FitOptions).items() if name != "priors_from"}
TAGS = _forms(Tags) | {"coverage_percent": _Form(int | float, "a number from 0 to 100", lambda p: 0 <= p <= 100)}
CONNECTION = _forms(Connection)
SAID = {
    "name": _Form(str, "a text", str.strip),
    "diagnose": _Form(str, " or ".join(f'"{word}"' for word in DIAGNOSES), DIAGNOSES.__contains__),
}
NOTE = {"note": _Form(str, f"a text of at most {MAX_NOTE} characters", lambda text: len(text) <= MAX_NOTE)}
DEVICE = {
    **SAID,
    **NOTE,
    "recordings": _Form(
        list,
        'files in the order they were run, as in ["run1.csv", "run2.csv"]',
        lambda files: files and all(isinstance(file, str) and file and "\0" not in file for file in files),
    ),
    "runs": OPTIONS["runs"],
    "options": _FORMS[dict],
}
MEMBERS = _Form(list, "[[set.device]] tables (mind the double brackets)", bool)
SET = {**SAID, **NOTE, **TAGS, "connection": _FORMS[dict], "options": _FORMS[dict], "device": MEMBERS}
GROUPS = _Form(list, "[[set]] tables, each with a name and [[set.device]] tables", bool)
TOP = {**SAID, "schema": _FORMS[str], "simulated": _FORMS[bool], "defaults": _FORMS[dict], "set": GROUPS}
PLACES = {  # of keys that stand where they would silently be without effect
    **dict.fromkeys(OPTIONS, "is an option: put it into a table [defaults], [set.options] or [set.device.options]"),
    **dict.fromkeys(TAGS, "describes a set: put it directly below [[set]]"),
    "diagnose": "is no option of a fit: put it at the top of the manifest, below [[set]] or below [[set.device]]",
}


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
    said = top.read(TOP, "set")
    devices = tuple(_devices(top))
    if len(devices) > MAX_DEVICES:
        raise CampaignError(f"{path.name} names {len(devices)} devices; allowed are 1 to {MAX_DEVICES}")
    folders = Counter(device.folder for device in devices)
    if twice := next((device for device in reversed(devices) if folders[device.folder] > 1), None):
        raise CampaignError(f"{path.name}: device '{twice.name}' stands twice in set '{twice.set_name}'")
    return Manifest(plain_name(said.get("name", path.stem)), devices, said.get("simulated", False))


def _devices(top: _Table) -> Iterator[Device]:
    """Devices of all sets; what a set or a device does not say, the table above it says."""
    defaults, diagnose = top.options(FitOptions(), "defaults"), top.content.get("diagnose", DIAGNOSES[0])
    for at in top.tables("set", ""):
        group = at.read(SET, "name", "device")
        tags = {name: group[name] for name in TAGS if name in group}
        if "coverage_percent" in tags:
            tags["coverage_percent"] = float(tags["coverage_percent"])
        connection = None
        if "connection" in group:
            place = _Table(top.path, f"{at.words}, its connection", group["connection"], (*at.keys, "connection"))
            try:
                connection = Connection(**_plain(place.read(CONNECTION)))
            except ValueError as error:
                raise place.error(f"cannot be: {error}") from error
        own = at.options(defaults)
        for here in at.tables("device", f"{at.words}, "):
            said = here.read(DEVICE, "name", "recordings")
            options = here.options(here.options(own, "runs"))
            try:
                _check(options, len(said["recordings"]))
            except ShjError as error:
                raise here.error(f"cannot be fitted: {error}", "recordings") from error
            yield Device(
                plain_name(said["name"]),
                plain_name(group["name"]),
                tuple(top.path.parent / file for file in said["recordings"]),
                options,
                Tags(**_plain(tags)),
                connection,
                said.get("diagnose", group.get("diagnose", diagnose)),
                *(plain_lines(one.get("note", "")).strip() for one in (said, group)),
            )


# What cannot be read or fitted is refused once for all devices that name it: a thousand share their options.
_priors = lru_cache(read_priors)
_check = lru_cache(check_priors)


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    return {key: plain_name(value) if isinstance(value, str) else value for key, value in values.items()}


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

    def tables(self, key: str, within: str) -> list[_Table]:
        """Tables of a list, which messages call by their names."""
        out = []
        for i, one in enumerate(self.content[key]):
            name = one.get("name") if isinstance(one, dict) else None
            named = isinstance(name, str) and name.strip()
            words = f"{key} '{plain_name(str(name))}'" if named else f"[[{key}]] number {i + 1}"
            out.append(_Table(self.path, f"{within}{words}", one, (*self.keys, key, i)))
        return out

    def read(self, forms: Mapping[str, _Form], *needed: str) -> dict[str, Any]:
        """Give the content; refuse other keys, values of another form, and that a needed key is missing."""
        if not isinstance(self.content, dict):
            raise self.error(f"must be a table, not {shown(self.content)}")
        for key, value in self.content.items():
            if key not in forms:
                place = PLACES.get(key, f"is not known; known are {', '.join(forms)}{did_you_mean(key, forms)}")
                raise self.error(f"has the key '{key}', which has no effect there; it {place}", key)
            kind, words, allowed = forms[key]
            if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool) or not allowed(value):
                near = did_you_mean(str(value), DIAGNOSES) if key == "diagnose" else ""
                raise self.error(f"has {key} = {shown(value)}; it needs {words}{near}", key)
        for key in needed:
            if key not in self.content:
                raise self.error(f"lacks {key} = ...; it needs {forms[key].words}")
        return self.content

    def options(self, base: FitOptions, key: str = "options") -> FitOptions:
        """Options with those of a table in this one put over them, one by one, so that a message can name the line.

        ``runs`` may stand in this table itself.
        """
        if key not in self.content:
            return base
        at = self if key == "runs" else _Table(self.path, self.words, self.content[key], (*self.keys, key))
        entry = {key: at.content[key]} if key == "runs" else at.read(OPTIONS)
        # The rate last: columns of the same table may take away the time column that it would contradict.
        for name, value in sorted(entry.items(), key=lambda item: item[0] == "rate_Hz"):
            known: Any = tuple(map(str, value)) if isinstance(value, list) else value
            if name == "priors" and value.endswith(".toml"):
                known = str(self.path.parent / value)
            try:
                base = replace(base, **{name: known})
                if name == "priors":
                    _priors(base.priors)
            except ShjError as error:
                raise at.error(f"option {error}", name) from error
        return base
