"""One device from files to page: read, check, fit, write, draw."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from shj_bayes._util.files import plain_name
from shj_bayes._util.lock import alone_in
from shj_bayes.commands.earlier import earlier
from shj_bayes.commands.finished import DeviceResult, default_name, device_result, finished_record, key_of, stale
from shj_bayes.commands.mistaken import content_digest, refuse_used_folder, remarked
from shj_bayes.errors import InferenceError, ModelError, RecordingError, StrangeCheckpointError, plain_text, shown
from shj_bayes.inference.fit import CHECKPOINT, fit
from shj_bayes.inference.record import read_group
from shj_bayes.inference.run import Run, runs_of
from shj_bayes.inference.sampler import Plan
from shj_bayes.model.device import DeviceModel, effects_named, meaning_of
from shj_bayes.model.law import variant_named
from shj_bayes.model.noise.catalogue import DEFAULT, noise_model
from shj_bayes.model.parameters import FloatArray
from shj_bayes.model.priors import Priors, read_priors
from shj_bayes.recording.columns import check_rate, parse_columns
from shj_bayes.recording.reader import read
from shj_bayes.recording.recording import Recording
from shj_bayes.recording.runs import Runs, check_runs, settle
from shj_bayes.recording.units import parse_units
from shj_bayes.report.device import render_device

SEEDS, STEPS = (0, 2**32 - 1), (1, 1_000_000)


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
    priors_from : str or None
        Folder of an earlier fit, or of a campaign with ``#SET`` behind it, whose posterior stands in for the priors
        of the law.
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
    priors_from: str | None = None

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
        assert self.device_model(n_runs, self.read_priors()).laws_of_parameters

    def read_priors(self) -> Priors:
        """Priors of the family, with what earlier tests say where they are named."""
        family = read_priors(self.priors)
        return family if self.priors_from is None else earlier(self.priors_from).on(family)


@dataclass(frozen=True, eq=False)
class DiagnosisResult:
    """A finished diagnosis."""

    folder: Path  # where its files are
    record: dict[str, Any]  # content of ``diagnosis.json``
    page: Path

    @property
    def text(self) -> str:
        """What a person wants to read at the end of a diagnosis."""
        from shj_bayes.report.diagnosis_words import (  # noqa: PLC0415  (for a diagnosis only)
            chance_words,
            sentences,
            verdict_words,
        )

        record = self.record
        chance = chance_words(record)
        why = f"chance of such a misfit if nothing were missing: {chance}" if chance else str(record.get("reason", ""))
        lines = [f"{record['device']}: {record['verdict']} ({why})"]
        lines += [f"  {sentence}" for sentence in (verdict_words(record)[2], *sentences(record))]
        # Where nothing was added to the law there is one law and one set of numbers.
        stages = ("before", "after") if record["modelled"] else ("after",)
        rough = ", a first look: approximate, and not the numbers of a fit" if record.get("quick") else ""
        lines += ["", f"  {' -> '.join(stages) if len(stages) > 1 else 'base law'}{rough}"]
        for name, row in record["shift"].items():
            shown = " -> ".join(f"{row[stage]['mean']:11.5g} +- {row[stage]['sd']:<9.2g}" for stage in stages)
            lines.append(f"  {name:8}{shown} {meaning_of(name).unit}")
        errors = " -> ".join(f"{record[stage]['heldout_rmse_kN']:.3g}" for stage in stages)
        lines.append(f"  error on held-out cycles {errors} kN")
        return "\n".join([*lines, "", f"report: {self.page}"])


def step_told(line: str) -> None:
    """Say on standard error, where it is a terminal, what is being done: a long recording takes seconds to read."""
    if sys.stderr.isatty():
        print(f"  {line}", file=sys.stderr)


def ignored(line: str) -> None:
    """Say nothing."""


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
    page: bool = True,
) -> DeviceResult:
    """Fit one device from its recordings and write its files and its page.

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
    page : bool
        Draw the page.

    Raises
    ------
    RecordingError
        If a recording cannot be used.
    InferenceError
        If `folder` holds the result of another device.
    """
    options.check(len(paths))
    recordings = _usable(paths, options, step_told if progress else ignored)
    name = plain_name(name) if name else default_name(source_of(paths[0]))
    if not force:
        refuse_used_folder(folder, name, recordings, InferenceError)
    model = options.device_model(len(recordings), options.read_priors())
    key = _key(paths, recordings, options, model, name)
    finished, note = finished_record(folder, key)
    fresh = finished is None
    if finished is None:
        plan = Plan(options.seed, max_steps=options.max_steps, threads=threads, progress=progress)
        finished = _fit(runs_of(recordings), folder, model, plan, name=name, key=key)
    if page and (fresh or stale(folder)):
        (step_told if progress else ignored)("drawing the page")
        render_device(folder)
    return device_result(folder, finished, fresh=fresh, note=note)


def _fit(runs: Sequence[Run], folder: Path, model: DeviceModel, plan: Plan, *, name: str, key: str) -> dict[str, Any]:
    """Fit and write the files; give the record."""
    sampled = partial(fit, runs, model, name=name, key=key, plan=plan, folder=folder)
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
        checkpoint.unlink(missing_ok=True)
    return result.record


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
    tell: Callable[[str], None] = ignored,
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
    """
    # Naming what is missing needs half of scipy, which a fit need not wait for.
    from shj_bayes.mismatch.diagnosis import diagnose  # noqa: PLC0415
    from shj_bayes.report.diagnosis import render_diagnosis  # noqa: PLC0415

    recordings = _usable(paths, options, tell)
    name = plain_name(name) if name else default_name(source_of(paths[0]))
    if not force:
        refuse_used_folder(folder, name, recordings, InferenceError)
    priors, runs = options.read_priors(), runs_of(recordings)

    def sample(model: DeviceModel, top: FloatArray) -> tuple[dict[str, FloatArray], dict[str, Any]]:
        """Fit what was found: the same files as those of `shj-bayes fit` with these effects."""
        key = _key(paths, recordings, options, model, name)
        record, _ = finished_record(folder, key)
        if record is None:
            steps = options.max_steps
            plan = Plan(options.seed, max_steps=steps, tops=(top,), threads=threads, progress=progress)
            record = _fit(runs, folder, model, plan, name=name, key=key)
        draws = {n: values.ravel() for n, values in read_group(folder, "posterior").items() if n in model.names}
        return draws, {"how": f"emcee; {'; '.join(record['reasons'])}", "verdict": record["verdict"]}

    given = options.device_model(len(runs), priors)
    diagnosis = diagnose(
        runs,
        given,
        name=name,
        without=without,
        seed=options.seed,
        quick=quick,
        sample=None if quick else sample,
        tell=tell,
    )
    findings = [finding.code for recording in recordings for finding in recording.findings]
    key = _key(paths, recordings, options, given, name)  # of the fit that it looks beyond
    diagnosis = replace(diagnosis, record=diagnosis.record | {"simulated": "simulated" in findings, "key": key})
    diagnosis.write(folder)
    tell("drawing the pages")
    if (folder / "fit.json").exists():  # its page repeats the verdict
        render_device(folder)
    return DiagnosisResult(folder, diagnosis.record, render_diagnosis(folder))


