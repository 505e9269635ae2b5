"""Loop of an edge: it steps at its rate, and at once when a plan has come."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from queue import SimpleQueue
from types import SimpleNamespace
from typing import Any

import pytest

from ltv_mpc.messages import Estimate, Message, Plan
from services.bus.mailbox import Mailbox
from services.bus.topics import BY_TYPE
from services.bus.wire import Header, encode
from services.edges.edge import Edge, Outgoing, Output, Received
from services.processes.edge_loop import EdgeLoop
from services.runtime.stopping import StopRequest
from tests.services.edges.plans import plan

PERIOD_US = 3_600_000_000
"""An hour, so that all later steps have another cause."""
PATIENCE_S = 30.0
PLAN = encode(plan(0), Header(epoch=2, sequence=0))


class CountingEdge(Edge):
    """Edge that sends in each step whether it has a plan."""

    name = "counting"
    reads = (Plan,)
    writes = (Estimate,)

    def convert(self, frame: Received) -> Iterable[Output]:  # noqa: ARG002 (interface)
        return ()

    def step(self, now_us: int) -> Iterable[Output]:  # noqa: ARG002 (interface)
        return [Outgoing("", b"plan" if self.plans.newest else b"none")]

    def release(self, now_us: int) -> Iterable[Outgoing]:  # noqa: ARG002 (interface)
        return [Outgoing("", b"release")]


class Sent:
    """Link that keeps what is sent."""

    def __init__(self) -> None:
        self.payloads: SimpleQueue[bytes] = SimpleQueue()

    def send(self, frame: Outgoing) -> None:
        self.payloads.put(frame.payload)


BUS: Any = SimpleNamespace(subscribe=lambda *_: None, publisher=lambda _: SimpleNamespace(put=lambda _: None))


def test_the_loop_steps_at_once_when_a_plan_has_come_and_says_why_it_does_not_drive() -> None:
    stop, mailbox, sent, said = StopRequest(), Mailbox(), Sent(), list[str]()
    stop.on_request(mailbox.wake)
    edge = CountingEdge(epoch=1)
    edge.clock.update(0, 0)
    edge.idle = "autopilot disarmed; arm it"
    thread = threading.Thread(target=EdgeLoop(edge, BUS, mailbox, 1, said.append).run, args=(sent, PERIOD_US, stop))
    thread.start()
    try:
        assert sent.payloads.get(timeout=PATIENCE_S) == b"none"
        mailbox.offer(BY_TYPE[Plan], "plan", PLAN)
        assert sent.payloads.get(timeout=PATIENCE_S) == b"plan"
        assert edge.plans.identity == (2, 0)
        edge.idle = ""
        mailbox.offer(None, "", b"frame of the other side")
    finally:
        stop.request()
        thread.join(PATIENCE_S)
    assert sent.payloads.get(timeout=PATIENCE_S) == b"release"
    assert said == ["not driving: autopilot disarmed; arm it", "driving"]


class HostileEdge(CountingEdge):
    """Edge whose inputs raise; its step does too once ``broken``."""

    name = "hostile"
    broken = False

    def convert(self, frame: Received) -> Iterable[Output]:
        raise ZeroDivisionError(frame.payload)

    def take(self, message: Message, *_: Any) -> Iterable[Output]:
        raise OverflowError(message)

    def step(self, now_us: int) -> Iterable[Output]:
        if self.broken:
            raise RuntimeError("broken")
        return super().step(now_us)

    def release(self, now_us: int) -> Iterable[Outgoing]:  # noqa: ARG002 (interface)
        return [Outgoing("", b"lost"), Outgoing("", b"release")]


class Broken(Sent):
    """Link on which some frames cannot be sent."""

    def send(self, frame: Outgoing) -> None:
        if frame.payload == b"lost":
            raise OSError("no route")
        super().send(frame)


def test_no_input_ends_the_loop_and_however_it_ends_the_thrusters_are_released() -> None:
    mailbox, sent, edge = Mailbox(), Broken(), HostileEdge(epoch=1)
    mailbox.offer(None, "odometry", b"7")
    mailbox.offer(BY_TYPE[Plan], "plan", PLAN)
    taken = StopRequest()

    def stop() -> bool:
        edge.broken = len(mailbox) == 0 and edge.refused == 2
        return taken()

    with pytest.raises(RuntimeError, match="broken"):
        EdgeLoop(edge, BUS, mailbox, 1, print).run(sent, 1, stop)  # type: ignore[arg-type]
    assert edge.refused_by_reason == {"ZeroDivisionError of odometry": 1, "OverflowError of plan": 1}
    payloads = [sent.payloads.get() for _ in range(sent.payloads.qsize())]
    assert payloads[-1] == b"release"
