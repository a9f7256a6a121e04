"""MAT files (v4 to v7.3) and HDF5: numbers, structs and cells of them, nothing that could hold code."""

import faulthandler
import json
import math
import struct
import subprocess
import sys
import tempfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

import numpy as np

from shj_bayes._util.processes import PYTHON, bound_memory, end_with_input, tether
from shj_bayes.errors import RecordingError
from shj_bayes.recording import limits
from shj_bayes.recording.recording import Column, Finding
from shj_bayes.recording.rows import is_unit_row, split_header
from shj_bayes.recording.tables import Format, Table, as_floats, grouped, left_out, refuse_large

MAX_WIDTH = 64  # a matrix with more columns is an image or a state history, not channels
_VALUES = {"data", "values", "value", "y"}  # fields of a channel: its numbers, their times, what they are called
_TIMES = {"time", "times", "t"}
_NAMES = ("name", "label", "channel", "title")
_UNITS = ("units", "unit")
Numbers = np.ndarray[Any, Any]


def shaped(values: Numbers) -> Numbers | None:
    """Vector, or matrix with the long side down; None for what is neither."""
    values = np.squeeze(values)
    if values.ndim <= 1:
        return values if values.size else None
    if values.ndim == 2:
        values = values if values.shape[0] >= values.shape[1] else values.T
        return values if values.shape[1] <= MAX_WIDTH else None
    return None


def flat(node: dict[str, Any], mark: str, group: str = "") -> Iterator[Column]:
    """Channels and whatever else lies in a nest of dictionaries, lists, arrays and texts, in its order.

    Vectors, matrices and single numbers as they are; what is no numbers has no values. `mark` stands between groups.

    A struct of values alone, or of values with their times, is one channel, with the name and unit that it states. A
    list of texts beside a matrix of as many columns names them.
    """
    values = {key: _numbers(value) for key, value in node.items()}
    names, units = _titles(values)
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _within(value, mark, group, key)
        elif isinstance(value, list):
            if value is not names and value is not units:
                yield from _listed(value, mark, group, key, (names, units))
        elif isinstance(value, Column) and value.values.ndim == 2 and value.values.shape[1] == len(names):
            yield from _titled(_below(group, mark, key), names, units, value.values.T)
        else:
            yield _named(value, key, group)


def _below(group: str, mark: str, key: str) -> str:
    return f"{group}{mark}{key}" if group else key


def _named(value: Any, name: str, group: str) -> Column:
    """Numbers under their name, or the name of what is none."""
    held = value if isinstance(value, Column) else Column("", np.empty(0))
    return replace(held, name=name, group=group)


def _titled(group: str, names: list[str], units: list[str], columns: Iterable[Numbers]) -> Iterator[Column]:
    """Columns with the names and units that stand in lists of texts."""
    for title, unit, column in zip(names, units or ("",) * len(names), columns, strict=True):
        yield Column(title, column, unit or None, group=group)


def _listed(cells: list[Any], mark: str, group: str, key: str, titles: tuple[list[str], list[str]]) -> Iterator[Column]:
    """Elements of an array of structs, and cells."""
    inside = [_numbers(each) for each in cells]
    if len(titles[0]) == len(inside) and all(isinstance(each, Column) for each in inside):
        yield from _titled(_below(group, mark, key), *titles, (each.values for each in inside))
    elif not any(isinstance(each, dict | Column) for each in inside):
        yield _named(None, key, group)
    else:
        for number, each in enumerate(inside, start=1):
            if isinstance(each, dict):
                yield from _within(each, mark, group, f"{key}({number})")
            else:
                yield _named(each, f"{key}{{{number}}}", group)


def _within(node: dict[str, Any], mark: str, group: str, key: str) -> Iterator[Column]:
    """Go into a struct, which is one channel or holds several things."""
    path = _below(group, mark, key)
    vectors = {k: v for k, value in node.items() if isinstance(v := _numbers(value), Column) and v.values.size > 1}
    data = [k for k in vectors if k.lower() in _VALUES]
    times = [k for k in vectors if k.lower() in _TIMES]
    if len(data) == 1 and len(times) == len(vectors) - 1 <= 1 and vectors[data[0]].values.ndim == 1:
        found = vectors[data[0]]
        clock = vectors[times[0]].values if times else None
        if clock is None or clock.shape == found.values.shape:
            said = {k.lower(): v.strip() for k, v in node.items() if isinstance(v, str) and v.strip()}
            name = next((said[k] for k in _NAMES if k in said), key)
            unit = found.unit or next((said[k] for k in _UNITS if k in said), None)
            yield Column(name, found.values, unit, f"{path}{mark}{data[0]}", group=group, clock_s=clock)
            return
    yield from flat(node, mark, path)


