"""Many devices to many posteriors: a TOML manifest, parallel processes, only what is missing or changed."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from tqdm import tqdm

from shj_bayes.cluster import results_on
from shj_bayes.errors import CampaignError, ShjError, plain_text
from shj_bayes.files import folder_name, make_writable, plain_name, read_toml, sealed, write_text
from shj_bayes.mistaken import repeated
from shj_bayes.pipeline import DeviceResult, Options, fit_device
from shj_bayes.population.device import NO_TAGS, Tags
from shj_bayes.report.device import is_simulated
from shj_bayes.suggest import did_you_mean

SCHEMA = "shj-bayes/campaign/1"
MAX_DEVICES = 100_000
OPTION_KINDS: dict[str, Any] = {
    "columns": str,
    "units": str,
    "rate_Hz": int | float,
    "priors": str,
    "model": str,
    "noise": str,
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
    """Read a campaign manifest.

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
        With the table and the value at fault.
    """
    table, _ = read_toml(path, SCHEMA, 50_000_000, CampaignError)
    _known(path, "the manifest", table, ("schema", "name", "simulated", "defaults", "set"), "[defaults]")
    defaults = _options(path, "[defaults]", Options(), table.get("defaults", {}))
    devices = tuple(_devices(path, table, defaults))
    if not 1 <= len(devices) <= MAX_DEVICES:
        raise CampaignError(f"{path.name} names {len(devices)} devices; allowed are 1 to {MAX_DEVICES}")
    seen: set[str] = set()
    for device in devices:
        if device.folder in seen:
            raise CampaignError(f"{path.name}: device '{device.name}' stands twice in set '{device.set_name}'")
        seen.add(device.folder)
    return Manifest(plain_name(str(table.get("name", path.stem))), devices, table.get("simulated") is True)


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
    if cluster:
        coming = _fit_on_cluster(manifest, folder, cluster, bar.set_postfix_str)
    else:
        coming = _fit_all(manifest, folder, workers or os.cpu_count() or 1)
    with bar:
        for outcome in coming:
            outcomes[outcome.device.folder] = outcome
            bar.update()
    ordered = [outcomes[device.folder] for device in manifest.devices]
    write_text(folder / "campaign.json", json.dumps(campaign_record(manifest, ordered), indent=1))
    return ordered


def _fit_all(manifest: Manifest, folder: Path, workers: int) -> Iterator[Outcome]:
    """Outcomes as they come; a pool whose worker died is replaced and its devices are tried once more."""
    waiting = list(manifest.devices)
    tries: dict[str, int] = {}
    while waiting:
        pool = ProcessPoolExecutor(max_workers=min(workers, len(waiting)), mp_context=get_context("spawn"))
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
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _fit_on_cluster(manifest: Manifest, folder: Path, address: str, tell: Callable[[str], None]) -> Iterator[Outcome]:
    """Outcomes as a dask cluster finishes them; it hands the devices of a lost worker to another."""
    there = {d.folder: d for d in manifest.devices}  # an outcome speaks of the device as the manifest names it
    sent = [_with_whole_paths(device) for device in manifest.devices]
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


def _devices(path: Path, table: dict[str, Any], defaults: Options) -> Iterator[Device]:
    sets = table.get("set", [])
    if not isinstance(sets, list) or not sets:
        raise CampaignError(f"{path.name} has no [[set]] table; each set needs a name and [[set.device]] tables")
    for number, entry in enumerate(sets, start=1):
        set_name = _text(path, f"[[set]] number {number}", entry, "name")
        where = f"set '{set_name}'"
        _known(path, where, entry, ("name", "options", "device", *TAG_KINDS), "[set.options]")
        tags = _tags(path, where, entry)
        if not isinstance(entry.get("device"), list) or not entry["device"]:
            raise CampaignError(f"{path.name}: {where} has no [[set.device]] table (mind the double brackets)")
        own = _options(path, where, defaults, entry.get("options", {}))
        for device in entry.get("device", []):
            name = _text(path, where, device, "name")
            at = f"{where}, device '{name}'"
            _known(path, at, device, ("name", "recordings", "runs", "options"), "[set.device.options]")
            files = device.get("recordings")
            if not isinstance(files, list) or not files or not all(isinstance(f, str) and f for f in files):
                raise CampaignError(
                    f'{path.name}: {at} needs recordings = ["run1.csv", ...] in the order they were run'
                )
            if "\x00" in "".join(files):
                raise CampaignError(f"{path.name}: {at} names a file with a NUL character")
            recordings = tuple(path.parent / f for f in files)
            for_all = own if "runs" not in device else _options(path, at, own, {"runs": device["runs"]})
            yield Device(name, set_name, recordings, _options(path, at, for_all, device.get("options", {})), tags)


def _tags(path: Path, where: str, entry: dict[str, Any]) -> Tags:
    """Read what makes a set what it is, for contrasts between sets."""
    values: dict[str, Any] = {}
    for key, (kind, words) in TAG_KINDS.items():
        value = entry.get(key)
        if value is None:
            continue
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise CampaignError(f"{path.name}: {where} has {key} = {value!r}; it needs {words}")
        values[key] = plain_name(value) if isinstance(value, str) else value
    percent = values.get("coverage_percent")
    if percent is not None:
        if not 0 <= percent <= 100:
            raise CampaignError(f"{path.name}: {where} has coverage_percent = {percent!r}; allowed is 0 to 100")
        values["coverage_percent"] = float(percent)
    return Tags(**values)


def _known(path: Path, where: str, entry: Any, allowed: tuple[str, ...], options: str) -> None:
    """Refuse keys that would be silently without effect, with the table where they belong."""
    if not isinstance(entry, dict):
        raise CampaignError(f"{path.name}: {where} must be a table, not {entry!r}")
    for key in entry:
        if key in allowed:
            continue
        if key in OPTION_KINDS:
            place = f"it is an option: put it into a table {options}"
        elif key in TAG_KINDS:
            place = "it describes a set: put it directly below [[set]]"
        else:
            place = f"known are {', '.join(allowed)}{did_you_mean(key, allowed)}"
        raise CampaignError(f"{path.name}: {where} has the key '{key}', which has no effect there; {place}")


def _text(path: Path, where: str, entry: Any, key: str) -> str:
    value = entry.get(key) if isinstance(entry, dict) else None
    if not isinstance(value, str) or not value.strip():
        raise CampaignError(f"{path.name}: {where} has {key} = {value!r}; it needs a text")
    return plain_name(value)


def _options(path: Path, where: str, base: Options, entry: Any) -> Options:
    """Options with those of a manifest table put over them."""
    if not isinstance(entry, dict):
        raise CampaignError(f"{path.name}: {where} options must be a table, not {entry!r}")
    values: dict[str, Any] = {}
    for key, value in entry.items():
        if key not in OPTION_KINDS:
            known = f"known are {', '.join(OPTION_KINDS)}{did_you_mean(key, OPTION_KINDS)}"
            raise CampaignError(f"{path.name}: {where} has the option '{key}'; {known}")
        if not isinstance(value, OPTION_KINDS[key]) or isinstance(value, bool):
            words = _KIND_WORDS.get(OPTION_KINDS[key], "a number")
            raise CampaignError(f"{path.name}: {where} option {key} = {value!r}; it needs {words}")
        values[key] = tuple(str(v) for v in value) if isinstance(value, list) else value
    priors = values.get("priors", "")
    if priors.endswith(".toml"):
        values["priors"] = str(path.parent / priors)
    try:
        return replace(base, **values)
    except ShjError as error:
        raise CampaignError(f"{path.name}: {where}: {error}") from error
