"""Many devices to many posteriors and diagnoses: a TOML manifest, parallel processes, only what is missing or changed.

Each device is fitted and diagnosed. Then the evidence of the devices of each set is added, and where a set has physics
that a device's own model lacks, the device is fitted with it too: that fit lies in the device's folder, and the margins
take it.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, TypeVar

from tqdm import tqdm

from shj_bayes._util.dask_cluster import results_on
from shj_bayes._util.files import (
    alone_in,
    folder_name,
    make_writable,
    plain_name,
    read_toml,
    toml_line,
)
from shj_bayes._util.processes import Workers
from shj_bayes.commands.finished import Done, kept_result
from shj_bayes.commands.mistaken import repeated
from shj_bayes.commands.options import Options
from shj_bayes.errors import CampaignError, ShjError, did_you_mean, plain_text, shown, system_words
from shj_bayes.mismatch.look import Look
from shj_bayes.model.priors import read_priors
from shj_bayes.population.device import NO_TAGS, Tags
from shj_bayes.results.campaign import SCHEMA, WITH_SET, CampaignRecord, DeviceEntry, SetEntry, SetTogether
from shj_bayes.results.codec import from_json, to_json
from shj_bayes.results.diagnosis import DiagnosisRecord
from shj_bayes.results.fit import FitRecord
from shj_bayes.results.store import DIAGNOSIS, digests, find, made, write

MAX_DEVICES = 100_000
OPTION_KINDS: dict[str, Any] = {
    "columns": str,
    "units": str,
    "rate_Hz": int | float,
    "sheet": str,
    "priors": str,
    "model": str,
    "noise": str,
    "effects": list,
    "free": list,
    "seed": int,
    "max_steps": int,
    "runs": int | str,
}
_KIND_WORDS: dict[Any, str] = {
    **{str: "a text", list: "a list of texts", int: "a whole number"},
    int | str: 'a number of runs, "split" or "one"',
}
TAG_KINDS: dict[str, tuple[Any, str]] = {
    "material": (str, "a text"),
    "coating": (str, "a text"),
    "coverage_percent": (int | float, "a number"),
    "corroded": (bool, "true or false"),
}
DIAGNOSES = ("quick", "full", "off")
FAILED = "failed"
MAX_TRIES = 2  # a device that was under way when a worker died is tried once more


Result = TypeVar("Result")


@dataclass(frozen=True)
class Device:
    """One device of a campaign."""

    # name, set_name: its name, unique within its set, and the set's
    name: str
    set_name: str
    recordings: tuple[Path, ...]  # consecutive runs
    options: Options  # how to read and fit it
    tags: Tags = NO_TAGS  # what makes its set what it is: material, coating, coverage, corroded
    # "quick", "full", "off": how to look for what the law leaves out: a first look, with the posterior of what is
    # found, or not at all
    diagnose: str = DIAGNOSES[0]
    below: str = ""  # of a fit with what the set has: its folder in that of the device

    @property
    def folder(self) -> str:
        """Results folder below the campaign's, safe on every system."""
        return f"devices/{folder_name(self.set_name, self.name)}{self.below}"


@dataclass(frozen=True)
class Manifest:
    """A campaign: its name and its devices in order."""

    name: str  # title of the report
    devices: tuple[Device, ...]  # all devices of all sets
    simulated: bool = False  # True where the recordings are simulated, so that the report says so


@dataclass(frozen=True)
class Outcome:
    """What became of one device."""

    device: Device
    status: str  # "done", "kept", "failed": fitted, found unchanged, or not fitted
    # reason, verdict: why it failed, or what there is to say; verdict of the fit
    reason: str = ""
    verdict: str = ""
    simulated: bool = False  # a recording says that it is simulated
    inputs: tuple[tuple[str, str], ...] = ()  # name and digest of each recording
    # diagnosis, diagnosis_reason: verdict of the diagnosis, ``off``, or ``failed`` with why
    diagnosis: str = ""
    diagnosis_reason: str = ""
    # with_set, with_set_reason: verdict of the fit with what its set makes certain, or ``failed`` with why; empty where
    # there is none
    with_set: str = ""
    with_set_reason: str = ""

    @property
    def failures(self) -> tuple[str, ...]:
        """What was not done for the device, with why."""
        parts = (
            ("", self.reason if self.status == FAILED else ""),
            ("not diagnosed: ", self.diagnosis_reason if self.diagnosis == FAILED else ""),
            ("not fitted with what its set has: ", self.with_set_reason if self.with_set == FAILED else ""),
        )
        return tuple(f"{head}{reason}" for head, reason in parts if reason)


