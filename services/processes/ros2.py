"""The process at the edge to ROS 2: reads odometry and plans, writes estimates and a force for each thruster."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import msgspec

from ltv_mpc.messages import Estimate, NodeStatus, Plan
from services.bus.mailbox import Frame, Mailbox
from services.bus.message_validation import MessageValidator
from services.bus.outbox import Outbox, new_epoch
from services.bus.session import BusOptions, Publisher, open_session
from services.bus.topics import BY_TYPE
from services.bus.wire import WireError
from services.edges.ros2 import cdr
from services.edges.ros2.edge import Edge
from services.runtime.clock import monotonic_us
from services.runtime.serve import run_until_stopped
from services.runtime.stopping import Say, StopRequest

NAME = "ros2"
STATUS_US = 500_000


class Topics(msgspec.Struct, frozen=True, kw_only=True):
    """Names in ROS. Over the bridge a topic's key is its name without the first slash."""

    odometry: str
    thrusts: tuple[str, str, str]  # port, starboard, vertical


def main(topics: Topics, bus: BusOptions, *, ros_namespace: str, rate_hz: float) -> int:
    """Translate until told to stop. ``ros_namespace`` is the bridge's, before each of its keys."""
    period_us = round(1e6 / rate_hz)
    return run_until_stopped(NAME, lambda request, say: _run(topics, bus, ros_namespace, period_us, request, say))


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
        loop.let_go()
        loop.publish_status(finished=True)


def key_of(topic: str) -> str:
    """The key of a ROS topic as zenoh-plugin-ros2dds has it."""
    return topic.removeprefix("/")


class _Loop:
    """What is done with each frame, and at each beat."""

    def __init__(self, outbox: Outbox, thrusters: Sequence[Publisher], say: Say) -> None:
        self._outbox = outbox
        self._thrusters = thrusters
        self._say = say
        self._said = ""
        self._door = MessageValidator()
        self._edge = Edge()

    def take(self, frame: Frame) -> None:
        """A plan of ours, or odometry of theirs."""
        if frame.topic is not BY_TYPE[Plan]:
            estimate = self._edge.odometry(frame.payload, frame.received_monotonic_us)
            if estimate is not None:
                self._outbox.publish(estimate)
            return
        try:
            plan, _ = self._door.validate(frame)
        except WireError:  # counted at the door
            return
        if isinstance(plan, Plan):
            self._edge.follow(plan)

    def play(self, now_us: int) -> None:
        """A force to each thruster."""
        thrust_N = self._edge.thrust_N(now_us)
        if thrust_N is not None:
            self._put(thrust_N)

    def let_go(self) -> None:
        """No force, the last word."""
        self._put((0.0, 0.0, 0.0))

    def publish_status(self, *, finished: bool = False) -> None:
        """Say what was taken and what was not; why not to the person at the terminal, once a reason."""
        edge = self._edge
        if edge.rejected and edge.reason != self._said:
            self._say(f"odometry rejected, {edge.rejected} so far: {edge.reason}")
            self._said = edge.reason
        self._outbox.publish(
            NodeStatus(
                node=NAME,
                t_ns=0,
                ready=True,
                waiting_for="" if edge.accepted or finished else "odometry",
                steps=edge.accepted,
                published=self._outbox.published + 1,  # this one included
                received=edge.accepted + self._door.received,
                dropped=self._door.dropped,
                rejected=edge.rejected + self._door.rejected,
                step_us=0.0,
                finished=finished,
            )
        )

    def _put(self, thrust_N: Iterable[float]) -> None:
        for publisher, force_N in zip(self._thrusters, thrust_N, strict=True):
            publisher.put(cdr.float64(float(force_N)))
