"""Invalid messages to a controller are counted by reason and never used."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import msgpack
import numpy as np
import pytest

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.messages import Applied, Command, CurrentProfile, Estimate, Manual, Message, Plan, RejectedFrame
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.references import Point
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.mailbox import Frame
from services.bus.message_validation import MessageValidator, rejection
from services.bus.schema import Schema, schema
from services.bus.topics import BY_KEY, BY_TYPE
from services.bus.wire import Header, WireError, crc, encode, unpack
from tests.services.bus.messages import EXAMPLES

PERIOD_NS = 300_000_000
READ = (Estimate, Applied, Command, Manual)
HERE_AT_ZERO = Point(north_m=0.0, east_m=0.0)


def estimate(k: int) -> Estimate:
    """Return an estimate with every field set, so that each can be damaged."""
    return Estimate(
        t_ns=k * PERIOD_NS,
        north_m=1.0 + 0.01 * k,
        east_m=-0.5,
        heading_rad=0.3,
        yaw_rate_radps=0.01,
        velocity_north_mps=0.02,
        velocity_east_mps=0.0,
        depth_m=5.0,
        velocity_down_mps=0.0,
        covariance=0.01 * np.eye(6),
        current=CurrentProfile(
            depth_m=np.arange(3.0), north_mps=np.full(3, 0.03), east_mps=np.zeros(3), sd_mps=np.full(3, 0.01)
        ),
    )


def example(kind: type[Message]) -> Message:
    return estimate(1000) if kind is Estimate else next(one for one in EXAMPLES if type(one) is kind)


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


class Listening:
    """Controller behind its message validation."""

    def __init__(self) -> None:
        self.node = ControllerNode(Vehicle.load("paper"), HERE_AT_ZERO, ControllerConfig())
        self.door = MessageValidator()
        self._inbox: list[ReceivedMessage] = []
        self.refused: list[RejectedFrame] = []

    def hear(self, key: str, payload: bytes, t_ns: int) -> None:
        """Receive a frame as ``services/runtime/runner.py`` does."""
        frame = Frame(BY_KEY[key], key, payload, 0)
        try:
            signal, header = self.door.validate(frame)
        except WireError as error:
            self.refused.append(rejection(frame, str(error), node="controller", t_ns=t_ns))
            return
        self._inbox.append(ReceivedMessage(signal, header.epoch, header.sequence, t_ns))

    def plan(self, t_ns: int) -> Plan:
        inbox, self._inbox = self._inbox, []
        (plan,) = (signal for signal in self.node.step(t_ns, inbox) if isinstance(signal, Plan))
        return plan


def as_bytes(plan: Plan) -> bytes:
    return encode(plan, Header(epoch=1, sequence=0))


ARM = msgpack.packb({"epoch": 7, "sequence": 0, "command_id": 1, "action": "arm"})


@pytest.mark.parametrize("kind", READ, ids=lambda kind: kind.__name__)
def test_no_field_that_is_wrong_changes_a_plan_and_each_is_counted_and_shown(kind: type[Message]) -> None:
    """Two controllers receive the same estimates, one also all damaged messages: their plans are equal to the bit."""
    quiet, beset = Listening(), Listening()
    key = BY_TYPE[kind].key
    bad = list(damaged(example(kind), Header(epoch=9, sequence=1_000_000)))
    assert len(bad) > 30
    share = -(-len(bad) // 10)
    for k in range(10):
        t_ns = k * PERIOD_NS
        good = encode(estimate(k), Header(epoch=9, sequence=k))
        for each in (quiet, beset):
            if k == 0:
                each.hear("command", ARM, t_ns)
            each.hear("estimate", good, t_ns)
        for one in bad[k * share : (k + 1) * share]:
            seen = len(beset.refused)
            beset.hear(key, one.payload, t_ns)
            assert len(beset.refused) == seen + 1, f"let in: {one.what}"
            assert beset.refused[-1].reason, one.what
            assert beset.refused[-1].crc == crc(one.payload)
        plans = [each.plan(t_ns) for each in (quiet, beset)]
        assert as_bytes(plans[0]) == as_bytes(plans[1])
        assert plans[0].origin == "solved"
    assert beset.door.rejected == len(bad) == beset.door.rejected_by_reason.total()
    assert beset.door.received == quiet.door.received
    assert quiet.door.rejected == 0