def read_manifest(path: Path) -> Manifest:
    """Read a campaign manifest, and check the whole of it before anything is fitted; ``docs/manifest.md`` has the keys.

    `CampaignError` with the line, the table and the value at fault, and what is allowed.
    """
    for cache in (_priors, _fit_for):
        cache.cache_clear()  # the files may have changed since
    table, _ = read_toml(path, SCHEMA, 50_000_000, CampaignError)
    top = _Place(path, "the manifest")
    _known(top, table, ("schema", "name", "simulated", "diagnose", "defaults", "set"), "[defaults]")
    name = _text(top, table, "name") if "name" in table else plain_name(path.stem)
    simulated = table.get("simulated", False)
    if not isinstance(simulated, bool):
        raise top.error(f"has simulated = {shown(simulated)}; allowed are true and false", "simulated")
    defaults = _options(top, Options(), table, "defaults")
    devices = tuple(_devices(top, table, defaults, _diagnose(top, table, DIAGNOSES[0])))
    if not 1 <= len(devices) <= MAX_DEVICES:
        raise CampaignError(f"{path.name} names {len(devices)} devices; allowed are 1 to {MAX_DEVICES}")
    folders = Counter(device.folder for device in devices)
    if twice := next((device for device in reversed(devices) if folders[device.folder] > 1), None):
        raise CampaignError(f"{path.name}: device '{twice.name}' stands twice in set '{twice.set_name}'")
    return Manifest(name, devices, simulated)


@alone_in("folder")
def run_campaign(
    manifest: Manifest,
    folder: Path,
    *,
    workers: int = 0,
    cluster: str = "",
    diagnose: str | None = None,
    progress: bool = False,
) -> list[Outcome]:
    """Fit and diagnose every device that is missing or changed; one bad device never stops the rest.

    Each device has its own folder below ``devices`` of `folder`. There are as many processes as `workers` (0 for one
    per processor), or those of the `cluster`, the address of a dask scheduler, whose workers must see `folder` and the
    recordings under the same paths. `diagnose` stands in for what the manifest says. The outcomes, in the manifest's
    order, are written to ``campaign.json``, too.
    """
    make_writable(folder)
    devices = manifest.devices
    if diagnose is not None:
        if diagnose not in DIAGNOSES:
            words = did_you_mean(diagnose, DIAGNOSES)
            raise CampaignError(f"diagnose = {shown(diagnose)}; allowed are {', '.join(DIAGNOSES)}{words}")
        devices = tuple(replace(device, diagnose=diagnose) for device in devices)
    crew = _Crew(folder, workers or os.cpu_count() or 1, cluster, progress)
    outcomes, together, enter = _together(crew.run("fits", devices), folder)
    outcomes = _fitted_with_sets(crew, outcomes, enter)
    write(campaign_record(manifest, outcomes, together), folder)
    return outcomes


