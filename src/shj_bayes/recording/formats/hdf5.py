"""HDF5 files, and structs and cells of MATLAB, read in a process of its own, which a damaged one can end.

Found by fuzzing (``tests/fuzz``): about one damaged HDF5 file in a thousand ended the reader with a segmentation fault;
so do a few thousand cells in one another in scipy.
"""

import faulthandler
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from shj_bayes._util.processes import PYTHON, bound_memory, end_with_input, tether
from shj_bayes.errors import RecordingError
from shj_bayes.recording.formats.nested import Item, Stated, flat
from shj_bayes.recording.limits import (
    CHILD_BYTES,
    HDF5_BYTES_S,
    HDF5_SECONDS,
    MAX_BYTES,
    MAX_DEPTH,
    MAX_NESTED,
    MAX_PARTS,
)
from shj_bayes.recording.tables import refuse_large

_CHILD = "import sys; from shj_bayes.recording.formats.hdf5 import child; child(*sys.argv[1:])"
_NUMERIC = {"double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))}


def apart(path: Path, mark: str) -> Iterator[Item]:
    """Read a file in a process of its own: what it holds, with `mark` between the levels of its groups.

    `RecordingError` if the file cannot be read, or the library dies, hangs or takes too much memory over it.
    """
    broken = f"{path.name}: the library of its format cannot read it and gave up"
    advice = "check that the file is complete; export it again"
    seconds = HDF5_SECONDS + path.stat().st_size // HDF5_BYTES_S
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
            for group, name, unit, where, given in answer["items"]:
                values, times = (np.load(stream, allow_pickle=False) if there else None for there in given)
                yield Item(group, name, unit, values, times, where)
    except subprocess.TimeoutExpired as error:
        raise RecordingError(f"{broken} after {seconds} s; {advice}") from error


def child(path: str, mark: str, seconds: str) -> None:
    """Read a file and write what it holds to standard output: a line of names and units, then the arrays."""
    end_with_input()
    faulthandler.dump_traceback_later(int(seconds), exit=True)  # also where the library holds every other thread up
    items: list[Item] = []
    try:
        # What is loaded does not count against the bound, so that is first.
        from shj_bayes.recording.formats.binary import is_hdf5, loaded  # noqa: PLC0415

        read = from_hdf5 if is_hdf5(Path(path)) else loaded
        import_module("h5py" if read is from_hdf5 else "scipy.io")
        bound_memory(CHILD_BYTES)
        items = list(flat(read(Path(path)), mark))
        heads = [(i.group, i.name, i.unit, i.path, (i.values is not None, i.times is not None)) for i in items]
        answer: dict[str, Any] = {"items": heads}
    except RecordingError as error:
        answer = {"error": str(error)}
    except Exception as error:  # the library raises many kinds of errors for damaged files; all mean the same
        reason = f"{Path(path).name}: cannot be read ({type(error).__name__}: {str(error)[:160]})"
        answer = {"error": f"{reason}; check that the file is complete"}
    out = sys.stdout.buffer
    out.write(json.dumps(answer).encode() + b"\n")
    for item in items:
        for values in (item.values, item.times):
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
        tree: dict[str, Any] = _Tree(path.name, file).group(file, 0)
        numbers = ((k, v) for k, v in file.attrs.items() if isinstance(v, int | float | np.integer | np.floating))
        return tree | {key: np.asarray(value) for key, value in numbers if key not in tree}


class _Tree:
    """What an HDF5 file holds, gone through with its objects, their depth and their bytes counted."""

    def __init__(self, name: str, file: Any) -> None:
        self.name, self.file, self.parts, self.cells, self.bytes = name, file, 0, 0, 0
        self.seen: set[Any] = set()

    def group(self, group: Any, depth: int) -> Any:
        """Members of a group by hard links, each object once; an array of structs of MATLAB as the list of them."""
        import h5py  # noqa: PLC0415

        if depth > MAX_DEPTH:
            raise RecordingError(
                f"{self.name}: groups within groups, {depth} deep; allowed are {MAX_DEPTH}; export it again"
            )
        self._count(len(group))
        found: dict[str, Any] = {}
        for key in group:
            if key.startswith("#") or not isinstance(group.get(key, getlink=True), h5py.HardLink):
                continue
            item = group[key]
            place = h5py.h5o.get_info(item.id).addr
            if place in self.seen:
                continue
            self.seen.add(place)
            found[key] = self.group(item, depth + 1) if isinstance(item, h5py.Group) else self.dataset(item, depth)
        # The fields of an array of structs are references without a class, as many for each field.
        if "MATLAB_class" in group.attrs and found and all(_of_elements(group[key]) for key in found):
            lists = [value for value in found.values() if isinstance(value, list)]
            if len(lists) == len(found) and len(set(map(len, lists))) == 1:
                return [dict(zip(found, element, strict=True)) for element in zip(*lists, strict=True)]
        return found

    def dataset(self, item: Any, depth: int) -> Any:
        """Numbers of a dataset, columns of a table, text and cells of MATLAB; None for anything else."""
        import h5py  # noqa: PLC0415

        if not isinstance(item, h5py.Dataset) or item.external or item.is_virtual or item.shape is None:
            return None
        kind = item.attrs.get("MATLAB_class", b"")
        kind = kind.decode("ascii", "replace") if isinstance(kind, bytes) else str(kind)
        if item.dtype == h5py.ref_dtype:
            ours = kind == "cell" or (not kind and "MATLAB_class" in item.parent.attrs)
            return self._followed(item, depth) if ours else None
        # What is stored of an object of MATLAB is no numbers but places.
        if "MATLAB_empty" in item.attrs or not _numeric(item.dtype) or kind not in {"", "char", *_NUMERIC}:
            return None
        self.bytes += int(item.size or 0) * max(8, item.dtype.itemsize)
        refuse_large(self.bytes, self.name)
        self._chunks(item)
        if kind == "char":
            return "".join(chr(int(letter)) for letter in np.ravel(item[()])[:MAX_PARTS])
        if item.dtype.names:
            table = item[()]
            return {field: table[field] for field in item.dtype.names}
        return Stated(item[()], _unit(item))

    def _followed(self, item: Any, depth: int) -> Any:
        """Cells, or elements of an array of structs, which lie elsewhere in the same file."""
        import h5py  # noqa: PLC0415

        if depth > MAX_DEPTH:
            raise RecordingError(f"{self.name}: cells within cells, {depth} deep; allowed are {MAX_DEPTH}")
        self.cells += int(item.size or 0)
        if self.cells > MAX_NESTED:
            raise RecordingError(f"{self.name} holds more than {MAX_NESTED} cells; save its channels as vectors")
        read: list[Any] = []
        for reference in np.ravel(item[()]):
            cell = self.file[reference] if reference else None
            one = self.group(cell, depth + 1) if isinstance(cell, h5py.Group) else self.dataset(cell, depth + 1)
            read.append(one.values.ravel()[0] if isinstance(one, Stated) and one.values.size == 1 else one)
        if len(item.shape) == 2 and min(item.shape) > 1:
            table = np.empty(len(read), dtype=object)
            table[:] = read
            return table.reshape(item.shape)
        return read

    def _chunks(self, item: Any) -> None:
        """Refuse chunks that no recording has; what a chunk really unpacks to, the bound on the memory tells."""
        if item.chunks and int(np.prod([float(n) for n in item.chunks])) * item.dtype.itemsize > MAX_BYTES:
            raise RecordingError(f"{self.name}: chunks of {item.chunks} values; save it again with smaller ones")

    def _count(self, more: int) -> None:
        """Refuse more groups and datasets than any recording has."""
        self.parts += more
        if self.parts > MAX_PARTS:
            raise RecordingError(f"{self.name} holds more than {MAX_PARTS} groups and datasets; export fewer channels")


def _of_elements(item: Any) -> bool:
    """Whether a member of a group is a field of an array of structs."""
    return getattr(item, "dtype", None) is not None and item.dtype.kind == "O" and "MATLAB_class" not in item.attrs


def _numeric(kind: Any) -> bool:
    """Whether a dataset is plain numbers, or a table of them; references and objects are not."""
    kinds = [kind[name] for name in kind.names] if kind.names else [kind]
    return all(one.kind in "fiub" for one in kinds)


def _unit(item: Any) -> str | None:
    """Look for a unit among the attributes of a dataset."""
    for key in ("units", "unit", "Units", "Unit"):
        value = item.attrs.get(key)
        if isinstance(value, bytes):
            value = value.decode("utf-8", "replace")
        if isinstance(value, str) and value.strip():
            return value.strip()
    return None
