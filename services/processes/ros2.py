"""ROS 2 process: the edge to ROS 2 on two sessions, one of this bus and one of the ROS side."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterable

import msgspec

from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.mailbox import Mailbox
from services.bus.options import check_namespace, invalid
from services.bus.outbox import new_epoch
from services.bus.rate_limit import SourceLimit
from services.bus.session import ForeignReceiver, Publisher, QueryReceiver, Reply, Session, configuration, open_session
from services.edges.edge import Outgoing, Refused
from services.edges.ros2.conversions import Settings
from services.edges.ros2.edge import MAX_REQUESTS, Ros2Edge
from services.edges.ros2.middleware import GID_BYTES, Attachment, Bridge, RmwZenoh, gid_of, is_topic
from services.edges.ros2.topics import BY_NAME, IN, OUT, Row, rows
from services.processes import settings
from services.processes.edge_loop import EdgeLoop
from services.runtime.clock import monotonic_us
from services.runtime.console import Console
from services.runtime.serve import run_until_stopped
from services.runtime.stopping import Say, StopRequest

FROM_PUBLISHER, PUBLISHERS = 1000, 100
"""Messages a second of one publisher, which the bridge does not tell apart, and publishers, that are received."""


Config = settings.Ros2


def main(config: Config) -> int:
    """Translate until a stop is requested. Return the exit code. Raises ``ConfigError``."""
    bus, dds = config.bus, config.middleware == "ros2dds"
    if bus.certs is not None and dds:
        problem = "only with --middleware rmw_zenoh: the keys of the bridge have no domain, and so no role"
        raise invalid("option --certs", problem)
    check_namespace(config.ros_namespace, "--ros-namespace")
    other = msgspec.structs.replace(
        bus, namespace=config.ros_namespace, role=f"ros-{config.domain_id}", timestamps=True
    )
    configuration(other)  # its certificate is checked before anything starts
    used = _rows(config.topic, config.array, config.scale)
    vehicle = Vehicle.load(config.vehicle)
    edge = Settings(vehicle=vehicle, speed_mps=config.speed_mps, array=config.array, scale=config.scale)
    middleware = Bridge() if dds else RmwZenoh(config.domain_id)

    def work(request: StopRequest, say: Say) -> None:
        mailbox, epoch = Mailbox(), new_epoch()
        request.on_request(mailbox.wake)
        with open_session(bus, stop=request, say=say) as session, open_session(other, stop=request, say=say) as ros:
            translator, link = Ros2Edge(epoch, edge), RosLink(ros, middleware, used, mailbox)
            loop = EdgeLoop(translator, session, mailbox, epoch, say)
            for frame in translator.start():
                link.send(frame)
            for direction, verb in ((IN, "reads"), (OUT, "writes")):
                say(f"{verb} {', '.join(row.topic for row in used if row.direction is direction)}")
            loop.run(link, round(1e6 / config.rate_hz), request)

    return run_until_stopped(Console(Ros2Edge.name, as_json=config.log_json), work)


def _rows(topics: Iterable[str], array: str, scale: float) -> tuple[Row, ...]:
    """Return the rows in use, with the topics of --topic. Raises ``ConfigError``."""
    names = {}
    for given in topics:
        name, _, of = given.partition("=")
        if name not in BY_NAME or not is_topic(of):
            problem = f"must be NAME=/TOPIC, NAME one of {', '.join(BY_NAME)}"
            raise invalid("option --topic", problem, value=given)
        names[name] = of
    used = rows(names, array=bool(array))
    if twice := sorted({row.topic for row in used if sum(row.topic == other.topic for other in used) > 1}):
        raise invalid("option --topic", "used for several rows", value=", ".join(twice))
    order = array.split(",") if array else []
    if not set(order) <= {"port", "starboard", "vertical"} or len(set(order)) < len(order):
        raise invalid("option --array", "must be names of port, starboard, vertical", value=array)
    if not (math.isfinite(scale) and scale != 0.0):
        raise invalid("option --scale", "must be a number other than 0", value=str(scale))
    return used


class RosLink:
    """Publishers, subscribers, services and liveliness tokens of the edge on the ROS side."""

    def __init__(
        self, session: Session, middleware: Bridge | RmwZenoh, rows: tuple[Row, ...], mailbox: Mailbox
    ) -> None:
        self._senders: dict[str, Callable[[bytes], None]] = {}
        self._replies: dict[str, tuple[Reply, bytes]] = {}
        self._mailbox = mailbox
        self._requests = 0
        self._limit = SourceLimit(FROM_PUBLISHER, PUBLISHERS)
        tokens = middleware.tokens(rows, session.identifier)
        for at, row in enumerate(rows, start=1):
            key = middleware.key(row)
            if row.direction is OUT:
                declare = session.latched_publisher if row.latched and tokens else session.publisher
                self._senders[row.name] = _sender(declare(key), gid_of(tokens[at]) if tokens else b"")
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
        elif (send := self._senders.get(frame.channel)) is not None:
            send(frame.payload)

    def _receiver(self, name: str) -> ForeignReceiver:
        def on_sample(payload: bytes, attachment: bytes) -> None:
            if self._limit.admits((name, attachment[-GID_BYTES:]), monotonic_us()):
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


def _sender(publisher: Publisher, gid: bytes) -> Callable[[bytes], None]:
    """Return the function that publishes; with a gid each message has an attachment with the next number."""
    numbers = itertools.count(1)

    def send(payload: bytes) -> None:
        attachment = Attachment(next(numbers), time.time_ns(), gid).pack() if gid else None
        publisher.put(payload, attachment=attachment)

    return send


def _answer(attachment: bytes) -> bytes | None:
    """Return the attachment of a response: that of the request, with the time of the response."""
    try:
        return Attachment.unpack(attachment)._replace(t_ns=time.time_ns()).pack()
    except Refused:
        return None