def _together(
    outcomes: Sequence[Outcome], folder: Path
) -> tuple[list[Outcome], Sequence[SetTogether], Mapping[str, Sequence[str]]]:
    """Add up what the diagnosed devices of each set, and all of them, have in common.

    Outcomes; what is common; and by device what of it enters its model.
    """
    diagnosed = [o for o in outcomes if o.status != FAILED and o.diagnosis not in ("off", FAILED)]
    if not diagnosed:
        return list(outcomes), (), {}

    def add_up() -> dict[str, Any]:
        from shj_bayes.mismatch.together import read_diagnosed, together  # noqa: PLC0415  (needs half of scipy)

        devices, failed = [], {}
        for o in diagnosed:
            place = o.device.folder
            try:
                devices.append((o.device.set_name, read_diagnosed(folder / place / DIAGNOSIS, place)))
            except ShjError as error:
                failed[place] = str(error)
        groups = together(devices)
        enter = {place: effects for one in groups if one.set_name for place, effects in one.effects.items()}
        return {"together": [to_json(one.record) for one in groups], "enter": enter, "unread": failed}

    files = [
        (o.device.set_name, digests(folder, [f"{o.device.folder}/{DIAGNOSIS}/{DiagnosisRecord.FILE}"]))
        for o in diagnosed
    ]
    said = made(folder, "together", files, (), add_up)
    unread = said["unread"]
    out = [
        replace(o, diagnosis=FAILED, diagnosis_reason=unread[o.device.folder]) if o.device.folder in unread else o
        for o in outcomes
    ]
    return out, [from_json(SetTogether, one) for one in said["together"]], said["enter"]


def _fitted_with_sets(crew: _Crew, outcomes: Sequence[Outcome], enter: Mapping[str, Sequence[str]]) -> list[Outcome]:
    """Fit the devices whose own fit lacks what their set has; the outcomes of the campaign with those of these fits."""
    devices = []
    for o in outcomes:
        if o.device.folder in enter:
            effects = (*o.device.options.effects, *enter[o.device.folder])
            options = replace(o.device.options, effects=effects)
            devices.append(replace(o.device, options=options, diagnose="off", below=f"/{WITH_SET}"))
    done = {o.device.folder: o for o in crew.run("with what the set has", devices)}
    out = []
    for o in outcomes:
        new = done.get(f"{o.device.folder}/{WITH_SET}")
        if new is not None:
            verdict = FAILED if new.status == FAILED else new.verdict
            o = replace(o, with_set=verdict, with_set_reason=new.reason)  # noqa: PLW2901
        out.append(o)
    return out


@dataclass(frozen=True)
class _Crew:
    """Processes, of this machine or of a cluster, that fit and diagnose many devices."""

    folder: Path
    workers: int
    cluster: str
    progress: bool

    def run(self, words: str, devices: Sequence[Device]) -> list[Outcome]:
        """Outcome of each device, in order; those that are known already are taken as they are."""
        outcomes = {device.folder: outcome for device in devices if (outcome := _kept(device, self.folder))}
        waiting = [device for device in devices if device.folder not in outcomes]
        quiet = None if self.progress and devices else True
        with tqdm(total=len(devices), initial=len(outcomes), unit="device", desc=words, disable=quiet) as bar:
            if self.cluster:
                coming = _on_cluster(waiting, self.folder, self.cluster, bar.set_postfix_str)
            else:
                coming = _in_processes(waiting, self.folder, self.workers)
            for outcome in coming:
                outcomes[outcome.device.folder] = outcome
                bar.update()
        return [outcomes[device.folder] for device in devices]


def _kept(device: Device, folder: Path) -> Outcome | None:
    """Outcome of a device that was fitted and diagnosed earlier and has not changed: no process is started for it."""
    place = folder / device.folder
    result = kept_result(device.recordings, place, asdict(device.options), device.name)
    if result is None:
        return None
    known = "off" if device.diagnose == "off" else _kept_diagnosis(device, place, result.record.key)
    return None if known is None else replace(_outcome(device, result), diagnosis=known)


def _kept_diagnosis(device: Device, place: Path, key: str) -> str | None:
    """Verdict of a diagnosis that was made earlier of the same recordings with the same options; None without one.

    A full one does where a quick one is asked for.
    """
    folder = place / DIAGNOSIS
    record = find(DiagnosisRecord, folder)
    if record is None or record.key != key or record.model is None or record.model.without:
        return None
    enough = device.diagnose == "quick" or not record.quick
    return record.verdict if enough and (folder / "diagnosis.html").is_file() else None


