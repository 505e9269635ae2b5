"""ROS 2 process: the edge to ROS 2 on two sessions, one of this bus and one of the ROS side."""

from __future__ import annotations

import time
from collections.abc import Sequence

import msgspec

from services.bus.mailbox import Mailbox
from services.bus.options import BusOptions
from services.bus.outbox import new_epoch
from services.bus.session import ForeignReceiver, Publisher, QueryReceiver, Reply, Session, open_session
from services.edges.edge import Outgoing, Refused
from services.edges.ros2.conversions import Settings
from services.edges.ros2.edge import MAX_REQUESTS, Ros2Edge
from services.edges.ros2.middleware import GID_BYTES, Attachment, Bridge, RmwZenoh, gid_of
from services.edges.ros2.topics import IN, OUT, Row
from services.processes.edge_loop import EdgeLoop, SenderLimit
from services.runtime.console import Console
from services.runtime.serve import run_until_stopped
from services.runtime.stopping import Say, StopRequest

FROM_PUBLISHER, PUBLISHERS = 1000, 100
"""Messages a second of one publisher, which the bridge does not tell apart, and publishers, that are received."""


class Config(msgspec.Struct, frozen=True, kw_only=True):
    """Settings of the process."""

    bus: BusOptions
    ros: BusOptions  # of the other side: the same router, with its own namespace and role
    rows: Sequence[Row]
    domain_id: int | None = None  # None: zenoh-plugin-ros2dds, which has no domain in its keys
    edge: Settings
    rate_hz: float = 20.0


def main(config: Config) -> int:
    """Translate until a stop is requested. Return the exit code."""
    return run_until_stopped(Console(Ros2Edge.name), lambda request, say: _run(config, request, say))


def _run(config: Config, request: StopRequest, say: Say) -> None:
    mailbox = Mailbox()
    request.on_request(mailbox.wake)
    middleware = Bridge() if config.domain_id is None else RmwZenoh(config.domain_id)
    with (
        open_session(config.bus, stop=request, say=say) as session,
        open_session(config.ros, stop=request, say=say) as ros,
    ):
        epoch = new_epoch()
        edge = Ros2Edge(epoch, config.edge)
        link = RosLink(ros, middleware, tuple(config.rows), mailbox)
        loop = EdgeLoop(edge, session, mailbox, epoch, say)
        for frame in edge.start():
            link.send(frame)
        for direction, verb in ((IN, "reads"), (OUT, "writes")):
            say(f"{verb} {', '.join(row.topic for row in config.rows if row.direction is direction)}")
        loop.run(link, round(1e6 / config.rate_hz), request)


class RosLink:
    """Publishers, subscribers, services and liveliness tokens of the edge on the ROS side."""

    def __init__(
        self, session: Session, middleware: Bridge | RmwZenoh, rows: tuple[Row, ...], mailbox: Mailbox
    ) -> None:
        self._attaches = middleware.attaches
        self._publishers: dict[str, Publisher] = {}
        self._gids: dict[str, bytes] = {}
        self._sequences: dict[str, int] = {}
        self._replies: dict[str, tuple[Reply, bytes]] = {}
        self._mailbox = mailbox
        self._requests = 0
        self._limit = SenderLimit(FROM_PUBLISHER, PUBLISHERS)
        tokens = middleware.tokens(rows, session.identifier)
        for at, row in enumerate(rows, start=1):
            key = middleware.key(row)
            if row.direction is OUT:
                declare = session.latched_publisher if row.latched and self._attaches else session.publisher
                self._publishers[row.name] = declare(key)
                self._gids[row.name] = gid_of(tokens[at]) if tokens else b""
            elif row.direction is IN:
                session.receive(key, self._receiver(row.name))
            else:
                session.serve(key, self._server(row.name))
        for token in tokens:
            session.declare_token(token)

    def send(self, frame: Outgoing) -> None:
        """Publish on the topic of a row, or reply to a request."""
        if frame.channel in self._replies:
            reply, attachment = self._replies.pop(frame.channel)
            reply(frame.payload, _answer(attachment))
        elif (publisher := self._publishers.get(frame.channel)) is not None:
            publisher.put(frame.payload, attachment=self._attachment(frame.channel))

    def _attachment(self, name: str) -> bytes | None:
        if not self._attaches:
            return None
        sequence = self._sequences[name] = self._sequences.get(name, 0) + 1
        return Attachment(sequence, time.time_ns(), self._gids[name]).pack()

    def _receiver(self, name: str) -> ForeignReceiver:
        def on_sample(payload: bytes, attachment: bytes) -> None:
            if self._limit.admits(f"{name} {attachment[-GID_BYTES:].hex()}", time.monotonic()):
                self._mailbox.offer(None, name, payload, attachment)
            else:
                self._mailbox.overflowed += 1

        return on_sample

    def _server(self, name: str) -> QueryReceiver:
        def on_query(payload: bytes, attachment: bytes, reply: Reply) -> None:
            if len(self._replies) >= MAX_REQUESTS:
                return  # the client waits until its time-out
            self._requests += 1
            channel = f"{name}?{self._requests}"
            self._replies[channel] = reply, attachment
            self._mailbox.offer(None, channel, payload, attachment)

        return on_query


def _answer(attachment: bytes) -> bytes | None:
    """Return the attachment of a response: that of the request, with the time of the response."""
    try:
        return Attachment.unpack(attachment)._replace(t_ns=time.time_ns()).pack()
    except Refused:
        return None
