"""Schemas of the messages, compared with the messages themselves and with the limits of Foxglove's reader."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import msgpack
import msgspec
import numpy as np
import pytest

from ltv_mpc.messages import (
    AdcpPing,
    BottomTrack,
    CurrentProfile,
    CycleTiming,
    Estimate,
    InboxEntry,
    Message,
    Plan,
    PlanOrigin,
    RecordedStep,
    Solve,
    SolveStatus,
    StepRecord,
)
from services.bus import schema, wire
from services.bus.topics import TOPICS

KINDS = [topic.message_type for topic in TOPICS]
HEADER = wire.Header(epoch=1, sequence=2, sent_monotonic_us=3)

PLAN = Plan(
    cycle_t_ns=-5,
    t_ns=np.array([0, 300_000_000]),
    thrust_N=np.array([[1.0, -2.5, 0.1], [1e-300, 2.0, 62.5]]),
    states=np.zeros((2, 6)),
    origin=PlanOrigin.SHIFTED,
    solve=Solve(status=SolveStatus.ITERATION_LIMIT, iterations=200),
)
ESTIMATE = Estimate.at_rest(north_m=1.5)
FULL_ESTIMATE = msgspec.structs.replace(
    ESTIMATE,
    depth_m=3.0,
    covariance=np.eye(6),
    current=CurrentProfile(depth_m=np.arange(3.0), north_mps=np.ones(3), east_mps=np.zeros(3), sd_mps=None),
)
BEAMS = BottomTrack(t_ns=1, range_m=np.array([1.0, np.nan, 3.0, 4.0]), beam_velocity_mps=np.array([0.1, np.nan, 0, 0]))
PING = AdcpPing(t_ns=1, range_m=np.array([1.0, 2.0]), beam_velocity_mps=np.array([[0.1, np.nan]] * 4))
TIMING = CycleTiming(t_ns=0, compute_ns=1, compute_wall_ns=2, estimate_age_ns=3, stage_us={"solve": 1.5})
RECORD = StepRecord(
    node="plant",
    epoch=1,
    step=2,
    steps=(
        RecordedStep(
            t_ns=0,
            cause="grid",
            inbox=(InboxEntry(key="plan", epoch=1, sequence=0, crc=4_000_000_000, received_t_ns=0),),
        ),
    ),
)


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


@pytest.mark.parametrize(
    "signal", [PLAN, ESTIMATE, FULL_ESTIMATE, PING, BEAMS, TIMING, RECORD], ids=lambda signal: type(signal).__name__
)
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
    message = wire.to_map(PLAN, HEADER) | change
    found = problems(message, schema.schema(Plan))
    assert found
    assert problem in found[0]


@pytest.mark.parametrize("signal", [PLAN, FULL_ESTIMATE, RECORD], ids=lambda signal: type(signal).__name__)
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


def numbers_at_their_bounds(kind: type[Message]) -> Iterator[tuple[str, str, Any]]:
    """Field, which bound, and the bound, of every number that stands alone."""
    for name, field in schema.message(kind).items():
        for bound in ("minimum", "maximum"):
            if bound in field.value:
                yield name, bound, field.value[bound]


@pytest.mark.parametrize("signal", [PLAN, ESTIMATE], ids=lambda signal: type(signal).__name__)
def test_the_bounds_of_the_schema_are_those_of_the_door(signal: Message) -> None:
    kind = type(signal)
    message = wire.unpack(wire.encode(signal, HEADER))
    seen = 0
    for name, bound, value in numbers_at_their_bounds(kind):
        beyond = value + (1 if bound == "maximum" else -1) * max(1, abs(value) // 1000)
        assert problems(message | {name: value}, schema.schema(kind)) == []
        assert problems(message | {name: beyond}, schema.schema(kind)) != []
        wire.from_map(kind, message | {name: value})
        with pytest.raises(wire.WireError, match=name):
            wire.from_map(kind, message | {name: beyond})
        seen += 1
    assert seen >= 12


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