def _in_processes(devices: Sequence[Device], folder: Path, workers: int) -> Iterator[Outcome]:
    """Outcomes as they come; a pool whose worker died is replaced and its devices are tried once more."""
    waiting = list(devices)
    tries: dict[str, int] = {}
    while waiting:
        pool = Workers(min(workers, len(waiting)))
        try:
            broken = False
            running: dict[Future[Outcome], Device] = {}
            while (waiting and not broken) or running:
                while waiting and not broken and len(running) < 2 * workers:
                    device = waiting.pop(0)
                    try:
                        running[pool.submit(_fit_one, device, folder)] = device
                    except BrokenProcessPool:
                        waiting.insert(0, device)
                        broken = True
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    device = running.pop(future)
                    try:
                        yield future.result()
                    except BrokenProcessPool:
                        broken = True
                        tries[device.folder] = tries.get(device.folder, 0) + 1
                        if tries[device.folder] < MAX_TRIES:
                            waiting.append(device)
                        else:
                            yield Outcome(device, FAILED, "the process that fitted it died twice (memory, or killed)")
        except BaseException:
            pool.stop()
            raise
        pool.shutdown(wait=True, cancel_futures=True)


def _on_cluster(
    devices: Sequence[Device], folder: Path, address: str, tell: Callable[[str], None]
) -> Iterator[Outcome]:
    """Outcomes as a dask cluster finishes them; it hands the devices of a lost worker to another."""
    if not devices:
        return
    there = {d.folder: d for d in devices}  # an outcome speaks of the device as the manifest names it
    sent = [_with_whole_paths(device) for device in devices]
    do_there = partial(_fit_one, folder=folder.absolute())
    for device, outcome, reason in results_on(address, folder.absolute(), do_there, sent, tell=tell):
        mine = there[device.folder]
        yield replace(outcome, device=mine) if outcome else Outcome(mine, FAILED, reason)


def _with_whole_paths(device: Device) -> Device:
    """Make the paths mean the same on another machine that shares the file system."""
    priors, options = device.options.priors, device.options
    if priors.endswith(".toml"):
        options = replace(options, priors=str(Path(priors).absolute()))
    return replace(device, recordings=tuple(path.absolute() for path in device.recordings), options=options)


def _fit_one(device: Device, folder: Path) -> Outcome:
    """Fit and diagnose one device in a worker process."""
    # A campaign in which nothing changed needs none of it.
    from shj_bayes.commands.pipeline import Work, fit_device  # noqa: PLC0415
    from shj_bayes.report.device import render_device  # noqa: PLC0415

    place, off = folder / device.folder, device.diagnose == "off"
    given = device.recordings, place, device.options
    result = _tried(lambda: fit_device(*given, name=device.name, page=off, work=Work(threads=1)))
    if isinstance(result, str):
        return Outcome(device, FAILED, result)
    outcome = _outcome(device, result)
    if off:
        return replace(outcome, diagnosis="off")
    outcome = _diagnosed(device, place, outcome, result.record.key)
    page = _tried(lambda: render_device(place))  # now, since it says what the diagnosis found
    return replace(outcome, status=FAILED, reason=page) if isinstance(page, str) else outcome


def _diagnosed(device: Device, place: Path, outcome: Outcome, key: str) -> Outcome:
    """Diagnose a fitted device, where that was not done earlier."""
    from shj_bayes.commands.pipeline import Work, diagnose_device  # noqa: PLC0415

    known = _kept_diagnosis(device, place, key)
    if known is not None:
        return replace(outcome, diagnosis=known)
    given = device.recordings, place / DIAGNOSIS, device.options, Look(quick=device.diagnose == "quick")
    found = _tried(lambda: diagnose_device(*given, name=device.name, work=Work(threads=1)))
    if isinstance(found, str):
        return replace(outcome, status="done", diagnosis=FAILED, diagnosis_reason=found)
    return replace(outcome, status="done", diagnosis=found.record.verdict)


def _tried(job: Callable[[], Result]) -> Result | str:
    """Do a job; give why it failed, in words, where it did: one bad device must not stop a thousand good ones."""
    try:
        return job()
    except ShjError as error:
        return str(error)
    except OSError as error:
        return system_words(error)
    except MemoryError:
        return "not enough memory; use fewer --workers, or export fewer samples"
    except Exception as error:  # the type says that it is a bug
        return plain_text(f"unexpected {type(error).__name__}: {error}")


