"""Fault injector on the bus, between two routers; the node under test is alone at the second one.

    everyone else -- router A -- inject -- router B -- node under test

The injector copies what the node under test reads from A to B and what it writes from B to A, byte for byte and in
order, except for the messages that an active fault affects. It publishes events at A when a fault begins and ends, with
the number of harmed messages. Times are vehicle times.
"""

from __future__ import annotations

import contextlib
import heapq
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta

from benchmarks.faults.effects import Interval
from benchmarks.faults.message_faults import Delivery, MessageFault, MessageFaultInterval, MessageFaults
from ltv_mpc import config
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Clock, ImuSample, ImuSamples, Message, RunEvent
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.validation import bounds
from services.bus.mailbox import Frame, Mailbox
from services.bus.options import BusOptions
from services.bus.outbox import Outbox, new_epoch
from services.bus.session import Publisher, Session, Stopped, open_session
from services.bus.topics import NAMED, TOPICS, Topic, expression, topic_at
from services.bus.wire import Header, WireError, crc, decode, encode, unpack
from services.recording.writer import RunWriter
from services.runtime.clock import ClockError, VehicleClock, monotonic_us
from services.runtime.console import Console
from services.runtime.serve import run_until_stopped
from services.runtime.stopping import Say, StopRequest

NAME = "inject"
WAIT_S = 0.05
"""Longest wait for a frame (s) before the stop request is checked."""

ANYONE = "*"

SHARES = (
    MessageFault.LOSS,
    MessageFault.REORDER,
    MessageFault.DUPLICATE,
    MessageFault.CORRUPTION,
    MessageFault.NOT_A_NUMBER,
)
"""Faults whose size is a share of the messages."""

MAX_DELAY_S = 60.0

EARLIEST_NS = -(10**15)
"""Vehicle time of log time 0 in the recording of the link: before any start of a run."""

LINK = "link.mcap"
"""Recording of the link to the node under test in the folder of a run."""

WORDS = "HARM,KEY,START_S,END_S[,SIZE[,SEED]]"

Time = Annotated[float, Meta(ge=-1e6, le=1e6)]


class Injection(msgspec.Struct, frozen=True, kw_only=True):
    """Fault in the messages of one key. Times are vehicle times (s).

    ``size`` is the share of the affected messages, except for "delay" (seconds), "clock_jump" (seconds ahead of the
    true time) and "stale" (unused).
    """

    harm: MessageFault
    key: str
    start_s: Time
    end_s: Time
    size: Annotated[float, Meta(ge=-1e6, le=1e6)] = 1.0
    seed: Annotated[int, Meta(ge=0, le=2**53 - 1)] = 0

    @property
    def interval(self) -> Interval:
        """Vehicle times of its begin and end (ns)."""
        return Interval(round(self.start_s * 1e9), round(self.end_s * 1e9))


def parse(text: str) -> Injection:
    """Parse a fault of the command line, as in ``WORDS``. Raises ``ConfigError``."""
    source, names = "option --fault", Injection.__struct_fields__
    values = [value.strip() for value in text.split(",")]
    if not 4 <= len(values) <= len(names):
        raise ConfigError(source, "", f"must be {WORDS}", value=text)
    table = {name: config.number_or_text(value) for name, value in zip(names, values, strict=False)}
    injection = config.parse(table, Injection, source=source)
    if (found := problem(injection)) is not None:
        raise ConfigError(source, *found)
    return injection


def problem(injection: Injection) -> tuple[str, str] | None:
    """Return field and violated bound of an injection that is not possible, or None."""
    topic = topic_at(injection.key)
    if topic is None:
        return "key", "must be a key of `ltv-mpc topics`"
    if topic.message_type in NAMED and injection.key != topic.key:
        return "key", f"must be {topic.key}: a fault there concerns all of its sources"
    if injection.end_s <= injection.start_s:
        return "end_s", f"must be > start_s = {injection.start_s:g}"
    if injection.harm in SHARES and not 0 < injection.size <= 1:
        return "size", f"must be > 0 and <= 1 (a share of the messages) for {injection.harm}"
    if injection.harm is MessageFault.DELAY and not 0 < injection.size <= MAX_DELAY_S:
        return "size", f"must be > 0 and <= {MAX_DELAY_S:g} (s) for {injection.harm}"
    # NaN in an array with gaps is a missing value.
    kind = ImuSample if topic.message_type is ImuSamples else topic.message_type
    harmable = (isinstance(of.low, float) and not of.has_gaps for of in bounds(kind).values())
    if injection.harm is MessageFault.NOT_A_NUMBER and not any(harmable):
        return "key", "has no field that can be NaN"
    return None


