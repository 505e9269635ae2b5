"""Loop of the recorder: writes every message on the run's keys into one file, and reports every loss.

Losses are found in two ways: by gaps in the sequence numbers of each key and source, and at the end by the number of
published messages that each process gives in its last status.

Beside a vehicle, messages wait until the vehicle time is known (``PublicationTime``). In a simulation those that
come before the clock have the time of the start.
"""

from __future__ import annotations

import contextlib
import time
from typing import Any

import msgspec

from ltv_mpc.messages import Clock, ClockState, Estimate, Message, NodeStatus, RejectedFrame, RunEvent, StepRecord
from services.bus.mailbox import Frame, Mailbox
from services.bus.message_validation import rejection
from services.bus.options import BusOptions
from services.bus.outbox import Outbox, new_epoch
from services.bus.rate_limit import RateLimit
from services.bus.roles import HISTORY
from services.bus.session import Reply, open_session
from services.bus.topics import BY_TYPE, key_of
from services.bus.wire import Header, WireError, crc, from_map, header_of, unpack
from services.recording.acceptance import NODES, Acceptance
from services.recording.segments import SegmentWriter
from services.runtime.clock import ClockError, ClockSegment, VehicleClock, monotonic_us
from services.runtime.clock_sync import STAMPED_INPUTS, ClockSync
from services.runtime.console import counted
from services.runtime.lifeline import LIFELINE
from services.runtime.node_status import NodeStatusReporter, WaitingFor
from services.runtime.stopping import Say, StopRequest

NAME = "recorder"
BACKLOG_US = 1_300_000  # longest time for writing what had arrived when the stop was requested
FINAL_STATUS_US = 600_000  # longest wait for the last status of all other processes
FINAL_SILENCE_US = 200_000  # the wait ends when no message has arrived for this time
OWN_STATUS_US = 200_000  # longest wait for this process's own last messages
GATHERING_S = 0.05  # no process waits for the recorder, and waking it costs as much as writing a message
MAX_GATHERED_US = 250_000  # longest time between two looks at the deadlines

MAX_WAITING = 20_000
"""Messages that wait for the vehicle time; with more, the host's clock is followed."""


FOLLOWS_VEHICLE = f"no clock is announced: following the vehicle's own clock, by the stamps on {BY_TYPE[Estimate].key}"
FOLLOWS_HOST = "neither a clock nor a stamped message: times are those of this host's clock (UTC)"
BEGAN_BEFORE = "{} began before this recorder: `ltv-mpc replay` can repeat it from its next start on"


class PublicationTime:
    """Vehicle time at which recorded messages were published, from the messages received so far.

    a clock is announced     that clock
    no clock                 the vehicle's own clock, by the stamps of estimates and actuators (``clock_sync.py``)
    neither                  in a simulation its start; otherwise unknown, until the host's clock is taken instead

    ``start_ns``: vehicle time of the start of a simulation; None beside a vehicle.
    """

    def __init__(self, *, start_ns: int | None, say: Say) -> None:
        self.clock = VehicleClock()
        self.start_ns = start_ns
        self._sync = ClockSync(self.clock, epoch=0)  # a recorder publishes no plans
        self._say = say

    @property
    def known(self) -> bool:
        """True once messages can be dated."""
        return self.start_ns is not None or self.clock.newest is not None

    def add(self, message: Message, epoch: int, received_us: int) -> None:
        """Add an announced clock, or a message with a stamp of the publisher ``epoch``.

        Once the vehicle's own clock is followed, a clock that is announced later is ignored: times have one origin.
        """
        was_active = self._sync.active
        try:
            self._sync.take(message, epoch, received_us)
        except ClockError as error:  # the messages of any clock master are recorded
            self._say(str(error))
        if self._sync.active and not was_active:
            self._say(FOLLOWS_VEHICLE)

    def at(self, sent_us: int, received_us: int) -> int | None:
        """Return the vehicle time (ns) of a message's publication; None while it is unknown.

        A clock is announced to the processes of one host, so the monotonic time ``sent_us`` counts. No message is sent
        after its arrival, whatever it says. Beside a vehicle the sender may be on another host, so the arrival counts.
        """
        newest = self.clock.newest
        if newest is None:
            return self.start_ns
        if not self._sync.active:
            return self.clock.at(min(sent_us, received_us))
        return newest.vehicle_ns + (received_us - newest.at_us) * 1000  # also before the newest stamp

    def follow_host(self) -> None:
        """Take the host's clock for that of the vehicle."""
        self._say(FOLLOWS_HOST)
        began_ns = time.time_ns() - monotonic_us() * 1000  # at monotonic time 0, so that it dates earlier messages too
        self.clock.set_segment(ClockSegment(0, began_ns, 1, 1, ClockState.RUNNING))