def _outcome(device: Device, result: Done) -> Outcome:
    """Outcome of a device that has a result."""
    record: FitRecord = result.record
    return Outcome(
        device,
        "done" if result.fresh else "kept",
        result.note,
        record.verdict,
        any(source.simulated for source in record.inputs),
        tuple((source.name, source.sha256 or "") for source in record.inputs),
    )


def campaign_record(
    manifest: Manifest, outcomes: Sequence[Outcome], together: Sequence[SetTogether] = ()
) -> CampaignRecord:
    """Say what became of the devices of each set."""
    told = ("status", "reason", "verdict", "diagnosis", "diagnosis_reason", "with_set", "with_set_reason")
    sets: dict[str, list[DeviceEntry]] = {}
    for o in outcomes:
        words = {word: getattr(o, word) for word in told}
        entry = DeviceEntry(name=o.device.name, folder=o.device.folder, **words)
        sets.setdefault(o.device.set_name, []).append(entry)
    inputs = ((f"{o.device.set_name}, {o.device.name}", name, digest) for o in outcomes for name, digest in o.inputs)
    return CampaignRecord(
        name=manifest.name,
        simulated=manifest.simulated or any(o.simulated for o in outcomes),
        warnings=tuple(repeated(inputs)),
        sets=tuple(SetEntry(name=name, devices=tuple(devices)) for name, devices in sets.items()),
        together=tuple(together),
    )


@dataclass(frozen=True)
class _Place:
    """A table of a manifest: what a message calls it, and the way to it."""

    path: Path
    words: str
    keys: tuple[str | int, ...] = ()

    def inside(self, words: str, *keys: str | int) -> _Place:
        """Give a table in this one."""
        return _Place(self.path, words, (*self.keys, *keys))

    def error(self, said: str, *key: str) -> CampaignError:
        """Say what is wrong with the table, or with a key of it and on which line that stands."""
        line = toml_line(self.path, (*self.keys, *key)) if key else None
        return CampaignError(f"{self.path.name}{f', line {line}' if line else ''}: {self.words} {said}")


def _devices(top: _Place, table: dict[str, Any], defaults: Options, diagnose: str) -> Iterator[Device]:
    sets = table.get("set", [])
    if not isinstance(sets, list) or not sets:
        raise top.error("has no [[set]] table; each set needs a name and [[set.device]] tables")
    for i, entry in enumerate(sets):
        at = top.inside(f"[[set]] number {i + 1}", "set", i)
        set_name = _text(at, entry, "name")
        at = top.inside(f"set '{set_name}'", "set", i)
        _known(at, entry, ("name", "diagnose", "options", "device", *TAG_KINDS), "[set.options]")
        tags, for_set = _tags(at, entry), _diagnose(at, entry, diagnose)
        if not isinstance(entry.get("device"), list) or not entry["device"]:
            raise at.error("has no [[set.device]] table (mind the double brackets)")
        own = _options(at, defaults, entry)
        for j, device in enumerate(entry["device"]):
            name = _text(at.inside(at.words, "device", j), device, "name")
            here = at.inside(f"{at.words}, device '{name}'", "device", j)
            _known(here, device, ("name", "recordings", "runs", "diagnose", "options"), "[set.device.options]")
            files = device.get("recordings")
            if not isinstance(files, list) or not files or not all(isinstance(f, str) and f for f in files):
                raise here.error(
                    'needs recordings = ["run1.csv", ...] in the order they were run',
                    *(["recordings"] if files else []),
                )
            if "\x00" in "".join(files):
                raise here.error("names a file with a NUL character", "recordings")
            recordings = tuple(top.path.parent / f for f in files)
            for_all = own if "runs" not in device else _with_option(here, own, "runs", device["runs"], ("runs",))
            options = _options(here, for_all, device)
            try:
                _fit_for(options, len(files))
            except ShjError as error:
                raise here.error(f"cannot be fitted: {error}", "recordings") from error
            yield Device(name, set_name, recordings, options, tags, _diagnose(here, device, for_set))


