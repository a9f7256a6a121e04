"""Posteriors as ArviZ InferenceData and the files of a fit; the only module that writes them."""

from __future__ import annotations

import json
import platform
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
from numpy.typing import NDArray

import shj_bayes
from shj_bayes.errors import InferenceError
from shj_bayes.files import check_seal, file_digest, read_json, replacing, reserve, sealed, write_text
from shj_bayes.inference.convergence import Diagnostics, Verdict
from shj_bayes.inference.floor import Floor
from shj_bayes.inference.posterior import Posterior
from shj_bayes.inference.predictive import add_noise, modelled_force
from shj_bayes.inference.quiet_arviz import az
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.parameters import FloatArray

_read_netcdf: Any = az.from_netcdf  # carries no types
SCHEMA = "shj-bayes/fit/1"
SUMMARY_COLUMNS = ("name", "unit", "mean", "sd", "q05", "q50", "q95", "ess_bulk", "ess_tail", "rhat")
N_STORED, N_LOOPS, N_PRIOR, N_PRIOR_LOOPS = 500, 25, 4000, 60  # draws; the first two for each ensemble
FILES = ("posterior.nc", "summary.csv", "summary.json")  # whose digests stand in fit.json
KINDS: dict[str, type] = {
    **{"device": str, "verdict": str, "reasons": list, "versions": dict, "model": dict},
    **{"prior_laws": list, "inputs": list, "sampling": dict, "parameters": list},
}
PACKAGES = ("arviz", "emcee", "h5py", "numba", "numpy", "pandas", "scipy", "xarray")


def natural_chains(posterior: Posterior, chains: FloatArray) -> FloatArray:
    """Draws of shape (..., d) from the unbounded space to natural units."""
    return posterior.natural(chains.reshape(-1, chains.shape[-1])).reshape(chains.shape)


def inference_data(
    posterior: Posterior, shown: FloatArray, sampled: FloatArray, heights: FloatArray, seed: int
) -> az.InferenceData:
    """Everything a reader of the fit needs, as one ArviZ object.

    Parameters
    ----------
    posterior : Posterior
        What was asked.
    shown : array, shape (n_ensembles, n_steps, n_walkers, d)
        Kept steps in the unbounded space, no narrower than the cycles scatter.
    sampled : array of the same shape
        The same as they were sampled.
    heights : array, shape (n_ensembles, n_steps, n_walkers)
        Log posterior of the latter.
    seed : int
        Seed of the fit; the predictive draws have a stream of their own.

    Returns
    -------
    arviz.InferenceData
        ``chain`` is the ensemble; ``draw`` goes through steps and walkers, thinned to nearly independent draws.
        Groups: posterior, prior, posterior_predictive, prior_predictive, log_likelihood, sample_stats,
        observed_data, constant_data.
    """
    names = posterior.names
    n_ensembles, n_steps, n_walkers, d = shown.shape
    step = max(1, int(np.ceil(n_steps * n_walkers / N_STORED)))
    flat = natural_chains(posterior, shown[:, ::step].reshape(n_ensembles, -1, d))
    lp = heights[:, ::step].reshape(n_ensembles, -1)
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(99,)))

    loops = flat[:, np.linspace(0, flat.shape[1] - 1, N_LOOPS).astype(int)].reshape(-1, d)
    clean = modelled_force(posterior, loops)
    noisy = add_noise(posterior, loops, clean, rng)
    shape = (n_ensembles, N_LOOPS, -1)
    laws = posterior.model.laws_of_parameters
    prior = np.stack([law.distribution.rvs(N_PRIOR, random_state=rng) for law in laws], axis=1)
    prior_loops = _prior_loops(posterior, prior)
    by_half_cycle = posterior.log_likelihood_by_half_cycle(natural_chains(posterior, sampled[:, ::step]).reshape(-1, d))

    sample = np.arange(clean.shape[1])
    data: az.InferenceData = az.from_dict(
        posterior={n: flat[:, :, i] for i, n in enumerate(names)},
        prior={n: prior[None, :, i] for i, n in enumerate(names)},
        posterior_predictive={
            "force": _short(noisy).reshape(shape),
            "force_model": _short(clean).reshape(shape),
        },
        prior_predictive={"force_model": _short(prior_loops)[None]},
        log_likelihood={"force_of_half_cycle": by_half_cycle.reshape(*lp.shape, -1)},
        sample_stats={"lp": lp},
        observed_data={"force": np.concatenate([r.recording.force_kN for r in posterior.runs])},
        constant_data=_constant(posterior),
        coords={"sample": sample, "half_cycle": np.arange(sum(r.motion.n_half for r in posterior.runs))},
        dims={
            "force": ["sample"],
            "force_model": ["sample"],
            "force_of_half_cycle": ["half_cycle"],
            **{
                n: ["sample"]
                for n in ("time_s", "displacement_mm", "speed_mm_s", "run", "half_cycle_of_sample", "used")
            },
        },
    )
    for group in ("posterior", "prior"):
        for parameter in posterior.model.parameters:
            data[group][parameter.name].attrs.update(unit=parameter.unit, meaning=parameter.meaning)
    return data


