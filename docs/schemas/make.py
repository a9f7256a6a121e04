"""Write the JSON Schemas of the files of results, from the records that they are read into."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Union

from shj_bayes.margins.files import MarginsRecord
from shj_bayes.planning.plan import PlanRecord
from shj_bayes.population.results import PopulationRecord
from shj_bayes.results.campaign import CampaignRecord
from shj_bayes.results.codec import fields_of, form_of
from shj_bayes.results.diagnosis import DiagnosisRecord, LeftOver
from shj_bayes.results.fit import FitRecord, SummaryRecord

TYPES: dict[Any, str] = {str: "string", int: "integer", float: "number", bool: "boolean"}
RECORDS: tuple[Any, ...] = (
    *(FitRecord, SummaryRecord, LeftOver, DiagnosisRecord, CampaignRecord, PopulationRecord, MarginsRecord, PlanRecord),
)


def schema_of(kind: Any) -> dict[str, Any]:
    """JSON Schema of what `from_json` reads as this kind; a description is the one of a field's ``Annotated``."""
    form, args = form_of(kind)
    return _SCHEMAS[form](kind, args) if form in _SCHEMAS else {"type": TYPES[kind]}


def _record_schema(kind: Any, _: Any) -> dict[str, Any]:
    stored = fields_of(kind)
    required = [key for key, _, needed, *_ in stored if needed or key == "schema"]
    of_fields = {key: schema_of(hint) for key, _, _, hint, _ in stored}
    return {"type": "object", "required": required, "properties": of_fields}


def _optional_schema(_: Any, kinds: tuple[Any, ...]) -> dict[str, Any]:
    own = schema_of(kinds[0])
    return own | {"type": [own["type"], "null"]} if "type" in own else {"anyOf": [own, {"type": "null"}]}


def _list_schema(_: Any, args: tuple[Any, ...]) -> dict[str, Any]:
    if args[-1] is Ellipsis:
        return {"type": "array", "items": schema_of(args[0])}
    return {"type": "array", "items": schema_of(args[0]), "minItems": len(args), "maxItems": len(args)}


_SCHEMAS: dict[Any, Callable[..., dict[str, Any]]] = {
    Any: lambda _kind, _args: {},
    Annotated: lambda _, args: schema_of(args[0]) | args[1],
    Union: _optional_schema,
    Literal: lambda _, words: {"enum": [*words]},
    tuple: _list_schema,
    Mapping: lambda _, args: {"type": "object", "additionalProperties": schema_of(args[1])},
    "record": _record_schema,
}


def texts() -> dict[str, str]:
    """Text of each schema by the name of its file."""
    out = {}
    for kind in RECORDS:
        described = {"title": kind.__doc__.splitlines()[0].replace("`", "").rstrip(".")} | schema_of(kind)
        out[kind.FILE.replace(".json", ".schema.json")] = json.dumps(described, indent=1) + "\n"
    return out


if __name__ == "__main__":
    for name, text in texts().items():
        (Path(__file__).parent / name).write_text(text, encoding="utf-8")
