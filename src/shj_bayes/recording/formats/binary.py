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
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

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
_OBJECTS = "; objects such as timeseries and timetable only MATLAB can open: save s.time = ts.Time; s.force = ts.Data"


def read_binary(path: Path, sheet: str | None) -> Table:
    """Read a MAT or HDF5 file: a column for each vector and each column of a matrix (``name[1]``), and single numbers.

    Structs and cells of MATLAB are gone into (``test.data.time``), groups of HDF5 too (``test/data/time``). v7.3 MAT
    files are HDF5 and are recognised by their contents. `sheet` is one of the groups or structs.
    """
    is_mat = path.suffix.lower() == ".mat"
    mark = "." if is_mat else "/"
    if not is_mat and not is_hdf5(path):
        raise RecordingError(f"{path.name} is not an HDF5 file although its ending says so; export it again")
    columns, scalars, findings = _channels(apart(path, mark), mark)
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


def _channels(items: Iterable[Column], mark: str) -> tuple[list[Column], dict[str, float], tuple[Finding, ...]]:
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
            matrix = item.values.ndim == 2
            for i, values in enumerate(item.values.T if matrix else [item.values], start=1):
                of, unit = f"[{i}]" if matrix else "", item.unit or own
                header = f"{path}{of}"
                columns.append(
                    Column(f"{plain}{of}", as_floats(values), unit, header, 0, item.group, clock, clock is None)
                )
    return columns, scalars, left_out(skipped)


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


# --- a nest of groups, structs and cells as channels ---


def flat(node: dict[str, Any], mark: str, group: str = "") -> Iterator[Column]:
    """Channels and whatever else lies in a nest of dictionaries, lists, arrays and texts, in its order.

    Vectors, matrices and single numbers as they are; what is no numbers has no values. `mark` stands between groups.

    A struct of values alone, or of values with their times, is one channel, with the name and unit that it states. A
    list of texts beside a matrix of as many columns, or beside as many cells, names them.
    """
    values = {key: _numbers(value) for key, value in node.items()}
    texts = [v for v in values.values() if isinstance(v, list) and v and all(isinstance(each, str) for each in v)]
    titles = [each for each in texts if not is_unit_row(each)]
    names = titles[0] if len(titles) == 1 else []  # else it is not clear which are the names
    beside = [each for each in texts if is_unit_row(each) and len(each) == len(names)]
    units = beside[0] if len(beside) == 1 else []
    stated = [unit or None for unit in units] or [None] * len(names)
    for key, value in values.items():
        below = _below(group, mark, key)
        cells = value if isinstance(value, list) else []
        if isinstance(value, Column) and value.values.ndim == 2 and value.values.shape[1] == len(names):
            cells = [Column("", column) for column in value.values.T]
        if names and len(cells) == len(names) and all(isinstance(each, Column) for each in cells):
            for title, unit, each in zip(names, stated, cells, strict=True):
                yield Column(title, each.values, unit, group=below)
        elif isinstance(value, dict):
            yield from _within(value, mark, group, key)
        elif not isinstance(value, list):
            yield _named(value, key, group)
        elif any(isinstance(each, dict | Column) for each in value):
            for number, each in enumerate(value, start=1):
                if isinstance(each, dict):
                    yield from _within(each, mark, group, f"{key}({number})")
                else:
                    yield _named(each, f"{key}{{{number}}}", group)
        elif value is not names and value is not units:
            yield _named(None, key, group)


def _below(group: str, mark: str, key: str) -> str:
    return f"{group}{mark}{key}" if group else key


