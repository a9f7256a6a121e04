"""A fitted population as tables and files, and back."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

import shj_bayes
from shj_bayes._util.files import damage_told, write_text
from shj_bayes.errors import PopulationError
from shj_bayes.population.device import NO_TAGS, RangeTested, Tags
from shj_bayes.population.hierarchy import ANY_SET, MAIN_PRIOR, SCHEMA, DeviceSet, PopulationResult, QuantityPosterior
from shj_bayes.population.predict import correlation_table, how_wide, new_device_table
from shj_bayes.population.quantities import PopulationPrior
from shj_bayes.results.codec import IF_KNOWN, Stored, finite
from shj_bayes.results.store import read, read_arrays, write, write_arrays
from shj_bayes.results.tables import Cells

_DRAWS = "population.npz"
PARTS = ("mu", "tau", "hyper")


@dataclass(frozen=True, kw_only=True)
class SetRecord:
    """A set: its devices, what is known of each, and a new device of it."""

    name: str
    n_devices: int
    devices: tuple[str, ...]
    tags: Tags | None  # None for a set that was never tested
    # points, errors: by quantity on its pooled scale, of each device
    points: Mapping[str, tuple[float | None, ...]]
    errors: Mapping[str, tuple[float | None, ...]]
    new_device: Mapping[str, Mapping[str, Any]]  # rows of ``population.csv`` by quantity
    how_wide: str | None


@dataclass(frozen=True, kw_only=True)
class QuantityRecord:
    """What a quantity rests on."""

    quantity: str
    draws: int
    importance_draws: float | None
    prior: str


@dataclass(frozen=True, kw_only=True)
class CorrelationRecord:
    """Correlation of two quantities between devices."""

    pair: tuple[str, str]
    q05: float | None
    q50: float | None
    q95: float | None
    degrees_of_freedom: int


@dataclass(frozen=True, kw_only=True)
class PopulationRecord(Stored, file="population.json", command="shj-bayes tables or campaign", error=PopulationError):
    """Content of ``population.json``."""

    schema: Literal["shj-bayes/population/1"] = SCHEMA
    version: str
    seed: int
    tested: RangeTested | None = None
    sets: tuple[SetRecord, ...]
    quantities: tuple[QuantityRecord, ...]
    priors: Mapping[str, PopulationPrior]
    other_priors: tuple[str, ...]
    correlation_between_quantities: tuple[CorrelationRecord, ...] = ()
    draws_sha256: str | None = field(default=None, metadata=IF_KNOWN)
    digest: str | None = field(default=None, metadata=IF_KNOWN)


def record_of(result: PopulationResult) -> PopulationRecord:
    """Everything but the draws."""
    bands: dict[str, dict[str, Any]] = {}
    for row in new_device_table(result):
        own = {key: value for key, value in row.items() if key not in ("set", "n_devices", "quantity")}
        bands.setdefault(row["set"], {})[row["quantity"]] = own
    return PopulationRecord(
        version=shj_bayes.__version__,
        seed=result.seed,
        tested=result.tested,
        sets=tuple(
            SetRecord(
                name=group.name,
                n_devices=len(group.devices),
                devices=group.devices,
                tags=None if group.name == ANY_SET else group.tags,
                points=finite(group.points),
                errors=finite(group.errors),
                new_device=finite(bands[group.name]),
                how_wide=how_wide(result, group.name) if "Fy" in result.posteriors else None,
            )
            for group in (*result.sets, DeviceSet(ANY_SET, (), NO_TAGS, {}))
        ),
        quantities=tuple(
            QuantityRecord(
                quantity=name,
                draws=fit.mu.shape[0],
                importance_draws=finite(result.importance_draws[name]),
                prior=result.priors[name].source,
            )
            for name, fit in result.posteriors.items()
        ),
        priors=dict(result.priors),
        other_priors=tuple(result.other_priors),
        correlation_between_quantities=tuple(CorrelationRecord(**finite(row)) for row in correlation_table(result)),
    )


def write_population(result: PopulationResult, folder: Path) -> None:
    """Write ``population.csv``, ``population.json`` and the draws ``population.npz``; the folder is made if need be."""
    folder.mkdir(parents=True, exist_ok=True)
    write_text(folder / "population.csv", Cells.of(new_device_table(result)).to_csv())
    written = write_arrays(draws_of(result), folder / _DRAWS)
    write(replace(record_of(result), draws_sha256=written), folder, ascii_only=False)


def draws_of(result: PopulationResult) -> dict[str, Any]:
    """Draws as arrays of numbers, by prior, quantity and part."""
    arrays: dict[str, Any] = {}  # so that nothing is pickled (a word to say so is an array before numpy 2.1)
    for label, fits in {MAIN_PRIOR: result.posteriors, **result.other_priors}.items():
        for name, fit in fits.items():
            arrays |= {f"{label}/{name}/{part}": getattr(fit, part).astype(np.float32) for part in PARTS}
            arrays[f"{label}/{name}/n_devices"] = np.array(fit.n_devices)
    return arrays


def fits_of(arrays: Mapping[str, Any]) -> dict[str, dict[str, QuantityPosterior]]:
    """Posteriors by prior and quantity from what `draws_of` gave."""
    fits: dict[str, dict[str, QuantityPosterior]] = {}
    for label, name, _ in (key.split("/") for key in arrays if key.endswith("/mu")):
        mu, tau, hyper = (arrays[f"{label}/{name}/{part}"].astype(np.float64) for part in PARTS)
        n_devices = tuple(arrays[f"{label}/{name}/n_devices"].tolist())
        fits.setdefault(label, {})[name] = QuantityPosterior(name, mu, tau, hyper, n_devices)
    return fits


def load_population(folder: Path) -> PopulationResult:
    """Read back what ``write_population`` wrote; `PopulationError` where that is missing or of another schema."""
    record = read(PopulationRecord, folder)
    arrays = read_arrays(folder / _DRAWS, PopulationRecord, record.draws_sha256)
    with damage_told(f"{PopulationRecord.FILE} or {_DRAWS} in {folder.name}", PopulationError):
        fits = fits_of(arrays)
        sets = tuple(
            DeviceSet(one.name, one.devices, one.tags or NO_TAGS, _numbers(one.points), _numbers(one.errors))
            for one in record.sets
            if one.name != ANY_SET
        )
        behind = {q.quantity: np.inf if q.importance_draws is None else q.importance_draws for q in record.quantities}
        return PopulationResult(sets, fits.pop(MAIN_PRIOR), fits, record.priors, behind, record.seed, record.tested)


def _numbers(rows: Mapping[str, tuple[float | None, ...]]) -> dict[str, tuple[float, ...]]:
    return {name: tuple(np.nan if x is None else x for x in row) for name, row in rows.items()}
