"""MAT files (v4 to v7.3) and HDF5: numbers, structs and cells of them, nothing that could hold code."""

import math
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from shj_bayes.errors import RecordingError
from shj_bayes.recording.formats.format import Format
from shj_bayes.recording.formats.hdf5 import apart
from shj_bayes.recording.formats.nested import Item, channels_of, flat
from shj_bayes.recording.groups import grouped
from shj_bayes.recording.limits import CHUNK_BYTES, MAX_DEPTH, MAX_NESTED, MAX_PARTS
from shj_bayes.recording.tables import Table, refuse_large

_INTEGERS = (f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))
_NUMERIC_CLASSES = {"double", "single", "logical", *_INTEGERS}
_V5_ORDERS = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}  # version and order of the bytes, at byte 124 of a v5 MAT file
_MATRIX, _COMPRESSED = 14, 15  # types of elements of a v5 MAT file
_NESTED = {"struct", "cell"}
_V5_BYTES = {3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, 17: 2, 18: 4}  # of a number, by the type of an element
_V4_BYTES = {0: 8, 1: 4, 2: 4, 3: 2, 4: 2, 5: 1}  # of a number, by its type in a v4 MAT file
_OBJECTS = "; objects such as timeseries and timetable only MATLAB can open: save s.time = ts.Time; s.force = ts.Data"


def read_binary(path: Path, sha256: str, sheet: str | None) -> Table:
    """Read a MAT or HDF5 file: a column for each vector and each column of a matrix (``name[1]``), and single numbers.

    Structs and cells of MATLAB are gone into (``test.data.time``), groups of HDF5 too (``test/data/time``). v7.3 MAT
    files are HDF5 and are recognised by their contents. `sheet` is one of the groups or structs.
    """
    kind = "mat" if path.suffix.lower() == ".mat" else "hdf5"
    mark = "." if kind == "mat" else "/"
    if is_hdf5(path):
        items = apart(path, mark)
    elif kind == "mat":
        items = _from_mat(path)
    else:
        raise RecordingError(f"{path.name} is not an HDF5 file although its ending says so; export it again")
    columns, scalars, findings = channels_of(items, mark)
    if not columns:
        held = "; ".join(
            [f"single numbers: {', '.join(list(scalars)[:12])}"] * bool(scalars) + [f.message for f in findings]
        )
        raise RecordingError(
            f"{path.name}: no column of numbers found; {held or 'it is empty'}; export time, displacement and force as "
            f"vectors{_OBJECTS if kind == 'mat' else ''}"
        )
    found, told = grouped(columns, path.name, mark, sheet)
    return Table(path.name, kind, sha256, found, scalars=scalars, findings=(*findings, *told))


def is_hdf5(path: Path) -> bool:
    """Whether the signature of HDF5 stands at 0, 512, 1024, 2048 ... (HDF5 format specification, section II.A)."""
    size, at = path.stat().st_size, 0
    with path.open("rb") as stream:
        while at < size:
            stream.seek(at)
            if stream.read(8) == b"\x89HDF\r\n\x1a\n":
                return True
            at = 2 * at or 512
    return False


def _from_mat(path: Path) -> Iterator[Item]:
    """Variables of a MAT file up to v7; structs and cells by way of a process of their own, which bad ones can end."""
    with path.open("rb") as stream:
        head = stream.read(128)
    order = _V5_ORDERS.get(head[124:])
    if order is not None:
        _Walk(path, order).through()
    elif 0 not in head[:4]:  # as in version 4, which has no compression: it begins with a small integer
        raise RecordingError(f"{path.name} is not a MAT file although its ending says so; export it again")
    else:
        _count_v4(path)
    listing = _listing(path)
    # math.prod, since the sizes of a damaged file overflow the integers of numpy
    refuse_large(sum(8 * math.prod(shape) for _, shape, kind in listing if kind in _NUMERIC_CLASSES), path.name)
    return apart(path, ".") if any(kind in _NESTED for _, _, kind in listing) else flat(loaded(path), ".")


def _listing(path: Path) -> list[tuple[str, tuple[int, ...], str]]:
    """Name, size and class of each variable."""
    from scipy.io import whosmat  # noqa: PLC0415

    with _sizes_told(path):
        return [(str(name), tuple(map(int, shape)), str(kind)) for name, shape, kind in whosmat(path)]


def loaded(path: Path) -> dict[str, Any]:
    """Variables of a MAT file up to v7 as nested dictionaries, lists and numbers; objects are not loaded at all."""
    from scipy.io import loadmat  # noqa: PLC0415

    listing = _listing(path)
    wanted = [name for name, _, kind in listing if kind in _NUMERIC_CLASSES or kind in _NESTED or kind == "char"]
    with _sizes_told(path):
        found = loadmat(path, variable_names=wanted, simplify_cells=True) if wanted else {}
    return {name: found.get(name) for name, _, _ in listing}


@contextmanager
def _sizes_told(path: Path) -> Iterator[None]:
    """Say in words what scipy says of elements that are shorter or longer than their tags claim."""
    try:
        yield
    except (ValueError, OSError, TypeError, IndexError, struct.error, zlib.error) as error:
        raise _damaged(path.name, str(error)[:100]) from error


def _damaged(name: str, why: str) -> RecordingError:
    return RecordingError(
        f"{name}: the MAT file is damaged, its elements do not have the sizes that they claim ({why}); check that it "
        "is complete, or save it again"
    )