class RecordingLoop:
    """Loop of one recorder: writes messages until a stop is requested, then those that are still on their way.

    A restarted recorder counts from its own start. What was lost in between shows when the segments are joined.
    ``start_ns``: vehicle time of the start of a simulation; None beside a vehicle.
    """

    def __init__(self, writer: SegmentWriter, *, start_ns: int | None, say: Say) -> None:
        self._writer = writer
        self._say = say
        self.mailbox = Mailbox()
        self._time = PublicationTime(start_ns=start_ns, say=say)
        self._waiting: list[tuple[Frame, dict[str, Any], Header]] = []  # unpacked
        self._unknown_keys = RateLimit()
        # In a simulation only a restarted recorder begins after the others.
        self._acceptance = Acceptance(late=writer.resumes or start_ns is None)
        self._losses = self._acceptance.losses
        self._written = 0
        self.rejected = 0
        self._out: Outbox
        self._status: NodeStatusReporter

    @property
    def received(self) -> int:
        """Number of messages in the file."""
        return self._written - self._writer.lost

    @property
    def dropped(self) -> int:
        """Number of published messages that are not in the file, as far as known."""
        return self._losses.missing + self._writer.lost

    def serve(self, bus: BusOptions, stop: StopRequest) -> None:
        """Connect, subscribe to every key, record until a stop is requested, publish the last status, disconnect."""
        stop.on_request(self.mailbox.wake)
        with open_session(bus, stop=stop, say=self._say) as session:
            self._out = Outbox(session, node=NAME, epoch=new_epoch(), kinds=(NodeStatus, RunEvent, RejectedFrame))
            self._status = NodeStatusReporter(
                NAME,
                outbox=self._out,
                counts=self,
                mailbox=self.mailbox,
                waiting=WaitingFor(self._time.clock, (), from_inputs=self._time.start_ns is None),
                say=self._say,
            )
            session.subscribe("**", None, self.mailbox)
            session.serve(HISTORY, self._answer)
            while not stop():
                now_us = monotonic_us()
                LIFELINE.beat(now_us)
                if now_us >= self._status.due_us:
                    self._status.publish(now_us)
                dues_us = self._status.due_us, LIFELINE.due_us
                self._gather((min(due_us for due_us in dues_us if due_us is not None) - now_us) / 1e6)
                self._writer.flush_if_due()
                self._report_disk()
            self._finish()
            LIFELINE.stopping()

    def _answer(self, query: bytes, _: bytes, reply: Reply) -> None:
        """Reply with a part of the history; a query that names no part gets none."""
        with contextlib.suppress(msgspec.MsgspecError):
            reply(self._writer.history.reply(msgspec.msgpack.decode(query, type=int)), None)

    def _finish(self) -> None:
        """Record until each process has reported its count and all its messages have arrived, or no more arrive.

        It ends in time however many messages arrive: those from before the stop request come first, and what is left
        of them counts as lost.
        """
        if not self._time.known:
            self._time.follow_host()
            self._write_waiting()
        began_us = now_us = arrived_us = monotonic_us()
        while now_us < began_us + BACKLOG_US:
            frame = self._take(0.01)
            now_us = monotonic_us()
            if frame is not None:
                arrived_us = now_us
                if frame.received_monotonic_us <= began_us:
                    continue
            elif not self._losses.unfinished(self._out.epoch) and not self._losses.by_process():
                break
            if now_us - arrived_us >= FINAL_SILENCE_US or now_us - began_us >= FINAL_STATUS_US:
                break
        left = [frame for _ in range(len(self.mailbox)) if (frame := self.mailbox.take(0.0)) is not None]
        unwritten = sum(frame.received_monotonic_us <= began_us for frame in left)
        self.mailbox.overflowed += unwritten
        self._writer.flush_if_due(now=True)
        self._report_disk()
        if lost := self._account(unwritten):
            self._out.publish(RunEvent(t_ns=self._now_ns, node=NAME, kind="loss", text=lost))
        self._say(f"{counted(self.received, 'message')} recorded, {lost or 'none lost'}")
        own_us = monotonic_us()
        self._status.publish(own_us, finished=True)
        while self._take(0.05) and monotonic_us() < own_us + OWN_STATUS_US:
            pass

    def _report_disk(self) -> None:
        """Report what the disk does not take."""
        for text in self._writer.news():
            self._say(text)
            self._out.publish(RunEvent(t_ns=self._now_ns, node=NAME, kind="disk", text=text))

    @property
    def _now_ns(self) -> int:
        return self._time.clock.read(monotonic_us()) or 0

    def _account(self, unwritten: int) -> str:
        """Return the losses as a text; empty if there are none."""
        gaps = [f"{count} of {node}" for node, count in self._losses.by_process().items()]
        gaps += [f"{count} on {key}" for key, count in self._losses.by_key().items()]
        gaps += [f"{unwritten} that still waited to be written"] if unwritten else []
        gaps += [f"{self._writer.lost} that the disk did not take"] if self._writer.lost else []
        return f"lost: {', '.join(gaps)}" if gaps else ""

    def _gather(self, timeout_s: float) -> None:
        """Wait for a message, then for ``GATHERING_S``, and record what has arrived by then."""
        if self._take(timeout_s):
            time.sleep(GATHERING_S)
            until_us = monotonic_us() + MAX_GATHERED_US
            while len(self.mailbox) and monotonic_us() < until_us:
                self._take(0.0)

    def _take(self, timeout_s: float) -> Frame | None:
        """Record the next message and return it; None if none arrives in time. Show that the process works."""
        LIFELINE.beat(monotonic_us())
        frame = self.mailbox.take(timeout_s)
        if frame is not None:
            try:
                self._record(frame)
            except WireError as error:
                self._reject(frame, error)
        return frame

    def _reject(self, frame: Frame, error: WireError) -> None:
        """Count a frame as rejected, and answer it; on an unknown key only within the rate limit."""
        self.rejected += 1
        if frame.topic is not None or self._unknown_keys.admits(frame):
            self._out.publish(rejection(frame, str(error), node=NAME, t_ns=self._now_ns))

    def _record(self, frame: Frame) -> None:
        if frame.topic is None:
            raise WireError("unknown key")
        kind = frame.topic.message_type
        plain_map = unpack(frame.payload)
        header = header_of(plain_map)
        if kind is Clock or kind in STAMPED_INPUTS:
            # A recorder also keeps what its readers reject. Only the time is not taken from it.
            with contextlib.nullcontext() if kind is Clock else contextlib.suppress(WireError):
                self._time.add(from_map(kind, plain_map)[0], header.epoch, frame.received_monotonic_us)
        self._waiting.append((frame, plain_map, header))
        if len(self._waiting) > MAX_WAITING:
            self._time.follow_host()
        if self._time.known:
            self._write_waiting()

    def _write_waiting(self) -> None:
        waiting, self._waiting = self._waiting, []
        for frame, plain_map, header in waiting:
            try:
                self._write(frame, plain_map, header)
            except WireError as error:
                self._reject(frame, error)

    def _write(self, frame: Frame, plain_map: dict[str, Any], header: Header) -> None:
        assert frame.topic is not None
        kind = frame.topic.message_type
        message = from_map(kind, plain_map)[0] if kind is NodeStatus else None
        t_ns = self._time.at(header.sent_monotonic_us or frame.received_monotonic_us, frame.received_monotonic_us)
        assert t_ns is not None
        self._writer.write_plain(frame.key, kind, plain_map, t_ns, crc(frame.payload))
        self._written += 1
        refused = self._acceptance.count(frame.topic, frame.key, header, frame.received_monotonic_us)
        resumes = self._writer.resumes
        if kind is StepRecord and not (refused or resumes) and self._losses.begins_late(frame.key, header.epoch):
            self._say(BEGAN_BEFORE.format(plain_map.get("node")))
        self._status.on_delivery(header.sent_monotonic_us, frame.received_monotonic_us, monotonic_us())
        if not isinstance(message, NodeStatus) or not message.finished or refused:
            return
        if message.node in NODES and frame.key == key_of(NodeStatus, message.node):
            self._losses.set_published(header.epoch, message.node, message.published)
