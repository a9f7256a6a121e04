"""One device from files to page: read, check for slips, fit, diagnose, write, draw. Simulated, it shows what works."""

import hashlib
import json
import os
import platform
import sys
import time
import timeit
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes._util.arrays import FloatArray
from shj_bayes._util.files import alone_in, file_digest, write_text
from shj_bayes.app.resume import (
    CommandResult,
    check_priors,
    device_text,
    earlier,
    finished_record,
    key_of,
    name_of_device,
    priors_of,
)
from shj_bayes.errors import InferenceError, ModelError, RecordingError, StrangeCheckpointError, plain_lines, plain_text
from shj_bayes.inference.binning import Run, runs_of
from shj_bayes.inference.fit import fit
from shj_bayes.inference.likelihood import make_likelihood
from shj_bayes.inference.sampler import LIBRARY, SamplingPlan
from shj_bayes.inference.start import find_start
from shj_bayes.inference.store import versions
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.parameters import base_parameters
from shj_bayes.model.priors import read_priors, shipped_families
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.options import DiagnoseOptions, FitOptions
from shj_bayes.recording.motion import table_1
from shj_bayes.recording.reader import read
from shj_bayes.recording.recording import Finding, Recording, write_csv
from shj_bayes.recording.runs import settle
from shj_bayes.report.browse import find_browser
from shj_bayes.report.device import render_device
from shj_bayes.results.device import read_group
from shj_bayes.results.diagnosis import DiagnosisRecord, Sampled
from shj_bayes.results.fit import FitRecord, Trust
from shj_bayes.results.store import CHECKPOINT, find, has


def diagnosis_text(record: DiagnosisRecord, page: Path) -> str:
    """Say what a diagnosis found."""
    from shj_bayes.report import diagnosis_words as say  # noqa: PLC0415  (for a diagnosis only)

    chance = say.chance_words(record)
    why = f"chance of such a misfit if nothing were missing: {chance}" if chance else record.reason
    lines = [f"{record.device}: {record.verdict} ({why})"]
    lines += [f"  {sentence}" for sentence in (say.verdict_words(record)[2], *say.sentences(record))]
    return "\n".join([*lines, "", *say.shift_lines(record), "", f"report: {page}"])


def step_told(line: str) -> None:
    """Say on standard error, where it is a terminal, what is being done: a long recording takes seconds to read."""
    if sys.stderr.isatty():
        print(plain_lines(f"  {line}"), file=sys.stderr)


@dataclass(frozen=True)
class Work:
    """How a device is worked on; nothing of it changes a number."""

    progress: bool = False  # show a progress bar
    threads: int = 0  # ensembles that run at the same time, 0 for one per processor
    force: bool = False  # replace the result of another device in the folder
    tell: Callable[[str], None] = lambda _: None  # gets one line for each step
    watch: Callable[[float, str], None] = lambda _share, _words: None  # gets how far sampling is
    # recordings of a device by their files, where one is fitted and diagnosed with the same options: read once
    held: dict[tuple[Path | Recording, ...], list[Recording]] | None = None

    def begin(
        self, paths: Sequence[Path | Recording], folder: Path, options: FitOptions, name: str | None
    ) -> tuple[list[Recording], str]:
        """Read a device that may be written into a folder: its recordings and its name."""
        recordings = (self.held or {}).get(tuple(paths)) or read_device(paths, options, self.tell)
        for recording in recordings:
            if blocking := [f.message for f in recording.findings if f.severity == "unusable"]:
                raise RecordingError(f"{recording.source.name} cannot be used: {'; '.join(blocking)}")
        if self.held is not None:
            self.held[tuple(paths)] = recordings
        first = paths[0].source if isinstance(paths[0], Recording) else paths[0]
        name = name_of_device(name, first.name)
        if not self.force:
            refuse_used_folder(folder, name, recordings)
        return recordings, name

    def plan(self, options: FitOptions, tops: tuple[FloatArray, ...] = ()) -> SamplingPlan:
        """How to sample; from `tops`, where the highest densities are known."""
        return SamplingPlan(
            options.seed,
            max_steps=options.max_steps,
            tops=tops,
            threads=self.threads,
            progress=self.progress,
            watch=self.watch,
        )


@alone_in("folder", kept=FitRecord.FILE)
def fit_device(
    paths: Sequence[Path | Recording],
    folder: Path,
    options: FitOptions,
    *,
    name: str | None = None,
    page: bool = True,
    work: Work | None = None,
) -> CommandResult:
    """Fit one device from its recordings and write its files and, with `page`, its page.

    Arguments and errors are those of `shj_bayes.api.fit`. An unchanged finished result in `folder` is kept; an
    unfinished one is gone on with.
    """
    check_priors(options, len(paths))
    work = work or Work()
    recordings, name = work.begin(paths, folder, options, name)
    model = options.device_model(len(recordings), priors_of(options))
    key = _key(paths, recordings, options, model, name)
    finished, note = finished_record(folder, key)
    fresh = finished is None
    if finished is None:
        finished = _fit(runs_of(recordings), folder, model, work.plan(options), name=name, key=key)
    if page and (fresh or not (folder / "report.html").exists()):
        work.tell("drawing the page")
        render_device(folder)
    return CommandResult(finished, device_text(folder, finished, note), fresh=fresh, note=note)


