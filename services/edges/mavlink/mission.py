"""Mission and fence of the autopilot as commands to the controller, and what is reached.

An operator's ``follow`` or ``hold`` ends the mission. It starts again when the ground station sends it again, and at
the item that the station sets as the current.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from ltv_mpc.messages import Acknowledgement, Action, Command, Pair, Plan
from ltv_mpc.references import Origin
from services.edges.edge import Output, Refused
from services.edges.mavlink.download import Download, ListKind, ListRefused
from services.edges.mavlink.lists import Mission, fence_of, mission_of

MISSION, FENCE = ListKind.MISSION, ListKind.FENCE
NOTICE, WARNING = 5, 4  # MAV_SEVERITY

MAX_TEXTS = 1000
NEAR_M, PASSED_M = 2.0, 4.0
"""Distance of the vehicle from a place on its way at which it counts as reached, and that of the target behind it."""

RECEIVED = "Flight plan received"
"""Text of ArduPilot when a ground station has sent a mission."""


class Progress:
    """Progress along a mission."""

    def __init__(self, mission: Mission) -> None:
        self.mission = mission
        self._reached = 0  # number of stops
        self._follows_ns: int | None = None  # time since which the controller follows the mission

    def accept(self, t_ns: int) -> None:
        """Note that the controller follows the mission."""
        self._follows_ns = t_ns

    def follow(self, plan: Plan) -> list[int]:
        """Take a plan. Return the numbers of the items that are reached."""
        if self._follows_ns is None or plan.cycle_t_ns < self._follows_ns:
            return []
        stops, before = self.mission.stops, self._reached
        while self._reached < len(stops) and (plan.arrived or self._has_passed(plan)):
            self._reached += 1
        return [stop.number for stop in stops[before : self._reached] if stop.number]

    def _has_passed(self, plan: Plan) -> bool:
        """Return True if the vehicle is at the next stop on its way, or the target, which waits for it, well behind."""
        at, along_m = self._reached, self.mission.along_m
        if at == len(along_m) - 1 or plan.progress is None:
            return False
        state, (north_m, east_m) = plan.states[0], self.mission.places[at]
        behind_m = plan.progress * along_m[-1] - along_m[at]
        near = behind_m >= -NEAR_M and math.hypot(state[0] - north_m, state[1] - east_m) <= NEAR_M
        return near or behind_m >= PASSED_M


class MissionFollower:
    """Commands for mission and fence, which are repeated until the controller has replied, and what is reached."""

    def __init__(self, speed_mps: float, command_id: Callable[[], int], *, dives: bool) -> None:
        """``command_id`` returns a new identifier for a ``Command``."""
        self._speed_mps, self._command_id, self._dives = speed_mps, command_id, dives
        self._origin: Origin | None = None
        self._downloads = {kind: Download(kind) for kind in ListKind}
        self._changed: set[ListKind] = set()
        self._due: dict[ListKind, Command] = {}  # newest of each kind that the controller has not acknowledged
        self._operators: deque[int] = deque(maxlen=100)  # commands of others that end the mission if accepted
        self._progress: Progress | None = None
        self.current: int | None = None
        """Item of the autopilot; None: unknown."""
        self.here: Pair | None = None
        """Where the vehicle is, north and east (m)."""
        self.texts: deque[tuple[int, str]] = deque(maxlen=MAX_TEXTS)
        """Texts for the ground station, with their severity."""

    def requests(self, make: Any, target: tuple[int, int], now_us: int) -> Iterator[Any]:
        """Yield what is due of the mission protocol."""
        due = (download.request(make, target, now_us) for download in self._downloads.values())
        return (request for request in due if request is not None)

    def take(self, kind: str, message: Any, now_us: int, *, by_station: bool) -> Iterable[Output]:
        """Take a message of the autopilot, whose item changes ``by_station`` or by itself."""
        first, mission = 1, self._downloads[MISSION]
        if kind == "GPS_GLOBAL_ORIGIN":
            latitude_deg, longitude_deg = message.latitude * 1e-7, message.longitude * 1e-7
            if abs(latitude_deg) > 90.0 or abs(longitude_deg) > 180.0:
                raise Refused(f"origin = {latitude_deg:g}, {longitude_deg:g} deg: must be within 90 and 180")
            self._origin = Origin(latitude_deg=latitude_deg, longitude_deg=longitude_deg)
        elif kind == "MISSION_CURRENT":
            if by_station and self.current not in (None, message.seq) and mission.items:
                self._changed.add(MISSION)
                first = message.seq
            self.current = message.seq
        elif kind == "MISSION_ACK":
            for download in self._downloads.values():
                download.refusal(message, now_us)
        elif kind == "STATUSTEXT":
            if str(message.text).startswith(RECEIVED):
                mission.begin_again(now_us)
        else:
            for of, download in self._downloads.items():
                if (download.count if kind == "MISSION_COUNT" else download.item)(message, now_us):
                    self._changed.add(of)
                    if self._origin is None and download.items:
                        self.texts.append((WARNING, f"{of.name.lower()} waits: no GPS_GLOBAL_ORIGIN yet"))
        if self._origin is not None:
            self._convert(self._origin, first)
        return ()

    def commands(self) -> tuple[Command, ...]:
        """Return the commands that have no reply yet."""
        return tuple(self._due.values())

    def operator(self, command: Command) -> None:
        """Take a command of somebody else."""
        if command.action in (Action.FOLLOW, Action.HOLD):
            self._operators.append(command.command_id)

    def acknowledged(self, reply: Acknowledgement) -> ListRefused | None:
        """Take a reply of the controller. Return the refusal if it rejects the newest mission or fence."""
        if reply.command_id in self._operators and reply.accepted and self._progress is not None:
            self._end("mission ended by a command of the operator")
        for kind in [kind for kind, command in self._due.items() if command.command_id == reply.command_id]:
            del self._due[kind]
            if not reply.accepted:
                self._progress = None if kind is MISSION else self._progress
                return ListRefused(f"{kind.name.lower()} rejected: {reply.why}")
            if kind is MISSION and self._progress is not None:
                self._progress.accept(reply.t_ns)
                self.texts.extend((NOTICE, text) for text in self._progress.mission.texts)
        return None

    def follow(self, plan: Plan) -> list[int]:
        """Take a plan. Return the numbers of the items that are reached."""
        return [] if self._progress is None else self._progress.follow(plan)

    def _convert(self, origin: Origin, first: int) -> None:
        """Make commands of what has changed, of the mission from an item on."""
        if MISSION in self._changed and self.here is not None:
            self._changed.discard(MISSION)
            items = self._downloads[MISSION].items
            mission = mission_of(items, origin, self._speed_mps, self.here, dives=self._dives, first=first)
            if mission is not None:
                self._progress = Progress(mission)
                self._ask(MISSION, Action.FOLLOW, reference_toml=mission.toml)
            elif self._progress is not None:
                self._end("mission cleared: holds")
                self._ask(MISSION, Action.HOLD)
        if FENCE in self._changed:
            self._changed.discard(FENCE)
            self._ask(FENCE, Action.FENCE, fence_toml=fence_of(self._downloads[FENCE].items, origin))

    def _ask(self, kind: ListKind, action: Action, **toml: Any) -> None:
        self._due[kind] = Command(command_id=self._command_id(), action=action, **toml)

    def _end(self, text: str) -> None:
        self._progress = None
        self._due.pop(MISSION, None)
        self.texts.append((NOTICE, text))
