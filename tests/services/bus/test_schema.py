"""Schemas of the messages, compared with the messages themselves and with the limits of Foxglove's reader."""

from __future__ import annotations

import re
from typing import Any

import msgpack
import msgspec
import pytest

from ltv_mpc.messages import Estimate, Message, Plan
from services.bus import schema, wire
from services.bus.topics import TOPICS
from tests.services.bus.messages import EXAMPLES, HEADER

KINDS = [topic.message_type for topic in TOPICS]
PLAN = next(one for one in EXAMPLES if isinstance(one, Plan))
ESTIMATES = [one for one in EXAMPLES if isinstance(one, Estimate)]


def problems(value: Any, schema: dict[str, Any], at: str = "$") -> list[str]:
    """Return the violations of ``schema`` by ``value``, for the keywords that the schemas use."""
    if "anyOf" in schema:
        found = [problems(value, one, at) for one in schema["anyOf"]]
        return [] if [] in found else [problem for one in found for problem in one]
    allowed = schema["type"] if isinstance(schema["type"], list) else [schema["type"]]
    is_type = {
        "null": value is None,
        "boolean": isinstance(value, bool),
        "integer": type(value) is int,
        "number": type(value) in (int, float),
        "string": isinstance(value, str),
        "array": isinstance(value, list),
        "object": isinstance(value, dict),
    }
    if not any(is_type[name] for name in allowed):
        return [f"{at}: {value!r} is no {allowed}"]
    if "enum" in schema and value not in schema["enum"]:
        return [f"{at}: {value!r} not in {schema['enum']}"]
    if is_type["number"] and not schema.get("minimum", value) <= value <= schema.get("maximum", value):
        return [f"{at}: {value!r} is out of bounds"]
    if isinstance(value, list):
        if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value)):
            return [f"{at}: {len(value)} items"]
        return [p for i, x in enumerate(value) for p in problems(x, schema["items"], f"{at}[{i}]")]
    if isinstance(value, dict):
        missing = [f"{at}.{name} is missing" for name in schema.get("required", ()) if name not in value]
        return missing + [p for name, x in value.items() for p in problems_of_field(name, x, schema, at)]
    return []


def problems_of_field(name: str, value: Any, schema: dict[str, Any], at: str) -> list[str]:
    found = [schema["properties"][name]] if name in schema["properties"] else []
    found += [s for pattern, s in schema.get("patternProperties", {}).items() if re.search(pattern, name)]
    extra = schema.get("additionalProperties", True)
    if not found and extra is False:
        return [f"{at}.{name} is unknown"]
    if not found and isinstance(extra, dict):
        found = [extra]
    return [p for one in found for p in problems(value, one, f"{at}.{name}")]


@pytest.mark.parametrize("signal", EXAMPLES, ids=lambda signal: type(signal).__name__)
def test_a_message_as_it_is_recorded_obeys_its_schema(signal: Message) -> None:
    recorded = msgspec.json.decode(msgspec.json.encode(wire.to_map(signal, HEADER)))
    assert problems(recorded, msgspec.json.decode(schema.text(type(signal)))) == []


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"origin": "guessed"}, "not in"),
        ({"t_ns": [0.5, 1]}, "t_ns[0]"),
        ({"states": [[None] * 6] * 2}, "states[0][0]"),
        ({"thrust_N": [[1e7, 0, 0]] * 2}, "thrust_N[0][0]"),
        ({"thrust_N": [1.0, 2.0]}, "thrust_N[0]"),
        ({"reference_m": [1.0]}, "1 items"),
        ({"cycle_t_ns": None}, "cycle_t_ns"),
        ({"sequence": "0"}, "sequence"),
        ({"thrust_kN": 1.0}, "unknown"),
    ],
)
def test_a_message_that_is_not_what_it_should_be_breaks_its_schema(change: dict[str, Any], problem: str) -> None:
    message = wire.unpack(wire.encode(PLAN, HEADER)) | change
    found = problems(message, schema.schema(Plan))
    assert found
    assert problem in found[0]


@pytest.mark.parametrize("signal", [PLAN, ESTIMATES[1]], ids=lambda signal: type(signal).__name__)
def test_the_schema_makes_optional_what_the_decoder_does_not_need(signal: Message) -> None:
    kind = type(signal)
    message = wire.unpack(wire.encode(signal, HEADER))
    for name in list(message):
        rest = {k: v for k, v in message.items() if k != name}
        try:
            wire.from_map(kind, rest)
        except wire.WireError:
            assert problems(rest, schema.schema(kind)) == [f"$.{name} is missing"]
        else:
            assert problems(rest, schema.schema(kind)) == []


def test_an_estimate_needs_time_position_heading_yaw_rate_and_velocity_alone() -> None:
    least = ("t_ns", "north_m", "east_m", "heading_rad", "yaw_rate_radps", "velocity_north_mps", "velocity_east_mps")
    assert schema.schema(Estimate)["required"] == ["epoch", "sequence", *least]
    message = {"epoch": 1, "sequence": 0, **dict.fromkeys(least, 0)}
    decoded, _ = wire.decode(Estimate, msgpack.packb(message))
    assert (decoded.depth_m, decoded.velocity_down_mps, decoded.covariance, decoded.current) == (None,) * 4


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
        assert problems(message | {name: value}, schema.schema(kind)) == []
        assert problems(message | {name: beyond}, schema.schema(kind)) != []
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
