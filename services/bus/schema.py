"""JSON Schema of each message as it travels and is recorded: the header's fields, then the signal's.

Every schema is an object and self-contained. Foxglove's reader of JSON schemas knows neither ``$ref`` nor ``null`` nor
an array in an array under ``properties``: it drops the whole channel. So a field that may be null and a matrix are
described under ``patternProperties``, by a pattern that only its own name matches: a validator checks all of it, and
Foxglove opens the channel and shows the field as it comes.
"""

from __future__ import annotations

from functools import cache
from inspect import cleandoc
from typing import Any, TypeAlias

import msgspec
import numpy as np
from msgspec import inspect as struct

from ltv_mpc.signals import Signal
from services.bus.wire import Header

Schema: TypeAlias = dict[str, Any]

NUMBER: Schema = {"type": "number"}
ROW: Schema = {"type": "array", "items": {"type": ["number", "null"]}}


@cache
def text(kind: type[Signal]) -> bytes:
    """The schema of ``kind`` on the wire, as JSON."""
    return msgspec.json.encode(schema(kind))


def schema(kind: type[Signal]) -> Schema:
    """JSON Schema (draft 2020-12) of the map that a message of ``kind`` is."""
    header = _struct(struct.type_info(Header))
    signal = _struct(struct.type_info(kind))
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": kind.__name__,
        "description": cleandoc(kind.__doc__ or ""),
        "type": "object",
        "properties": header["properties"] | signal["properties"],
        "patternProperties": signal["patternProperties"],
        "required": list(dict.fromkeys(header["required"] + signal["required"])),
        "additionalProperties": False,
    }


def _struct(info: struct.Type) -> Schema:
    if not isinstance(info, struct.StructType):
        raise TypeError(f"{info} is no message")
    described = {field.encode_name: _value(field.type) for field in info.fields}
    simple = {name: value for name, value in described.items() if _is_simple(value)}
    return {
        "type": "object",
        "properties": simple,
        "patternProperties": {f"^{name}$": value for name, value in described.items() if name not in simple},
        "required": list(described),  # the wire leaves nothing out: an absent value is null
        "additionalProperties": False,
    }


def _is_simple(value: Schema) -> bool:
    """Whether Foxglove takes it as a property: one type, and no array directly in an array."""
    return "type" in value and value.get("items", NUMBER)["type"] != "array"


def _value(info: struct.Type) -> Schema:
    match info:
        case struct.Metadata(type=inner, extra_json_schema=extra):
            value = _value(inner)
            items = (extra or {}).get("items")
            return value if items is None else value | {"items": ROW if items["type"] == "array" else items}
        case struct.BoolType():
            return {"type": "boolean"}
        case struct.IntType():
            return {"type": "integer"}
        case struct.FloatType():
            return NUMBER
        case struct.StrType():
            return {"type": "string"}
        case struct.EnumType(cls=cls):
            return {"type": "string", "enum": [member.value for member in cls]}
        case struct.CustomType(cls=cls) if cls is np.ndarray:
            return {"type": "array", "items": NUMBER}
        case struct.TupleType(item_types=items):
            return {"type": "array", "items": _value(items[0]), "minItems": len(items), "maxItems": len(items)}
        case struct.VarTupleType(item_type=item):
            return {"type": "array", "items": _value(item)}
        case struct.DictType(value_type=value):
            return {"type": "object", "properties": {}, "additionalProperties": _value(value)}
        case struct.StructType():
            return _struct(info)
        case struct.UnionType(types=types):
            return {"anyOf": [_value(t) for t in types]}
        case struct.NoneType():
            return {"type": "null"}
    raise NotImplementedError(f"{info} has no place in a message")