def summary(model: DeviceModel, figures: Diagnostics, chains: FloatArray) -> pd.DataFrame:
    """Table of the parameters.

    Parameters
    ----------
    model : DeviceModel
        Says the units.
    figures : Diagnostics
        Convergence figures.
    chains : array, shape (..., d)
        Kept draws in natural units.

    Returns
    -------
    pandas.DataFrame
        Columns of INTERFACE: name, unit, mean, sd, q05, q50, q95, ess_bulk, ess_tail, rhat.
    """
    flat = chains.reshape(-1, chains.shape[-1])
    q05, q50, q95 = np.quantile(flat, [0.05, 0.5, 0.95], axis=0)
    columns = (
        list(figures.names),
        [parameter.unit for parameter in model.parameters],
        flat.mean(axis=0),
        flat.std(axis=0, ddof=1),
        q05,
        q50,
        q95,
        figures.ess_bulk,
        figures.ess_tail,
        figures.rhat,
    )
    return pd.DataFrame(dict(zip(SUMMARY_COLUMNS, columns, strict=True)))


def fit_record(
    posterior: Posterior,
    figures: Diagnostics,
    floor: Floor,
    verdict: Verdict,
    table: pd.DataFrame,
    *,
    name: str,
    seed: int,
    key: str,
) -> dict[str, Any]:
    """Content of ``fit.json``: verdict, reasons, seeds, versions, digests, data quality and convergence."""
    pairs = zip(posterior.averages, posterior.runs, strict=True)
    return {
        "schema": SCHEMA,
        "device": name,
        "verdict": verdict.word,
        "reasons": list(verdict.reasons),
        "seed": seed,
        "key": key,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": versions(),
        "model": {
            "variant": posterior.model.variant,
            "effects": [effect.id for effect in posterior.model.effects],
            "speed": posterior.model.speed,
            "noise": posterior.model.noise.id,
            "free_between_runs": list(posterior.model.free),
            "priors": posterior.model.priors.family,
            "priors_statement": posterior.model.priors.statement,
            "priors_sha256": posterior.model.priors.sha256,
        },
        "prior_laws": [
            {"name": n, "unit": p.unit, "law": p.law, "a": p.a, "b": p.b, "source": p.source}
            for n, p in zip(posterior.names, posterior.model.laws_of_parameters, strict=True)
        ],
        "inputs": [
            {
                "name": run.recording.source.name,
                "sha256": run.recording.source.sha256,
                "format": run.recording.source.format,
                "columns": run.recording.source.columns,
                "units": run.recording.source.units,
                "n_samples": run.recording.n_samples,
                "rate_Hz": run.recording.rate_Hz,
                "duration_s": run.recording.duration_s,
                "n_half_cycles": run.motion.n_half,
                "start_force_kN": run.start_force_kN,
                "motion_method": run.motion.method,
                "displacement_noise_mm": run.motion.noise_mm,
                "findings": [vars(finding) for finding in run.recording.findings],
            }
            for run in posterior.runs
        ],
        "sampling": {
            "n_ensembles": int(figures.acceptance.shape[0]),
            "n_walkers": int(figures.acceptance.shape[1]),
            "n_steps_kept": figures.n_steps,
            "n_steps_dropped": figures.n_burn,
            "tau_steps": dict(zip(figures.names, figures.tau.tolist(), strict=True)),
            "acceptance": figures.acceptance.mean(axis=1).tolist(),
            "n_failed_evaluations": figures.n_failed,
        },
        "cycles": {
            "n_pieces": floor.n_pieces,
            "scatter_over_posterior": dict(zip(floor.names, floor.scatter.tolist(), strict=True)),
            "widening": dict(zip(floor.names, floor.factor.tolist(), strict=True)),
        },
        "reduction": [{"n_blocks": part.n, "n_samples": run.recording.n_samples} for part, run in pairs],
        "parameters": json.loads(table.to_json(orient="records", double_precision=15)),
    }


def _short(force_kN: FloatArray) -> NDArray[np.float32]:
    """Round simulated forces to at most 1/16 384 of the largest in each row: packed, the file is a third smaller."""
    largest = np.maximum(np.abs(force_kN).max(axis=-1, keepdims=True), 1e-30)
    step = 2.0 ** (np.floor(np.log2(largest)) - 14)
    return np.asarray(np.round(force_kN / step) * step, dtype=np.float32)


def write_fit(folder: Path, data: az.InferenceData, table: pd.DataFrame, record: dict[str, Any]) -> None:
    """Write ``posterior.nc``, ``summary.csv``, ``summary.json`` and, last, ``fit.json`` (each whole or not at all).

    The record gains ``files``, the SHA-256 of the other three, and ``digest``, that of the record itself.
    """
    data.attrs.update(schema=SCHEMA, device=record["device"], provenance=json.dumps(record))
    with replacing(folder / "posterior.nc") as part:
        reserve(part, sum(data[group].nbytes for group in data.groups()) + 2**20)  # a MiB of names and attributes
        data.to_netcdf(str(part), engine="h5netcdf", compress=True)
    write_text(folder / "summary.csv", table.assign(schema=SCHEMA).to_csv(index=False))
    write_text(folder / "summary.json", json.dumps({"schema": SCHEMA, "parameters": record["parameters"]}, indent=1))
    record["files"] = {name: file_digest(folder / name) for name in FILES}
    record.update(sealed(record))
    write_text(folder / "fit.json", json.dumps(record, indent=1))


