"""MAT files (v4 to v7.3) and HDF5: numeric arrays only, nothing that could hold code."""

import math
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from shj_bayes.errors import RecordingError
from shj_bayes.recording.formats.format import Format
from shj_bayes.recording.formats.hdf5 import Item, apart, shaped
from shj_bayes.recording.headers import split_header
from shj_bayes.recording.limits import CHUNK_BYTES
from shj_bayes.recording.tables import Column, Table, as_floats, left_out, refuse_large

_INTEGERS = (f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))
_NUMERIC_CLASSES = {"double", "single", "logical", *_INTEGERS}
_V5_ORDERS = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}  # version and order of the bytes, at byte 124 of a v5 MAT file
_COMPRESSED = 15  # type of a compressed element of a v5 MAT file


def read_binary(path: Path, sha256: str) -> Table:
    """Read a MAT or HDF5 file: a column for each vector and each column of a matrix (``name[1]``), and single numbers.

    v7.3 MAT files are HDF5 and are recognised by their contents.
    """
    kind = "mat" if path.suffix.lower() == ".mat" else "hdf5"
    if _is_hdf5(path):
        arrays = apart(path)
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
    return Table(path.name, kind, sha256, tuple(columns), scalars=scalars, findings=left_out(skipped))


def _is_hdf5(path: Path) -> bool:
    """Whether the signature of HDF5 stands at 0, 512, 1024, 2048 ... (HDF5 format specification, section II.A)."""
    size, at = path.stat().st_size, 0
    with path.open("rb") as stream:
        while at < size:
            stream.seek(at)
            if stream.read(8) == b"\x89HDF\r\n\x1a\n":
                return True
            at = 2 * at or 512
    return False


def _columns(name: str, values: np.ndarray[Any, Any], unit: str | None) -> Iterator[Column]:
    """Vectors as they are, matrices column by column."""
    plain, own = split_header(name)
    if values.ndim == 1:
        yield Column(plain, as_floats(values), unit or own, name)
        return
    for i in range(values.shape[1]):
        yield Column(f"{plain}[{i + 1}]", as_floats(values[:, i]), unit or own, f"{name}[{i + 1}]")


def _from_mat(path: Path) -> Iterator[Item]:
    """Variables of a MAT file up to v7; only the numeric classes are loaded at all."""
    from scipy.io import loadmat, whosmat  # noqa: PLC0415

    with path.open("rb") as stream:
        head = stream.read(128)
    order = _V5_ORDERS.get(head[124:])
    if order is not None:
        _refuse_bomb(path, order)
    elif 0 not in head[:4]:  # as in version 4, which has no compression: it begins with a small integer
        raise RecordingError(f"{path.name} is not a MAT file although its ending says so; export it again")
    with _sizes_told(path):
        listing = whosmat(path)
    wanted = [name for name, _, kind in listing if kind in _NUMERIC_CLASSES]
    # math.prod, since the sizes of a damaged file overflow the integers of numpy
    refuse_large(sum(8 * math.prod(map(int, shape)) for name, shape, _ in listing if name in wanted), path.name)
    with _sizes_told(path):
        loaded = loadmat(path, variable_names=wanted) if wanted else {}
    for name, _, _ in listing:
        values = loaded.get(name)
        numeric = isinstance(values, np.ndarray) and values.dtype.kind in "fiub"
        yield name, shaped(values) if numeric and values is not None else None, None


@contextmanager
def _sizes_told(path: Path) -> Iterator[None]:
    """Say in words what scipy says of elements that are shorter or longer than their tags claim."""
    try:
        yield
    except (ValueError, OSError, TypeError, IndexError, struct.error, zlib.error) as error:
        raise RecordingError(
            f"{path.name}: the MAT file is damaged, its elements do not have the sizes that they claim "
            f"({str(error)[:100]}); check that it is complete, or save it again"
        ) from error


def _refuse_bomb(path: Path, order: str) -> None:
    """Unpack the compressed elements of a v5 MAT file in pieces, counting, before scipy unpacks them whole.

    An element that claims to be longer than the file would hide those behind it.
    """
    length, total = path.stat().st_size, 0
    with path.open("rb") as stream:
        stream.seek(128)
        while len(tag := stream.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            if size > length - stream.tell():
                raise RecordingError(
                    f"{path.name}: the element at byte {stream.tell() - 8} claims {size} bytes, the file has "
                    f"{length - stream.tell()} left; check that it is complete, or save it again"
                )
            if kind != _COMPRESSED:
                stream.seek(size, 1)
                continue
            unpacker, left = zlib.decompressobj(), size
            while left > 0 and (packed := stream.read(min(left, CHUNK_BYTES))):
                left -= len(packed)
                while packed:
                    total += len(unpacker.decompress(packed, CHUNK_BYTES))
                    refuse_large(total, path.name)
                    packed = unpacker.unconsumed_tail


FORMATS = (Format("mat", (".mat",), read_binary), Format("hdf5", (".h5", ".hdf5"), read_binary))
