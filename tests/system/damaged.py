"""Messages with one fault each: a field missing, of another type, not a number, out of bounds or misspelt."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import msgpack

from ltv_mpc.messages import Message
from services.bus.schema import Schema, schema
from services.bus.wire import Header, encode, unpack


class Damaged(NamedTuple):
    """Frame and the description of its fault."""

    what: str
    payload: bytes


def damaged(signal: Message, header: Header) -> Iterator[Damaged]:
    """Yield the messages with one fault each that the schema of ``signal`` rules out; the rest of each is valid."""
    message = unpack(encode(signal, header))
    described = schema(type(signal))
    for path, value in _places(described, message, ()):
        yield Damaged(f"{'.'.join(map(str, path))} = {value!r}", _packed(message, path, value))
    for name in described["required"]:
        yield Damaged(f"{name} missing", msgpack.packb({k: v for k, v in message.items() if k != name}))
    yield Damaged("a field of another version", msgpack.packb(message | {"added_since": 1.0}))
    for payload in (b"", b"\xc1", msgpack.packb([message]), msgpack.packb(message)[:-1]):
        yield Damaged(f"{len(payload)} bytes of rubbish", payload)


def _packed(message: dict[str, Any], path: tuple[str | int, ...], value: Any) -> bytes:
    changed = copy.deepcopy(message)
    place: Any = changed
    for step in path[:-1]:
        place = place[step]
    place[path[-1]] = value
    payload: bytes = msgpack.packb(changed)
    return payload


def _places(described: Schema, value: Any, path: tuple[str | int, ...]) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    """Yield positions in a message, each with a value that its schema forbids; of an array only the last entry."""
    if "anyOf" in described:
        described = next(one for one in described["anyOf"] if (one["type"] == "null") == (value is None))
    yield from ((path, wrong) for wrong in _wrong(described))
    if isinstance(value, dict):
        found = described["properties"] | described.get("patternProperties", {})
        for name, inner in found.items():
            yield from _places(inner, value[name.strip("^$")], (*path, name.strip("^$")))
    elif isinstance(value, list) and value:
        yield from _places(described["items"], value[-1], (*path, len(value) - 1))


def _wrong(described: Schema) -> list[Any]:
    """Yield values of a wrong type and outside the bounds of ``described``."""
    if "type" not in described or described["type"] == "null":
        return []
    kind = described["type"]
    bounds = [described[name] for name in ("minimum", "maximum") if name in described]
    beyond = [bound + math.copysign(max(1, abs(bound) // 1000), -1 if i == 0 else 1) for i, bound in enumerate(bounds)]
    match kind:
        case "integer":
            return ["1", 0.5, True, math.nan, 2**63, *(int(x) for x in beyond)]
        case "number":
            return ["1", True, [], math.nan, math.inf, -math.inf, *beyond]
        case "string":
            return [1, None, *(["guessed"] if "enum" in described else [])]
        case "boolean":
            return [1, None, "yes"]
        case "array":
            return [1.0, "x", {}, [[[1.0]]]]
    return []
