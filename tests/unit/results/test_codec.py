"""Records are read as they were written, and what a field may not hold is told with its name."""

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Annotated, Any

import pytest
from made_diagnosis import record
from page_tools import OLD

from shj_bayes.results.codec import IF_KNOWN, Probability, WrongValueError, from_json, to_json
from shj_bayes.results.diagnosis import DiagnosisRecord
from shj_bayes.results.fit import FitRecord

FIT = json.loads((OLD / "fit.json").read_text(encoding="utf-8"))


@dataclass(frozen=True, kw_only=True)
class Sample:
    number: float
    count: int = 1
    share: Probability = 0.5
    class_: str = "a"
    pair: tuple[int, str] = (1, "x")
    some: Annotated[tuple[str, ...], {"minItems": 1}] = ("x",)
    hint: str | None = field(default=None, metadata=IF_KNOWN)
    more: Any = None


def places(value: Any, at: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Every value within a JSON value: its place, what holds it and under which key."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, part in list(pairs):
        name = f"{at}[{key}]" if isinstance(key, int) else f"{at}.{key}" if at else key
        yield name, value, key
        yield from places(part, name)


def test_what_is_written_is_read() -> None:
    one = Sample(number=1.5, pair=(2, "y"), more={"a": [1]})
    content = json.loads(json.dumps(to_json(one)))
    assert list(content) == ["number", "count", "share", "class", "pair", "some", "more"]
    assert from_json(Sample, content | {"of a later version": 1}) == one
    assert to_json(from_json(Sample, {"number": 2, "hint": "h"}))["hint"] == "h"
    for kind, held in ((FitRecord, FIT), (DiagnosisRecord, record("unknown", "d"))):
        again = from_json(kind, held)
        assert from_json(kind, json.loads(json.dumps(to_json(again)))) == again


@pytest.mark.parametrize(("held", "read"), [(1.0 + 2e-13, 1.0), (-1e-13, 0.0), (1e-124, 1e-124), (0.3, 0.3)])
def test_a_sum_that_rounding_took_past_its_bound_is_the_bound(held: float, read: float) -> None:
    assert from_json(Sample, {"number": 1.0, "share": held}).share == read


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"number": "1"}, "number is '1'; it must be a number"),
        ({"number": True}, "number is True; it must be a number"),
        ({"number": 10**400}, "it must be a number"),
        ({"count": 1.0}, "count is 1.0; it must be a whole number"),
        ({"share": 1.5}, "share is 1.5; it must be at most 1"),
        ({"share": math.nan}, "share is nan; it must be at least 0"),
        ({"class": None}, "class is None; it must be a text"),
        ({"pair": [1]}, "it must be a list of 2"),
        ({"pair": [1, 2]}, r"pair\[1\] is 2; it must be a text"),
        ({"some": []}, "it must be a list of 1 or more"),
    ],
)
def test_a_wrong_value_is_named_with_what_is_allowed(change: dict[str, Any], words: str) -> None:
    with pytest.raises(WrongValueError, match=words):
        from_json(Sample, {"number": 1.0} | change)


@pytest.mark.parametrize(("kind", "content"), [(FitRecord, FIT), (DiagnosisRecord, record("unknown", "d"))])
def test_no_field_of_a_file_holds_anything_else(kind: Any, content: dict[str, Any]) -> None:
    """Whatever stands in the place of a value is refused where it stands, or is passed over with its whole table."""
    known = to_json(from_json(kind, content))
    for name, holder, key in list(places(known)):
        kept, holder[key] = holder[key], [{"a": object()}]
        with pytest.raises(WrongValueError) as told:
            from_json(kind, known)
        assert str(told.value).startswith(name), name
        holder[key] = kept
    for key in ("schema", "verdict"):
        with pytest.raises(WrongValueError, match="it must be one of"):
            from_json(kind, known | {key: "else"})
