"""A fitted population as tables and files, and back."""

import json
import unicodedata
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

import shj_bayes
from shj_bayes._util.files import (
    check_seal,
    damage_told,
    file_digest,
    read_json,
    refuse_packed,
    replacing,
    sealed,
    write_text,
)
from shj_bayes.errors import PopulationError
from shj_bayes.population.correlation import correlation_table
from shj_bayes.population.device import NO_TAGS, Tags
from shj_bayes.population.posterior import ANY_SET, SCHEMA, DeviceSet, PopulationResult, QuantityPosterior
from shj_bayes.population.predict import how_wide, new_device_table
from shj_bayes.population.priors import PopulationPrior
from shj_bayes.population.quantities import FloatArray
from shj_bayes.population.tested import RangeTested

_DRAWS = "population.npz"


def safe_cell(value: object) -> object:
    """Text that a spreadsheet would run as a formula, with an apostrophe before it; all else unchanged."""
    if not isinstance(value, str):
        return value
    first = unicodedata.normalize("NFKC", value.lstrip()[:1])  # full-width and small signs as the plain ones
    runs = value.startswith(("\t", "\r")) or first in ("=", "+", "-", "@", "\u2212")
    return "'" + value if runs else value


def _finite(value: Any) -> Any:
    """Return the value with infinities and NaN as None, which JSON can hold."""
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if isinstance(value, dict):
        return {k: _finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(v) for v in value]
    return value


def to_json(result: PopulationResult) -> dict[str, Any]:
    """Return everything but the draws, ready for ``json.dumps``; schema "shj-bayes/population/1"."""
    sets: list[dict[str, Any]] = []
    by_set = dict(list(new_device_table(result).groupby("set", sort=False)))
    for group in (*result.sets, DeviceSet(ANY_SET, (), NO_TAGS, {})):
        name = group.name
        bands = {
            str(row["quantity"]): {str(k): v for k, v in row.items() if k not in {"set", "n_devices", "quantity"}}
            for row in by_set[name].to_dict("records")
        }
        sets.append(
            {
                "name": name,
                "n_devices": len(group.devices),
                "devices": list(group.devices),
                "tags": None if name == ANY_SET else asdict(group.tags),
                "points": dict(group.points),
                "errors": dict(group.errors),
                "new_device": bands,
                "how_wide": how_wide(result, name) if "Fy" in result.posteriors else None,
            }
        )
    document = {
        "schema": SCHEMA,
        "version": shj_bayes.__version__,
        "seed": result.seed,
        "tested": None if result.tested is None else asdict(result.tested),
        "converged": result.converged,
        "sets": sets,
        "quantities": [
            {
                "quantity": name,
                "r_hat": fit.r_hat,
                "ess": fit.ess,
                "chains": fit.n_chains,
                "draws": fit.mu.shape[0],
                "importance_draws": result.importance_draws[name],
                "converged": fit.converged,
                "prior": result.priors[name].source,
            }
            for name, fit in result.posteriors.items()
        ],
        "priors": {k: asdict(v) for k, v in result.priors.items()},
        "other_priors": list(result.other_priors),
        "correlation_between_quantities": correlation_table(result),
    }
    return {key: _finite(value) for key, value in document.items()}


def write_population(result: PopulationResult, folder: Path) -> None:
    """Write ``population.csv``, ``population.json`` and the draws ``population.npz``; the folder is made if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    table = new_device_table(result).map(safe_cell)
    write_text(folder / "population.csv", table.to_csv(index=False, lineterminator="\n"))
    arrays: dict[str, Any] = {}  # of numbers, so nothing is pickled (a word to say so is an array before numpy 2.1)
    for label, fits in {"default": result.posteriors, **result.other_priors}.items():
        for name, fit in fits.items():
            key = f"{label}/{name}"
            arrays |= {f"{key}/mu": fit.mu, f"{key}/tau": fit.tau, f"{key}/hyper": fit.hyper}
            arrays[f"{key}/n_devices"] = np.array(fit.n_devices)
            arrays[f"{key}/diagnostics"] = np.array([fit.r_hat, fit.ess, fit.n_chains])
    with replacing(folder / _DRAWS) as part, part.open("wb") as stream:
        np.savez(stream, **arrays)
    document = sealed(to_json(result) | {"draws_sha256": file_digest(folder / _DRAWS)})
    text = json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False)
    write_text(folder / "population.json", text + "\n")


def population_record(folder: Path) -> dict[str, Any]:
    """Content of ``population.json``; `PopulationError` where it is missing, altered or of another schema."""
    path = folder / "population.json"
    if not path.exists():
        raise PopulationError(
            f"{folder} holds no readable population (no {path.name} in it); "
            "run `shj-bayes tables` or `shj-bayes campaign` first"
        )
    document = read_json(path, PopulationError)
    if not isinstance(document, dict) or document.get("schema") != SCHEMA:
        raise PopulationError(f"{path} is not of schema {SCHEMA}; write it again with this version")
    check_seal(document, path, PopulationError)
    return document


def load_population(folder: Path) -> PopulationResult:
    """Read back what ``write_population`` wrote; `PopulationError` where that is missing or of another schema."""
    document = population_record(folder)
    if not (folder / _DRAWS).is_file():
        raise PopulationError(f"{_DRAWS} is missing in {folder.name}; run `shj-bayes tables` or `campaign` again")
    if document.get("draws_sha256") not in (None, file_digest(folder / _DRAWS)):
        raise PopulationError(
            f"{_DRAWS} in {folder.name} was cut short or altered after it was written (its SHA-256 is not the one in "
            "population.json); restore it or run the command again"
        )
    with damage_told(f"population.json or {_DRAWS} in {folder.name}", PopulationError):
        refuse_packed(folder / _DRAWS, PopulationError)
        with np.load(folder / _DRAWS, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
        return _from_document(document, arrays)


def _from_document(document: dict[str, Any], arrays: dict[str, FloatArray]) -> PopulationResult:
    """Build a population from the content of its files."""
    fits: dict[str, dict[str, QuantityPosterior]] = {}
    for key in arrays:
        label, name, part = key.split("/")
        if part != "mu":
            continue
        mu, tau, hyper, n, diagnostics = (
            arrays[f"{label}/{name}/{p}"] for p in ("mu", "tau", "hyper", "n_devices", "diagnostics")
        )
        r_hat, ess, n_chains = diagnostics.tolist()
        fits.setdefault(label, {})[name] = QuantityPosterior(
            name, mu, tau, hyper, tuple(n.tolist()), r_hat, ess, int(n_chains)
        )

    def number(value: float | None, missing: float) -> float:
        return missing if value is None else float(value)

    return PopulationResult(
        sets=tuple(
            DeviceSet(
                s["name"],
                tuple(s["devices"]),
                Tags(**s["tags"]),
                {k: tuple(number(x, np.nan) for x in v) for k, v in s["points"].items()},
                {k: tuple(number(x, np.nan) for x in v) for k, v in s["errors"].items()},
            )
            for s in document["sets"]
            if s["name"] != ANY_SET
        ),
        posteriors=fits.pop("default"),
        other_priors=fits,
        priors={k: PopulationPrior(**v) for k, v in document["priors"].items()},
        importance_draws={r["quantity"]: number(r["importance_draws"], np.inf) for r in document["quantities"]},
        seed=int(document["seed"]),
        tested=RangeTested(**document["tested"]) if document["tested"] else None,
    )
