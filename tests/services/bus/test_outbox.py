"""Frames of several messages: what is published together is joined, and each message arrives by itself."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from ltv_mpc.messages import ImuSample, Message, PressureDepth
from services.bus.mailbox import Mailbox
from services.bus.options import BusOptions
from services.bus.outbox import MAX_FRAME_BYTES, Outbox
from services.bus.rate_limit import LIMITED
from services.bus.session import open_session
from services.bus.topics import BATCHED, BY_TYPE
from services.bus.wire import crc, decode, split
from services.runtime.stopping import StopRequest

ZERO = (0.0, 0.0, 0.0)
KINDS = (ImuSample, PressureDepth)


class Wire:
    """Session that keeps each frame with its key, in the order in which they were sent."""

    def __init__(self) -> None:
        self.frames: list[tuple[str, bytes]] = []

    def publisher(self, key: str) -> Wire.Key:
        return Wire.Key(self, key)

    class Key:
        def __init__(self, wire: Wire, key: str) -> None:
            self._wire, self._key = wire, key

        def put(self, payload: bytes) -> None:
            self._wire.frames.append((self._key, payload))


def sample(t_ns: int) -> ImuSample:
    return ImuSample(t_ns=t_ns, interval_ns=1, angular_rate_radps=ZERO, specific_force_mps2=ZERO)


def depth(t_ns: int) -> PressureDepth:
    return PressureDepth(t_ns=t_ns, depth_m=1.0)


def published(messages: Sequence[Message]) -> list[tuple[str, list[bytes]]]:
    """Return the key of each frame and the payloads of its messages."""
    wire = Wire()
    outbox = Outbox(wire, node="sensors", epoch=7, kinds=KINDS)  # type: ignore[arg-type]
    sent = outbox.publish_all(messages)
    frames = [(key, split(frame)) for key, frame in wire.frames]
    assert outbox.published == len(sent) == len(messages) == sum(len(payloads) for _, payloads in frames)
    assert {(s.key, s.crc) for s in sent} == {(key, crc(each)) for key, payloads in frames for each in payloads}
    return frames


def test_messages_of_one_key_share_a_frame_at_the_place_of_the_last() -> None:
    """So a ping between two samples is there before the later one."""
    frames = published([sample(1), depth(2), sample(3), depth(4)])
    assert [(key, len(payloads)) for key, payloads in frames] == [
        ("sensor/depth", 1),
        ("sensor/imu", 2),
        ("sensor/depth", 1),
    ]
    decoded = [decode(ImuSample, payload) for payload in frames[1][1]]
    assert [(message.t_ns, header.sequence) for message, header in decoded] == [(1, 0), (3, 1)]


def test_a_frame_of_several_messages_has_a_largest_size() -> None:
    frames = published([sample(t_ns) for t_ns in range(500)])
    lengths = [sum(map(len, payloads)) for _, payloads in frames]
    assert MAX_FRAME_BYTES / 2 < max(lengths) <= MAX_FRAME_BYTES
    assert len(frames) == -(-sum(lengths) // MAX_FRAME_BYTES)
    times = [decode(ImuSample, payload)[0].t_ns for _, payloads in frames for payload in payloads]
    assert times == list(range(500))


def test_each_message_of_a_frame_arrives_by_itself_and_other_keys_have_one_a_frame(free_port: int) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    stop, box = StopRequest(), Mailbox()
    with (
        open_session(BusOptions(listen=(endpoint,)), stop=stop, say=print) as router,
        open_session(BusOptions(connect=(endpoint,)), stop=stop, say=print) as client,
    ):
        for kind in (ImuSample, PressureDepth):
            router.subscribe(BY_TYPE[kind].key, BY_TYPE[kind], box)
        Outbox(client, node="sensors", epoch=7, kinds=KINDS).publish_all([sample(1), sample(2)])
        two = b"".join(payload for _, payloads in published([depth(1), depth(2)]) for payload in payloads)
        client.publisher(BY_TYPE[PressureDepth].key).put(two)  # as no publisher may
        frames = [box.take(60.0) for _ in range(3)]
    assert all(frame is not None for frame in frames)
    first, second, last = (frame for frame in frames if frame is not None)
    assert [decode(ImuSample, frame.payload)[0].t_ns for frame in (first, second)] == [1, 2]
    assert (last.key, last.payload) == ("sensor/depth", two)


@pytest.mark.parametrize("kind", sorted(BATCHED, key=lambda kind: kind.__name__))
def test_no_type_with_several_messages_a_frame_is_limited_by_its_frames(kind: type[Message]) -> None:
    """The rate limit counts frames."""
    assert kind not in LIMITED