def _count_v4(path: Path) -> None:
    """Count the variables of a v4 MAT file by their heads: each takes scipy a walk over those before it."""
    length, found = path.stat().st_size, 0
    with path.open("rb") as stream:
        head = stream.read(20)
        order = "<" if len(head) == 20 and struct.unpack("<i", head[:4])[0] in range(5000) else ">"
        while len(head) == 20:
            kind, rows, columns, imaginary, name = struct.unpack(f"{order}5i", head)
            size = _V4_BYTES.get(kind // 10 % 10, 8) * rows * columns * (2 if imaginary else 1) + name
            if min(kind, rows, columns, name) < 0 or size > length - stream.tell():
                return  # damaged; scipy says how
            stream.seek(size, 1)
            found += 1
            _refuse_many(found, MAX_PARTS, "variables", path.name)
            head = stream.read(20)


def _refuse_many(found: int, most: int, what: str, name: str) -> None:
    if found > most:
        raise RecordingError(f"{name} holds more than {most} {what}; save its channels alone, as vectors")


class _Walk:
    """The elements of a v5 MAT file, gone through and counted before scipy unpacks and builds them."""

    def __init__(self, path: Path, order: str) -> None:
        self.path, self.order, self.length = path, order, path.stat().st_size
        self.total = self.nested = self.numbers = 0

    def through(self) -> None:
        """Go through the variables; each may be compressed."""
        with self.path.open("rb") as stream:
            stream.seek(128)
            found = 0
            while len(tag := stream.read(8)) == 8:
                found += 1
                _refuse_many(found, MAX_PARTS, "variables", self.path.name)
                kind, size = struct.unpack(f"{self.order}II", tag)
                left = self.length - stream.tell()
                if size > left:  # it would hide those behind it
                    raise RecordingError(
                        f"{self.path.name}: the element at byte {stream.tell() - 8} claims {size} bytes, the file has "
                        f"{left} left; check that it is complete, or save it again"
                    )
                end = stream.tell() + size
                if kind == _COMPRESSED:
                    self._elements(_Pieces(self, _unpacked(stream, size)))
                elif kind == _MATRIX:
                    self._matrix(_Pieces(self, _pieces(stream, size)), size, 1)
                stream.seek(end)

    def _elements(self, pieces: "_Pieces") -> None:
        """Go through what a compressed element holds, to its end."""
        while len(tag := pieces.read(8)) == 8:
            kind, size = struct.unpack(f"{self.order}II", tag)
            if kind == _MATRIX:
                self._matrix(pieces, size, 1)
            else:
                pieces.skip(size)

    def _matrix(self, pieces: "_Pieces", size: int, depth: int) -> None:
        """Go through the parts of a matrix; those of structs and cells are matrices themselves."""
        self.nested += 1
        _refuse_many(self.nested, MAX_NESTED, "cells and fields", self.path.name)
        _refuse_many(depth, MAX_DEPTH, "structs or cells within one another", self.path.name)
        end = pieces.at + size
        while pieces.at < end and len(tag := pieces.read(8)) == 8:
            kind, count = struct.unpack(f"{self.order}II", tag)
            if kind >> 16:  # a small element, whose data stand in the tag
                continue
            if count > end - pieces.at:
                raise _damaged(self.path.name, f"one of {count} bytes lies in one with {end - pieces.at} left")
            if kind == _MATRIX:
                self._matrix(pieces, count, depth + 1)
                continue
            self.numbers += 8 * count // _V5_BYTES.get(kind, 1)  # small whole numbers become doubles of eight bytes
            refuse_large(self.numbers, self.path.name)
            pieces.skip(min(count + -count % 8, end - pieces.at))

    def counted(self, size: int) -> None:
        """Count bytes that were unpacked."""
        self.total += size
        refuse_large(self.total, self.path.name)


class _Pieces:
    """A stream of pieces to read from and to skip in, never held whole."""

    def __init__(self, walk: _Walk, pieces: Iterator[bytes]) -> None:
        self.walk, self.pieces, self.held, self.used, self.at = walk, pieces, b"", 0, 0

    def read(self, size: int) -> bytes:
        """Bytes from here on, fewer at the end."""
        found = b""
        while size > len(found):
            part = self.held[self.used : self.used + size - len(found)]
            self.used += len(part)
            found += part
            if len(found) < size and not self._more():
                break
        self.at += len(found)
        return found

    def skip(self, size: int) -> None:
        """Go on without looking."""
        self.at += size
        while size > len(self.held) - self.used:
            size -= len(self.held) - self.used
            if not self._more():
                return
        self.used += size

    def _more(self) -> bool:
        self.held, self.used = next(self.pieces, b""), 0
        self.walk.counted(len(self.held))
        return bool(self.held)


def _pieces(stream: IO[bytes], size: int) -> Iterator[bytes]:
    """So many bytes of a file, in pieces."""
    while size > 0 and (piece := stream.read(min(size, CHUNK_BYTES))):
        size -= len(piece)
        yield piece


def _unpacked(stream: IO[bytes], size: int) -> Iterator[bytes]:
    """Unpack so many bytes of a file, in pieces."""
    unpacker = zlib.decompressobj()
    for packed in _pieces(stream, size):
        left = packed
        while left:
            if piece := unpacker.decompress(left, CHUNK_BYTES):
                yield piece
            left = unpacker.unconsumed_tail


FORMATS = (
    Format("mat", (".mat",), read_binary, sheets=True),
    Format("hdf5", (".h5", ".hdf5"), read_binary, sheets=True),
)
