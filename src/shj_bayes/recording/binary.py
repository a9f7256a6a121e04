"""MAT files (v4 to v7.3) and HDF5: numeric arrays only, nothing that could hold code."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes.errors import RecordingError
from shj_bayes.recording.headers import split_header
from shj_bayes.recording.limits import MAX_BYTES
from shj_bayes.recording.recording import Finding
from shj_bayes.recording.tables import Column, Table, as_floats

_NUMERIC_CLASSES = {
    "double",
    "single",
    "logical",
    *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)),
}
_MAX_WIDTH = 64  # a matrix with more columns is an image or a state history, not channels


def read_binary(path: Path, sha256: str) -> Table:
    """Read a MAT or HDF5 file.

    Parameters
    ----------
    path : Path
        The file; v7.3 MAT files are HDF5 and are recognised by their contents.
    sha256 : str
        Its digest.

    Returns
    -------
    Table
        One column for each vector, one for each column of a matrix (``name[1]``), and the single numbers.
    """
    import h5py  # noqa: PLC0415

    kind = "mat" if path.suffix.lower() == ".mat" else "hdf5"
    if h5py.is_hdf5(path):
        arrays = _from_hdf5(path)
    elif kind == "mat":
        arrays = _from_mat(path)
    else:
        raise RecordingError(f"{path.name} is not an HDF5 file although its ending says so; export it again")
    columns: list[Column] = []
    scalars: dict[str, float] = {}
    skipped: list[str] = []
    for name, values, unit in arrays:
        if values is None:
            skipped.append(name)
        elif values.size == 1:
            scalars[name] = float(values.ravel()[0])
        else:
            columns.extend(_columns(name, values, unit))
    findings = []
    if skipped:
        findings.append(
            Finding("not-numbers", "note", f"left out, not columns of numbers: {', '.join(skipped[:8])}", len(skipped))
        )
    return Table(path.name, kind, sha256, tuple(columns), scalars=scalars, findings=tuple(findings))


def _columns(name: str, values: np.ndarray[Any, Any], unit: str | None) -> Iterator[Column]:
    """Vectors as they are, matrices column by column."""
    plain, own = split_header(name)
    if values.ndim == 1:
        yield Column(plain, as_floats(values), unit or own, name)
        return
    for i in range(values.shape[1]):
        yield Column(f"{plain}[{i + 1}]", as_floats(values[:, i]), unit or own, f"{name}[{i + 1}]")


def _shaped(values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any] | None:
    """Vector, or matrix with the long side down; None for what is neither."""
    values = np.squeeze(values)
    if values.ndim <= 1:
        return values if values.size else None
    if values.ndim == 2:
        values = values if values.shape[0] >= values.shape[1] else values.T
        return values if values.shape[1] <= _MAX_WIDTH else None
    return None


def _bounded(total: int, name: str) -> None:
    """Refuse before reading what would not fit."""
    if total > MAX_BYTES:
        raise RecordingError(
            f"{name} holds {total / 1024**2:.0f} MiB of numbers; "
            f"allowed are {MAX_BYTES // 1024**2} MiB; export fewer channels"
        )


def _from_mat(path: Path) -> Iterator[tuple[str, np.ndarray[Any, Any] | None, str | None]]:
    """Variables of a MAT file up to v7; only the numeric classes are loaded at all."""
    from scipy.io import loadmat, whosmat  # noqa: PLC0415

    listing = whosmat(path)
    wanted = [name for name, _, kind in listing if kind in _NUMERIC_CLASSES]
    _bounded(sum(8 * int(np.prod(shape)) for name, shape, _ in listing if name in wanted), path.name)
    loaded = loadmat(path, variable_names=wanted) if wanted else {}
    for name, _, _ in listing:
        values = loaded.get(name)
        numeric = isinstance(values, np.ndarray) and values.dtype.kind in "fiub"
        yield name, _shaped(values) if numeric and values is not None else None, None


def _from_hdf5(path: Path) -> Iterator[tuple[str, np.ndarray[Any, Any] | None, str | None]]:
    """Numeric datasets and tables of an HDF5 file; links to other files are never followed."""
    import h5py  # noqa: PLC0415

    found: list[tuple[str, np.ndarray[Any, Any] | None, str | None]] = []
    with h5py.File(path, "r") as file:
        datasets: list[h5py.Dataset] = []
        # visititems goes through hard links only, so neither soft nor external links lead out of the file.
        file.visititems(lambda _, item: datasets.append(item) if isinstance(item, h5py.Dataset) else None)
        datasets = [item for item in datasets if not str(item.name).startswith("/#")]  # MATLAB's own bookkeeping
        numeric = [item for item in datasets if _holds_numbers(item.dtype)]
        _bounded(sum(int(item.size or 0) * max(8, item.dtype.itemsize) for item in numeric), path.name)
        for item in datasets:
            name = str(item.name).lstrip("/")
            if item not in numeric or item.external:
                found.append((name, None, None))
            elif item.dtype.names:
                table = item[()]
                found.extend((field, _shaped(table[field]), None) for field in item.dtype.names)
            else:
                found.append((name, _shaped(item[()]), _unit(item)))
        found.extend((key, np.asarray(value), None) for key, value in file.attrs.items() if _is_number(value))
    return iter(found)


def _holds_numbers(dtype: np.dtype[Any]) -> bool:
    """Whether a dataset is plain numbers, or a table of them; references and objects are not."""
    if dtype.names:
        return all(dtype[name].kind in "fiub" for name in dtype.names)
    return dtype.kind in "fiub"


def _is_number(value: object) -> bool:
    return np.ndim(value) == 0 and isinstance(value, (int, float, np.integer, np.floating))  # type: ignore[arg-type]


def _unit(item: Any) -> str | None:
    """Look for a unit among the attributes of a dataset."""
    for key in ("units", "unit", "Units", "Unit"):
        value = item.attrs.get(key)
        if isinstance(value, bytes):
            value = value.decode("utf-8", "replace")
        if isinstance(value, str) and value.strip():
            return value.strip()
    return None
