"""Peer of the edge to MAVLink: it is the sender of the autopilot's accepted frames, whatever others send."""

from __future__ import annotations

import contextlib
import socket
import threading
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("pymavlink", reason="not installed: pip install pymavlink (extra mavlink)")

from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.mailbox import Mailbox
from services.edges.edge import Outgoing, Received
from services.edges.mavlink.codec import Codec
from services.edges.mavlink.edge import MavlinkEdge, Settings
from services.processes.edge_loop import EdgeLoop
from services.processes.mavlink import STRANGERS, UdpLink
from services.runtime.stopping import StopRequest
from services.supervisor import loopback
from tests.waiting import until

KEY, OTHER_KEY, NOW = bytes(range(32)), bytes(32), 10**13
SECOND_US = 1_000_000


def edge_of(key: bytes | None = None) -> MavlinkEdge:
    return MavlinkEdge(1, Settings(vehicle=Vehicle.load("bluerobotics-boat")), Codec(255, key, stamp=NOW))


def heartbeat(autopilot: Codec, kind: int = 11) -> bytes:
    return autopilot.encode(autopilot.make.heartbeat_encode(kind, 3, 0x81, 0, 4))


def answers(edge: MavlinkEdge, now_us: int) -> set[str]:
    """Return the channels of what the edge sends within a second."""
    return {one.channel for one in edge.step(now_us + SECOND_US) if isinstance(one, Outgoing)}


@pytest.mark.parametrize("key", [None, KEY])
def test_nothing_that_a_stranger_sends_takes_the_link_of_an_autopilot_that_speaks(key: bytes | None) -> None:
    edge, autopilot = edge_of(key), Codec(1, key, component=1, stamp=NOW)
    first = heartbeat(autopilot)
    edge.receive(Received("autopilot:1", first, b"", 0))
    latest = Codec(1, OTHER_KEY, component=1, stamp=2**47)  # a stamp that none can be newer than
    forged = [
        b"x",
        b"",
        first,
        heartbeat(Codec(1, component=1)),
        heartbeat(latest),
        heartbeat(Codec(2, key, stamp=NOW)),
    ]
    for number, frame in enumerate(forged):
        edge.receive(Received(f"stranger:{number}", frame, b"", SECOND_US))
    assert edge.refused == 4  # an empty datagram has no frame, and another system is none of ours
    assert key is None or any("signature" in reason for reason in edge.refused_by_reason)
    assert answers(edge, SECOND_US) == {"autopilot:1"}
    edge.receive(Received("autopilot:1", heartbeat(autopilot), b"", 2 * SECOND_US))
    assert edge.autopilot.heard_us == 2 * SECOND_US  # its frames still count


def test_the_link_follows_an_autopilot_that_was_silent_and_at_once_one_that_signs() -> None:
    edge, autopilot = edge_of(), Codec(1, component=1)
    for channel, at_s, peer in (("a:1", 0, "a:1"), ("b:1", 2, "a:1"), ("b:1", 4, "b:1"), ("a:1", 5, "b:1")):
        edge.receive(Received(channel, heartbeat(autopilot), b"", at_s * SECOND_US))
        assert edge.autopilot.channel == peer
    assert "second sender for autopilot 1: a:1 beside b:1" in edge.reason
    edge, autopilot = edge_of(KEY), Codec(1, KEY, component=1, stamp=NOW)
    for channel in ("a:1", "b:1"):
        edge.receive(Received(channel, heartbeat(autopilot), b"", SECOND_US))
        assert edge.autopilot.channel == channel


def test_a_stranger_that_was_first_and_only_sends_loses_the_link_to_the_autopilot_that_answers() -> None:
    edge, autopilot, stranger = edge_of(), Codec(1, component=1), Codec(1, component=1)

    def answer(asked: Outgoing) -> bytes:
        request = Codec(1).decode(asked.payload)
        return autopilot.encode(autopilot.make.timesync_encode(12345, request.ts1))

    def asked(at_s: int) -> dict[str, Outgoing]:
        sent = [one for one in edge.step(at_s * SECOND_US) if isinstance(one, Outgoing)]
        return {one.channel: one for one in sent if Codec(1).decode(one.payload).get_type() == "TIMESYNC"}

    blind = autopilot.encode(autopilot.make.timesync_encode(12345, 1))
    for sender, frame in (("stranger:1", heartbeat(stranger)), ("a:1", heartbeat(autopilot)), ("a:1", blind)):
        edge.receive(Received(sender, frame, b"", 2 * SECOND_US))
    assert edge.autopilot.channel == "stranger:1"
    assert set(asked(2)) == set(asked(3)) == {"stranger:1"}
    requests = asked(4)
    assert set(requests) == {"stranger:1", "a:1"}
    edge.receive(Received("a:1", answer(requests["a:1"]), b"", 4 * SECOND_US))
    assert edge.autopilot.channel == "a:1"
    (request,) = asked(5).values()
    edge.receive(Received("stranger:1", answer(request), b"", 5 * SECOND_US))
    assert edge.autopilot.channel == "a:1"


def test_a_frame_that_is_refused_does_not_move_the_link() -> None:
    edge, autopilot = edge_of(), Codec(1, component=1)
    edge.receive(Received("a:1", heartbeat(autopilot), b"", 0))
    nowhere = autopilot.encode(autopilot.make.attitude_encode(1, float("nan"), 0.0, 0.0, 0.0, 0.0, 0.0))
    for frame in (nowhere, heartbeat(autopilot, kind=2)):
        edge.receive(Received("b:1", frame, b"", 4 * SECOND_US))
    assert (edge.refused, edge.autopilot.channel) == (2, "a:1")


def silent_bus() -> Any:
    return SimpleNamespace(subscribe=lambda *_: None, publisher=lambda _: SimpleNamespace(put=lambda *_, **__: None))


def udp() -> socket.socket:
    one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    one.bind(("127.0.0.1", 0))
    one.settimeout(60.0)
    return one


def test_under_a_flood_of_many_senders_the_autopilot_is_heard_and_answered() -> None:
    port, mailbox, stop, edge = loopback.free_port(), Mailbox(200), StopRequest(), edge_of()
    to, said, autopilot = ("127.0.0.1", port), list[str](), Codec(1, component=1)
    stop.on_request(mailbox.wake)
    loop = EdgeLoop(edge, silent_bus(), mailbox, 1, said.append)
    with UdpLink(*to, mailbox, listens=True) as link, udp() as mine, contextlib.ExitStack() as sockets:
        strangers = [sockets.enter_context(udp()) for _ in range(2 * STRANGERS)]
        thread = threading.Thread(target=loop.run, args=(link, 50_000, stop))
        thread.start()
        try:
            mine.sendto(heartbeat(autopilot), to)
            mine.recv(4096)
            for _ in range(2):
                for stranger in strangers:
                    for frame in (b"x", heartbeat(Codec(1, component=1))):
                        stranger.sendto(frame, to)
                mine.sendto(heartbeat(autopilot), to)
            until(lambda: edge.accepted >= 3)
            until(lambda: mailbox.overflowed >= 2 * len(strangers) and edge.refused)
            mine.recv(4096)
        finally:
            stop.request()
            thread.join()
        for stranger in strangers:
            stranger.setblocking(False)
            with pytest.raises(BlockingIOError):
                stranger.recv(4096)
    assert edge.lost == 0
