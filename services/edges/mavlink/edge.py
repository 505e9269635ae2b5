"""Edge to ArduPilot: estimates and mission in, overrides and state out."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from typing import Any
from zlib import crc32

import msgspec

from ltv_mpc.errors import one_line
from ltv_mpc.messages import (
    Acknowledgement,
    Applied,
    Array,
    Authority,
    Command,
    ControllerStatus,
    Estimate,
    Message,
    Plan,
)
from ltv_mpc.vehicle.parameters import Vehicle
from services.edges.edge import AppliedReporter, Edge, LossCounter, Outgoing, Output, Received, Refused
from services.edges.mavlink.actuation import Overrides
from services.edges.mavlink.autopilot import AUTOPILOT, Autopilot
from services.edges.mavlink.codec import COMPONENT, Codec, frames_of
from services.edges.mavlink.download import ListRefused
from services.edges.mavlink.mission import NOTICE, WARNING, MissionFollower
from services.edges.mavlink.navigation import CONST_POSITION, MS, Accuracy, Navigation

INTERVALS_US = {"SYSTEM_TIME": (2, 1_000_000), "ATTITUDE": (30, 50_000), "LOCAL_POSITION_NED": (32, 100_000),
                "MISSION_CURRENT": (42, 1_000_000), "GPS_GLOBAL_ORIGIN": (49, 1_000_000),
                "EKF_STATUS_REPORT": (193, 1_000_000)}  # fmt: skip
"""Number and interval of each requested message."""

OF_MISSION = ("GPS_GLOBAL_ORIGIN", "MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ACK", "MISSION_CURRENT", "STATUSTEXT")

SPEED_MPS = 0.5  # on a mission that sets none
SECOND_US = 1_000_000
SILENT_US = 3_000_000
REQUESTS = 2  # of the time, unanswered, after which another sender is asked too
SET_MESSAGE_INTERVAL = 511
ONBOARD_CONTROLLER, NO_AUTOPILOT, ACTIVE = 18, 8, 4
RELEASES = 5
TEXT_BYTES, MAX_PIECES = 50, 20  # of a STATUSTEXT; a longer text comes in pieces


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """Settings of the edge to ArduPilot."""

    vehicle: Vehicle
    ground_station: int = 255  # system number of the ground station, which the autopilot obeys
    accuracy: Accuracy = Accuracy()
    follow_mission: bool = True


class MavlinkEdge(Edge):
    """Edge to ArduPilot. A received frame is a datagram, with one or more frames of MAVLink.

    Its channel is its sender. Frames go to the channel of the autopilot, "" before it is known.
    """

    name = "mavlink"
    reads = (Plan, Acknowledgement, Command, ControllerStatus)
    writes = (Estimate, Command, Applied)

    def __init__(self, epoch: int, settings: Settings, codec: Codec) -> None:
        super().__init__(epoch)
        self._settings, self._codec = settings, codec
        dives = settings.vehicle.can_dive
        self.autopilot = Autopilot(settings.ground_station)
        self.navigation = Navigation(settings.accuracy, dives=dives)
        self.overrides = Overrides(settings.vehicle)
        self._applied = AppliedReporter(settings.vehicle)
        self._mission = MissionFollower(SPEED_MPS, self.command_id, dives=dives)
        self._numbers = LossCounter(256)
        self._seen_us: dict[str, int] = {}
        self._asked_us = -SECOND_US
        self._requests_ns: deque[int] = deque(maxlen=REQUESTS)  # times of the newest, which an answer repeats
        self._told = ""
        self._reported = (0, 0)  # restarts and resets

    @property
    def waiting_for(self) -> str:
        """Input that the edge needs before it can do its work; empty if it needs none."""
        return "autopilot" if self.autopilot.kind is None else ""

    def receive(self, frame: Received) -> list[Output]:
        """Convert each frame of a datagram; each is counted for itself."""
        outputs: list[Output] = []
        for one in frames_of(frame.payload):
            outputs += super().receive(frame._replace(payload=one))
        for output in outputs:
            if isinstance(output, Estimate):
                self._mission.here = output.north_m, output.east_m
        return outputs

    def convert(self, frame: Received) -> Iterable[Output]:
        """Convert a frame of MAVLink."""
        message = self._codec.decode(frame.payload)
        kind = message.get_type()
        if self.autopilot.is_from(message):  # of the others not all frames come this way
            answers = kind == "TIMESYNC" and message.tc1 != 0 and message.ts1 in self._requests_ns
            self.autopilot.check_channel(frame.channel, frame.now_us, signed=self._codec.signs, answers=answers)
            self._numbers.add(message.get_srcSystem(), message.get_seq())
            self.lost = self._numbers.lost
        if kind == "HEARTBEAT":
            if self.autopilot.kind is None:
                self._asked_us = -SECOND_US  # its messages are asked for at once
            self.autopilot.heartbeat(message, frame.now_us)
        elif self.autopilot.is_from(message) and self._is_mine(message):
            self._seen_us[kind] = frame.now_us
            yield from self._take_in(kind, message, frame.now_us)
        if self.autopilot.is_from(message):  # and accepted
            self.autopilot.channel, self.autopilot.heard_us = frame.channel, frame.now_us

    def refuse(self, refusal: Refused) -> None:
        """Count a refusal; that of a mission or fence is also reported to the ground station."""
        super().refuse(refusal)
        if isinstance(refusal, ListRefused):
            self._mission.texts.append((WARNING, str(refusal)))

    def take(self, message: Message, now_us: int, identity: tuple[int, int] = (0, -1)) -> Iterable[Output]:
        """Take a plan, a status or a reply of the controller."""
        super().take(message, now_us, identity)
        match message:
            case Acknowledgement():
                if (refusal := self._mission.acknowledged(message)) is not None:
                    self.refuse(refusal)
            case Command():
                self._mission.operator(message)
            case Plan():
                numbers = self._mission.follow(message)
                return [self._send(self._codec.make.mission_item_reached_encode(number)) for number in numbers]
            case ControllerStatus(error_m=float() as error_m):
                boot_ms = (self.clock.read(now_us) or 0) // MS & 0xFFFFFFFF
                return [self._send(self._codec.make.named_value_float_encode(boot_ms, b"mpc_err", error_m))]
        return []

    def step(self, now_us: int) -> Iterable[Output]:
        """Return the override of this period and what acts, and once a second what keeps the link alive."""
        why = self.autopilot.why_not(now_us)
        thrust_N, self.idle = self._thrust(why, now_us)
        yield from self._applied.report(self.plans, thrust_N, self.clock.read(now_us), why)
        if self.autopilot.kind is not None:
            row = self.overrides.step(self.autopilot.kind, thrust_N, self.autopilot.armed, now_us)
            if row is not None:
                yield self._override(row)
            if self.idle != self._told:
                yield from self._text(*((WARNING, f"not driving: {self.idle}") if self.idle else (NOTICE, "driving")))
                self._told = self.idle
        yield from self._reports()
        if now_us >= self._asked_us + SECOND_US:
            self._asked_us = now_us
            yield from self._every_second(now_us)
        if self.autopilot.kind is not None and self._settings.follow_mission:
            yield from map(self._send, self._mission.requests(self._codec.make, self._target, now_us))

    def release(self, now_us: int) -> Iterable[Output]:
        """Return neutral, while armed, and the release, several times because frames may be lost."""
        yield from self._applied.report(self.plans, None, self.clock.read(now_us), "the edge has stopped")
        kind = self.autopilot.kind
        if kind is not None and self.overrides.acts(now_us):
            rows = [self.overrides.neutral(kind)] * (RELEASES if self.autopilot.armed else 0)
            yield from map(self._override, (*rows, *[self.overrides.release(kind)] * RELEASES))

    # --- out ---

    def _thrust(self, why: str, now_us: int) -> tuple[Array | None, str]:
        """Return the thrust (N), or None and why the edge does not drive, for which the autopilot may have a reason."""
        newest = self.plans.newest
        authority = Authority.DISARMED if newest is None else newest.authority
        if not why and authority not in (Authority.CONTROLLER, Authority.MANUAL):
            why = f"controller {authority.value}; ltv-mpc ctl arm"
        thrust_N = None if why else self.plans.thrust_N(self.clock.read(now_us))
        return thrust_N, why or ("" if thrust_N is not None else "no plan; is the controller running?")

    def _every_second(self, now_us: int) -> Iterator[Output]:
        """Yield heartbeat, requests of time and of the messages that do not come, and a reference until it is taken.

        Without the ground station there is no heartbeat: it has the same system number, and would stand for it.
        """
        if self.autopilot.station_is_there(now_us):
            yield self._send(self._codec.make.heartbeat_encode(ONBOARD_CONTROLLER, NO_AUTOPILOT, 0, 0, ACTIVE))
        if self.autopilot.kind is None:
            return
        request = self._codec.make.timesync_encode(0, now_us * 1000)
        if self.autopilot.rival and len(self._requests_ns) == REQUESTS:
            yield self._send(request)._replace(channel=self.autopilot.rival)
        yield self._send(request)
        self._requests_ns.append(now_us * 1000)
        yield from self._mission.commands()
        for name, (number, interval_us) in INTERVALS_US.items():
            if now_us > self._seen_us.get(name, -SILENT_US) + SILENT_US - SECOND_US:
                asked = SET_MESSAGE_INTERVAL, 0, number, interval_us, 0, 0, 0, 0, 0
                yield self._send(self._codec.make.command_long_encode(*self._target, *asked))

    def _reports(self) -> Iterator[Outgoing]:
        counted = self.navigation.restarts, self.navigation.resets
        if counted != self._reported:
            if counted[0] > self._reported[0]:
                self.clock.reset()
                self._mission.current = None  # its own change is none by the ground station
                yield from self._text(WARNING, "autopilot restarted")
            else:
                yield from self._text(WARNING, f"EKF reset, {counted[1]} so far")
            self._reported = counted
        if self._mission.texts:
            yield from self._text(*self._mission.texts.popleft())

    @property
    def _target(self) -> tuple[int, int]:
        return self.autopilot.system, AUTOPILOT

    def _override(self, row: list[int]) -> Outgoing:
        return self._send(self._codec.make.rc_channels_override_encode(*self._target, *row))

    def _text(self, severity: int, text: str) -> Iterator[Outgoing]:
        """Yield a text for the ground station, in pieces of 50 characters."""
        line = f"LTV-MPC: {one_line(text)}".encode("ascii", "replace")[: TEXT_BYTES * MAX_PIECES]
        identity = 1 + crc32(line) % 65_535 if len(line) > TEXT_BYTES else 0
        for number, at in enumerate(range(0, len(line), TEXT_BYTES)):
            piece = line[at : at + TEXT_BYTES]
            yield self._send(self._codec.make.statustext_encode(severity, piece, identity, number))

    def _send(self, message: Any) -> Outgoing:
        return Outgoing(self.autopilot.channel, self._codec.encode(message))

    # --- in ---

    def _take_in(self, kind: str, message: Any, now_us: int) -> Iterable[Output]:
        """Take a message of the autopilot."""
        match kind:
            case "ATTITUDE":
                return self.navigation.attitude(message)
            case "LOCAL_POSITION_NED":
                return self.navigation.position(message)
            case "ODOMETRY":
                return self.navigation.odometry(message)
            case "EKF_STATUS_REPORT":
                self.navigation.has_position = not message.flags & CONST_POSITION
            case "SYSTEM_TIME":
                self.clock.update(message.time_boot_ms * MS, now_us)
            case "TIMESYNC" if message.tc1 != 0:  # an answer, and no request
                self.clock.exchange(message.tc1, message.ts1 // 1000, now_us)
            case _ if kind in OF_MISSION:
                by_station = self.autopilot.is_manual and self.navigation.restarts == self._reported[0]
                return self._mission.take(kind, message, now_us, by_station=by_station)
        return ()

    def _is_mine(self, message: Any) -> bool:
        """Return False for a message to another station, such as the items that the ground station asked for."""
        system, component = getattr(message, "target_system", 0), getattr(message, "target_component", 0)
        return system in (0, self._settings.ground_station) and component in (0, COMPONENT)
