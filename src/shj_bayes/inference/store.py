"""Files of a fit, and the remarks that stand in them."""

from __future__ import annotations

import csv
import io
import json
import math
import platform
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import shj_bayes
from shj_bayes._util.arrays import FloatArray, IntArray
from shj_bayes._util.files import file_digest, replacing, reserve, write_text
from shj_bayes.inference.binning import Run, measured_of
from shj_bayes.inference.likelihood import Likelihood
from shj_bayes.inference.predictive import force_at_points, half_cycles, points_of, zero_of_run
from shj_bayes.model.device import DeviceModel, meaning_of
from shj_bayes.results.codec import from_json, to_json
from shj_bayes.results.device import EXTRA
from shj_bayes.results.fit import (
    SCHEMA,
    ChannelScale,
    CyclesRecord,
    FitRecord,
    ModelRecord,
    ParameterRow,
    PriorRecord,
    Reduction,
    Remark,
    RemarkRecord,
    RunInput,
    SamplingRecord,
    SummaryRecord,
    Trust,
    ZeroError,
)
from shj_bayes.results.store import CHECKPOINT, FILES, Group, write, write_netcdf

if TYPE_CHECKING:
    from shj_bayes.inference.convergence import Diagnostics, FitVerdict, Widening


UNDETERMINED = 0.6  # of the prior's width: the data took less than half of the uncertainty away
AGAINST = 2.6  # standard deviations of the prior: 1 in 100 beyond it


def remarks_of(model: DeviceModel, chains: FloatArray) -> tuple[RemarkRecord, ...]:
    """Parameters that the recordings do not determine, and those whose value the prior holds nearly impossible.

    From draws of shape (..., d) in natural units; of the law alone, since nobody designs with the noise.
    """
    flat = chains.reshape(-1, chains.shape[-1])
    out = []
    for i, (name, law) in enumerate(zip(model.law_names, model.laws, strict=False)):
        if not model.predicted[i]:
            continue
        place = law.to_free(flat[:, i])  # standard normal, were there no data
        place = place[np.isfinite(place)]
        kind = None
        # A recording that adds nothing to what an earlier one said leaves the parameter as well known.
        if place.size and np.std(place) > UNDETERMINED and not law.earlier:
            kind = Remark.UNDETERMINED
        elif place.size and abs(np.median(place)) > AGAINST:
            kind = Remark.AGAINST_EARLIER if law.earlier else Remark.AGAINST_PRIOR
        if kind:
            low, high = law.quantile(np.array([0.05, 0.95])).tolist()
            middle = float(np.median(flat[:, i]))
            out.append(RemarkRecord(parameter=name, kind=kind, q50=middle, prior_q05=low, prior_q95=high))
    return tuple(out)


Grouped = Callable[..., Group]  # `_group` with the words of a fit
N_STORED, N_LOOPS = 500, 25  # draws of each ensemble, and those of them with the force of every sample
N_PRIOR, N_FORESEEN = 4000, 100  # draws of the prior, and those of them with forces of half-cycles
N_POINTS = 12_000  # of each run in the file, about
PACKAGES = ("arviz", "emcee", "h5py", "numba", "numpy", "pandas", "scipy", "xarray")
MEANINGS = {  # unit and meaning of what is not a parameter, by name
    "chain": ("1", "ensemble"),
    "draw": ("1", "draw of the ensemble, through steps and walkers; the same number is the same draw in every group"),
    "half_cycle": ("1", "half-cycle, through all runs; those without a sample that is evidence are left out"),
    "number": ("1", "half-cycle within its run, 0 for the first"),
    "point": ("1", "sample, through all runs"),
    "run": ("1", "run, 1 for the first"),
    "time_s": ("s", "time in the recording"),
    "displacement_mm": ("mm", "displacement that drives the law (smoothed)"),
    "speed_mm_s": ("mm/s", "absolute value of the velocity (smoothed)"),
    "half_cycle_of_sample": ("1", "half-cycle within its run, 0 for the first"),
    "used": ("1", "1 where the sample is evidence"),
    "force": ("kN", "force as it was measured, or would be: with noise"),
    "force_model": ("kN", "force without noise"),
    "force_of_half_cycle": ("kN", "mean force of the half-cycle's evidence in the direction of motion"),
    "lp": ("1", "log posterior density of the unbounded parameters, up to a constant"),
}
AS_SAMPLED = "of the draws as sampled; those in posterior are wider where the record's cycles, widening is above 1"


