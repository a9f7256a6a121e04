"""Many devices to many posteriors: a TOML manifest, parallel processes, only what is missing or changed."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass, replace
from functools import lru_cache, partial
from itertools import chain
from pathlib import Path
from typing import Any

from tqdm import tqdm

from shj_bayes._util.child_processes import Workers
from shj_bayes._util.dask_cluster import results_on
from shj_bayes._util.did_you_mean import did_you_mean
from shj_bayes._util.files import folder_name, make_writable, plain_name, read_toml, sealed, toml_line, write_text
from shj_bayes._util.lock import alone_in
from shj_bayes.commands.finished import DeviceResult, kept_result
from shj_bayes.commands.mistaken import repeated
from shj_bayes.commands.pipeline import Options, fit_device
from shj_bayes.errors import CampaignError, ShjError, plain_text, shown
from shj_bayes.model.priors import read_priors
from shj_bayes.population.device import NO_TAGS, Tags
from shj_bayes.report.device import is_simulated

SCHEMA = "shj-bayes/campaign/1"
MAX_DEVICES = 100_000
OPTION_KINDS: dict[str, Any] = {
    "columns": str,
    "units": str,
    "rate_Hz": int | float,
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
MAX_TRIES = 2  # a device that was under way when a worker died is tried once more


@dataclass(frozen=True)
class Device:
    """One device of a campaign.

    Parameters
    ----------
    name, set_name : str
        Its name, unique within its set, and the set's.
    recordings : tuple of Path
        Consecutive runs.
    options : Options
        How to read and fit it.
    tags : Tags
        What makes its set what it is: material, coating, coverage, corroded.
    """

    name: str
    set_name: str
    recordings: tuple[Path, ...]
    options: Options
    tags: Tags = NO_TAGS

    @property
    def folder(self) -> str:
        """Results folder below the campaign's, safe on every system."""
        return f"devices/{folder_name(f'{self.set_name} {self.name}')}"


@dataclass(frozen=True)
class Manifest:
    """A campaign: its name and its devices in order.

    Parameters
    ----------
    name : str
        Title of the report.
    devices : tuple of Device
        All devices of all sets.
    simulated : bool
        True where the recordings are simulated, so that the report says so.
    """

    name: str
    devices: tuple[Device, ...]
    simulated: bool = False


@dataclass(frozen=True)
class Outcome:
    """What became of one device.

    Parameters
    ----------
    device : Device
        The device.
    status : {"done", "kept", "failed"}
        Fitted, found unchanged, or not fitted.
    reason, verdict : str
        Why it failed, or what there is to say; verdict of the fit.
    simulated : bool
        A recording says that it is simulated.
    inputs : tuple of (str, str)
        Name and digest of each recording.
    """

    device: Device
    status: str
    reason: str = ""
    verdict: str = ""
    simulated: bool = False
    inputs: tuple[tuple[str, str], ...] = ()


def read_manifest(path: Path) -> Manifest:
    """Read a campaign manifest, and check the whole of it before anything is fitted.

    Parameters
    ----------
    path : Path
        TOML file with ``schema``, ``name``, optional ``[defaults]`` and ``[[set]]`` tables, each with a ``name`` and
        ``[[set.device]]`` tables of ``name`` and ``recordings`` (paths relative to the manifest).

    Returns
    -------
    Manifest

    Raises
    ------
    CampaignError
        With the line, the table and the value at fault, and what is allowed.
    """
    for cache in (_priors, _fit_for):
        cache.cache_clear()  # the files may have changed since
    table, _ = read_toml(path, SCHEMA, 50_000_000, CampaignError)
    top = _Place(path, "the manifest")
    _known(top, table, ("schema", "name", "simulated", "defaults", "set"), "[defaults]")
    name = _text(top, table, "name") if "name" in table else plain_name(path.stem)
    simulated = table.get("simulated", False)
    if not isinstance(simulated, bool):
        raise top.error(f"has simulated = {shown(simulated)}; allowed are true and false", "simulated")
    defaults = _options(top, Options(), table, "defaults")
    devices = tuple(_devices(top, table, defaults))
    if not 1 <= len(devices) <= MAX_DEVICES:
        raise CampaignError(f"{path.name} names {len(devices)} devices; allowed are 1 to {MAX_DEVICES}")
    seen: set[str] = set()
    for device in devices:
        if device.folder in seen:
            raise CampaignError(f"{path.name}: device '{device.name}' stands twice in set '{device.set_name}'")
        seen.add(device.folder)
    return Manifest(name, devices, simulated)


@alone_in("folder")
def run_campaign(
    manifest: Manifest, folder: Path, *, workers: int = 0, cluster: str = "", progress: bool = False
) -> list[Outcome]:
    """Fit every device that is missing or changed; one bad device never stops the rest.

    Parameters
    ----------
    manifest : Manifest
        What to fit.
    folder : Path
        Campaign folder; each device has its own folder below ``devices``.
    workers : int
        Processes, 0 for one per processor.
    cluster : str
        Address of a dask scheduler whose workers fit the devices instead; they must see `folder` and the recordings
        under the same paths.
    progress : bool
        Show a progress bar on standard error.

    Returns
    -------
    list of Outcome
        One per device, in the manifest's order; also written to ``campaign.json``.
    """
    make_writable(folder)
    outcomes: dict[str, Outcome] = {}
    bar = tqdm(total=len(manifest.devices), unit="device", desc="devices", disable=None if progress else True)
    kept = {device.folder: result for device in manifest.devices if (result := _kept(device, folder))}
    waiting = [device for device in manifest.devices if device.folder not in kept]
    if cluster:
        coming = _fit_on_cluster(waiting, folder, cluster, bar.set_postfix_str)
    else:
        coming = _fit_all(waiting, folder, workers or os.cpu_count() or 1)
    with bar:
        for outcome in chain(kept.values(), coming):
            outcomes[outcome.device.folder] = outcome
            bar.update()
    ordered = [outcomes[device.folder] for device in manifest.devices]
    write_text(folder / "campaign.json", json.dumps(campaign_record(manifest, ordered), indent=1))
    return ordered