# What cannot be read or fitted is refused once for all devices that name it: a thousand share their options.
_priors = lru_cache(read_priors)
_fit_for = lru_cache(Options.check)


def _tags(at: _Place, entry: dict[str, Any]) -> Tags:
    """Read what makes a set what it is, for contrasts between sets."""
    values: dict[str, Any] = {}
    for key, (kind, words) in TAG_KINDS.items():
        value = entry.get(key)
        if value is None:
            continue
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise at.error(f"has {key} = {shown(value)}; it needs {words}", key)
        values[key] = plain_name(value) if isinstance(value, str) else value
    percent = values.get("coverage_percent")
    if percent is not None:
        if not 0 <= percent <= 100:
            raise at.error(f"has coverage_percent = {shown(percent)}; allowed is 0 to 100", "coverage_percent")
        values["coverage_percent"] = float(percent)
    return Tags(**values)


def _diagnose(at: _Place, entry: Any, otherwise: str) -> str:
    """How devices of a table are to be diagnosed."""
    value = entry.get("diagnose", otherwise) if isinstance(entry, dict) else otherwise
    if value in DIAGNOSES:
        return str(value)
    hint = did_you_mean(value, DIAGNOSES) if isinstance(value, str) else ""
    allowed = ", ".join(f'"{word}"' for word in DIAGNOSES)
    raise at.error(f"has diagnose = {shown(value)}; allowed are {allowed}{hint}", "diagnose")


def _known(at: _Place, entry: Any, allowed: tuple[str, ...], options: str) -> None:
    """Refuse keys that would be silently without effect, with the table where they belong."""
    if not isinstance(entry, dict):
        raise at.error(f"must be a table, not {shown(entry)}")
    for key in entry:
        if key in allowed:
            continue
        if key in OPTION_KINDS:
            place = f"it is an option: put it into a table {options}"
        elif key in TAG_KINDS:
            place = "it describes a set: put it directly below [[set]]"
        else:
            place = f"known are {', '.join(allowed)}{did_you_mean(key, allowed)}"
        raise at.error(f"has the key '{key}', which has no effect there; {place}", key)


def _text(at: _Place, entry: Any, key: str) -> str:
    value = entry.get(key) if isinstance(entry, dict) else None
    if not isinstance(value, str) or not value.strip():
        raise at.error(f"has {key} = {shown(value)}; it needs a text", *([] if value is None else [key]))
    return plain_name(value)


def _options(at: _Place, base: Options, table: dict[str, Any], key: str = "options") -> Options:
    """Options with those of a manifest table put over them, one by one, so that a message can name the line."""
    entry = table.get(key, {})
    if not isinstance(entry, dict):
        raise at.error(f"{key} must be a table, not {shown(entry)}", key)
    # The rate last: columns of the same table may take away the time column that it would contradict.
    for name, value in sorted(entry.items(), key=lambda item: item[0] == "rate_Hz"):
        base = _with_option(at, base, name, value, (key, name))
    return base


def _with_option(at: _Place, base: Options, name: str, value: Any, where: tuple[str, ...]) -> Options:
    """Options with one more of a manifest table, which stands at `where`."""
    if name == "diagnose":
        places = "the top of the manifest, below [[set]] or below [[set.device]]"
        raise at.error(f"has the option 'diagnose', which is no option of a fit: put it at {places}", *where)
    if name not in OPTION_KINDS:
        known = f"known are {', '.join(OPTION_KINDS)}{did_you_mean(name, OPTION_KINDS)}"
        raise at.error(f"has the option '{name}'; {known}", *where)
    kind = OPTION_KINDS[name]
    if not isinstance(value, kind) or isinstance(value, bool):
        raise at.error(f"option {name} = {shown(value)}; it needs {_KIND_WORDS.get(kind, 'a number')}", *where)
    if name == "priors" and value.endswith(".toml"):
        value = str(at.path.parent / value)
    change: dict[str, Any] = {name: tuple(map(str, value)) if isinstance(value, list) else value}
    try:
        base = replace(base, **change)
        if name == "priors":
            _priors(base.priors)
    except ShjError as error:
        raise at.error(f"option {error}", *where) from error
    return base