def _usable(paths: Sequence[Path | Recording], options: Options, tell: Callable[[str], None]) -> list[Recording]:
    """Read recordings that are not read yet; refuse those that must not be fitted."""
    given = []
    for each in paths:
        if isinstance(each, Recording):
            given.append(each)
        else:
            tell(f"reading {plain_text(each.name)}")
            given.append(read(each, columns=options.columns, units=options.units, rate_Hz=options.rate_Hz))
    recordings = remarked(settle(given, options.runs), options.free)
    if options.priors_from is not None:
        recordings = earlier(options.priors_from).remarked(recordings)
    for recording in recordings:
        blocking = [f.message for f in recording.findings if f.severity == "unusable"]
        if blocking:
            raise RecordingError(f"{recording.source.name} cannot be used: {'; '.join(blocking)}")
    return recordings


def _key(
    paths: Sequence[Path | Recording], recordings: Sequence[Recording], options: Options, model: DeviceModel, name: str
) -> str:
    """Digest of all that the result depends on; the effects are those of the model, asked for or found."""
    changeable = any(isinstance(given, Recording) for given in paths)
    digests = [content_digest(recording) if changeable else recording.source.sha256 for recording in recordings]
    chosen = asdict(options) | {"effects": [effect.id for effect in model.effects]}
    return key_of(digests, chosen, model.priors.sha256, name, speed=model.speed)


def source_of(given: Path | Recording) -> str:
    """Name of the file of a recording."""
    return given.source.name if isinstance(given, Recording) else given.name