def _kept(device: Device, folder: Path) -> Outcome | None:
    """Outcome of a device that was fitted earlier and has not changed: no process is started for it."""
    result = kept_result(device.recordings, folder / device.folder, asdict(device.options), device.name)
    return None if result is None else _outcome(device, result)


def _fit_all(devices: Sequence[Device], folder: Path, workers: int) -> Iterator[Outcome]:
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
                            yield Outcome(device, "failed", "the process that fitted it died twice (memory, or killed)")
        except BaseException:
            pool.stop()
            raise
        pool.shutdown(wait=True, cancel_futures=True)


def _fit_on_cluster(
    devices: Sequence[Device], folder: Path, address: str, tell: Callable[[str], None]
) -> Iterator[Outcome]:
    """Outcomes as a dask cluster finishes them; it hands the devices of a lost worker to another."""
    if not devices:
        return
    there = {d.folder: d for d in devices}  # an outcome speaks of the device as the manifest names it
    sent = [_with_whole_paths(device) for device in devices]
    fit_there = partial(_fit_one, folder=folder.absolute())
    for device, outcome, reason in results_on(address, folder.absolute(), fit_there, sent, tell=tell):
        mine = there[device.folder]
        yield replace(outcome, device=mine) if outcome else Outcome(mine, "failed", reason)


def _with_whole_paths(device: Device) -> Device:
    """Make the paths mean the same on another machine that shares the file system."""
    priors, options = device.options.priors, device.options
    if priors.endswith(".toml"):
        options = replace(options, priors=str(Path(priors).absolute()))
    return replace(device, recordings=tuple(path.absolute() for path in device.recordings), options=options)


def _fit_one(device: Device, folder: Path) -> Outcome:
    """Fit one device in a worker process."""
    try:
        result: DeviceResult = fit_device(
            device.recordings, folder / device.folder, device.options, name=device.name, threads=1
        )
    except ShjError as error:
        return Outcome(device, "failed", str(error))
    except OSError as error:
        where = f" ({Path(str(error.filename)).name})" if error.filename else ""
        reason = plain_text(error.strerror or str(error))
        return Outcome(device, "failed", f"{reason}{where}; check the path, the rights and the free space")
    except MemoryError:
        return Outcome(device, "failed", "not enough memory; use fewer --workers, or export fewer samples")
    except Exception as error:  # one bad device must not stop a thousand good ones; the type says it is a bug
        return Outcome(device, "failed", plain_text(f"unexpected {type(error).__name__}: {error}"))
    return _outcome(device, result)


def _outcome(device: Device, result: DeviceResult) -> Outcome:
    """Outcome of a device that has a result."""
    inputs = result.record["inputs"]
    return Outcome(
        device,
        "done" if result.fresh else "kept",
        result.note,
        result.record["verdict"],
        any(map(is_simulated, inputs)),
        tuple((source["name"], source["sha256"]) for source in inputs),
    )


def campaign_record(manifest: Manifest, outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """Content of ``campaign.json``."""
    sets: dict[str, list[dict[str, str]]] = {}
    for o in outcomes:
        entry = {"name": o.device.name, "folder": o.device.folder}
        entry |= {"status": o.status, "reason": o.reason, "verdict": o.verdict}
        sets.setdefault(o.device.set_name, []).append(entry)
    return sealed(
        {
            "schema": SCHEMA,
            "name": manifest.name,
            "simulated": manifest.simulated or any(o.simulated for o in outcomes),
            "warnings": repeated(
                (f"{o.device.set_name}, {o.device.name}", name, digest) for o in outcomes for name, digest in o.inputs
            ),
            "sets": [{"name": name, "devices": devices} for name, devices in sets.items()],
        }
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


def _devices(top: _Place, table: dict[str, Any], defaults: Options) -> Iterator[Device]:
    sets = table.get("set", [])
    if not isinstance(sets, list) or not sets:
        raise top.error("has no [[set]] table; each set needs a name and [[set.device]] tables")
    for i, entry in enumerate(sets):
        at = top.inside(f"[[set]] number {i + 1}", "set", i)
        set_name = _text(at, entry, "name")
        at = top.inside(f"set '{set_name}'", "set", i)
        _known(at, entry, ("name", "options", "device", *TAG_KINDS), "[set.options]")
        tags = _tags(at, entry)
        if not isinstance(entry.get("device"), list) or not entry["device"]:
            raise at.error("has no [[set.device]] table (mind the double brackets)")
        own = _options(at, defaults, entry)
        for j, device in enumerate(entry["device"]):
            name = _text(at.inside(at.words, "device", j), device, "name")
            here = at.inside(f"{at.words}, device '{name}'", "device", j)
            _known(here, device, ("name", "recordings", "runs", "options"), "[set.device.options]")
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
            yield Device(name, set_name, recordings, options, tags)


@lru_cache
def _priors(which: str) -> None:
    """Refuse priors that cannot be read, once for all devices that name them."""
    read_priors(which)


@lru_cache
def _fit_for(options: Options, n_runs: int) -> None:
    """Refuse options with which no device of so many runs can be fitted; a thousand devices share them."""
    options.check(n_runs)


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
