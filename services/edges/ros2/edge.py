"""Edge to ROS 2: odometry to an estimate, goals and services to commands, and plans to thrusts and views."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ltv_mpc.messages import (
    Acknowledgement,
    Action,
    Applied,
    Command,
    ControllerStatus,
    CurrentProfile,
    Estimate,
    FenceInForce,
    FenceReport,
    Message,
    Obstacles,
    Plan,
)
from services.edges.edge import AppliedReporter, Edge, LossCounter, Outgoing, Output, Received, Refused
from services.edges.ros2 import cdr, conversions
from services.edges.ros2.conversions import Settings
from services.edges.ros2.middleware import Attachment
from services.edges.ros2.odometry import estimate_of, stamp_ns
from services.edges.ros2.topics import ACTIONS, BY_NAME, SERVICE

CURRENT_US = 30_000_000
"""Time for which a current is added to the estimates."""

WATER_US = 1_000_000
REPLY_US = 3_000_000
"""Longest wait for the controller's reply to the command of a service."""

MAX_REQUESTS = 100
ZERO = (0.0, 0.0, 0.0)


class Ros2Edge(Edge):
    """Edge to ROS 2. The channel of a frame is the name of a row; that of a request has a number behind a ``?``."""

    name = "ros2"
    reads = (Plan, Acknowledgement, ControllerStatus, Estimate, FenceInForce)
    writes = (Estimate, Command, Obstacles, Applied)

    def __init__(self, epoch: int, settings: Settings) -> None:
        super().__init__(epoch)
        self._settings = settings
        self._applied = AppliedReporter(settings.vehicle)
        self._twist: Any = None
        self._odometry = False  # its source publishes odometry, and so no poses
        self._current: tuple[CurrentProfile, int] | None = None  # with the arrival
        self._requests: dict[int, tuple[str, int]] = {}  # by command: channel of the reply, arrival
        self._sent = {"goal": 0, "fence": 0}  # newest command of a goal or a route, and of a fence
        self._numbers = LossCounter()
        self._water_us = 0
        self._fence: FenceReport | None = None  # of the newest plan

    def start(self) -> list[Outgoing]:
        """Return the first frames: the static transform."""
        return [_frame("tf_static", conversions.reference_point_of(self._settings))]

    def receive(self, frame: Received) -> list[Output]:
        """Convert a message or a request; a refused request has a reply with the reason."""
        outputs = super().receive(frame)
        if not outputs and BY_NAME[frame.channel.partition("?")[0]].direction is SERVICE:
            return [_reply(frame.channel, False, f"refused: {self.reason}")]
        return outputs

    def convert(self, frame: Received) -> Iterable[Output]:
        """Convert a message or a request."""
        name, _, request = frame.channel.partition("?")
        row = BY_NAME[name]
        if frame.attachment:
            attachment = Attachment.unpack(frame.attachment)
            if row.direction is not SERVICE and not self._numbers.add((name, attachment.gid), attachment.sequence):
                raise Refused("duplicate")
            self.lost = self._numbers.lost
        if row.direction is SERVICE:
            yield self._command(name, request, frame)
            return
        message = cdr.decode(frame.payload, row.ros_type)
        match name:
            case "odometry":
                yield estimate_of(message, self._current_at(frame.now_us))
                self._odometry = True
            case "pose" if self._odometry:
                raise Refused("pose: the odometry is in use")
            case "pose":
                yield estimate_of(conversions.odometry_of(message, self._twist), self._current_at(frame.now_us))
            case "twist":
                stamp_ns(message.header)  # a wrong one would exclude the poses that follow
                self._twist = message
            case "current":
                self._current = conversions.current_of(message), frame.now_us
            case "fence":
                self._sent["fence"] = self.command_id()
                fence = conversions.fence_of(message.data)
                yield Command(command_id=self._sent["fence"], action=Action.FENCE, fence_toml=fence)
            case "obstacles":
                yield conversions.obstacles_of(message.data)
            case "goal":
                yield self._follow([message.pose], message.header)
            case _:
                yield self._follow([pose.pose for pose in message.poses], message.header)

    def take(self, message: Message, now_us: int, identity: tuple[int, int] = (0, -1)) -> Iterable[Output]:
        """Convert a message of this bus."""
        super().take(message, now_us, identity)
        match message:
            case Plan():
                self._fence = message.fence
                return [_frame("path", conversions.path_of(message))]
            case Acknowledgement() if message.command_id in self._requests:
                channel, _ = self._requests.pop(message.command_id)
                return [_reply(channel, message.accepted, message.why or message.authority.value)]
            case Acknowledgement(accepted=False):
                for name in (name for name, of in self._sent.items() if of == message.command_id):
                    self.refuse(Refused(f"{name} rejected: {message.why}"))
            case ControllerStatus():
                t_ns = self.clock.read(now_us) or 0
                refused = dict(self.refused_by_reason)
                array = conversions.diagnostics_of(message, self._fence, refused, t_ns, self._settings)
                return [_frame("diagnostics", array)]
            case FenceInForce():
                return [_frame("zones", conversions.zones_of(message))]
            case Estimate(current=CurrentProfile() as profile) if now_us >= self._water_us + WATER_US:
                self._water_us = now_us
                return [_frame("water", conversions.cloud_of(message, profile))]
        return []

    def step(self, now_us: int) -> Iterable[Output]:
        """Return the thrusts, zero past the plan's end, what acts, and the replies that did not come in time."""
        outputs: list[Output] = []
        for key, (channel, at_us) in [*self._requests.items()]:
            if now_us > at_us + REPLY_US:
                del self._requests[key]
                outputs.append(_reply(channel, False, "no reply from the controller within 3 s"))
        t_ns = self.clock.read(now_us)
        thrust_N = self.plans.thrust_N(t_ns)
        if t_ns is not None and self.plans.newest is not None:
            outputs += self._thrusts(ZERO if thrust_N is None else thrust_N, t_ns)
        return [*outputs, *self._applied.report(self.plans, thrust_N, t_ns)]

    def release(self, now_us: int) -> Iterable[Output]:
        """Return zero thrusts."""
        t_ns = self.clock.read(now_us)
        return [*self._thrusts(ZERO, t_ns or 0), *self._applied.report(self.plans, None, t_ns)]

    def _thrusts(self, thrust_N: Any, t_ns: int) -> list[Outgoing]:
        messages = conversions.thrust_messages(thrust_N, t_ns, self._settings)
        return [_frame(name, message) for name, message in messages.items()]

    def _current_at(self, now_us: int) -> CurrentProfile | None:
        if self._current is None or now_us > self._current[1] + CURRENT_US:
            return None
        return self._current[0]

    def _follow(self, poses: list[Any], header: Any) -> Command:
        text = conversions.reference_of(poses, header, self._settings)
        self._sent["goal"] = self.command_id()
        return Command(command_id=self._sent["goal"], action=Action.FOLLOW, reference_toml=text)

    def _command(self, name: str, request: str, frame: Received) -> Output:
        """Return the command of a request, or the refusal as a reply."""
        channel = f"{name}?{request}"
        message = cdr.decode(frame.payload, f"{BY_NAME[name].ros_type}_Request")
        action = ACTIONS.get((name, bool(getattr(message, "data", True))))
        if action is None:
            return _reply(channel, False, f"{name} false has no meaning: follow another reference")
        if len(self._requests) >= MAX_REQUESTS:
            raise Refused(f"request: {MAX_REQUESTS} others wait for a reply")
        command = Command(command_id=self.command_id(), action=action)
        self._requests[command.command_id] = channel, frame.now_us
        return command


def _frame(name: str, message: Any) -> Outgoing:
    return Outgoing(name, cdr.encode(message))


def _reply(channel: str, success: bool, text: str) -> Outgoing:
    """Return the response of a service; both types of services have the same one."""
    name = channel.partition("?")[0]
    response = cdr.make(f"{BY_NAME[name].ros_type}_Response", success=success, message=text)
    return Outgoing(channel, cdr.encode(response))