def groups_of(
    likelihood: Likelihood, shown: FloatArray, sampled: FloatArray, heights: FloatArray, seed: int, library: str
) -> dict[str, Group]:
    """Everything a reader of the fit needs, in the groups of ArviZ.

    `shown` are the kept draws in the unbounded space, shape (n_ensembles, n, d), no narrower than the cycles
    scatter; `sampled` the same as they were sampled, `heights` the log posterior of these; `library` is the package
    that sampled them.

    ``chain`` is the ensemble; ``draw`` goes through steps and walkers, thinned to nearly independent draws. Groups:
    posterior, prior, posterior_predictive, prior_predictive, log_likelihood, log_prior, sample_stats, observed_data,
    constant_data, loops. Forces of half-cycles are there for all draws, those of samples (group loops) for a few. The
    predictive draws have a stream of their own.
    """
    some = np.linspace(0, shown.shape[1] - 1, min(N_STORED, shown.shape[1])).astype(int)
    draws, own = (likelihood.model.laws.natural(chains[:, some]) for chains in (shown, sampled))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(99,)))
    laws = likelihood.model.laws
    prior = np.stack([law.from_free(rng.standard_normal(N_PRIOR)) for law in laws], axis=1)
    log_prior = np.stack([law.log_density(own[:, :, i]) for i, law in enumerate(laws)], axis=2)

    def named(values: FloatArray) -> dict[str, FloatArray]:
        return {name: values[..., i] for i, name in enumerate(likelihood.model.names)}

    group = partial(_group, _words(likelihood), library)
    groups = {
        "posterior": group("draws", named(draws)),
        "prior": group("draws of the priors", named(prior[None])),
        **_half_cycle_groups(group, likelihood, own, prior[:N_FORESEEN], rng),
        "log_prior": group(f"in natural units; {AS_SAMPLED}", named(log_prior)),
        "sample_stats": group(AS_SAMPLED, {"lp": heights[:, some]}),
        **_sample_groups(group, likelihood, draws, rng),
    }
    for name in ("log_likelihood", "log_prior"):
        for dimensions, _, words in groups[name].arrays.values():
            if len(dimensions) > 1:
                words.update(units="1", meaning=f"{name.replace('_', ' ')} of: {words['meaning']}")
    return groups


def _words(likelihood: Likelihood) -> dict[str, tuple[str, str]]:
    """Give unit and meaning of everything in the file, by name."""
    words = MEANINGS | {p.name: (p.unit, p.meaning) for p in map(meaning_of, likelihood.model.names)}
    for name, unit in extra_names(likelihood).items():
        words[f"{EXTRA}{name}"] = (unit or "1", "further channel, as named")
    further = measured_of(likelihood.runs)[0]
    return words | {name: (one.unit or "1", "further channel without its noise") for name, one in further.items()}