def read_record(folder: Path) -> dict[str, Any]:
    """Read ``fit.json`` of a results folder.

    Raises
    ------
    InferenceError
        If there is none, it is not one of ours, or it was altered after it was written.
    """
    path = folder / "fit.json"
    if not path.exists():
        raise InferenceError(f"{folder.name} holds no finished fit (no {path.name} in it); run shj-bayes fit")
    record = read_json(path, InferenceError)
    if not isinstance(record, dict) or record.get("schema") != SCHEMA:
        raise InferenceError(f"{path.name} in {folder.name} has not the schema {SCHEMA!r}; run the fit again")
    check_seal(record, path, InferenceError)
    for key, kind in KINDS.items():
        if not isinstance(record.get(key), kind):
            raise InferenceError(f"{path.name} in {folder.name} lacks a proper {key!r}; run the fit again")
    return record


def check_files(folder: Path, record: dict[str, Any]) -> None:
    """Refuse files of a fit that are missing, cut short or altered; a fit of an earlier version has no digests.

    Raises
    ------
    InferenceError
        With the file at fault.
    """
    for name in FILES:
        path = folder / name
        if not path.is_file():
            raise InferenceError(f"{name} is missing in {folder.name}; run the fit again")
        wanted = record.get("files", {}).get(name)
        if wanted is not None and file_digest(path) != wanted:
            raise InferenceError(
                f"{name} in {folder.name} was cut short or altered after it was written (its SHA-256 is not the one "
                "in fit.json); restore it or run the fit again"
            )


def read_posterior(folder: Path) -> az.InferenceData:
    """Read ``posterior.nc`` of a results folder.

    Raises
    ------
    InferenceError
        If it is missing, damaged, or not the one that ``fit.json`` belongs to.
    """
    if (folder / "fit.json").exists():
        check_files(folder, read_record(folder))
    try:
        data: az.InferenceData = _read_netcdf(str(folder / "posterior.nc"), engine="h5netcdf")
        data.load()  # and close: an open file cannot be replaced on Windows
        data.close()
    except Exception as error:  # the readers below raise dozens of kinds for damaged files; all mean the same
        raise InferenceError(
            f"posterior.nc in {folder.name} cannot be read ({str(error)[:200]}); run the fit again"
        ) from error
    return data


def read_group(folder: Path, group: str) -> dict[str, FloatArray]:
    """Read the arrays of one group of ``posterior.nc`` and nothing else.

    A campaign's summary asks three times for a little of every device; all groups with their coordinates through
    xarray took a third of a second each time.

    Parameters
    ----------
    folder : Path
        Results folder.
    group : str
        ``posterior``, ``constant_data`` ...

    Returns
    -------
    dict of str to array
        By variable, in the shape in which they are stored.

    Raises
    ------
    InferenceError
        As for `read_posterior`.
    """
    if (folder / "fit.json").exists():
        check_files(folder, read_record(folder))
    try:
        with h5py.File(folder / "posterior.nc", "r") as file:
            return {name: np.asarray(part) for name, part in file[group].items() if isinstance(part, h5py.Dataset)}
    except Exception as error:  # as above
        raise InferenceError(
            f"posterior.nc in {folder.name} cannot be read ({str(error)[:200]}); run the fit again"
        ) from error


def versions() -> dict[str, str]:
    """Versions of what the numbers depend on."""
    out = {"shj-bayes": shj_bayes.__version__, "python": platform.python_version()}
    for package in PACKAGES:
        try:
            out[package] = version(package)
        except PackageNotFoundError:
            out[package] = "not installed"
    return out


def _prior_loops(posterior: Posterior, prior: FloatArray) -> FloatArray:
    """Loops under the prior, without noise; sets whose law overflows are left out."""
    with np.errstate(over="ignore", invalid="ignore"):
        loops = modelled_force(posterior, prior[: 2 * N_PRIOR_LOOPS])
    return loops[np.all(np.isfinite(loops), axis=1)][:N_PRIOR_LOOPS]


def _constant(posterior: Posterior) -> dict[str, Any]:
    """Channels that the law and the pages need, runs one after the other."""
    runs = posterior.runs
    return {
        "time_s": np.concatenate([r.recording.time_s for r in runs]),
        "displacement_mm": np.concatenate([r.motion.displacement_mm for r in runs]),
        "speed_mm_s": np.concatenate([r.motion.speed_mm_s for r in runs]),
        "run": np.concatenate([np.full(r.recording.n_samples, i) for i, r in enumerate(runs, start=1)]),
        "half_cycle_of_sample": np.concatenate([r.motion.half_cycle for r in runs]),
        "used": np.concatenate([r.used for r in runs]).astype(np.int8),
    }