def _numbers(value: Any) -> Any:
    """Numbers as a column, cells of numbers too; cells of anything else as a list; the rest as it is."""
    if isinstance(value, np.ndarray) and value.dtype.kind == "O":
        value = _cells(value)
    if isinstance(value, list) and value and all(_single(each) for each in value):
        value = np.array([float(each) for each in value])
    if isinstance(value, np.ndarray) and value.dtype.kind == "U":
        return [str(text).strip() for text in np.ravel(value)] if value.ndim else str(value)
    if _single(value) or (isinstance(value, np.ndarray) and value.dtype.kind in "fiub"):
        value = Column("", np.asarray(value))
    if isinstance(value, Column):
        plain = shaped(value.values)
        return None if plain is None else replace(value, values=plain)
    return value


def _cells(cells: np.ndarray[Any, Any]) -> Any:
    """Table of single numbers as a matrix, with titles as a dictionary of columns; other cells as a list."""
    if cells.ndim == 2:
        table = cells if cells.shape[0] >= cells.shape[1] else cells.T
        titled = all(isinstance(each, str) for each in table[0])
        if all(_single(each) for each in table[titled:].ravel()):
            numbers = table[titled:].astype(np.float64)
            return dict(zip(table[0].tolist(), numbers.T, strict=True)) if titled else numbers
    return list(np.ravel(cells))


def _single(value: Any) -> bool:
    return isinstance(value, int | float | np.number) or (
        isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "fiub"
    )


def _titles(values: dict[str, Any]) -> tuple[list[str], list[str]]:
    """Find the lists of texts that are names and units; empty where it is not clear which are the names."""
    texts = [v for v in values.values() if isinstance(v, list) and v and all(isinstance(each, str) for each in v)]
    names = [each for each in texts if not is_unit_row(each)]
    if len(names) != 1:
        return [], []
    units = [each for each in texts if is_unit_row(each) and len(each) == len(names[0])]
    return names[0], units[0] if len(units) == 1 else []


def channels_of(items: Iterable[Column], mark: str) -> tuple[list[Column], dict[str, float], tuple[Finding, ...]]:
    """Columns for vectors and for each column of a matrix, single numbers, and what was left out."""
    columns, scalars, skipped = list[Column](), dict[str, float](), list[str]()
    for item in items:
        path = item.header or _below(item.group, mark, item.name)
        if not item.values.size:
            skipped.append(path)
        elif item.values.size == 1:
            scalars[path] = float(item.values.ravel()[0])
        else:
            plain, own = split_header(item.name)
            clock = None if item.clock_s is None else as_floats(item.clock_s)
            each = item.values.T if item.values.ndim == 2 else [item.values]
            for i, values in enumerate(each, start=1):
                of = f"[{i}]" if item.values.ndim == 2 else ""
                own_name, unit = f"{plain}{of}", item.unit or own
                columns.append(
                    Column(own_name, as_floats(values), unit, f"{path}{of}", 0, item.group, clock, clock is None)
                )
    return columns, scalars, left_out(skipped)


_CHILD = "import sys; from shj_bayes.recording.formats.binary import child; child(*sys.argv[1:])"
_NUMERIC = {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}
_NESTED = {"struct", "cell"}


