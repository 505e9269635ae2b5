"""Bus monitor of the supervisor: the newest message of each key, decoded when it is first read."""

from __future__ import annotations

from typing import cast

from ltv_mpc.messages import NodeStatus
from services.bus.session import FrameReceiver, Session
from services.bus.topics import BY_TYPE, Topic
from services.bus.wire import Header, encode
from services.supervisor.bus_monitor import BusMonitor

KEY = "status/plant"


class Bus:
    """Session that keeps the receiver of each key."""

    def __init__(self) -> None:
        self.receivers: dict[str, FrameReceiver] = {}

    def subscribe(self, key: str, _topic: Topic | None, receiver: FrameReceiver) -> None:
        self.receivers[key] = receiver

    def deliver(self, payload: bytes) -> None:
        self.receivers[KEY].offer(BY_TYPE[NodeStatus], KEY, payload)


def status(steps: int) -> bytes:
    message = NodeStatus(
        node="plant",
        t_ns=0,
        ready=True,
        waiting_for="",
        steps=steps,
        published=1,
        received=0,
        dropped=0,
        rejected=0,
        step_us=0.0,
    )
    return encode(message, Header(epoch=1, sequence=steps))


def test_a_message_is_decoded_once_and_a_newer_one_replaces_it() -> None:
    bus = Bus()
    monitor = BusMonitor(cast(Session, bus), ["plant"])
    assert monitor.newest(NodeStatus, "plant") is None
    bus.deliver(status(1))
    first = monitor.newest(NodeStatus, "plant")
    assert first is not None
    assert first.steps == 1
    assert monitor.newest(NodeStatus, "plant") is first
    bus.deliver(status(2))
    second = monitor.newest(NodeStatus, "plant")
    assert second is not None
    assert second.steps == 2


def test_a_damaged_frame_hides_the_message_before_it() -> None:
    bus = Bus()
    monitor = BusMonitor(cast(Session, bus), ["plant"])
    bus.deliver(status(1))
    assert monitor.newest(NodeStatus, "plant") is not None
    bus.deliver(b"\xc1")
    assert monitor.newest(NodeStatus, "plant") is None