def _half_cycle_groups(
    group: Grouped, likelihood: Likelihood, draws: FloatArray, prior: FloatArray, rng: np.random.Generator
) -> dict[str, Group]:
    """Group by half-cycle what is likely and predicted for draws, and what was measured."""
    n_ensembles, _, d = draws.shape
    likely, predicted, measured = half_cycles(likelihood, draws.reshape(-1, d), rng)
    with np.errstate(over="ignore", invalid="ignore"):
        foreseen = half_cycles(likelihood, prior, rng, tested=False)[1]
    some = np.flatnonzero(np.isfinite(measured))
    possible = np.flatnonzero(np.isfinite(foreseen[:, some]).all(axis=1))
    n_half = [run.motion.n_half for run in likelihood.runs]
    at = {
        "half_cycle": some,
        "run": ("half_cycle", np.repeat(np.arange(len(n_half)) + 1, n_half)[some]),
        "number": ("half_cycle", np.concatenate([np.arange(n) for n in n_half])[some]),
    }

    def by_half(values: FloatArray, n_chains: int = n_ensembles) -> dict[str, NDArray[Any]]:
        return {"force_of_half_cycle": values[:, some].reshape(n_chains, -1, some.size)}

    likely = np.round(likely * 2.0**20) / 2.0**20  # a millionth; the file is smaller
    predicted, foreseen = predicted.astype(np.float32), foreseen[possible].astype(np.float32)
    return {
        "posterior_predictive": group(f"with noise; {AS_SAMPLED}", by_half(predicted), at),
        "prior_predictive": group("with noise", by_half(foreseen, 1), at | {"draw": possible}),
        "log_likelihood": group(f"given those before it; {AS_SAMPLED}", by_half(likely), at),
        "observed_data": group("measured", {"force_of_half_cycle": measured[some]}, at),
    }


def _sample_groups(
    group: Grouped, likelihood: Likelihood, draws: FloatArray, rng: np.random.Generator
) -> dict[str, Group]:
    """Group by sample the recordings, and the force that a few draws give."""
    points = tuple(points_of(run, N_POINTS) for run in likelihood.runs)
    begins = np.cumsum([0, *(run.recording.n_samples for run in likelihood.runs[:-1])])
    at = {"point": np.concatenate([keep + begin for keep, begin in zip(points, begins, strict=True)])}
    few = np.linspace(0, draws.shape[1] - 1, N_LOOPS).astype(int)
    clean, noisy = force_at_points(likelihood, draws[:, few].reshape(-1, draws.shape[2]), points, rng)
    forces = {"force": noisy, "force_model": clean}
    forces = {name: force.reshape(draws.shape[0], few.size, -1) for name, force in forces.items()}
    loops = group("posterior predictive at the points of constant_data", forces, at | {"draw": few})
    return {
        "constant_data": group("recordings, thinned where they are long", _channels(likelihood, points), at),
        "loops": _packed(loops),
    }


def summary(model: DeviceModel, figures: Diagnostics, chains: FloatArray) -> tuple[ParameterRow, ...]:
    """Table of the parameters from kept draws in natural units, shape (..., d)."""
    flat = chains.reshape(-1, chains.shape[-1])
    of_draws = (flat.mean(axis=0), flat.std(axis=0, ddof=1), *np.quantile(flat, [0.05, 0.5, 0.95], axis=0))
    numbers = np.stack([*of_draws, figures.ess_bulk, figures.ess_tail, figures.rhat], axis=1)
    rows = [[value if math.isfinite(value) else None for value in row] for row in numbers.tolist()]
    columns = ("mean", "sd", "q05", "q50", "q95", "ess_bulk", "ess_tail", "rhat")
    named: list[dict[str, Any]] = [dict(zip(columns, row, strict=True)) for row in rows]
    units = [meaning_of(name).unit for name in model.names]
    rows_of = zip(model.names, units, named, strict=True)
    return tuple(ParameterRow(name=name, unit=unit, **row) for name, unit, row in rows_of)