class Interference:
    """Effect of the injected faults on frames; it knows times and bytes, and no bus."""

    def __init__(self, injections: Sequence[Injection] = ()) -> None:
        self.asked = injections
        intervals = []
        for one in injections:
            topic = topic_at(one.key)
            assert topic is not None  # by ``problem``
            intervals.append(MessageFaultInterval((topic.message_type,), one.harm, one.interval, one.size, one.seed))
        self._message_faults = MessageFaults(intervals, encode=_as_received, receive=_nobody)

    @property
    def harmed(self) -> list[int]:
        """Return the number of messages that each fault has harmed, in the order in which the faults were added."""
        return self._message_faults.harmed

    def carry(self, topic: Topic, payload: bytes, t_ns: int) -> list[tuple[int, bytes]]:
        """Return the frames that result from a frame received at ``t_ns``, each with its time of delivery (ns).

        A frame that cannot be decoded is forwarded unchanged.
        """
        if not self._message_faults.covers(topic.message_type):
            return [(t_ns, payload)]
        try:
            signal, header = decode(topic.message_type, payload)
        except WireError:
            return [(t_ns, payload)]
        message = _Carried(signal, header.epoch, header.sequence, t_ns, payload=payload, sent=signal, header=header)
        return [(delivery.at_ns, _bytes(delivery)) for delivery in self._message_faults.carry("", "", message)]


class _Carried(ReceivedMessage, frozen=True, eq=False, kw_only=True):
    """Received message together with the frame that carried it."""

    payload: bytes
    sent: Message
    header: Header


def _as_received(message: ReceivedMessage) -> bytes:
    assert isinstance(message, _Carried)
    return message.payload


def _bytes(delivery: Delivery) -> bytes:
    message = delivery.message
    assert isinstance(message, _Carried)
    if delivery.payload is not None:
        return delivery.payload
    return message.payload if message.message is message.sent else encode(message.message, message.header)


def _nobody(_: str, __: Delivery) -> ReceivedMessage | str:
    raise AssertionError("each reader validates its own messages")


class _Side:
    """Connection to one router. Frames of this side's keys go into the mailbox."""

    def __init__(self, session: Session, mailbox: Mailbox, takes: Callable[[str], bool]) -> None:
        self._session = session
        self._mailbox = mailbox
        self._takes = takes
        self._publishers: dict[str, Publisher] = {}

    def subscribe(self, key: str, topic: Topic) -> None:
        """Subscribe to a key."""
        self._session.subscribe(key, None if topic.message_type in NAMED else topic, self)

    def offer(self, topic: Topic | None, key: str, payload: bytes) -> None:
        """Put a received frame into the mailbox (on Zenoh's thread). Frames that this process published are skipped."""
        if self._takes(key):
            self._mailbox.offer(topic or topic_at(key), key, payload)

    def put(self, key: str, payload: bytes) -> None:
        """Publish a frame on this side."""
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._publishers[key] = self._session.publisher(key)
        publisher.put(payload)


class Config(msgspec.Struct, frozen=True, kw_only=True):
    """Start settings of the injector process."""

    node: str  # under test
    injections: tuple[Injection, ...]
    at_a: BusOptions  # where everyone else is
    at_b: BusOptions  # where the node under test is
    link: str = ""  # recording of the frames at B that differ from those at A; empty: none


