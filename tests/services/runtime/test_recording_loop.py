"""Recorder on a real router: one bad frame must not affect the others."""

from __future__ import annotations

import errno
import os
import threading
import time
from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgpack
import pytest
from msgspec.structs import replace

from ltv_mpc.messages import Clock, Estimate, Message, NodeStatus, PressureDepth, RejectedFrame, RunEvent, StepRecord
from services.bus.options import BusOptions
from services.bus.outbox import Outbox
from services.bus.session import open_session
from services.bus.topics import BY_TYPE
from services.bus.wire import Header, to_map
from services.recording import segments
from services.recording.reader import Recording, StoredMessage
from services.recording.segments import SegmentWriter
from services.recording.writer import RunWriter
from services.runtime import recording_loop
from services.runtime.clock import monotonic_us
from services.runtime.lifeline import Lifeline
from services.runtime.recording_loop import BEGAN_BEFORE, FOLLOWS_HOST, RecordingLoop
from services.runtime.stopping import StopRequest
from tests.services.words import running_clock, status
from tests.waiting import until

S = 1_000_000_000
KEY = BY_TYPE[PressureDepth].key
EPOCH = 77

UNREAD = "read/by/nobody"
"""Key of no topic: messages on it are rejected and counted."""


class Listening(SegmentWriter):
    """Segment writer that sets an event once the status of ``AFTER`` is written: all earlier messages have arrived."""

    AFTER = "after"

    def __init__(self, path: Path, start_ns: int = -S) -> None:
        super().__init__(path, start_ns=start_ns, metadata={})
        self.heard = threading.Event()

    def write_plain(self, key: str, kind: type[Message], message: Mapping[str, Any], t_ns: int, crc: int) -> None:
        super().write_plain(key, kind, message, t_ns, crc)
        if message.get("node") == self.AFTER:
            self.heard.set()


def record(
    path: Path,
    port: int,
    say: Callable[[Outbox, Callable[[bytes], None]], None],
    *,
    begin: Callable[[RecordingLoop], object] = lambda _: None,
    start_ns: int | None = -S,
    said: Callable[[str], None] = print,
    timed: bool = True,
) -> list[StoredMessage]:
    """Return the recording of what ``say`` publishes, as messages and as bytes on the key of depths.

    ``begin`` is called with the loop before it serves. ``start_ns``: None beside a vehicle. ``said`` takes what the
    recorder says. Not ``timed``: nothing tells the time, so nothing is written before the end.
    """
    endpoint = f"tcp/127.0.0.1:{port}"
    stop = StopRequest()
    with (
        open_session(BusOptions(listen=(endpoint,)), stop=StopRequest(), say=print) as session,
        Listening(path, start_ns or 0) as writer,
    ):
        loop = RecordingLoop(writer, start_ns=start_ns, say=said)
        begin(loop)
        thread = threading.Thread(target=loop.serve, args=(BusOptions(connect=(endpoint,), mode="client"), stop))
        thread.start()
        out = Outbox(session, node="plant", epoch=EPOCH, kinds=(Clock, NodeStatus, Estimate, StepRecord))
        knock = session.publisher(UNREAD).put
        until(lambda: knock(b"") or loop.rejected)  # it has subscribed, and the router knows
        say(out, session.publisher(KEY).put)
        out.publish(status(Listening.AFTER))
        assert not timed or writer.heard.wait(60)
        stop.request()
        thread.join(20)
        assert not thread.is_alive()
    return list(Recording(path))


def depth(sequence: int, sent_us: int) -> bytes:
    message = to_map(PressureDepth(t_ns=0, depth_m=1.0), Header(epoch=EPOCH, sequence=0, sent_monotonic_us=0))
    return bytes(msgpack.packb(message | {"sequence": sequence, "sent_monotonic_us": sent_us}))


def test_a_frame_with_a_wrong_header_neither_moves_the_others_nor_ends_the_recording(tmp_path, free_port) -> None:
    def say(out: Outbox, put: Callable[[bytes], None]) -> None:
        out.publish(running_clock(monotonic_us(), epoch=EPOCH))
        put(depth(0, monotonic_us()))
        put(depth(1, monotonic_us() * 1000))  # nanoseconds: in range, and days ahead
        put(depth(2, 2**62))
        put(depth(-1, monotonic_us()))
        put(depth(2, monotonic_us()))

    messages = record(tmp_path / "run.mcap", free_port, say)
    depths = [message for message in messages if message.key == KEY]
    assert [message.plain["sequence"] for message in depths] == [0, 1, 2]
    assert all(0 <= message.t_ns < 5 * S for message in depths)
    assert all(message.t_ns < 5 * S for message in messages)
    reasons = [
        message.plain["reason"] for message in messages if message.kind is RejectedFrame and message.plain["key"] == KEY
    ]
    assert [reason.partition(" = ")[0] for reason in reasons] == ["sent_monotonic_us", "sequence"]


def test_messages_without_room_in_the_mailbox_count_as_dropped(tmp_path: Path, free_port: int) -> None:
    """They are not counted twice: the frames after them show a gap in their sequence numbers."""

    def say(_: Outbox, put: Callable[[bytes], None]) -> None:
        put(depth(3, 0))

    messages = record(tmp_path / "run.mcap", free_port, say, begin=lambda loop: setattr(loop.mailbox, "overflowed", 5))
    own = [message.plain for message in messages if message.key == "status/recorder"]
    assert own[-1]["dropped"] == 5  # 3 of which are also the gap before sequence 3


