"""Invalid messages to a controller are counted by reason, visible and never used."""

from __future__ import annotations

import json
import time
from collections import Counter
from pathlib import Path

import msgpack
import msgspec
import numpy as np
import pytest

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.messages import (
    Applied,
    Command,
    ControllerStatus,
    CurrentProfile,
    Estimate,
    Manual,
    Message,
    Plan,
    RejectedFrame,
)
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.references import Point
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.mailbox import Frame, Mailbox
from services.bus.message_validation import MessageValidator, rejection
from services.bus.options import BusOptions
from services.bus.outbox import Outbox
from services.bus.session import open_session
from services.bus.topics import BY_KEY, BY_TYPE
from services.bus.wire import Header, WireError, crc, decode, encode
from services.cli.app import run
from services.runtime.stopping import StopRequest
from services.supervisor import loopback
from tests.services.bus.messages import EXAMPLES
from tests.system.alone import controller
from tests.system.damaged import damaged

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


def test_an_estimate_out_of_order_doubled_or_of_another_source_changes_no_plan() -> None:
    quiet, beset = Listening(), Listening()
    wrong = msgspec.structs.replace(estimate(3), north_m=500.0)
    for each in (quiet, beset):
        each.hear("command", ARM, 0)
        each.hear("estimate", encode(estimate(2), Header(epoch=9, sequence=4)), 0)
    for sequence in (4, 3):
        beset.hear("estimate", encode(wrong, Header(epoch=9, sequence=sequence)), 0)
        assert "out of order" in beset.refused[-1].reason
    beset.hear("estimate", encode(wrong, Header(epoch=8, sequence=51)), 0)
    # In order, but older than what is known already: let in, and of no use.
    beset.hear("estimate", encode(msgspec.structs.replace(wrong, t_ns=PERIOD_NS), Header(epoch=9, sequence=5)), 0)
    assert dict(beset.door.rejected_by_reason) == {"out of order": 2}
    assert beset.node.sources.selector.rejected == 0  # nothing has reached the node yet
    plans = [each.plan(2 * PERIOD_NS) for each in (quiet, beset)]
    assert as_bytes(plans[0]) == as_bytes(plans[1])
    assert beset.node.sources.selector.rejected == 1


def test_one_estimate_of_another_source_does_not_lock_out_the_publisher() -> None:
    """One valid frame of another epoch between those of the publisher: every frame of the publisher is used."""
    controlled = Listening()
    wrong = msgspec.structs.replace(estimate(3), north_m=3.0)
    for k in range(8):
        controlled.hear("estimate", encode(estimate(k), Header(epoch=9, sequence=k)), k * PERIOD_NS)
        if k == 3:
            controlled.hear("estimate", encode(wrong, Header(epoch=8, sequence=0)), k * PERIOD_NS)
        plan = controlled.plan(k * PERIOD_NS)
        assert plan.estimate_t_ns == k * PERIOD_NS
    assert controlled.door.rejected == 0


@pytest.mark.timeout(400)
def test_a_controller_process_shows_and_counts_what_it_refuses_and_goes_on(tmp_path: Path) -> None:
    (tmp_path / "point.toml").write_text('kind = "point"\nnorth_m = 0.0\neast_m = 0.0\n')
    arguments = ("--reference", str(tmp_path / "point.toml"), "--log-json")
    with controller(loopback.free_port(), arguments) as (endpoint, console):
        bus = BusOptions(connect=(endpoint,))
        with open_session(bus, stop=StopRequest(), say=lambda _: None) as session:
            box = Mailbox()
            for key in ("plan", "rejected/controller", "controller/status"):
                session.subscribe(key, None, box)
            _besiege(
                Outbox(session, node="estimator", epoch=9, kinds=(Estimate,)), session.publisher("estimate").put, box
            )
        console.until(lambda line: '"kind": "rejected"' in line)
    lines = [json.loads(line) for line in console.said]
    assert {line["kind"] for line in lines} == {"note", "health", "authority", "rejected", "source"}
    assert max(Counter(line["text"] for line in lines if line["kind"] == "rejected").values()) == 1


def _besiege(out: Outbox, put: object, box: Mailbox) -> None:
    bad = [one.payload for one in damaged(example(Estimate), Header(epoch=9, sequence=1_000_000))]
    shown: list[RejectedFrame] = []
    plans: list[Plan] = []
    counted: ControllerStatus | None = None
    stamps = set()
    deadline = time.monotonic() + 120.0
    sent = 0
    while counted is None or sum(counted.rejected.values()) < len(bad) or len(plans) < 5:
        assert time.monotonic() < deadline, (sent, len(shown), counted, len(plans))
        t_ns = time.time_ns()
        stamps.add(t_ns)
        out.publish(msgspec.structs.replace(Estimate.at_rest(north_m=1.0), t_ns=t_ns))
        if plans:  # it has a time, and goes on planning while it is besieged
            for payload in bad[sent : sent + 10]:
                put(payload)  # type: ignore[operator]
            sent += 10
        until = time.monotonic() + 0.1
        while (left := until - time.monotonic()) > 0:
            frame = box.take(left)
            if frame is None or frame.topic is None:
                continue
            signal, _ = decode(frame.topic.message_type, frame.payload)
            match signal:
                case Plan():
                    plans.append(signal)
                case RejectedFrame():
                    shown.append(signal)
                case ControllerStatus():
                    counted = signal
    assert sorted(one.crc for one in shown) == sorted(map(crc, bad))
    assert sum(counted.rejected.values()) == len(bad)
    assert len(counted.rejected) >= 10  # by reason
    assert {plan.estimate_t_ns for plan in plans} <= stamps
    assert {float(np.abs(plan.states[0, :2] - [1.0, 0.0]).max()) < 0.5 for plan in plans} == {True}


def test_a_wrong_file_ends_the_command_with_2_before_anything_starts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "hull.toml").write_text('name = "x"\n')
    assert run(["controller", "--vehicle", str(tmp_path / "hull.toml"), "--connect", "tcp/127.0.0.1:1"]) == 2
    said = capsys.readouterr().err
    assert "hull.toml" in said
    assert said.count("\n") == 1