def _fit(
    runs: Sequence[Run], folder: Path, model: DeviceModel, plan: SamplingPlan, *, name: str, key: str
) -> FitRecord:
    """Fit and write the files; give the record."""
    sampled = partial(fit, runs, model, name=name, key=key, plan=plan, folder=folder)
    checkpoint = folder / CHECKPOINT
    try:
        result = sampled()
    except StrangeCheckpointError:
        # One that a finished fit left goes with its result; one of a fit that was interrupted stays.
        finished = find(FitRecord, folder)
        if finished is None or finished.files.get(CHECKPOINT) != file_digest(checkpoint):
            raise
        checkpoint.unlink()
        result = sampled()
    if result.verdict.word == Trust.RELIABLE:
        checkpoint.unlink(missing_ok=True)
    return result.record


@alone_in("folder")
def diagnose_device(
    paths: Sequence[Path | Recording],
    folder: Path,
    options: FitOptions,
    wanted: DiagnoseOptions,
    *,
    name: str | None,
    work: Work,
) -> CommandResult:
    """Find what the base law leaves out of a device's recordings; write ``diagnosis.json`` and the page."""
    # Naming what is missing needs half of scipy, which a fit need not wait for.
    from shj_bayes.mismatch.diagnosis import diagnose  # noqa: PLC0415
    from shj_bayes.report.diagnosis_page import render_diagnosis  # noqa: PLC0415

    recordings, name = work.begin(paths, folder, options, name)
    priors, runs = priors_of(options), runs_of(recordings)

    def sample(model: DeviceModel, top: FloatArray) -> tuple[dict[str, FloatArray], Sampled]:
        """Fit what was found: the same files as those of `shj-bayes fit` with these effects."""
        key = _key(paths, recordings, options, model, name)
        record, _ = finished_record(folder, key)
        if record is None:
            record = _fit(runs, folder, model, work.plan(options, (top,)), name=name, key=key)
        draws = {n: values.ravel() for n, values in read_group(folder, "posterior").items() if n in model.names}
        return draws, Sampled(how=f"{LIBRARY}; {'; '.join(record.reasons)}", verdict=record.verdict)

    given = options.device_model(len(runs), priors)
    diagnosis = diagnose(runs, given, replace(wanted, name=name), seed=options.seed, sample=sample, tell=work.tell)
    findings = [finding.code for recording in recordings for finding in recording.findings]
    key = _key(paths, recordings, options, given, name)  # of the fit that it looks beyond
    diagnosis = replace(diagnosis, record=replace(diagnosis.record, simulated="simulated" in findings, key=key))
    diagnosis.write(folder)
    work.tell("drawing the pages")
    if has(FitRecord, folder):  # its page repeats the verdict
        render_device(folder)
    return CommandResult(diagnosis.record, diagnosis_text(diagnosis.record, render_diagnosis(folder)))


def read_device(
    paths: Sequence[Path | Recording], options: FitOptions, tell: Callable[[str], None] = lambda _: None
) -> list[Recording]:
    """Read the consecutive runs of a device that are not read yet, with what is to be remarked of them together."""
    given = []
    for each in paths:
        if isinstance(each, Recording):
            given.append(each)
        else:
            tell(f"reading {plain_text(each.name)}")
            columns, units = options.columns, options.units
            given.append(read(each, columns=columns, units=units, rate_Hz=options.rate_Hz, sheet=options.sheet))
    recordings = remarked(settle(given, options.runs), options.free)
    return recordings if options.priors_from is None else earlier(options.priors_from).remarked(recordings)


def _key(
    paths: Sequence[Path | Recording],
    recordings: Sequence[Recording],
    options: FitOptions,
    model: DeviceModel,
    name: str,
) -> str:
    """Digest of all that the result depends on; the effects are those of the model, asked for or found."""
    digests = [recording.source.sha256 for recording in recordings]
    if any(isinstance(given, Recording) for given in paths):  # what it holds counts, whatever its file is called
        digests = [
            _digest(r.time_s, r.displacement_mm, r.force_kN, r.used, *(extra.values for extra in r.extras))
            for r in recordings
        ]
    chosen = asdict(options) | {"effects": [effect.id for effect in model.effects]}
    return key_of(digests, chosen, model.priors.sha256, name, speed=model.speed)


def _digest(*arrays: object) -> str:
    return hashlib.sha256(b"".join(np.asarray(values).tobytes() for values in arrays)).hexdigest()


def remarked(recordings: Sequence[Recording], free: Sequence[str] = ()) -> list[Recording]:
    """Warn where one of a device's recordings comes again, and where an option can have no effect."""
    if len(recordings) == 1 and free:
        message = f"{', '.join(free)} cannot differ between runs where there is one run: --free has no effect"
        return [recordings[0].with_findings(Finding("free-without-effect", "warning", message))]
    first: dict[str, int] = {}
    out = list(recordings)
    for number, recording in enumerate(recordings, start=1):
        # By the samples, whatever clock they were copied onto.
        before = first.setdefault(_digest(recording.displacement_mm, recording.force_kN), number)
        if before != number:
            message = (
                f"run {number} ({recording.source.name}) holds the same samples as run {before} "
                f"({recordings[before - 1].source.name}): the device would look as if a run changed nothing; name each "
                "recording once"
            )
            out[number - 1] = recording.with_findings(Finding("same-recording", "warning", message))
    return out


