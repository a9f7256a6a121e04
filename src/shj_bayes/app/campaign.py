"""Many devices to many posteriors and diagnoses, and what they say together: only what is missing or changed is done.

Each device is fitted and diagnosed. Then the evidence of the devices of each set is added, and where a set has physics
that a device's own model lacks, the device is fitted with it too: that fit lies in the device's folder, and the margins
take it. Population, margins and pages are made in the end.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from tqdm import tqdm

from shj_bayes._util.files import alone_in, make_writable, shipped
from shj_bayes._util.processes import results
from shj_bayes.app.manifest import Device, Manifest
from shj_bayes.app.resume import MARGINS, PAGE, POPULATION, CommandResult, campaign_inputs, kept_result
from shj_bayes.errors import CampaignError, ShjError, did_you_mean, shown, words_of
from shj_bayes.options import DIAGNOSES, DiagnoseOptions
from shj_bayes.population.device import Claim
from shj_bayes.report.campaign_physics import statements
from shj_bayes.results.campaign import WITH_SET, CampaignRecord, DeviceEntry, SetEntry, SetTogether, read_campaign
from shj_bayes.results.codec import from_json, to_json
from shj_bayes.results.diagnosis import DiagnosisRecord
from shj_bayes.results.fit import FitRecord, Trust
from shj_bayes.results.store import DIAGNOSIS, digests, find, made, write

if TYPE_CHECKING:
    from shj_bayes.app.device import Work

FAILED = "failed"
WRITES = (*POPULATION, *MARGINS, "comparison-curves.csv", "report.html")
Result = TypeVar("Result")


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
    n_workers = workers or os.cpu_count() or 1
    run = partial(_all_done, folder=folder, workers=n_workers, cluster=cluster, progress=progress)
    outcomes = run(devices, "fits")
    said = _together(outcomes, folder)
    further = []  # devices whose own fit lacks what their set has, as they are to be fitted with it
    for i, o in enumerate(outcomes):
        if o.device.folder in said["unread"]:
            outcomes[i] = replace(o, diagnosis=FAILED, diagnosis_reason=said["unread"][o.device.folder])
        elif o.device.folder in said["enter"]:
            effects = (*o.device.options.effects, *said["enter"][o.device.folder])
            options = replace(o.device.options, effects=effects)
            further.append(replace(o.device, options=options, diagnose="off", below=f"/{WITH_SET}"))
    more = {o.device.folder: o for o in run(further, "with what the set has")}
    for i, o in enumerate(outcomes):
        if found := more.get(f"{o.device.folder}/{WITH_SET}"):
            verdict = FAILED if found.status == FAILED else found.verdict
            outcomes[i] = replace(o, with_set=verdict, with_set_reason=found.reason)
    together = [from_json(SetTogether, one) for one in said["together"]]
    write(campaign_record(manifest, outcomes, together), folder)
    return outcomes


def _together(outcomes: Sequence[Outcome], folder: Path) -> dict[str, Any]:
    """Add up what the diagnosed devices of each set, and all of them, have in common.

    ``together`` is what is common, ``enter`` by device what of it enters its model, ``unread`` why a diagnosis is not.
    """
    diagnosed = [o for o in outcomes if o.status != FAILED and o.diagnosis not in ("off", FAILED)]

    def add_up() -> dict[str, Any]:
        from shj_bayes.mismatch.sets import read_diagnosed, together  # noqa: PLC0415  (needs half of scipy)

        devices, failed = [], {}
        for o in diagnosed:
            place = o.device.folder
            try:
                devices.append((o.device.set_name, read_diagnosed(folder / place / DIAGNOSIS, place)))
            except ShjError as error:
                failed[place] = str(error)
        groups, enter = together(devices)
        return {"together": to_json(groups), "enter": enter, "unread": failed}

    if not diagnosed:
        return {"together": (), "enter": {}, "unread": {}}
    files = [
        (o.device.set_name, digests(folder, [f"{o.device.folder}/{DIAGNOSIS}/{DiagnosisRecord.FILE}"]))
        for o in diagnosed
    ]
    said: dict[str, Any] = made(folder, "together", files, (), add_up)
    return said


def _all_done(
    devices: Sequence[Device], words: str, *, folder: Path, workers: int, cluster: str, progress: bool
) -> list[Outcome]:
    """Outcome of each device, in order: known already, or of a process, of this machine or of a cluster."""
    named = {device.folder: device for device in devices}  # an outcome speaks of the device as the manifest does
    outcomes = {device.folder: outcome for device in devices if (outcome := _kept(device, folder))}
    waiting = [device for device in devices if device.folder not in outcomes]
    there = folder.absolute() if cluster else folder
    sent = map(_with_whole_paths, waiting) if cluster else waiting
    quiet = None if progress and devices else True
    with tqdm(total=len(devices), initial=len(outcomes), unit="device", desc=words, disable=quiet) as bar:
        do, tell = partial(fit_one, folder=there), bar.set_postfix_str
        for device, outcome, reason in results(workers, do, sent, cluster=cluster, folder=there, tell=tell):
            mine = named[device.folder]
            outcomes[device.folder] = replace(outcome, device=mine) if outcome else Outcome(mine, FAILED, reason)
            bar.update()
    return [outcomes[device.folder] for device in devices]


def _with_whole_paths(device: Device) -> Device:
    """Make the paths mean the same on another machine that shares the file system."""
    priors, options = device.options.priors, device.options
    if priors.endswith(".toml"):
        options = replace(options, priors=str(Path(priors).absolute()))
    return replace(device, recordings=tuple(path.absolute() for path in device.recordings), options=options)


def _kept(device: Device, folder: Path) -> Outcome | None:
    """Outcome of a device that was fitted and diagnosed earlier and has not changed: no process is started for it."""
    place = folder / device.folder
    result = kept_result(device.recordings, place, asdict(device.options), device.name)
    known = result and _kept_diagnosis(device, place, result.record.key)
    return replace(_outcome(device, result), diagnosis=known) if result and known else None


def _kept_diagnosis(device: Device, place: Path, key: str) -> str | None:
    """Verdict of a diagnosis that was made earlier of the same recordings with the same options; None without one.

    A full one does where a quick one is asked for.
    """
    if device.diagnose == "off":
        return "off"
    folder = place / DIAGNOSIS
    record = find(DiagnosisRecord, folder)
    if record is None or record.key != key or record.model is None or record.model.without:
        return None
    enough = device.diagnose == "quick" or not record.quick
    return record.verdict if enough and (folder / "diagnosis.html").is_file() else None


def fit_one(device: Device, folder: Path, work: Work | None = None) -> Outcome:
    """Fit and diagnose one device of a campaign in its folder below `folder`; by default with one thread, silently."""
    # A campaign in which nothing changed needs none of it.
    from shj_bayes.app.device import Work, diagnose_device, fit_device  # noqa: PLC0415
    from shj_bayes.report.device import render_device  # noqa: PLC0415

    place, off = folder / device.folder, device.diagnose == "off"
    name, options = device.name, device.options
    work = replace(work or Work(threads=1), held={})
    result = _tried(lambda: fit_device(device.recordings, place, options, name=name, page=off, work=work))
    if isinstance(result, str):
        return Outcome(device, FAILED, result)
    outcome, known = _outcome(device, result), _kept_diagnosis(device, place, result.record.key)
    if known is None:
        look, below = DiagnoseOptions(quick=device.diagnose == "quick"), place / DIAGNOSIS
        found = _tried(lambda: diagnose_device(device.recordings, below, options, look, name=name, work=work))
        known, reason = (FAILED, found) if isinstance(found, str) else (found.record.verdict, "")
        outcome = replace(outcome, status="done", diagnosis_reason=reason)
    # The page is drawn now, since it says what the diagnosis found.
    page = None if off else _tried(lambda: render_device(place))
    outcome = replace(outcome, diagnosis=known)
    return replace(outcome, status=FAILED, reason=page) if isinstance(page, str) else outcome


def _tried(job: Callable[[], Result]) -> Result | str:
    """Do a job; give why it failed, in words, where it did: one bad device must not stop a thousand good ones."""
    try:
        return job()
    except Exception as error:  # whatever it is, it is told of the one device
        return words_of(error)


def _outcome(device: Device, result: CommandResult) -> Outcome:
    """Outcome of a device that has a result."""
    record: FitRecord = result.record
    simulated = any(source.simulated for source in record.inputs)
    inputs = tuple((source.name, source.sha256 or "") for source in record.inputs)
    return Outcome(device, "done" if result.fresh else "kept", result.note, record.verdict, simulated, inputs)


def campaign_record(manifest: Manifest, outcomes: Sequence[Outcome], together: Sequence[SetTogether]) -> CampaignRecord:
    """Say what became of the devices of each set, and which recordings belong to several devices."""
    told = ("status", "reason", "verdict", "diagnosis", "diagnosis_reason", "with_set", "with_set_reason")
    sets: dict[str, list[DeviceEntry]] = {}
    of_set = {o.device.set_name: o.device for o in outcomes}
    places: dict[str, dict[str, str]] = {}  # by digest: names of the file by device
    for o in outcomes:
        device, words = o.device, {word: getattr(o, word) for word in told}
        entry = DeviceEntry(name=device.name, folder=device.folder, note=device.note or None, **words)
        sets.setdefault(device.set_name, []).append(entry)
        for name, digest in o.inputs:
            places.setdefault(digest, {}).setdefault(f"{device.set_name}, {device.name}", name)
    warnings = [
        f"The same recording is in {len(where)} devices, which counts one test as several: "
        + ", ".join(f"{device} ({name})" for device, name in list(where.items())[:5])
        + (f" and {len(where) - 5} more." if len(where) > 5 else ".")
        for digest, where in places.items()
        if digest and len(where) > 1
    ]
    return CampaignRecord(
        name=manifest.name,
        simulated=manifest.simulated or any(o.simulated for o in outcomes),
        warnings=tuple(warnings),
        sets=tuple(
            SetEntry(name=n, devices=tuple(own), connection=of_set[n].connection, note=of_set[n].set_note or None)
            for n, own in sets.items()
        ),
        together=tuple(together),
    )


@alone_in("folder")
def summarise_campaign(
    outcomes: Sequence[Outcome], folder: Path, *, seed: int, progress: bool = False
) -> CommandResult:
    """Pool the usable devices of a campaign and write its page; the same seed and devices, the same numbers."""
    usable = [o for o in outcomes if o.status != FAILED and o.verdict != Trust.UNUSABLE]
    record = read_campaign(folder)
    lines = [*map(_line, outcomes), *record.warnings, *statements(record.together)]

    def pool() -> dict[str, Any]:
        # Population, margins and pictures need most of scipy, which a campaign in which nothing changed need not load.
        from shj_bayes.app.design import pooled_campaign  # noqa: PLC0415

        return pooled_campaign(usable, folder, seed=seed, progress=progress)

    who = [(o.device.folder, o.device.name, o.device.set_name, asdict(o.device.tags)) for o in usable]
    said = made(folder, "summary", [seed, who, campaign_inputs(folder)], WRITES, pool)
    if usable:
        lines += ["", *said["lines"], "", f"margins: {folder / PAGE}"]
    text = "\n".join([*lines, f"report: {folder / 'report.html'}"])
    return CommandResult(to_json(record) | said["record"], text, usable=bool(usable))


@alone_in("folder")
def summarise_tables(folder: Path, claims: Sequence[Claim], *, seed: int, progress: bool = False) -> CommandResult:
    """Pool the published tables and write their page with the paper's claims; as for `summarise_campaign`."""
    make_writable(folder)

    def pool() -> dict[str, Any]:
        from shj_bayes.app.design import pooled_tables  # noqa: PLC0415  (as above)

        return pooled_tables(claims, folder, seed=seed, progress=progress)

    rests_on = [seed, digests(shipped("data", "published"), ["*"]), [vars(claim) for claim in claims]]
    said = made(folder, "tables", rests_on, (*POPULATION, *MARGINS, "report.html"), pool)
    where = [f"margins: {folder / PAGE}", f"report: {folder / 'report.html'}"]
    return CommandResult(said["record"], "\n".join([*said["lines"], "", *where]))


def _line(o: Outcome) -> str:
    """Say what became of a device."""
    parts = [o.status, o.verdict or o.reason]
    if o.diagnosis not in ("", "off"):
        parts.append(f"{o.diagnosis}{f' ({o.diagnosis_reason})' if o.diagnosis_reason else ''}")
    if o.with_set:
        parts.append(f"with what its set has: {o.with_set}{f' ({o.with_set_reason})' if o.with_set == FAILED else ''}")
    return f"{o.device.set_name}, {o.device.name}: {', '.join(parts)}"