def test_messages_lost_by_a_full_disk_are_counted_and_reported(tmp_path, free_port, monkeypatch) -> None:
    original = RunWriter.write_plain
    full = iter([OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))])

    def write_plain(writer: RunWriter, key: str, kind: type[Message], message: Mapping[str, Any], *rest: int) -> bool:
        if key == KEY and message["sequence"] == 3:
            for error in full:
                raise error
        return original(writer, key, kind, message, *rest)

    monkeypatch.setattr(RunWriter, "write_plain", write_plain)
    monkeypatch.setattr(segments, "RETRY_S", 0.0)

    def say(_: Outbox, put: Callable[[bytes], None]) -> None:
        for sequence in range(8):
            put(depth(sequence, monotonic_us()))
        until((tmp_path / "run.2.mcap").exists)

    path = tmp_path / "run.mcap"
    before = record(path, free_port, say)
    after = list(Recording(tmp_path / "run.2.mcap"))
    kept = [message.plain["sequence"] for message in (*before, *after) if message.key == KEY]
    assert kept[-4:] == [4, 5, 6, 7]
    assert 3 not in kept
    events = [message.plain["text"] for message in after if message.kind is RunEvent]
    refused = int(events[0].removeprefix(f"not recording: {os.strerror(errno.ENOSPC)}; ").split()[0])
    assert refused >= 8 - len(kept)  # and words of its own, where any were not flushed yet
    assert events[1] == "recording continues in run.2.mcap"
    assert events[2] == f"lost: {refused} that the disk did not take"
    status = [message.plain for message in after if message.key == "status/recorder"]
    assert status[-1]["dropped"] == refused


def test_beside_a_vehicle_that_says_nothing_messages_have_the_time_of_this_host(tmp_path: Path, free_port: int) -> None:
    said: list[str] = []
    messages = record(
        tmp_path / "run.mcap",
        free_port,
        lambda _, put: put(depth(0, monotonic_us())),
        start_ns=None,
        said=said.append,
        timed=False,
    )
    assert [message.key for message in messages].count(KEY) == 1
    assert all(abs(message.t_ns - time.time_ns()) < 120 * S for message in messages)
    assert FOLLOWS_HOST in said


def test_a_late_recorder_counts_no_loss_and_reports_what_cannot_be_replayed(tmp_path: Path, free_port: int) -> None:
    def say(out: Outbox, put: Callable[[bytes], None]) -> None:
        put(depth(1000, monotonic_us()))
        out.publish(running_clock(monotonic_us(), epoch=EPOCH))
        put(depth(1001, monotonic_us()))
        put(depth(1003, monotonic_us()))
        for step in (70, 71):
            out.publish(StepRecord(node="controller", epoch=EPOCH, step=step, steps=()))

    said: list[str] = []
    record(tmp_path / "run.mcap", free_port, say, start_ns=None, said=said.append)
    assert said.count(BEGAN_BEFORE.format("controller")) == 1
    assert said[-1].endswith("messages recorded, lost: 1 on sensor/depth")


def test_what_another_or_an_unknown_name_says_it_has_published_is_no_loss(tmp_path: Path, free_port: int) -> None:
    said: list[str] = []

    def say(out: Outbox, _: object) -> None:
        out.publish(running_clock(monotonic_us(), epoch=EPOCH))
        out.publish(replace(status("sensors"), finished=True, published=50))  # on the key of the plant

    record(tmp_path / "run.mcap", free_port, say, said=said.append)
    assert said[-1].endswith("none lost")


class Watched(Lifeline):
    """Lifeline that notes at each heartbeat how many frames the loop has rejected so far."""

    loop: RecordingLoop

    def __init__(self) -> None:
        super().__init__()
        self.rejected = [0]

    def beat(self, now_us: int) -> None:
        del now_us
        self.rejected.append(self.loop.rejected)


def test_a_flood_neither_stops_the_heartbeats_nor_the_recorder_and_is_answered_within_the_limit(
    tmp_path: Path, free_port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frames of an unknown key and messages arrive faster than they are written, and go on after the stop request."""
    link, ended, said = Watched(), threading.Event(), list[str]()
    monkeypatch.setattr(recording_loop, "LIFELINE", link)

    def pour() -> None:
        sequence = 0
        while not ended.is_set():
            link.loop.mailbox.offer(BY_TYPE[PressureDepth], KEY, depth(sequence, monotonic_us()))
            link.loop.mailbox.offer(None, UNREAD, b"")
            sequence += 1
            time.sleep(0.002)

    def begin(loop: RecordingLoop) -> None:
        link.loop = loop
        for _ in range(10_000):
            loop.mailbox.offer(None, UNREAD, b"")
        pouring.start()

    pouring = threading.Thread(target=pour)
    try:
        messages = record(
            tmp_path / "run.mcap",
            free_port,
            lambda *_: until(lambda: link.loop.rejected > 10_000),
            said=said.append,
            begin=begin,
        )
    finally:
        ended.set()
        pouring.join()
    assert said[-1].endswith("none lost")
    assert max(after - before for before, after in pairwise(link.rejected)) <= 1
    assert [message for message in messages if message.key == "status/recorder"][-1].plain["finished"]
    assert 0 < sum(message.kind is RejectedFrame for message in messages) < 5_000
