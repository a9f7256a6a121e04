"""One device from files to page: read, check, fit, write, draw."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import shj_bayes
from shj_bayes.alone import alone_in
from shj_bayes.errors import InferenceError, ModelError, RecordingError, StrangeCheckpointError, plain_text, shown
from shj_bayes.files import plain_name
from shj_bayes.inference.fit import CHECKPOINT, Fit, fit
from shj_bayes.inference.run import Run, runs_of
from shj_bayes.inference.sampler import Plan
from shj_bayes.inference.store import check_files, read_group, read_record
from shj_bayes.mismatch.diagnosis import diagnose
from shj_bayes.mistaken import content_digest, refuse_used_folder, remarked
from shj_bayes.model.device import DeviceModel, effects_named, meaning_of
from shj_bayes.model.law import variant_named
from shj_bayes.model.noise.catalogue import DEFAULT, noise_model
from shj_bayes.model.parameters import BASE, FloatArray
from shj_bayes.model.priors import Priors, read_priors
from shj_bayes.recording.check import describe, to_dict
from shj_bayes.recording.columns import check_rate, parse_columns
from shj_bayes.recording.kinematics import motion_of
from shj_bayes.recording.reader import read
from shj_bayes.recording.recording import Recording
from shj_bayes.recording.runs import Runs, check_runs, settle
from shj_bayes.recording.units import parse_units
from shj_bayes.report.device import render_device
from shj_bayes.report.diagnosis import render_diagnosis
from shj_bayes.report.residual_file import read_residual

SEEDS, STEPS = (0, 2**32 - 1), (1, 1_000_000)
SURE_P = 1e-3  # below it, digits of a p value say nothing to a reader; diagnosis.json keeps them


@dataclass(frozen=True)
class Options:
    """How to read and fit a device; the same words as on the command line.

    Parameters
    ----------
    columns, units : str or None
        Columns and units, where the file does not say.
    rate_Hz : float or None
        Sampling rate of files without time, Hz.
    priors : str
        Shipped family or TOML file.
    model : {"published", "continuous"}
        Reversal rule.
    noise : str
        Noise model: ``slow``, ``ar1``, ``independent``, ``student``.
    effects : tuple of str
        Physical effects that are known to be there, by their ids.
    free : tuple of str
        Parameters that each run has for itself.
    seed : int
        Same seed, same numbers.
    max_steps : int
        Steps after which to stop.
    runs : int, "split", "one" or None
        Number of runs that the files hold; ``"split"`` parts files where runs are found, ``"one"`` never does.
    """

    columns: str | None = None
    units: str | None = None
    rate_Hz: float | None = None
    priors: str = "afc"
    model: str = "published"
    noise: str = DEFAULT
    effects: tuple[str, ...] = ()
    free: tuple[str, ...] = ()
    seed: int = 1
    max_steps: int = 10_000
    runs: Runs = None

    def __post_init__(self) -> None:
        """Refuse choices that no fit could take, before any device is read."""
        object.__setattr__(self, "model", variant_named(self.model))
        for number, found, (low, high) in (("seed", self.seed, SEEDS), ("max_steps", self.max_steps, STEPS)):
            if not low <= found <= high:
                raise ModelError(f"{number} = {shown(found, 20)}; allowed is {low} to {high}")
        asked = parse_columns(self.columns)
        parse_units(self.units)
        if self.rate_Hz is not None:
            check_rate(self.rate_Hz, asked)
        check_runs(self.runs)
        if "velocity" in self.effects:
            raise ModelError(
                "the base law depends on speed already; take 'velocity' out of the effects (or --without velocity)"
            )
        self.device_model(1, None)

    def device_model(self, n_runs: int, priors: Priors | None) -> DeviceModel:
        """Model of a device with so many runs; without priors those of the default family stand in."""
        return DeviceModel(
            n_runs,
            priors or read_priors(),
            effects=effects_named(self.effects),
            noise=noise_model(self.noise),
            free=self.free,
            variant=self.model,
        )

    def check(self, n_runs: int) -> None:
        """Refuse priors that cannot be read, or that lack a law that a device of so many runs needs."""
        assert self.device_model(n_runs, read_priors(self.priors)).laws_of_parameters


@dataclass(frozen=True, eq=False)
class DiagnosisResult:
    """A finished diagnosis.

    Parameters
    ----------
    folder : Path
        Where its files are.
    record : dict
        Content of ``diagnosis.json``.
    page : Path
        The page.
    """

    folder: Path
    record: dict[str, Any]
    page: Path

    @property
    def text(self) -> str:
        """What a person wants to read at the end of a diagnosis."""
        record = self.record
        p = f"below {SURE_P:g}" if record["p_value"] < SURE_P else f"{record['p_value']:.2g}"
        lines = [f"{record['device']}: {record['verdict']} (chance of such a misfit if nothing were missing: {p})"]
        lines += [f"  {sentence}" for sentence in record["words"]]
        # Where nothing was added to the law there is one law and one set of numbers.
        stages = ("before", "after") if record["effects"] else ("after",)
        lines += ["", f"  {' -> '.join(stages)}" if len(stages) > 1 else "  base law"]
        for name, row in record["shift"].items():
            shown = " -> ".join(f"{row[stage]['mean']:11.5g} +- {row[stage]['sd']:<9.2g}" for stage in stages)
            lines.append(f"  {name:8}{shown} {meaning_of(name).unit}")
        errors = " -> ".join(f"{record[stage]['heldout_rmse_kN']:.3g}" for stage in stages)
        lines.append(f"  error on held-out cycles {errors} kN")
        return "\n".join([*lines, "", f"report: {self.page}"])


@dataclass(frozen=True, eq=False)
class DeviceResult:
    """A finished device.

    Parameters
    ----------
    folder : Path
        Where its files are.
    record : dict
        Content of ``fit.json``.
    fresh : bool
        False when an earlier, unchanged result was found and kept.
    residual : str
        What the page says of the residual: nothing beyond noise, or where it has a structure.
    note : str
        Why an earlier result was not kept although it is of the same fit: which file was damaged.
    """

    folder: Path
    record: dict[str, Any]
    fresh: bool
    residual: str = ""
    note: str = ""

    @property
    def text(self) -> str:
        """What a person wants to read at the end of a fit."""
        record = self.record
        lines = [f"{record['device']}: {record['verdict']}"]
        lines += [f"  {reason}" for reason in record["reasons"]]
        lines += [f"  {extra}" for extra in (self.residual, self.note) if extra]
        width = max(len(row["name"]) for row in record["parameters"]) + 1
        lines += ["", f"  {'':{width}}{'mean':>12}{'sd':>11}{'5 %':>12}{'95 %':>12}  unit"]
        for row in record["parameters"]:
            numbers = f"{row['mean']:12.5g}{row['sd']:11.2g}{row['q05']:12.5g}{row['q95']:12.5g}"
            lines.append(f"  {row['name']:{width}}{numbers}  {row['unit']}{dep_words(row)}")
        notes = [f for run in record["inputs"] for f in run["findings"] if f["severity"] != "note"]
        lines += dict.fromkeys(f"  {finding['severity']}: {finding['message']}" for finding in notes)
        lines += ["", f"report: {self.folder / 'report.html'}"]
        return "\n".join(lines)


@alone_in("folder", kept="fit.json")
def fit_device(
    paths: Sequence[Path | Recording],
    folder: Path,
    options: Options,
    *,
    name: str | None = None,
    progress: bool = False,
    threads: int = 0,
    force: bool = False,
) -> DeviceResult:
    """Fit one device from its recordings and write the files and the page of INTERFACE.

    An unchanged finished result in `folder` is kept; an unfinished one is gone on with.

    Parameters
    ----------
    paths : sequence of Path or Recording
        Consecutive runs, in the order they were made; as files, or as read.
    folder : Path
        Results folder.
    options : Options
        How to read and fit.
    name : str, optional
        Name of the device; the first file's name without ending by default.
    progress : bool
        Show a progress bar.
    threads : int
        Ensembles that run at the same time, 0 for one per processor.
    force : bool
        Replace the result of another device in `folder`.

    Returns
    -------
    DeviceResult

    Raises
    ------
    RecordingError
        If a recording cannot be used.
    InferenceError
        If `folder` holds the result of another device.
    """
    options.check(len(paths))
    recordings = _usable(paths, options)
    name = plain_name(name) if name else _default_name(paths[0])
    if not force:
        refuse_used_folder(folder, name, recordings, InferenceError)
    model = options.device_model(len(recordings), read_priors(options.priors))
    key = _key(_digests(paths, recordings), options, model, name)
    finished, note = _finished(folder, key)
    if finished is None:
        finished, fresh = _fit(runs_of(recordings), folder, options, model, name, key, progress, threads), True
    else:
        fresh = False
    if fresh or _stale(folder):
        render_device(folder)
    left = read_residual(folder)
    return DeviceResult(folder, finished, fresh, left[1] if left else "", note)


def _fit(
    runs: Sequence[Run],
    folder: Path,
    options: Options,
    model: DeviceModel,
    name: str,
    key: str,
    progress: bool,
    threads: int,
    tops: Sequence[FloatArray] = (),
) -> dict[str, Any]:
    """Fit and write the files; give the record."""
    plan = Plan(seed=options.seed, max_steps=options.max_steps)

    def sampled() -> Fit:
        return fit(
            runs, model, name=name, key=key, plan=plan, tops=tops, folder=folder, progress=progress, threads=threads
        )

    finished, checkpoint = folder / "fit.json", folder / CHECKPOINT
    try:
        result = sampled()
    except StrangeCheckpointError:
        # One that an earlier fit left when it was finished goes with its result; one of a fit that was interrupted
        # stays.
        if not finished.exists() or checkpoint.stat().st_mtime_ns > finished.stat().st_mtime_ns:
            raise
        checkpoint.unlink()
        result = sampled()
    if result.verdict.word == "reliable":
        (folder / CHECKPOINT).unlink(missing_ok=True)
    return result.record


def check_recording(path: Path, runs: Runs = None, **reading: Any) -> list[tuple[dict[str, Any], str]]:
    """Read and check one file.

    Parameters
    ----------
    path : Path
        The file.
    runs : int, "split", "one" or None
        As in `Options`.
    **reading
        ``columns``, ``units``, ``rate_Hz`` as for `shj_bayes.recording.reader.read`.

    Returns
    -------
    list of (dict, str)
        For each run in the file facts for machines (``usable`` says whether it may be fitted) and text for people. A
        file that cannot be read at all gives its reason in both.
    """
    try:
        recordings = settle([read(path, **reading)], runs)
    except RecordingError as error:
        name = plain_text(path.name)
        reason = str(error).removeprefix(f"{name}: ")
        return [({"name": name, "usable": False, "error": str(error)}, f"{name}: NOT USABLE\n  {reason}")]
    return [_checked(recording) for recording in recordings]


def _checked(recording: Recording) -> tuple[dict[str, Any], str]:
    """Facts and text of one run."""
    try:
        motion = motion_of(recording)
    except RecordingError:
        motion = None
    return to_dict(recording, motion), describe(recording, motion)


@alone_in("folder")
def diagnose_device(
    paths: Sequence[Path | Recording],
    folder: Path,
    options: Options,
    *,
    without: Sequence[str] = (),
    name: str | None = None,
    quick: bool = False,
    progress: bool = False,
    threads: int = 0,
    force: bool = False,
    tell: Callable[[str], None] = lambda _: None,
) -> DiagnosisResult:
    """Find what the base law leaves out of a device's recordings; write ``diagnosis.json`` and the page.

    Parameters
    ----------
    paths, folder, options, name, progress, threads, force
        As for `fit_device`.
    without : sequence of str
        ``velocity`` runs the base law without speed dependence; other ids are taken out of the catalogue.
    quick : bool
        A first look without sampling the posterior.
    tell : callable
        Gets one line for each step.

    Returns
    -------
    DiagnosisResult
    """
    recordings = _usable(paths, options)
    name = plain_name(name) if name else _default_name(paths[0])
    if not force:
        refuse_used_folder(folder, name, recordings, InferenceError)
    priors, runs = read_priors(options.priors), runs_of(recordings)
    digests = _digests(paths, recordings)

    def sample(model: DeviceModel, top: FloatArray) -> tuple[dict[str, FloatArray], dict[str, Any]]:
        """Fit what was found: the same files as those of `shj-bayes fit` with these effects."""
        key = _key(digests, options, model, name)
        record, _ = _finished(folder, key)
        if record is None:
            record = _fit(runs, folder, options, model, name, key, progress, threads, [top])
        draws = {n: values.ravel() for n, values in read_group(folder, "posterior").items() if n in model.names}
        render_device(folder)
        return draws, {"how": f"emcee; {'; '.join(record['reasons'])}", "verdict": record["verdict"]}

    diagnosis = diagnose(
        runs,
        options.device_model(len(runs), priors),
        name=name,
        without=without,
        seed=options.seed,
        quick=quick,
        sample=None if quick else sample,
        tell=tell,
    )
    findings = [finding.code for recording in recordings for finding in recording.findings]
    diagnosis = replace(diagnosis, record=diagnosis.record | {"simulated": "simulated" in findings})
    diagnosis.write(folder)
    return DiagnosisResult(folder, diagnosis.record, render_diagnosis(folder))


def dep_words(row: dict[str, Any]) -> str:
    """Interval of dep = 1/gamma behind a row of the parameter table; nothing for other parameters."""
    if row["name"].partition("_")[0] != "gamma":
        return ""
    low, high = row["q05"], row["q95"]
    if low <= 0 <= high:
        return "  (dep has no bound: the force may not depend on speed)"
    first, second = sorted((1 / low, 1 / high))
    return f"  (dep {first:.4g} to {second:.4g} mm/s)"


def _usable(paths: Sequence[Path | Recording], options: Options) -> list[Recording]:
    """Read recordings that are not read yet; refuse those that must not be fitted."""
    given = [
        path
        if isinstance(path, Recording)
        else read(path, columns=options.columns, units=options.units, rate_Hz=options.rate_Hz)
        for path in paths
    ]
    recordings = remarked(settle(given, options.runs), options.free)
    for recording in recordings:
        blocking = [f.message for f in recording.findings if f.severity == "unusable"]
        if blocking:
            raise RecordingError(f"{recording.source.name} cannot be used: {'; '.join(blocking)}")
    return recordings


def _default_name(first: Path | Recording) -> str:
    """Name of the first file without its endings (a dot inside the name stays)."""
    name = first.source.name if isinstance(first, Recording) else first.name
    return plain_name(re.sub(r"(\.(csv|tsv|txt|xlsx|json|mat|h5|hdf5|tdms|gz))+$", "", name, flags=re.IGNORECASE))


def _digests(paths: Sequence[Path | Recording], recordings: Sequence[Recording]) -> list[str]:
    """Digest of each recording: of its file, or of what it holds where one was given that may have been changed."""
    changeable = any(isinstance(given, Recording) for given in paths)
    return [content_digest(recording) if changeable else recording.source.sha256 for recording in recordings]


def _key(digests: list[str], options: Options, model: DeviceModel, name: str) -> str:
    """Digest of all that the result depends on; the effects are those of the model, asked for or found."""
    # Of a prior file its name and digest count, not where it lies: the folder may be reached by another path.
    chosen = asdict(options) | {"priors": Path(options.priors).name, "effects": [e.id for e in model.effects]}
    content = [digests, chosen, model.priors.sha256, name, model.speed, shj_bayes.__version__, sorted(BASE)]
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def _finished(folder: Path, key: str) -> tuple[dict[str, Any] | None, str]:
    """Record of an unchanged finished fit, or None; and, where files of a fit were damaged, which and how."""
    if not (folder / "fit.json").exists():
        return None, ""
    try:
        record = read_record(folder)
        check_files(folder, record)
    except InferenceError as error:
        return None, f"done anew: {error}"
    return (record, "") if record.get("key") == key else (None, "")


def _stale(folder: Path) -> bool:
    """Whether the page is missing or older than the fit, as after a process was killed between the two."""
    page = folder / "report.html"
    return not page.exists() or page.stat().st_mtime_ns < (folder / "fit.json").stat().st_mtime_ns