def fit_record(
    likelihood: Likelihood,
    figures: Diagnostics,
    widening: Widening,
    verdict: FitVerdict,
    table: Sequence[ParameterRow],
    pareto_k: float,
    **asked: Any,
) -> FitRecord:
    """Say what was fitted, how, and what came of it.

    `table` is the summary of the parameters, `pareto_k` of the weights of all samples; `asked` are the name of the
    device, the seed and the key of the fit, the verdict on the chains alone (``convergence``), and the ``remarks``.
    """
    pairs = zip(likelihood.blocks, likelihood.runs, strict=True)
    means = np.array([[row.mean for row in table]])
    runs = range(1, len(likelihood.runs) + 1)
    zeros = [[float(value[0]) for value in zero_of_run(likelihood, means, run)] for run in runs]
    model = likelihood.model
    return FitRecord(
        **asked,
        verdict=verdict.word,
        reasons=verdict.reasons,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        versions=versions(),
        model=ModelRecord(
            variant=model.variant,
            effects=tuple(effect.id for effect in model.effects),
            speed=model.speed,
            noise=model.noise.id,
            free_between_runs=model.free,
            priors=model.priors.family,
            priors_statement=model.priors.statement,
            priors_sha256=model.priors.sha256,
        ),
        channels={
            coordinate: ChannelScale(unit=one.unit, low=one.low, high=one.high, reference=one.reference)
            for coordinate, one in measured_of(likelihood.runs)[0].items()
        },
        prior_laws=tuple(
            PriorRecord(name=n, unit=p.unit, law=p.law, a=p.a, b=p.b, source=p.source)
            for n, p in zip(likelihood.model.names, model.laws, strict=True)
        ),
        inputs=tuple(_input(run, *zero) for run, zero in zip(likelihood.runs, zeros, strict=True)),
        sampling=SamplingRecord(
            n_ensembles=int(figures.acceptance.shape[0]),
            n_walkers=int(figures.acceptance.shape[1]),
            n_steps_kept=figures.n_steps,
            n_steps_dropped=figures.n_burn,
            tau_steps=dict(zip(figures.names, figures.tau.tolist(), strict=True)),
            acceptance=tuple(figures.acceptance.mean(axis=1).tolist()),
            n_failed_evaluations=figures.n_failed,
            pareto_k=pareto_k if math.isfinite(pareto_k) else None,
        ),
        cycles=CyclesRecord(
            n_pieces=widening.n_pieces,
            scatter_over_posterior=dict(zip(widening.names, widening.scatter.tolist(), strict=True)),
            widening=dict(zip(widening.names, widening.factor.tolist(), strict=True)),
        ),
        noise_at_rest=math.exp(likelihood.at_rest),
        reduction=tuple(Reduction(n_blocks=part.n, n_samples=run.recording.n_samples) for part, run in pairs),
        parameters=tuple(table),
    )


def _input(run: Run, zero_kN: float, zero_sd_kN: float) -> RunInput:
    """Say what a recording is, with the error of the load cell's zero, kN."""
    recording = run.recording
    return RunInput(
        **vars(recording.source),
        extras={extra.name: extra.unit or "" for extra in recording.extras},
        n_samples=recording.n_samples,
        rate_Hz=recording.rate_Hz,
        duration_s=recording.duration_s,
        n_half_cycles=run.motion.n_half,
        start_force_kN=run.start_force_kN,
        motion_method=run.motion.method,
        displacement_noise_mm=run.motion.noise_mm,
        zero_error_kN=ZeroError(mean=zero_kN, sd=zero_sd_kN),
        findings=tuple(recording.findings),
    )