def apart(path: Path, mark: str) -> Iterator[Column]:
    """Read a file in a process of its own, which a damaged file may end, and give what it holds.

    `mark` stands between the levels of its groups. About one damaged HDF5 file in a thousand ends its reader with a
    segmentation fault (``tests/fuzz``); so do a few thousand cells in one another in scipy.

    `RecordingError` if the file cannot be read, or the library dies, hangs or takes too much memory over it.
    """
    broken = f"{path.name}: the library of its format cannot read it and gave up"
    advice = "check that the file is complete; export it again"
    seconds = limits.HDF5_SECONDS + path.stat().st_size // limits.HDF5_BYTES_S
    try:
        with tether() as until_our_end, tempfile.TemporaryFile() as stream:
            done = subprocess.run(
                [*PYTHON, "-c", _CHILD, str(path.resolve()), mark, str(seconds)],
                stdin=until_our_end,
                stdout=stream,
                stderr=subprocess.DEVNULL,
                timeout=seconds,
                check=False,
            )
            if done.returncode:
                raise RecordingError(f"{broken} (status {done.returncode}); {advice}")
            stream.seek(0)
            answer = json.loads(stream.readline())
            if "error" in answer:
                raise RecordingError(answer["error"])
            for name, unit, header, group, timed in answer["items"]:
                values = np.load(stream, allow_pickle=False)
                clock = np.load(stream, allow_pickle=False) if timed else None
                yield Column(name, values, unit, header, group=group, clock_s=clock)
    except subprocess.TimeoutExpired as error:
        raise RecordingError(f"{broken} after {seconds} s; {advice}") from error


def child(path: str, mark: str, seconds: str) -> None:
    """Read a file and write what it holds to standard output: a line of names and units, then the arrays."""
    end_with_input()
    faulthandler.dump_traceback_later(int(seconds), exit=True)  # also where the library holds every other thread up
    items: list[Column] = []
    try:
        read = from_hdf5 if is_hdf5(Path(path)) else loaded
        import_module("h5py" if read is from_hdf5 else "scipy.io")  # what is loaded is not counted against the bound
        bound_memory(limits.CHILD_BYTES)
        items = list(flat(read(Path(path)), mark))
        heads = [(i.name, i.unit, i.header, i.group, i.clock_s is not None) for i in items]
        answer: dict[str, Any] = {"items": heads}
    except RecordingError as error:
        answer = {"error": str(error)}
    except Exception as error:  # the library raises many kinds of errors for damaged files; all mean the same
        reason = f"{Path(path).name}: cannot be read ({type(error).__name__}: {str(error)[:160]})"
        answer = {"error": f"{reason}; check that the file is complete"}
    out = sys.stdout.buffer
    out.write(json.dumps(answer).encode() + b"\n")
    for item in items:
        for values in (item.values, item.clock_s):
            if values is not None:
                # In pieces, by way of something that is no file: a second copy of it all would be over the bound.
                np.save(SimpleNamespace(write=out.write), values, allow_pickle=False)
    out.flush()


def from_hdf5(path: Path) -> dict[str, Any]:
    """Read the groups of an HDF5 file as nested dictionaries of numbers, texts and lists.

    What is no numbers is None. No link out of the file is followed; cells and arrays of structs of MATLAB, which are
    references in it, are.
    """
    import h5py  # noqa: PLC0415

    with h5py.File(path, "r") as file:
        tree: dict[str, Any] = _Tree(path.name, file, h5py).group(file, 0)
        numbers = ((k, v) for k, v in file.attrs.items() if isinstance(v, int | float | np.integer | np.floating))
        return tree | {key: np.asarray(value) for key, value in numbers if key not in tree}