def refuse_used_folder(folder: Path, name: str, recordings: Sequence[Recording]) -> None:
    """Refuse a folder that holds the result of another device: neither its name nor any recording is the same."""
    mine = {recording.source.sha256 for recording in recordings}
    # A damaged file is told of, and replaced, by whoever reads it.
    for record in (find(FitRecord, folder), find(DiagnosisRecord, folder)):
        if record and record.device != name and not mine & {str(sha256) for sha256 in record.sha256_of_inputs}:
            word = record.FILE.removesuffix(".json")
            raise InferenceError(
                f"{folder.name} holds the {word} of another device, '{record.device}'; give '{name}' a folder of its "
                "own with -o, or replace what is there with --force"
            )


def gamma_of(dep_mm_s: float | None) -> float:
    """Speed coefficient, s/mm, of a dep, mm/s; None is no speed dependence."""
    if dep_mm_s == 0:
        raise ModelError("dep = 0 mm/s: allowed is any other number; leave --dep out for no speed dependence")
    return 0.0 if dep_mm_s is None else 1 / dep_mm_s


def write_simulated(
    stem: Path, truth: Truth, *, seed: int, rate_Hz: float, last_cycles: int = 5, model: str = "published"
) -> list[Path]:
    """Simulate two runs of Table 1 and write ``STEM-run1.csv``, ``STEM-run2.csv`` and the truth, ``STEM.json``."""
    blocks = table_1(last_cycles)
    recordings = simulate_device(truth, seed=seed, rate_Hz=rate_Hz, blocks=blocks, variant=model)
    stem.parent.mkdir(parents=True, exist_ok=True)
    words = f"SIMULATED by shj-bayes, seed {seed}; not a measurement. Truth: {stem.name}.json"
    paths = [
        write_csv(stem.with_name(f"{stem.name}-run{run}.csv"), recording, comment=words)
        for run, recording in enumerate(recordings, start=1)
    ]
    known = base_parameters()
    content = {
        "schema": "shj-bayes/truth/1",
        "simulated": True,
        "seed": seed,
        "model": model,
        "rate_Hz": rate_Hz,
        "blocks": [asdict(block) for block in blocks],
        "truth": asdict(truth),
        "units": {name: known[name].unit for name in asdict(truth) if name in known},
    }
    path = stem.with_name(f"{stem.name}.json")
    write_text(path, json.dumps(content, indent=1))
    return [*paths, path]


TRUTH = Truth(gamma=1 / 60)


def examine() -> tuple[dict[str, Any], str]:
    """Fit a small simulated device and time the law: what is installed, whether it works, how fast this machine is."""
    begin = time.perf_counter()
    runs = runs_of(simulate_device(TRUTH, seed=1, rate_Hz=20.0))
    posterior, start = find_start(make_likelihood(runs, DeviceModel(len(runs), read_priors())))
    first = time.perf_counter() - begin
    theta = posterior.model.laws.natural(start.free[None])[0]
    found = dict(zip(posterior.model.names, theta, strict=True))
    error = {name: abs(found[name] / getattr(TRUTH, name) - 1) for name in ("K", "Fy", "gamma")}
    works = bool(max(error.values()) < 0.05)
    batch = np.repeat(theta[None], 16, axis=0)
    seconds = min(timeit.repeat(lambda: posterior.log_likelihood(batch), number=1, repeat=20))
    browser = find_browser()
    families = [f"{family} ({len(read_priors(family).priors)} laws)" for family in shipped_families()]
    record: dict[str, Any] = {
        "schema": "shj-bayes/doctor/1",
        "works": works,
        "versions": versions(),
        "machine": {"system": platform.system(), "processor": platform.machine(), "processors": os.cpu_count()},
        "checks": {
            "fit of a simulated device": f"K, Fy and gamma within {100 * max(error.values()):.2g} % of the truth",
            "priors": ", ".join(families),
            "pages to PDF": f"by {Path(browser).name}"
            if browser
            else "no Chromium, Chrome or Edge found; print by hand",
        },
        "first_fit_s": first,
        "likelihood_ns_per_block": 1e9 * seconds / (16 * posterior.blocks.used.size),
    }
    lines = [f"{name:12}{said}" for part in ("versions", "machine") for name, said in record[part].items()]
    lines += [f"{name}: {words}" for name, words in record["checks"].items()]
    lines += [
        f"first search for a fit: {first:.1f} s (compiles once after installation)",
        f"likelihood: {record['likelihood_ns_per_block']:.1f} ns per average of samples on one processor",
        "everything works" if works else "NOT WORKING: the fit of a simulated device misses the truth by more than 5 %",
    ]
    return record, "\n".join(lines)