class Injector:
    """Bridge between the two routers that applies the faults, until it is stopped."""

    def __init__(self, config: Config, *, link: RunWriter | None, stop: StopRequest, say: Say) -> None:
        """Prepare the bridge. ``link`` records the frames at B that differ from those at A."""
        self._config = config
        self._interference = Interference(config.injections)
        self._mailbox = Mailbox()
        self._stop = stop
        self._say = say
        stop.on_request(self._mailbox.wake)
        self._own = _written_by(config.node)
        self._clock = VehicleClock()
        self._link = link
        self._delayed: list[tuple[int, int, str, bytes]] = []  # heap: due (ns), count, key, frame
        self._count = 0
        self._events: list[tuple[int, int, str]] = sorted(  # time (ns), number of the fault, "begins" or "ends"
            event
            for i, one in enumerate(config.injections)
            for event in ((one.interval.start_ns, i, "begins"), (one.interval.end_ns, i, "ends"))
        )
        self._out: Outbox
        self._sides: tuple[_Side, _Side]

    @property
    def account(self) -> list[dict[str, object]]:
        """Return each fault with the number of messages that it has harmed."""
        asked = zip(self._interference.asked, self._interference.harmed, strict=True)
        return [{**msgspec.to_builtins(injection), "harmed": harmed} for injection, harmed in asked]

    def serve(self) -> None:
        """Open both sides, copy, close. Raises ``BusError``, ``Stopped``."""
        with (
            open_session(self._config.at_a, stop=self._stop, say=self._say) as at_a,
            open_session(self._config.at_b, stop=self._stop, say=self._say) as at_b,
        ):
            own = self._own
            side_a = _Side(at_a, self._mailbox, lambda key: key not in own)
            side_b = _Side(at_b, self._mailbox, lambda key: key in own)
            self._sides = side_a, side_b
            self._out = Outbox(at_a, node=NAME, epoch=new_epoch(), kinds=(RunEvent,))
            for key, topic in read_by(self._config.node).items():
                side_a.subscribe(key, topic)
            for key, topic in own.items():
                side_b.subscribe(key, topic)
            self._say(f"ready: {self._config.node} at the second router")
            while not self._stop():
                self._tend()
                frame = self._mailbox.take(self._wait_s())
                if frame is not None:
                    self._take(frame)

    def _take(self, frame: Frame) -> None:
        assert frame.topic is not None
        if frame.topic.message_type is Clock:
            with contextlib.suppress(WireError, ClockError):  # the processes that follow the clock report it
                self._clock.follow(decode(Clock, frame.payload)[0])
        now_ns = self._now_ns()
        if now_ns is None:  # nothing happens before there is a time
            self._send(frame.key, frame.payload)
            return
        come = self._interference.carry(frame.topic, frame.payload, now_ns)
        for payload in unlike_at_a(frame.payload, come, now_ns, said_at_b=frame.key in self._own):
            if self._link is not None:
                with contextlib.suppress(WireError):  # a damaged frame, which the node cannot read either
                    kind = frame.topic.message_type
                    self._link.write_plain(frame.key, kind, unpack(payload), now_ns, crc(payload))
        for due_ns, payload in come:
            if due_ns <= now_ns:
                self._send(frame.key, payload)
            else:
                self._count += 1
                heapq.heappush(self._delayed, (due_ns, self._count, frame.key, payload))

    def _tend(self) -> None:
        """Forward delayed frames that are due, and publish the begin and end events of faults."""
        now_ns = self._now_ns()
        if now_ns is None:
            return
        while self._delayed and self._delayed[0][0] <= now_ns:
            self._send(*heapq.heappop(self._delayed)[2:])
        while self._events and self._events[0][0] <= now_ns:
            _, number, what = self._events.pop(0)
            asked, harmed = self._interference.asked[number], self._interference.harmed[number]
            text = f"{asked.harm} of {asked.key} {what}" + (f", {harmed} harmed" if what == "ends" else "")
            self._out.publish(RunEvent(t_ns=now_ns, node=NAME, kind="injected", text=text))

    def _send(self, key: str, payload: bytes) -> None:
        a, b = self._sides
        (a if key in self._own else b).put(key, payload)

    def _now_ns(self) -> int | None:
        return self._clock.read(monotonic_us())

    def _wait_s(self) -> float:
        dues = [entry[0] for entry in (*self._delayed[:1], *self._events[:1])]
        due_us = self._clock.due_us(min(dues)) if dues else None
        return WAIT_S if due_us is None else min(max((due_us - monotonic_us()) / 1e6, 0.0), WAIT_S)


def unlike_at_a(payload: bytes, come: Sequence[tuple[int, bytes]], now_ns: int, *, said_at_b: bool) -> list[bytes]:
    """Return the frames at B that are not published at A, or not yet; ``come`` is the result of ``payload`` and its
    delivery times.

    With them a recording made at A holds everything that the node under test received and published.
    """
    if said_at_b:
        return [] if (now_ns, payload) in come else [payload]
    return [other for _, other in come if other != payload]


def _written_by(node: str) -> dict[str, Topic]:
    """Return the keys that a node writes; of a topic that every node writes, only the node's own key."""
    return {
        (f"{topic.key}/{node}" if topic.written_by == ANYONE else topic.key): topic
        for topic in TOPICS
        if topic.written_by in (node, ANYONE)
    }


def read_by(node: str) -> dict[str, Topic]:
    """Return the key expressions of other processes' topics that a process reads."""
    expressions = {expression(topic): topic for topic in TOPICS if node in topic.read_by or ANYONE in topic.read_by}
    own = _written_by(node)
    return {key: topic for key, topic in expressions.items() if key not in own}


def main(config: Config) -> int:
    """Inject until stopped; the last line on stdout is the number of harmed messages by fault, as JSON."""

    def work(request: StopRequest, say: Say) -> None:
        with contextlib.ExitStack() as stack:
            link = None
            if config.link:
                link = stack.enter_context(RunWriter(Path(config.link), start_ns=EARLIEST_NS, metadata={}))
            injector = Injector(config, link=link, stop=request, say=say)
            with contextlib.suppress(Stopped):
                injector.serve()
        sys.stdout.write(json.dumps(injector.account) + "\n")

    return run_until_stopped(Console(NAME), work)
