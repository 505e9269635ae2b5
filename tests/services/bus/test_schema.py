"""Schemas of the messages, compared with the messages themselves and with the limits of Foxglove's reader."""

from __future__ import annotations

import contextlib
import re
from typing import Any

import msgspec
import pytest

from ltv_mpc.messages import Estimate, Message, Plan
from services.bus import schema, wire
from services.bus.topics import TOPICS
from tests.services.bus.messages import EXAMPLES, HEADER

KINDS = [topic.message_type for topic in TOPICS]
PLAN = next(one for one in EXAMPLES if isinstance(one, Plan))
ESTIMATES = [one for one in EXAMPLES if isinstance(one, Estimate)]


TYPES: dict[str, Any] = {
    "null": type(None),
    "boolean": bool,
    "integer": int,
    "number": (int, float),
    "string": str,
    "array": list,
    "object": dict,
}


def obeys(value: Any, described: schema.Schema) -> bool:
    """Return True if a value obeys a schema, for the keywords that the schemas use."""
    if "anyOf" in described:
        return any(obeys(value, one) for one in described["anyOf"])
    kinds = described["type"] if isinstance(described["type"], list) else [described["type"]]
    if not any(isinstance(value, TYPES[kind]) and isinstance(value, bool) == (kind == "boolean") for kind in kinds):
        return False
    if isinstance(value, int | float) and not described.get("minimum", value) <= value <= described.get(
        "maximum", value
    ):
        return False
    if isinstance(value, list):
        fits = described.get("minItems", 0) <= len(value) <= described.get("maxItems", len(value))
        return fits and all(obeys(one, described["items"]) for one in value)
    if isinstance(value, dict):
        complete = set(described.get("required", ())) <= set(value)
        return complete and all(field_obeys(name, one, described) for name, one in value.items())
    return value in described.get("enum", [value])


def field_obeys(name: str, value: Any, described: schema.Schema) -> bool:
    patterns = described.get("patternProperties", {})
    found = [described["properties"][name]] if name in described["properties"] else []
    found += [one for pattern, one in patterns.items() if re.search(pattern, name)]
    if not found and isinstance(extra := described.get("additionalProperties", True), dict):
        found = [extra]
    elif not found:
        return extra
    return all(obeys(value, one) for one in found)


@pytest.mark.parametrize("signal", EXAMPLES, ids=lambda signal: type(signal).__name__)
def test_a_message_as_it_is_recorded_obeys_its_schema(signal: Message) -> None:
    recorded = msgspec.json.decode(msgspec.json.encode(wire.to_map(signal, HEADER)))
    assert obeys(recorded, msgspec.json.decode(schema.text(type(signal))))


@pytest.mark.parametrize(
    "change",
    [
        {"origin": "guessed"},
        {"t_ns": [0.5, 1]},
        {"states": [[None] * 6] * 2},
        {"thrust_N": [[1e7, 0, 0]] * 2},
        {"thrust_N": [1.0, 2.0]},
        {"reference_m": [1.0]},
        {"cycle_t_ns": None},
        {"sequence": "0"},
        {"thrust_kN": 1.0},
    ],
)
def test_a_message_that_is_not_what_it_should_be_breaks_its_schema(change: dict[str, Any]) -> None:
    message = wire.unpack(wire.encode(PLAN, HEADER))
    assert obeys(message, schema.schema(Plan))
    assert not obeys(message | change, schema.schema(Plan))


@pytest.mark.parametrize("signal", [PLAN, ESTIMATES[1]], ids=lambda signal: type(signal).__name__)
def test_the_schema_makes_optional_what_the_decoder_does_not_need(signal: Message) -> None:
    kind = type(signal)
    message = wire.unpack(wire.encode(signal, HEADER))
    for name in list(message):
        rest = {k: v for k, v in message.items() if k != name}
        needed = name in schema.schema(kind)["required"]
        assert obeys(rest, schema.schema(kind)) != needed
        with pytest.raises(wire.WireError, match=name) if needed else contextlib.nullcontext():
            wire.from_map(kind, rest)


@pytest.mark.parametrize("signal", [PLAN, ESTIMATES[0]], ids=lambda signal: type(signal).__name__)
def test_the_bounds_of_the_schema_are_those_of_the_door(signal: Message) -> None:
    kind = type(signal)
    message = wire.unpack(wire.encode(signal, HEADER))
    numbers = [
        (name, bound, field.value[bound])
        for name, field in schema.message(kind).items()
        for bound in ("minimum", "maximum")
        if bound in field.value
    ]
    assert len(numbers) >= 12
    for name, bound, value in numbers:
        beyond = value + (1 if bound == "maximum" else -1) * max(1, abs(value) // 1000)
        assert obeys(message | {name: value}, schema.schema(kind))
        assert not obeys(message | {name: beyond}, schema.schema(kind))
        wire.from_map(kind, message | {name: value})
        with pytest.raises(wire.WireError, match=name):
            wire.from_map(kind, message | {name: beyond})


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_foxgloves_reader_takes_every_schema(kind: type[Message]) -> None:
    """Its rules, as read in packages/mcap-support/src/parseJsonSchema.ts of foxglove/studio 1.87."""

    def takes(value: dict[str, Any]) -> bool:
        if value["type"] == "object":
            return all(takes(one) for one in value["properties"].values())
        if value["type"] == "array":
            return value["items"]["type"] != "array" and takes(value["items"])
        return value["type"] in ("boolean", "string", "number", "integer")

    described = msgspec.json.decode(schema.text(kind))
    assert described["type"] == "object"
    assert takes(described)
    assert b"$ref" not in schema.text(kind)
