"""What is nested in a file - structs, cells, groups - as a flat list of channels."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from shj_bayes.recording.heads import is_unit_row, split_header
from shj_bayes.recording.recording import Finding
from shj_bayes.recording.tables import Column, as_floats, left_out

MAX_WIDTH = 64  # a matrix with more columns is an image or a state history, not channels
_VALUES = {"data", "values", "value", "y"}  # fields of a channel: its numbers, their times, what they are called
_TIMES = {"time", "times", "t"}
_NAMES = ("name", "label", "channel", "title")
_UNITS = ("units", "unit")
Numbers = np.ndarray[Any, Any]


@dataclass(frozen=True, eq=False)
class Stated:
    """Numbers with the unit that the file states beside them."""

    values: Numbers
    unit: str | None


@dataclass(frozen=True, eq=False)
class Item:
    """One thing that a file holds."""

    group: str  # what it lies in, with the marks of the file between the levels
    name: str
    unit: str | None = None
    values: Numbers | None = None  # vector, matrix or single number; None for what is no numbers
    times: Numbers | None = None  # times of the values, where they have their own
    path: str = ""  # where the numbers themselves lie, if not under the name

    def full(self, mark: str) -> str:
        """Path in the file."""
        return self.path or (f"{self.group}{mark}{self.name}" if self.group else self.name)


def shaped(values: Numbers) -> Numbers | None:
    """Vector, or matrix with the long side down; None for what is neither."""
    values = np.squeeze(values)
    if values.ndim <= 1:
        return values if values.size else None
    if values.ndim == 2:
        values = values if values.shape[0] >= values.shape[1] else values.T
        return values if values.shape[1] <= MAX_WIDTH else None
    return None


def flat(node: dict[str, Any], mark: str, group: str = "") -> Iterator[Item]:
    """Channels and whatever else lies in a nest of dictionaries, lists, arrays and texts, in its order.

    A struct of values alone, or of values with their times, is one channel, with the name and unit that it states. A
    list of texts beside a matrix of as many columns names them.
    """
    values = {key: _numbers(value) for key, value in node.items()}
    names, units = _titles(values)
    for key, value in values.items():
        if isinstance(value, dict):
            yield from _within(value, mark, group, key)
        elif isinstance(value, list):
            if not any(value is texts for texts in (names, units)):
                yield from _listed(value, mark, group, key, (names, units))
        elif not isinstance(value, Stated):
            yield Item(group, key)
        elif value.values.ndim == 2 and value.values.shape[1] == len(names):
            yield from _titled(_below(group, mark, key), names, units, value.values.T)
        else:
            yield Item(group, key, value.unit, value.values)


def _below(group: str, mark: str, key: str) -> str:
    return f"{group}{mark}{key}" if group else key


def _titled(group: str, names: list[str], units: list[str], columns: Iterable[Numbers]) -> Iterator[Item]:
    """Columns with the names and units that stand in lists of texts."""
    for title, unit, column in zip(names, units or ("",) * len(names), columns, strict=True):
        yield Item(group, title, unit or None, column)


def _listed(cells: list[Any], mark: str, group: str, key: str, titles: tuple[list[str], list[str]]) -> Iterator[Item]:
    """Elements of an array of structs, and cells."""
    inside = [_numbers(each) for each in cells]
    if len(titles[0]) == len(inside) and all(isinstance(each, Stated) for each in inside):
        yield from _titled(_below(group, mark, key), *titles, (each.values for each in inside))
    elif not any(isinstance(each, dict | Stated) for each in inside):
        yield Item(group, key)
    else:
        for number, each in enumerate(inside, start=1):
            if isinstance(each, dict):
                yield from _within(each, mark, group, f"{key}({number})")
            else:
                yield Item(group, f"{key}{{{number}}}", None, each.values if isinstance(each, Stated) else None)


def _within(node: dict[str, Any], mark: str, group: str, key: str) -> Iterator[Item]:
    """Go into a struct, which is one channel or holds several things."""
    path = _below(group, mark, key)
    vectors = {k: v for k, value in node.items() if isinstance(v := _numbers(value), Stated) and v.values.size > 1}
    data = [k for k in vectors if k.lower() in _VALUES]
    times = [k for k in vectors if k.lower() in _TIMES]
    if len(data) == 1 and len(times) == len(vectors) - 1 <= 1 and vectors[data[0]].values.ndim == 1:
        found = vectors[data[0]]
        clock = vectors[times[0]].values if times else None
        if clock is None or clock.shape == found.values.shape:
            said = {k.lower(): v.strip() for k, v in node.items() if isinstance(v, str) and v.strip()}
            name = next((said[k] for k in _NAMES if k in said), key)
            unit = found.unit or next((said[k] for k in _UNITS if k in said), None)
            yield Item(group, name, unit, found.values, clock, f"{path}{mark}{data[0]}")
            return
    yield from flat(node, mark, path)


def _numbers(value: Any) -> Any:
    """Numbers as `Stated`, cells of numbers too; cells of anything else as a list; the rest as it is."""
    if isinstance(value, np.ndarray) and value.dtype.kind == "O":
        value = _cells(value)
    if isinstance(value, list) and value and all(_single(each) for each in value):
        value = np.array([float(each) for each in value])
    if isinstance(value, np.ndarray) and value.dtype.kind == "U":
        return [str(text).strip() for text in np.ravel(value)] if value.ndim else str(value)
    if _single(value) or (isinstance(value, np.ndarray) and value.dtype.kind in "fiub"):
        value = Stated(np.asarray(value), None)
    if isinstance(value, Stated):
        plain = shaped(value.values)
        return None if plain is None else Stated(plain, value.unit)
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


def channels_of(items: Iterator[Item], mark: str) -> tuple[list[Column], dict[str, float], tuple[Finding, ...]]:
    """Columns for vectors and for each column of a matrix, single numbers, and what was left out."""
    columns, scalars, skipped = list[Column](), dict[str, float](), list[str]()
    for item in items:
        path = item.full(mark)
        if item.values is None:
            skipped.append(path)
        elif item.values.size == 1:
            scalars[path] = float(item.values.ravel()[0])
        else:
            plain, own = split_header(item.name)
            clock = None if item.times is None else as_floats(item.times)
            unit = item.unit or own
            if item.values.ndim == 1:
                columns.append(Column(plain, as_floats(item.values), unit, path, 0, item.group, clock, clock is None))
            else:
                columns += (
                    Column(f"{plain}[{i}]", as_floats(each), unit, f"{path}[{i}]", 0, item.group)
                    for i, each in enumerate(item.values.T, start=1)
                )
    return columns, scalars, left_out(skipped)