class _Tree:
    """What an HDF5 file holds, gone through with its objects, their depth and their bytes counted."""

    def __init__(self, name: str, file: Any, h5py: Any) -> None:
        self.name, self.file, self.h5py = name, file, h5py
        self.parts = self.cells = self.bytes = 0
        self.seen: set[Any] = set()

    def group(self, group: Any, depth: int) -> Any:
        """Members of a group by hard links, each object once; an array of structs of MATLAB as the list of them."""
        if depth > limits.MAX_DEPTH:
            raise RecordingError(
                f"{self.name}: groups within groups, {depth} deep; allowed are {limits.MAX_DEPTH}; export it again"
            )
        self.parts += len(group)
        if self.parts > limits.MAX_PARTS:
            raise RecordingError(
                f"{self.name} holds more than {limits.MAX_PARTS} groups and datasets; export fewer channels"
            )
        found: dict[str, Any] = {}
        for key in group:
            if key.startswith("#") or not isinstance(group.get(key, getlink=True), self.h5py.HardLink):
                continue
            item = group[key]
            place = self.h5py.h5o.get_info(item.id).addr
            if place in self.seen:
                continue
            self.seen.add(place)
            found[key] = self.group(item, depth + 1) if isinstance(item, self.h5py.Group) else self.dataset(item, depth)
        # The fields of an array of structs are references without a class, as many for each field.
        fields = [group[key] for key in found] if "MATLAB_class" in group.attrs else []
        kinds = [f.dtype.kind for f in fields if isinstance(f, self.h5py.Dataset) and "MATLAB_class" not in f.attrs]
        if fields and kinds == ["O"] * len(fields):
            lists = [value for value in found.values() if isinstance(value, list)]
            if len(lists) == len(found) and len(set(map(len, lists))) == 1:
                return [dict(zip(found, element, strict=True)) for element in zip(*lists, strict=True)]
        return found

    def dataset(self, item: Any, depth: int) -> Any:
        """Numbers of a dataset, columns of a table, text and cells of MATLAB; None for anything else."""
        if not isinstance(item, self.h5py.Dataset) or item.external or item.is_virtual or item.shape is None:
            return None
        kind = item.attrs.get("MATLAB_class", b"")
        kind = kind.decode("ascii", "replace") if isinstance(kind, bytes) else str(kind)
        if item.dtype == self.h5py.ref_dtype:
            ours = kind == "cell" or (not kind and "MATLAB_class" in item.parent.attrs)
            return self._followed(item, depth) if ours else None
        # Of an object of MATLAB no numbers are stored, but where they are.
        parts = [item.dtype[name] for name in item.dtype.names or ()] or [item.dtype]
        plain = all(part.kind in "fiub" for part in parts)
        if "MATLAB_empty" in item.attrs or not plain or kind not in {"", "char", *_NUMERIC}:
            return None
        self.bytes += int(item.size or 0) * max(8, item.dtype.itemsize)
        refuse_large(self.bytes, self.name)
        # What a chunk really unpacks to is limited by the bound on the memory.
        if item.chunks and int(np.prod([float(n) for n in item.chunks])) * item.dtype.itemsize > limits.MAX_BYTES:
            raise RecordingError(f"{self.name}: chunks of {item.chunks} values; save it again with smaller ones")
        if kind == "char":
            return "".join(chr(int(letter)) for letter in np.ravel(item[()])[: limits.MAX_PARTS])
        if item.dtype.names:
            table = item[()]
            return {field: table[field] for field in item.dtype.names}
        return Column("", item[()], _unit(item))

    def _followed(self, item: Any, depth: int) -> Any:
        """Cells, or elements of an array of structs, which lie elsewhere in the same file."""
        if depth > limits.MAX_DEPTH:
            raise RecordingError(f"{self.name}: cells within cells, {depth} deep; allowed are {limits.MAX_DEPTH}")
        self.cells += int(item.size or 0)
        if self.cells > limits.MAX_NESTED:
            raise RecordingError(f"{self.name} holds more than {limits.MAX_NESTED} cells; save its channels as vectors")
        read: list[Any] = []
        for reference in np.ravel(item[()]):
            cell = self.file[reference] if reference else None
            one = self.group(cell, depth + 1) if isinstance(cell, self.h5py.Group) else self.dataset(cell, depth + 1)
            read.append(one.values.ravel()[0] if isinstance(one, Column) and one.values.size == 1 else one)
        if len(item.shape) == 2 and min(item.shape) > 1:
            table = np.empty(len(read), dtype=object)
            table[:] = read
            return table.reshape(item.shape)
        return read


def _unit(item: Any) -> str | None:
    """Look for a unit among the attributes of a dataset."""
    for key in ("units", "unit", "Units", "Unit"):
        value = item.attrs.get(key)
        if isinstance(value, bytes):
            value = value.decode("utf-8", "replace")
        if isinstance(value, str) and value.strip():
            return value.strip()
    return None


_V5_ORDERS = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}  # version and order of the bytes, at byte 124 of a v5 MAT file
_MATRIX, _COMPRESSED = 14, 15  # types of elements of a v5 MAT file
_V5_BYTES = {3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 9: 8, 12: 8, 13: 8, 17: 2, 18: 4}  # of a number, by the type of an element
_V4_BYTES = {0: 8, 1: 4, 2: 4, 3: 2, 4: 2, 5: 1}  # of a number, by its type in a v4 MAT file
_OBJECTS = "; objects such as timeseries and timetable only MATLAB can open: save s.time = ts.Time; s.force = ts.Data"


