"""Records to JSON and back by the types of their fields.

A record is a frozen dataclass of texts, numbers, truth values, literals, enumerations of texts, tuples, mappings from
texts, other records, each of them ``| None``, and ``Any``. ``Annotated[kind, {"minimum": 0}]`` bounds a value, in the
words of JSON Schema. An array is itself: `results.store` puts arrays beside a file. A field with a default may be
missing in a file; what a file holds beside the fields is no fault.
"""

import math
import re
import types
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from enum import StrEnum
from functools import cache
from typing import Annotated, Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from shj_bayes.errors import ReportError, ShjError, shown

IF_KNOWN = {"if_known": True}  # metadata of a field that is written only where it is not None
ROUNDING = 1e-9  # by which a sum of probabilities may pass its bound
LARGEST = 2**1000  # of whole numbers in the place of a number: larger ones are none in double precision
Probability = Annotated[float, {"minimum": 0, "maximum": 1}]
ProbabilityOrNone = Annotated[float | None, {"minimum": 0, "maximum": 1}]
WORDS: dict[Any, str] = {
    **{str: "a text", int: "a whole number", float: "a number", bool: "true or false"},
    **{list: "a list", dict: "a table"},
}
Record = TypeVar("Record")


class WrongValueError(ValueError):
    """A value of a file is not what its field may hold; the message names both."""


class Stored:
    """A record that has a file of its own in a folder of results."""

    FILE: ClassVar[str]
    ERROR: ClassVar[type[ShjError]]  # of a file that is missing, damaged, altered or of another schema
    COMMAND: ClassVar[str]  # that writes it

    def __init_subclass__(cls, *, file: str, command: str, error: type[ShjError] = ReportError) -> None:
        """Name the file, the command that writes it, and the error."""
        cls.FILE, cls.COMMAND, cls.ERROR = file, command, error


def to_json(value: Any) -> Any:
    """Record as values that JSON holds, its fields in their order."""
    if value is None or type(value) in (str, float, int, bool):
        return value
    if is_dataclass(value):
        own = ((key, getattr(value, name), bare) for key, name, _, _, bare in fields_of(value.__class__))
        return {key: to_json(part) for key, part, bare in own if part is not None or not bare}
    if isinstance(value, Mapping):
        return {key: to_json(part) for key, part in value.items()}
    if isinstance(value, tuple | list):
        return [to_json(part) for part in value]
    return value.value if isinstance(value, StrEnum) else value


def finite(value: Any) -> Any:
    """Values with infinities and NaN as None, which JSON can hold."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, str | int):
        return value
    return {k: finite(part) for k, part in value.items()} if isinstance(value, Mapping) else tuple(map(finite, value))


def from_json(kind: type[Record], content: Any) -> Record:
    """Record from values that JSON holds; `WrongValueError` names the field, what it holds and what it may hold."""
    return _value(kind, content, "")  # type: ignore[no-any-return]


def form_of(kind: Any) -> tuple[Any, tuple[Any, ...]]:
    """Which way a kind is read, and the kinds within it; ``Literal`` and enumerations are alike."""
    origin, args = get_origin(kind), get_args(kind)
    if isinstance(kind, type) and issubclass(kind, StrEnum):
        return Literal, tuple(one.value for one in kind)
    if is_dataclass(kind):
        return "record", ()
    return (Union if origin is types.UnionType else origin or kind), args


def _value(kind: Any, value: Any, at: str) -> Any:
    """Value of a kind; `at` says which part of the record it is."""
    form, args = form_of(kind)
    if form in _READERS:
        return _READERS[form](kind, args, value, at)
    if kind is float and type(value) is int and abs(value) < LARGEST:
        return float(value)
    if form is not kind and isinstance(value, form):  # an array, which stood beside the file
        return value
    return _of(kind, value, at)


def _of(kind: Any, value: Any, at: str) -> Any:
    if type(value) is not kind:
        raise _wrong(value, WORDS[kind], at)
    return value


def _wrong(value: Any, allowed: str, at: str) -> WrongValueError:
    return WrongValueError(f"{at or 'it'} is {shown(value)}; it must be {allowed}")


@cache
def fields_of(kind: Any) -> tuple[tuple[str, str, bool, Any, bool], ...]:
    """Fields that files hold: key, name, whether it must be there, type, whether it is written only where not None.

    A field ``class_`` has the key ``class``, one with ``metadata["key"]`` that one.
    """
    hints = get_type_hints(kind, include_extras=True)
    return tuple(
        (key, f.name, f.default is MISSING and f.default_factory is MISSING, hints[f.name], "if_known" in f.metadata)
        for f in fields(kind)
        for key in [f.metadata.get("key", f.name.rstrip("_"))]
    )


def _record(kind: Any, _args: Any, value: Any, at: str) -> Any:
    content, given = _of(dict, value, at), {}
    for key, name, needed, hint, _ in fields_of(kind):
        if key in content:
            given[name] = _value(hint, content[key], f"{at}.{key}" if at else key)
        elif needed:
            raise WrongValueError(f"{at or 'it'} lacks {key}")
    return kind(**given)


def _one_of(kind: Any, words: tuple[str, ...], value: Any, at: str) -> Any:
    if not isinstance(value, str) or value not in words:
        raise _wrong(value, f"one of {', '.join(words) or 'none'}", at)
    return kind(value) if isinstance(kind, type) else value


def _items(_: Any, args: tuple[Any, ...], value: Any, at: str) -> Any:
    values = _of(list, value, at)
    kinds = (args[0],) * len(values) if args[-1] is Ellipsis else args
    if len(values) != len(kinds):
        raise _wrong(values, f"a list of {len(kinds)}", at)
    return tuple(_value(one, part, f"{at}[{i}]") for i, (one, part) in enumerate(zip(kinds, values, strict=True)))


def _bounded(_: Any, args: tuple[Any, ...], given: Any, at: str) -> Any:
    value, bounds = _value(args[0], given, at), args[1]
    for word, (allowed, kept) in _BOUNDS.items():
        bound = bounds.get(word)
        if None in (value, bound) or kept(value, bound):
            continue
        if not (isinstance(value, float) and abs(value - bound) < ROUNDING):
            raise _wrong(given, allowed.format(", ".join(bound) if isinstance(bound, tuple) else bound), at)
        value = float(bound)
    return value


_BOUNDS: dict[str, tuple[str, Callable[[Any, Any], bool]]] = {
    "minimum": ("at least {}", lambda value, least: value >= least),
    "maximum": ("at most {}", lambda value, most: value <= most),
    "minItems": ("a list of {} or more", lambda value, n: len(value) >= n),
    "enum": ("one of {}", lambda value, words: value in words),
    "pattern": ("a text like {}", lambda value, pattern: re.search(pattern, value) is not None),
}
_READERS: dict[Any, Callable[..., Any]] = {
    Any: lambda _kind, _args, value, _at: value,
    Annotated: _bounded,
    Union: lambda _, args, value, at: None if value is None else _value(args[0], value, at),
    Literal: _one_of,
    tuple: _items,
    **dict.fromkeys(
        (Mapping, dict),
        lambda _, args, value, at: {
            key: _value(args[1], part, f"{at}.{key}") for key, part in _of(dict, value, at).items()
        },
    ),
    "record": _record,
}