def _named(value: Any, name: str, group: str) -> Column:
    """Numbers under their name, or the name of what is none."""
    return replace(value if isinstance(value, Column) else Column("", np.empty(0)), name=name, group=group)


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
    """Numbers as a column, also of cells; other cells as a list, those with titles by them; the rest as it is."""
    if isinstance(value, np.ndarray) and value.dtype.kind == "O":
        table = np.empty((0, 0)) if value.ndim != 2 else value if value.shape[0] >= value.shape[1] else value.T
        titled = bool(table.size) and all(isinstance(each, str) for each in table[0])
        if table.size and all(map(_single, table[titled:].ravel())):
            numbers = table[titled:].astype(np.float64)
            value = dict(zip(table[0].tolist(), numbers.T, strict=True)) if titled else numbers
        else:
            value = [_numbers(each) for each in np.ravel(value)]
    elif isinstance(value, list):
        value = [_numbers(each) for each in value]
    if isinstance(value, list) and value and all(isinstance(v, Column) and not v.values.ndim for v in value):
        value = np.array([float(each.values) for each in value])
    if isinstance(value, np.ndarray) and value.dtype.kind == "U":
        return [str(text).strip() for text in np.ravel(value)] if value.ndim else str(value)
    if _single(value) or (isinstance(value, np.ndarray) and value.dtype.kind in "fiub"):
        value = Column("", np.asarray(value))
    if not isinstance(value, Column):
        return value
    plain = np.squeeze(value.values)
    if plain.ndim == 2 and plain.shape[0] < plain.shape[1]:
        plain = plain.T
    fits = plain.ndim < 2 or (plain.ndim == 2 and plain.shape[1] <= MAX_WIDTH)
    return replace(value, values=plain) if fits and plain.size else None


def _single(value: Any) -> bool:
    return isinstance(value, int | float | np.number) or (
        isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "fiub"
    )


# --- a process of its own ---

_CHILD = "import sys; from shj_bayes.recording.formats.binary import child; child(*sys.argv[1:])"


