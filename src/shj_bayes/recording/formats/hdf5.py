"""HDF5 files, read in a process of its own: a damaged file can make the HDF5 library end the process it runs in.

Found by fuzzing (``tests/fuzz``): about one damaged file in a thousand ended the reader with a segmentation fault.
"""

import faulthandler
import io
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes._util.child_processes import PYTHON, end_with_input, tether
from shj_bayes.errors import RecordingError
from shj_bayes.recording.limits import HDF5_SECONDS, MAX_COLUMNS
from shj_bayes.recording.tables import refuse_large

_CHILD = "import sys; from shj_bayes.recording.formats.hdf5 import child; child(sys.argv[1])"
_MAX_WIDTH = 64  # a matrix with more columns is an image or a state history, not channels
Item = tuple[str, np.ndarray[Any, Any] | None, str | None]


def apart(path: Path) -> Iterator[Item]:
    """Read a file in a process of its own: name, numbers (None for what is not numbers) and unit of each dataset.

    `RecordingError` if the file cannot be read, or the library dies or hangs on it.
    """
    broken = f"{path.name}: the HDF5 library cannot read it and gave up"
    advice = "check that the file is complete; export it again"
    try:
        with tether() as until_our_end:
            done = subprocess.run(
                [*PYTHON, "-c", _CHILD, str(path.resolve())],
                stdin=until_our_end,
                capture_output=True,
                timeout=HDF5_SECONDS,
                check=False,
            )
    except subprocess.TimeoutExpired as error:
        raise RecordingError(f"{broken} after {HDF5_SECONDS} s; {advice}") from error
    if done.returncode:
        raise RecordingError(f"{broken} (status {done.returncode}); {advice}")
    stream = io.BytesIO(done.stdout)
    answer = json.loads(stream.readline())
    if "error" in answer:
        raise RecordingError(answer["error"])
    for name, unit, given in answer["items"]:
        yield name, np.load(stream, allow_pickle=False) if given else None, unit


def child(path: str) -> None:
    """Read a file and write what it holds to standard output: a line of names and units, then the arrays."""
    end_with_input()
    faulthandler.dump_traceback_later(HDF5_SECONDS, exit=True)  # also where the library holds every other thread up
    items: list[Item] = []
    try:
        items = from_hdf5(Path(path))
        answer: dict[str, Any] = {"items": [(name, unit, values is not None) for name, values, unit in items]}
    except RecordingError as error:
        answer = {"error": str(error)}
    except Exception as error:  # the library raises many kinds of errors for damaged files; all mean the same
        reason = f"{Path(path).name}: cannot be read as HDF5 ({type(error).__name__}: {str(error)[:160]})"
        answer = {"error": f"{reason}; check that the file is complete"}
    out = sys.stdout.buffer
    out.write(json.dumps(answer).encode() + b"\n")
    for _, values, _ in items:
        if values is not None:
            whole = io.BytesIO()  # numpy asks a buffered file where it stands, which a pipe does not know
            np.save(whole, np.ascontiguousarray(values), allow_pickle=False)
            out.write(whole.getbuffer())
    out.flush()


def shaped(values: np.ndarray[Any, Any]) -> np.ndarray[Any, Any] | None:
    """Vector, or matrix with the long side down; None for what is neither."""
    values = np.squeeze(values)
    if values.ndim <= 1:
        return values if values.size else None
    if values.ndim == 2:
        values = values if values.shape[0] >= values.shape[1] else values.T
        return values if values.shape[1] <= _MAX_WIDTH else None
    return None


def from_hdf5(path: Path) -> list[Item]:
    """Numeric datasets and tables of an HDF5 file; links to other files are never followed."""
    import h5py  # noqa: PLC0415

    found: list[Item] = []
    with h5py.File(path, "r") as file:
        datasets: list[h5py.Dataset] = []

        def collect(_: str, item: Any) -> bool | None:
            if isinstance(item, h5py.Dataset):
                datasets.append(item)
            return True if len(datasets) > MAX_COLUMNS else None  # anything but None ends the walk

        # visititems goes through hard links only, so neither soft nor external links lead out of the file.
        if file.visititems(collect):
            raise RecordingError(
                f"{path.name} holds more than {MAX_COLUMNS} datasets; allowed are {MAX_COLUMNS}; export fewer channels"
            )
        datasets = [item for item in datasets if not str(item.name).startswith("/#")]  # MATLAB's own bookkeeping
        refuse_large(sum(int(d.size or 0) * max(8, d.dtype.itemsize) for d in datasets if _safe(d)), path.name)
        for item in datasets:
            name = str(item.name).lstrip("/")
            if not _safe(item):
                found.append((name, None, None))
            elif item.dtype.names:
                table = item[()]
                found.extend((field, shaped(table[field]), None) for field in item.dtype.names)
            else:
                found.append((name, shaped(item[()]), _unit(item)))
        numbers = ((k, v) for k, v in file.attrs.items() if isinstance(v, int | float | np.integer | np.floating))
        found.extend((key, np.asarray(value), None) for key, value in numbers)
    return found


def _safe(item: Any) -> bool:
    """Whether a dataset is plain numbers, or a table of them, in this very file.

    References and objects are not; external and virtual datasets are windows into other files.
    """
    kinds = [item.dtype[name] for name in item.dtype.names] if item.dtype.names else [item.dtype]
    return all(kind.kind in "fiub" for kind in kinds) and not item.external and not item.is_virtual


def _unit(item: Any) -> str | None:
    """Look for a unit among the attributes of a dataset."""
    for key in ("units", "unit", "Units", "Unit"):
        value = item.attrs.get(key)
        if isinstance(value, bytes):
            value = value.decode("utf-8", "replace")
        if isinstance(value, str) and value.strip():
            return value.strip()
    return None
