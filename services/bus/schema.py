"""JSON Schema of each message as it travels and is recorded: the header's fields, then the signal's.

A field is required where nobody can do without it: a reader takes the rest as absent (this project's own writers leave
nothing out: there it is null). Numbers have the bounds of ``ltv_mpc/ranges.py``, beyond which a message is refused.

Every schema is an object and self-contained. Foxglove's reader of JSON schemas knows neither ``$ref`` nor ``null`` nor
an array in an array under ``properties``: it drops the whole channel. So a field that may be null and a matrix are
described under ``patternProperties``, by a pattern that only its own name matches: a validator checks all of it, and
Foxglove opens the channel and shows the field as it comes.
"""

from __future__ import annotations

from functools import cache
from inspect import cleandoc
from typing import Any, NamedTuple, TypeAlias

import msgspec
import numpy as np
from msgspec import inspect as struct

from ltv_mpc.messages import Message
from ltv_mpc.ranges import RANGES, Range
from services.bus.meanings import meaning
from services.bus.wire import HEADER_RANGES, Header

Schema: TypeAlias = dict[str, Any]


class Field(NamedTuple):
    """One entry of a message's map."""

    value: Schema
    required: bool
    range: Range | None  # of all its numbers


@cache
def text(kind: type[Message]) -> bytes:
    """The schema of ``kind`` on the wire, as JSON."""
    return msgspec.json.encode(schema(kind))


def schema(kind: type[Message]) -> Schema:
    """JSON Schema (draft 2020-12) of the map that a message of ``kind`` is."""
    about = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": kind.__name__,
        "description": cleandoc(kind.__doc__ or ""),
    }
    return about | _object(message(kind))


def message(kind: type[Message]) -> dict[str, Field]:
    """The entries of a message's map by name, the header's first."""
    # A step record's own epoch is its sender's: one entry.
    return fields(Header) | fields(kind)


def fields(kind: type) -> dict[str, Field]:
    """The entries of a signal, or of a struct inside one, without a header."""
    info = struct.type_info(kind)
    if not isinstance(info, struct.StructType):
        raise TypeError(f"{kind} is no message")
    ranges = HEADER_RANGES if kind is Header else RANGES.get(kind, {})
    found = {}
    for field in info.fields:
        name = field.encode_name
        value = _value(field.type, ranges.get(name))
        if words := meaning(kind, name):
            value = {"description": words} | value
        found[name] = Field(value, field.required, ranges.get(name))
    return found


def _object(found: dict[str, Field]) -> Schema:
    simple = {name: field.value for name, field in found.items() if _is_simple(field.value)}
    return {
        "type": "object",
        "properties": simple,
        "patternProperties": {f"^{name}$": field.value for name, field in found.items() if name not in simple},
        "required": [name for name, field in found.items() if field.required],
        "additionalProperties": False,
    }


def _is_simple(value: Schema) -> bool:
    """Whether Foxglove takes it as a property: one type, and no array or null directly in an array."""
    if "type" not in value:
        return False
    inside = value.get("items", {}).get("type")
    return inside != "array" and not isinstance(inside, list)


def _value(info: struct.Type, bounds: Range | None) -> Schema:
    match info:
        case struct.Metadata(type=inner, extra_json_schema=extra):
            return _array(inner, (extra or {}).get("items", {}).get("type", "number"), bounds)
        case struct.BoolType():
            return {"type": "boolean"}
        case struct.IntType():
            return {"type": "integer"} | _bounds(bounds)
        case struct.FloatType():
            return {"type": "number"} | _bounds(bounds)
        case struct.StrType():
            return {"type": "string"}
        case struct.EnumType(cls=cls):
            return {"type": "string", "enum": [member.value for member in cls]}
        case struct.CustomType(cls=cls) if cls is np.ndarray:
            return _array(info, "number", bounds)
        case struct.TupleType(item_types=items):
            item = _value(items[0], bounds)
            return {"type": "array", "items": item, "minItems": len(items), "maxItems": len(items)}
        case struct.VarTupleType(item_type=item):
            return {"type": "array", "items": _value(item, bounds)}
        case struct.DictType(value_type=value):
            return {"type": "object", "properties": {}, "additionalProperties": _value(value, bounds)}
        case struct.StructType(cls=cls):
            return _object(fields(cls))
        case struct.UnionType(types=types):
            return {"anyOf": [_value(t, bounds) for t in types]}
        case struct.NoneType():
            return {"type": "null"}
    raise NotImplementedError(f"{info} has no place in a message")


def _array(info: struct.Type, item: str, bounds: Range | None) -> Schema:
    """``item`` is "integer", "number" or, where the array is a matrix, "array"."""
    if not isinstance(info, struct.CustomType):
        raise NotImplementedError(f"{info} has no place in a message")
    # Without bounds of its own it may hold NaN, which means something there and travels as null.
    number: Schema = {"type": "number" if bounds else ["number", "null"]} | _bounds(bounds)
    inner = {"array": {"type": "array", "items": number}, "integer": {"type": "integer"} | _bounds(bounds)}
    return {"type": "array", "items": inner.get(item, number)}


def _bounds(bounds: Range | None) -> Schema:
    return {} if bounds is None else {"minimum": bounds.low, "maximum": bounds.high}