def read_binary(path: Path, sheet: str | None) -> Table:
    """Read a MAT or HDF5 file: a column for each vector and each column of a matrix (``name[1]``), and single numbers.

    Structs and cells of MATLAB are gone into (``test.data.time``), groups of HDF5 too (``test/data/time``). v7.3 MAT
    files are HDF5 and are recognised by their contents. `sheet` is one of the groups or structs.
    """
    is_mat = path.suffix.lower() == ".mat"
    mark = "." if is_mat else "/"
    if is_hdf5(path):
        items = apart(path, mark)
    elif is_mat:
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
            f"vectors{_OBJECTS if is_mat else ''}"
        )
    found, told = grouped(columns, path.name, mark, sheet)
    return Table(path.name, found, scalars=scalars, findings=(*findings, *told))


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


def _from_mat(path: Path) -> Iterator[Column]:
    """Variables of a MAT file up to v7; files with structs or cells in a process of their own (see `apart`)."""
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
    refuse_large(sum(8 * math.prod(shape) for _, shape, kind in listing if kind in _NUMERIC), path.name)
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
    wanted = [name for name, _, kind in listing if kind in _NUMERIC | _NESTED | {"char"}]
    with _sizes_told(path):
        found = loadmat(path, variable_names=wanted, simplify_cells=True) if wanted else {}
    return {name: found.get(name) for name, _, _ in listing}


@contextmanager
def _sizes_told(path: Path) -> Iterator[None]:
    """Turn errors of scipy over elements that are shorter or longer than they claim into one sentence."""
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
            _refuse_many(found, limits.MAX_PARTS, "variables", path.name)
            head = stream.read(20)


def _refuse_many(found: int, most: int, what: str, name: str) -> None:
    if found > most:
        raise RecordingError(f"{name} holds more than {most} {what}; save its channels alone, as vectors")


class _Walk:
    """The elements of a v5 MAT file, gone through and counted before scipy unpacks and builds them."""

    def __init__(self, path: Path, order: str) -> None:
        self.path, self.tag = path, struct.Struct(f"{order}II")  # type and size of an element
        self.total = self.nested = self.numbers = 0

    def through(self) -> None:
        """Go through the variables; each may be compressed."""
        with self.path.open("rb") as stream:
            stream.seek(128)
            found, length = 0, self.path.stat().st_size
            while len(tag := stream.read(8)) == 8:
                found += 1
                _refuse_many(found, limits.MAX_PARTS, "variables", self.path.name)
                kind, size = self.tag.unpack(tag)
                left = length - stream.tell()
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
            kind, size = self.tag.unpack(tag)
            if kind == _MATRIX:
                self._matrix(pieces, size, 1)
            else:
                pieces.skip(size)

    def _matrix(self, pieces: "_Pieces", size: int, depth: int) -> None:
        """Go through the parts of a matrix; those of structs and cells are matrices themselves."""
        self.nested += 1
        _refuse_many(self.nested, limits.MAX_NESTED, "cells and fields", self.path.name)
        _refuse_many(depth, limits.MAX_DEPTH, "structs or cells within one another", self.path.name)
        end = pieces.at + size
        while pieces.at < end and len(tag := pieces.read(8)) == 8:
            kind, count = self.tag.unpack(tag)
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
    while size > 0 and (piece := stream.read(min(size, limits.CHUNK_BYTES))):
        size -= len(piece)
        yield piece


def _unpacked(stream: IO[bytes], size: int) -> Iterator[bytes]:
    """Unpack so many bytes of a file, in pieces."""
    unpacker = zlib.decompressobj()
    for packed in _pieces(stream, size):
        left = packed
        while left:
            if piece := unpacker.decompress(left, limits.CHUNK_BYTES):
                yield piece
            left = unpacker.unconsumed_tail


FORMATS = (
    Format("mat", (".mat",), read_binary, sheets=True),
    Format("hdf5", (".h5", ".hdf5"), read_binary, sheets=True),
)
