"""ROS 2 process: reads odometry and plans, writes estimates and a force for each thruster."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import msgspec

from ltv_mpc.messages import Estimate, NodeStatus, Plan
from services.bus.mailbox import Frame, Mailbox
from services.bus.message_validation import MessageValidator
from services.bus.options import BusOptions
from services.bus.outbox import Outbox, new_epoch
from services.bus.session import Publisher, open_session
from services.bus.topics import BY_TYPE
from services.bus.wire import WireError
from services.edges.ros2 import cdr
from services.edges.ros2.edge import Edge
from services.runtime.clock import monotonic_us
from services.runtime.console import Console
from services.runtime.serve import run_until_stopped
from services.runtime.stopping import Say, StopRequest

NAME = "ros2"
STATUS_US = 500_000


class Topics(msgspec.Struct, frozen=True, kw_only=True):
    """Names of the ROS topics. Over the bridge the key of a topic is its name without the first slash."""

    odometry: str
    thrusts: tuple[str, str, str]  # port, starboard, vertical


def main(topics: Topics, bus: BusOptions, *, ros_namespace: str, rate_hz: float) -> int:
    """Translate until a stop is requested. ``ros_namespace`` is the bridge's prefix of all its keys."""
    period_us = round(1e6 / rate_hz)
    return run_until_stopped(
        Console(NAME), lambda request, say: _run(topics, bus, ros_namespace, period_us, request, say)
    )


def _run(topics: Topics, bus: BusOptions, ros_namespace: str, period_us: int, request: StopRequest, say: Say) -> None:
    mailbox = Mailbox()
    request.on_request(mailbox.wake)
    theirs = msgspec.structs.replace(bus, namespace=ros_namespace)
    with (
        open_session(bus, stop=request, say=say) as session,
        open_session(theirs, stop=request, say=say) as ros,
    ):
        outbox = Outbox(session, node=NAME, epoch=new_epoch(), kinds=(Estimate, NodeStatus))
        loop = _Loop(outbox, [ros.publisher(key_of(name)) for name in topics.thrusts], say)
        session.subscribe(BY_TYPE[Plan].key, BY_TYPE[Plan], mailbox)
        ros.subscribe(key_of(topics.odometry), None, mailbox)
        say(f"reads {topics.odometry} (nav_msgs/Odometry); writes {', '.join(topics.thrusts)} (std_msgs/Float64, N)")
        due_us = status_us = monotonic_us()
        while not request():
            now_us = monotonic_us()
            if now_us >= due_us:
                loop.play(now_us)
                due_us = max(due_us + period_us, now_us)
            if now_us >= status_us:
                loop.publish_status()
                status_us = now_us + STATUS_US
            if (frame := mailbox.take((min(due_us, status_us) - now_us) / 1e6)) is not None:
                loop.take(frame)
        loop.release()
        loop.publish_status(finished=True)


def key_of(topic: str) -> str:
    """Return the key that zenoh-plugin-ros2dds uses for a ROS topic."""
    return topic.removeprefix("/")


class _Loop:
    """Handling of each received frame, and of each period."""

    def __init__(self, outbox: Outbox, thrusters: Sequence[Publisher], say: Say) -> None:
        self._outbox = outbox
        self._thrusters = thrusters
        self._say = say
        self._last_reason = ""
        self._validator = MessageValidator()
        self._edge = Edge()

    def take(self, frame: Frame) -> None:
        """Handle a plan from the bus or odometry from ROS."""
        if frame.topic is not BY_TYPE[Plan]:
            estimate = self._edge.odometry(frame.payload, frame.received_monotonic_us)
            if estimate is not None:
                self._outbox.publish(estimate)
            return
        try:
            plan, _ = self._validator.validate(frame)
        except WireError:  # counted by the validator
            return
        if isinstance(plan, Plan):
            self._edge.follow(plan)

    def play(self, now_us: int) -> None:
        """Publish the force of each thruster at this instant."""
        thrust_N = self._edge.thrust_N(now_us)
        if thrust_N is not None:
            self._put(thrust_N)

    def release(self) -> None:
        """Publish zero force, as the last message."""
        self._put((0.0, 0.0, 0.0))

    def publish_status(self, *, finished: bool = False) -> None:
        """Publish the node's status, and print each new reason for rejected odometry once."""
        edge = self._edge
        if edge.rejected and edge.reason != self._last_reason:
            self._say(f"odometry rejected, {edge.rejected} so far: {edge.reason}")
            self._last_reason = edge.reason
        self._outbox.publish(
            NodeStatus(
                node=NAME,
                t_ns=0,
                ready=True,
                waiting_for="" if edge.accepted or finished else "odometry",
                steps=edge.accepted,
                published=self._outbox.published + 1,  # this one included
                received=edge.accepted + self._validator.received,
                dropped=self._validator.dropped,
                rejected=edge.rejected + self._validator.rejected,
                step_us=0.0,
                finished=finished,
            )
        )

    def _put(self, thrust_N: Iterable[float]) -> None:
        for publisher, force_N in zip(self._thrusters, thrust_N, strict=True):
            publisher.put(cdr.float64(float(force_N)))
