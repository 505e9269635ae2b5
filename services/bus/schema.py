"""JSON Schema of each message on the wire and in a recording: the header's fields, then the message's.

A field is required if no reader can do without it; any other field may be absent or null. This project's writers leave
no field out and write null. Types and bounds are the annotations of ``ltv_mpc/messages.py``, meanings the docstrings
below its fields; a message outside its bounds is rejected.

Every schema is an object and self-contained. Foxglove's reader of JSON schemas supports neither ``$ref`` nor ``null``
nor an array of arrays under ``properties``: it drops the whole channel. A field that may be null, or that is a
matrix, is therefore described under ``patternProperties``, by a pattern that matches only its name. A validator still
checks it, and Foxglove opens the channel and shows the field as received.
"""

from __future__ import annotations

import ast
import itertools
import sys
from functools import cache
from inspect import cleandoc, getsource
from typing import Any, NamedTuple, TypeAlias

import msgspec
from msgspec import inspect as struct

from ltv_mpc.messages import Message
from ltv_mpc.validation import Bounds, bounds, plain_type
from services.bus.wire import Header

Schema: TypeAlias = dict[str, Any]


class Field(NamedTuple):
    """Entry of a message's map."""

    value: Schema
    required: bool
    bounds: Bounds | None  # of all its numbers


@cache
def text(kind: type[Message]) -> bytes:
    """Return the schema of a message type as JSON."""
    return msgspec.json.encode(schema(kind))


def schema(kind: type[Message]) -> Schema:
    """Return the JSON Schema (draft 2020-12) of a message type's map."""
    about = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": kind.__name__,
        "description": cleandoc(kind.__doc__ or ""),
    }
    return about | _object(message(kind))


def message(kind: type[Message]) -> dict[str, Field]:
    """Return the entries of a message's map by name, the header's first."""
    # A step record's own epoch is its sender's: one entry.
    return fields(Header) | fields(kind)


def fields(kind: type) -> dict[str, Field]:
    """Return the entries of a message, or of a struct inside one, without the header."""
    info = struct.type_info(kind)
    if not isinstance(info, struct.StructType):
        raise TypeError(f"{kind} is not a message")
    limits, meanings = bounds(kind), _meanings(kind.__module__)
    return {
        field.name: Field(
            meanings.get((kind.__name__, field.name), {}) | _value(field.type),
            field.required,
            limits.get(field.name),
        )
        for field in info.fields
    }


@cache
def _meanings(module: str) -> dict[tuple[str, str], Schema]:
    """Return the docstring below each field of the classes in a module, by the names of class and field."""
    meanings = {}
    nodes = ast.walk(ast.parse(getsource(sys.modules[module])))
    for one in (node for node in nodes if isinstance(node, ast.ClassDef)):
        for field, below in itertools.pairwise(one.body):
            match field, below:
                case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(meaning))):
                    meanings[one.name, name] = {"description": " ".join(meaning.split())}
    return meanings


def _object(entries: dict[str, Field]) -> Schema:
    simple = {name: field.value for name, field in entries.items() if _is_simple(field.value)}
    return {
        "type": "object",
        "properties": simple,
        "patternProperties": {f"^{name}$": field.value for name, field in entries.items() if name not in simple},
        "required": [name for name, field in entries.items() if field.required],
        "additionalProperties": False,
    }


def _is_simple(value: Schema) -> bool:
    """Return True if Foxglove accepts it as a property: one type, and no array or null directly in an array."""
    if "type" not in value:
        return False
    inside = value.get("items", {}).get("type")
    return inside != "array" and not isinstance(inside, list)


def _value(field_type: struct.Type) -> Schema:
    match plain_type(field_type):
        case struct.BoolType():
            return {"type": "boolean"}
        case struct.IntType(ge=low, le=high):
            return {"type": "integer", "minimum": low, "maximum": high}
        case struct.FloatType(ge=low, le=high):
            return {"type": "number", "minimum": low, "maximum": high}
        case struct.StrType(max_length=most):
            return {"type": "string"} | ({} if most is None else {"maxLength": most})
        case struct.EnumType(cls=cls):
            return {"type": "string", "enum": [member.value for member in cls]}
        case struct.TupleType(item_types=items):
            return {"type": "array", "items": _value(items[0]), "minItems": len(items), "maxItems": len(items)}
        case struct.VarTupleType(item_type=item, max_length=most):
            return {"type": "array", "items": _value(item)} | ({} if most is None else {"maxItems": most})
        case struct.ListType(item_type=item):
            return {"type": "array", "items": _number_or_null(item)}
        case struct.DictType(value_type=value):
            return {"type": "object", "properties": {}, "additionalProperties": _value(value)}
        case struct.StructType(cls=cls):
            return _object(fields(cls))
        case struct.UnionType(types=types):
            return {"anyOf": [_value(member) for member in types]}
        case struct.NoneType():
            return {"type": "null"}
    raise NotImplementedError(f"{field_type} is not a type that a message can hold")


def _number_or_null(field_type: struct.Type) -> Schema:
    """Describe an entry of an array: a number, or a number or null where a value may be missing."""
    if not isinstance(field_type, struct.UnionType):
        return _value(field_type)
    (number,) = (_value(member) for member in field_type.types if not isinstance(member, struct.NoneType))
    return number | {"type": [number["type"], "null"]}


def unit(field: Field) -> str:
    """Return unit and bounds, as in ``m, +-1e+06`` or ``m, -100 to 12000``; empty without bounds."""
    if field.bounds is None:
        return ""
    low, high = field.bounds.low, field.bounds.high
    return f"{field.bounds.unit}, " + (f"+-{_bound(high)}" if low == -high else f"{_bound(low)} to {_bound(high)}")


def _bound(bound: float) -> str:
    """Format a bound; limits of integers are written as powers of two."""
    for power in (48, 53, 63):
        if abs(bound) == 2**power - 1:
            return f"{'-' if bound < 0 else ''}(2^{power}-1)"
    return f"{bound:g}"


def words(value: Schema) -> str:
    """Describe the type of a field, as in ``3 x number`` or ``list of lists of number or null``."""
    if "anyOf" in value:
        return " or ".join(words(x) for x in value["anyOf"])
    if "enum" in value:
        return " | ".join(value["enum"])
    kind = value["type"]
    if isinstance(kind, list):
        return " or ".join(kind)
    if kind == "array":
        many = f"{value['minItems']} x" if "minItems" in value else "list of"
        return f"{many} {words(value['items'])}"
    if kind == "object":
        names = [*value.get("properties", ()), *(name.strip("^$") for name in value.get("patternProperties", ()))]
        return f"map of {', '.join(names)}" if names else "map"
    return str(kind)