def apart(path: Path, mark: str) -> Iterator[Column]:
    """Read a file in a process of its own, whose memory and time are bounded, and give what it holds.

    A small file may unpack to gigabytes; about one damaged HDF5 file in a thousand ends its reader with a segmentation
    fault (``tests/fuzz``), and so do a few thousand cells in one another in scipy. `mark` stands between its groups.
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
        read = from_hdf5 if is_hdf5(Path(path)) else from_mat
        import_module("h5py" if read is from_hdf5 else "scipy.io")  # what is loaded is not counted against the bound
        bound_memory(limits.CHILD_BYTES)
        items = list(flat(read(Path(path)), mark))
        refuse_large(sum(8 * item.values.size for item in items), Path(path).name)
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


# --- what the libraries give, as nested dictionaries of numbers, texts and lists; None for what is none of them ---

_NUMERIC = {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}


def from_hdf5(path: Path) -> dict[str, Any]:
    """Read the groups of an HDF5 file: no link out of it; cells and arrays of structs of MATLAB, references in it."""
    import h5py  # noqa: PLC0415

    with h5py.File(path, "r") as file:
        tree: dict[str, Any] = _Tree(path.name, file, h5py).group(file)
        numbers = ((k, v) for k, v in file.attrs.items() if isinstance(v, int | float | np.integer | np.floating))
        return tree | {key: np.asarray(value) for key, value in numbers if key not in tree}


class _Tree:
    """What an HDF5 file holds, gone through with its bytes counted."""

    def __init__(self, name: str, file: Any, h5py: Any) -> None:
        self.name, self.file, self.h5py, self.bytes = name, file, h5py, 0
        self.seen: set[Any] = set()

    def group(self, group: Any) -> Any:
        """Members of a group by hard links, each object once; an array of structs of MATLAB as the list of them."""
        found: dict[str, Any] = {}
        for key in group:
            if key.startswith("#") or not isinstance(group.get(key, getlink=True), self.h5py.HardLink):
                continue
            place = self.h5py.h5o.get_info(group[key].id).addr
            if place not in self.seen:
                self.seen.add(place)
                found[key] = self.item(group[key])
        # The fields of an array of structs are references without a class, as many for each field.
        fields = [group[key] for key in found] if "MATLAB_class" in group.attrs else []
        kinds = [f.dtype.kind for f in fields if isinstance(f, self.h5py.Dataset) and "MATLAB_class" not in f.attrs]
        if fields and kinds == ["O"] * len(fields):
            lists = [value for value in found.values() if isinstance(value, list)]
            if len(lists) == len(found) and len(set(map(len, lists))) == 1:
                return [dict(zip(found, element, strict=True)) for element in zip(*lists, strict=True)]
        return found

    def item(self, item: Any) -> Any:
        """Give a group; or numbers of a dataset, columns of a table, text and cells of MATLAB."""
        if isinstance(item, self.h5py.Group):
            return self.group(item)
        if not isinstance(item, self.h5py.Dataset) or item.external or item.is_virtual or item.shape is None:
            return None
        kind = item.attrs.get("MATLAB_class", b"")
        kind = kind.decode("ascii", "replace") if isinstance(kind, bytes) else str(kind)
        if item.dtype == self.h5py.ref_dtype:
            return self.cells(item) if kind == "cell" or (not kind and "MATLAB_class" in item.parent.attrs) else None
        # Of an object of MATLAB no numbers are stored, but where they are.
        fields = item.dtype.names or ()
        plain = all(part.kind in "fiub" for part in [item.dtype[name] for name in fields] or [item.dtype])
        if "MATLAB_empty" in item.attrs or not plain or kind not in {"", "char", *_NUMERIC}:
            return None
        self.bytes += int(item.size or 0) * max(8, item.dtype.itemsize)
        refuse_large(self.bytes, self.name)
        if item.chunks and math.prod(map(int, item.chunks)) * item.dtype.itemsize > limits.MAX_BYTES:
            raise RecordingError(f"{self.name}: chunks of {item.chunks} values; save it again with smaller ones")
        values = item[()]
        if kind == "char":
            return "".join(chr(int(letter)) for letter in np.ravel(values)[: limits.MAX_PARTS])
        stated = [item.attrs.get(key) for key in ("units", "unit", "Units", "Unit")]
        words = [unit.decode("utf-8", "replace") if isinstance(unit, bytes) else unit for unit in stated]
        unit = next((word.strip() for word in words if isinstance(word, str) and word.strip()), None)
        return {field: values[field] for field in fields} or Column("", values, unit)

    def cells(self, item: Any) -> Any:
        """Give cells, or elements of an array of structs, which lie elsewhere in the same file."""
        read = [self.item(self.file[reference]) if reference else None for reference in np.ravel(item[()])]
        out = np.empty(len(read), dtype=object)
        out[:] = [r.values.ravel()[0] if isinstance(r, Column) and r.values.size == 1 else r for r in read]
        return out.reshape(item.shape) if len(item.shape) == 2 and min(item.shape) > 1 else list(out)


_V5_ORDERS: dict[bytes, Literal["little", "big"]] = {b"\x00\x01IM": "little", b"\x01\x00MI": "big"}  # at byte 124
_COMPRESSED = 15  # type of an element


def from_mat(path: Path) -> dict[str, Any]:
    """Read the variables of a MAT file up to v7; objects are not loaded at all."""
    from scipy.io import loadmat, whosmat  # noqa: PLC0415

    with path.open("rb") as stream:
        head, length = stream.read(128), path.stat().st_size
        order = _V5_ORDERS.get(head[124:])
        if order is None and 0 not in head[:4]:  # as in version 4: it begins with a small integer
            raise RecordingError(f"{path.name} is not a MAT file although its ending says so; export it again")
        total = 0
        while order and len(tag := stream.read(8)) == 8:
            kind, size = (int.from_bytes(part, order) for part in (tag[:4], tag[4:]))
            begin = stream.tell()
            if size > length - begin:  # it would hide those behind it
                raise RecordingError(
                    f"{path.name}: the element at byte {begin - 8} claims {size} bytes, the file has {length - begin} "
                    "left; check that it is complete, or save it again"
                )
            unpacker = zlib.decompressobj()
            while kind == _COMPRESSED and (left := begin + size - stream.tell()) > 0:
                packed = stream.read(min(left, limits.CHUNK_BYTES))
                while packed:  # counted in pieces before scipy unpacks it whole
                    total += len(unpacker.decompress(packed, limits.CHUNK_BYTES))
                    refuse_large(total, path.name)
                    packed = unpacker.unconsumed_tail
            stream.seek(begin + size)
    try:
        listing = whosmat(path)
        # math.prod, since the sizes of a damaged file overflow the integers of numpy
        refuse_large(sum(8 * math.prod(map(int, shape)) for _, shape, kind in listing if kind in _NUMERIC), path.name)
        wanted = [name for name, _, kind in listing if kind in {*_NUMERIC, "struct", "cell", "char"}]
        found = loadmat(path, variable_names=wanted, simplify_cells=True) if wanted else {}
    except (ValueError, OSError, TypeError, IndexError, MemoryError, struct.error, zlib.error) as error:
        raise RecordingError(
            f"{path.name}: the MAT file is damaged, its elements do not have the sizes that they claim "
            f"({str(error)[:100]}); check that it is complete, or save it again"
        ) from error
    return {str(name): found.get(name) for name, _, _ in listing}


FORMATS = (
    Format("mat", (".mat",), read_binary, sheets=True),
    Format("hdf5", (".h5", ".hdf5"), read_binary, sheets=True),
)