def write_fit(folder: Path, groups: Mapping[str, Group], record: FitRecord) -> FitRecord:
    """Write ``posterior.nc``, ``summary.csv``, ``summary.json`` and, last, ``fit.json`` (each whole or not at all).

    The record gains ``files``, the SHA-256 of the other three and of the checkpoint of one to be gone on with,
    and ``digest``, that of the record itself.
    """
    known = {key: value for key, value in to_json(record).items() if key not in ("files", "digest")}
    words = {"schema": SCHEMA, "device": record.device, "provenance": json.dumps(known)}
    n_bytes = sum(values.nbytes for group in groups.values() for _, values, _ in group.arrays.values())
    with replacing(folder / "posterior.nc") as part:
        reserve(part, n_bytes + 2**20)  # a MiB of names and attributes
        write_netcdf(part, groups, words)
    table = io.StringIO()
    rows = [{**vars(row), "schema": SCHEMA} for row in record.parameters]
    written = csv.DictWriter(table, rows[0], lineterminator="\n")
    written.writeheader()
    written.writerows(rows)
    write_text(folder / "summary.csv", table.getvalue())
    write(SummaryRecord(parameters=record.parameters), folder)
    left = (CHECKPOINT,) if record.verdict != Trust.RELIABLE and (folder / CHECKPOINT).is_file() else ()
    record = replace(record, files={name: file_digest(folder / name) for name in (*FILES, *left)})
    (folder / "report.html").unlink(missing_ok=True)  # of the fit before; no clock tells which came first
    return from_json(FitRecord, write(record, folder, allow_nan=True))


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on."""
    out = {"shj-bayes": shj_bayes.__version__, "python": platform.python_version()}
    for package in PACKAGES:
        try:
            out[package] = version(package)
        except PackageNotFoundError:
            out[package] = "not installed"
    return out


def extra_names(likelihood: Likelihood) -> dict[str, str]:
    """Further channels of all runs: name and unit, each once."""
    return {extra.name: extra.unit or "" for run in likelihood.runs for extra in run.recording.extras}


def _channels(likelihood: Likelihood, points: Sequence[IntArray]) -> dict[str, NDArray[Any]]:
    """Channels that the law and the pages need, at points of the runs, one run after the other."""
    of_runs = [
        {
            "time_s": run.recording.time_s,
            "displacement_mm": run.motion.displacement_mm,
            "speed_mm_s": run.motion.speed_mm_s,
            "force": run.recording.force_kN,
            "run": np.full(run.recording.n_samples, number),
            "half_cycle_of_sample": run.motion.half_cycle,
            "used": run.used.astype(np.int8),
        }
        for number, run in enumerate(likelihood.runs, start=1)
    ]
    for channels, run, measured in zip(of_runs, likelihood.runs, measured_of(likelihood.runs), strict=True):
        own = {extra.name: extra.values for extra in run.recording.extras}
        nowhere = np.full(run.recording.n_samples, np.nan)
        channels |= {f"{EXTRA}{name}": own.get(name, nowhere) for name in extra_names(likelihood)}
        since = channels["time_s"] - channels["time_s"][0]
        channels |= {name: one.at(since) for name, one in measured.items()}
    pairs = list(zip(of_runs, points, strict=True))
    return {name: np.concatenate([channels[name][keep] for channels, keep in pairs]) for name in of_runs[0]}


def _group(
    words: Mapping[str, tuple[str, str]],
    library: str,
    meaning: str,
    variables: Mapping[str, NDArray[Any]],
    coords: Mapping[str, Any] | None = None,
) -> Group:
    """One group of the file: arrays by chain and draw, if by more than one number, and by the first of `coords`."""
    given = {name: one if isinstance(one, tuple) else (name, one) for name, one in (coords or {}).items()}
    last = tuple(given)[:1]
    parts = {name: (("chain", "draw", *last) if v.ndim > 1 else last, v) for name, v in variables.items()}
    sizes = {d: n for dimensions, v in parts.values() for d, n in zip(dimensions, v.shape, strict=True)}
    parts |= {name: ((d,), v) for name, (d, v) in given.items()}
    parts |= {d: ((d,), np.arange(n)) for d, n in sizes.items() if d not in given}
    about = {
        "meaning": meaning,
        "creation_library": "shj-bayes",
        "creation_library_version": shj_bayes.__version__,
        "inference_library": library,
        "inference_library_version": version(library),
    }
    if beside := " ".join(name for name, (d, _) in given.items() if name != d):
        about["coordinates"] = beside
    pairs = {name: dict(zip(("units", "meaning"), words[name], strict=True)) for name in parts}
    return Group({name: (d, v, pairs[name]) for name, (d, v) in parts.items()}, about)


def _packed(group: Group) -> Group:
    """Hold forces of shape (chain, draw, point) in 16 bits, to 1/16 384 of the largest or finer."""
    arrays = dict(group.arrays)
    for name, (dimensions, values, words) in group.arrays.items():
        if len(dimensions) > 1:
            unit = np.float32(2.0 ** (np.floor(np.log2(np.abs(values).max())) - 13))
            arrays[name] = (dimensions, np.round(values / unit).astype(np.int16), words | {"scale_factor": unit})
    return Group(arrays, group.words)
