"""Mission and fence of the autopilot as commands to the controller: the legs of the mission one after the other.

A leg follows the one before when the vehicle has arrived and waited. An operator's ``follow`` or ``hold`` ends the
mission. It starts again when the ground station sends it again, and at the item that the station sets as the current.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from msgspec import structs

from ltv_mpc.messages import Acknowledgement, Action, Command, Pair, Plan
from ltv_mpc.references import Origin
from services.edges.edge import Output
from services.edges.mavlink.download import Download, ListKind, ListRefused
from services.edges.mavlink.fence_items import fence_of
from services.edges.mavlink.mission_items import Leg, legs_of

MISSION, FENCE = ListKind.MISSION, ListKind.FENCE
NOTICE, WARNING = 5, 4  # MAV_SEVERITY

NEAR_M, PASSED_M = 2.0, 4.0
"""Distance of the vehicle from a place on its way at which it counts as reached, and that of the target behind it."""

RECEIVED = "Flight plan received"
"""Text of ArduPilot when a ground station has sent a mission."""


class Progress:
    """Progress along the first of the legs of a mission that are left."""

    def __init__(self, legs: Sequence[Leg], texts: Sequence[str] = ()) -> None:
        """``texts`` say what the mission is."""
        self.legs, self._texts, self._reached = legs, texts, 0
        self._follows_ns: int | None = None  # time since which the controller follows the leg
        self._leaves_us: float | None = None  # end of the wait

    def accept(self, t_ns: int) -> Sequence[str]:
        """Note that the controller follows the leg. Return the texts of a mission that begins."""
        self._follows_ns = t_ns
        return self._texts

    def follow(self, plan: Plan, now_us: int) -> list[int]:
        """Take a plan. Return the numbers of the items that are reached."""
        if not self.legs or self._follows_ns is None or plan.cycle_t_ns < self._follows_ns:
            return []
        leg, before = self.legs[0], self._reached
        while self._reached < len(leg.stops) and (plan.arrived or _passed(leg, self._reached, plan)):
            self._reached += 1
        if plan.arrived and self._leaves_us is None:
            self._leaves_us = now_us + leg.wait_s * 1e6
        return [stop.number for stop in leg.stops[before : self._reached]]

    def is_done(self, now_us: int) -> bool:
        """Return True if the vehicle has arrived at the end of the leg and waited."""
        return self._leaves_us is not None and now_us >= self._leaves_us


class MissionFollower:
    """Commands for mission and fence, which are repeated until the controller has replied, and what is reached."""

    def __init__(self, speed_mps: float, *, dives: bool) -> None:
        self._speed_mps, self._dives = speed_mps, dives
        self._origin: Origin | None = None
        self._downloads = {kind: Download(kind) for kind in ListKind}
        self._changed: set[ListKind] = set()
        self._due: dict[ListKind, Command] = {}  # that the controller has not acknowledged
        self._sent: dict[ListKind, int] = {}  # newest command of each kind
        self._operators: deque[int] = deque(maxlen=100)  # commands of others that end the mission if accepted
        self._progress = Progress([])
        self.current: int | None = None
        """Item of the autopilot; None: unknown."""
        self.here: Pair | None = None
        """Where the vehicle is, north and east (m)."""
        self.texts: deque[tuple[int, str]] = deque()
        """Texts for the ground station, with their severity."""

    def requests(self, make: Any, target: tuple[int, int], now_us: int) -> Iterator[Any]:
        """Yield what is due of the mission protocol."""
        due = (download.request(make, target, now_us) for download in self._downloads.values())
        return (request for request in due if request is not None)

    def take(self, kind: str, message: Any, now_us: int, *, by_station: bool) -> Iterable[Output]:
        """Take a message of the autopilot, whose item changes ``by_station`` or by itself."""
        first, mission = 1, self._downloads[MISSION]
        if kind == "GPS_GLOBAL_ORIGIN":
            self._origin = Origin(latitude_deg=message.latitude * 1e-7, longitude_deg=message.longitude * 1e-7)
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
        if self._origin is not None:
            self._convert(self._origin, first)
        return ()

    def commands(self, command_id: Callable[[], int]) -> Iterator[Command]:
        """Yield the commands that have no reply yet, with new identifiers."""
        for kind, command in list(self._due.items()):
            self._sent[kind] = command_id()
            yield structs.replace(command, command_id=self._sent[kind])

    def operator(self, command: Command) -> None:
        """Take a command of somebody else."""
        if command.action in (Action.FOLLOW, Action.HOLD):
            self._operators.append(command.command_id)

    def acknowledged(self, reply: Acknowledgement) -> ListRefused | None:
        """Take a reply of the controller. Return the refusal if it rejects the newest mission or fence."""
        if reply.command_id in self._operators and reply.accepted and self._progress.legs:
            self._end("mission ended by a command of the operator")
        for kind in (kind for kind in ListKind if self._sent.get(kind) == reply.command_id):
            self._due.pop(kind, None)
            if not reply.accepted:
                self._progress = Progress([]) if kind is MISSION else self._progress
                return ListRefused(f"{kind.label} rejected: {reply.why}")
            if kind is MISSION:
                self.texts.extend((NOTICE, text) for text in self._progress.accept(reply.t_ns))
        return None

    def follow(self, plan: Plan, now_us: int) -> list[int]:
        """Take a plan. Return the numbers of the items that are reached, and begin the next leg when it is time."""
        numbers = self._progress.follow(plan, now_us)
        if self._progress.is_done(now_us):
            self._begin(Progress(self._progress.legs[1:]))
        return numbers

    def _convert(self, origin: Origin, first: int) -> None:
        """Make commands of what has changed, of the mission from an item on."""
        if MISSION in self._changed and self.here is not None:
            self._changed.discard(MISSION)
            items = self._downloads[MISSION].items
            legs = legs_of(items, origin, self._speed_mps, self.here, dives=self._dives, first=first)
            if legs:
                self._begin(Progress(legs, [text for leg in legs for text in leg.texts]))
            elif self._progress.legs:
                self._end("mission cleared: holds")
                self._ask(MISSION, Command(command_id=0, action=Action.HOLD))
        if FENCE in self._changed:
            self._changed.discard(FENCE)
            fence = fence_of(self._downloads[FENCE].items, origin)
            self._ask(FENCE, Command(command_id=0, action=Action.FENCE, fence_toml=fence))

    def _begin(self, progress: Progress) -> None:
        self._progress = progress
        self._ask(MISSION, Command(command_id=0, action=Action.FOLLOW, reference_toml=progress.legs[0].toml))

    def _ask(self, kind: ListKind, command: Command) -> None:
        self._due[kind] = command
        self._sent.pop(kind, None)  # a reply to the one before is none to this one

    def _end(self, text: str) -> None:
        self._progress = Progress([])
        self._due.pop(MISSION, None)
        self.texts.append((NOTICE, text))


def _passed(leg: Leg, at: int, plan: Plan) -> bool:
    """Return True if the vehicle is at a place on its way, or the target, which waits for it, is well behind it."""
    if at == len(leg.stops) - 1:
        return False
    stop, state = leg.stops[at], plan.states[0]
    near = math.hypot(state[0] - stop.north_m, state[1] - stop.east_m) <= NEAR_M
    return near or (plan.progress is not None and plan.progress * leg.along_m[-1] >= leg.along_m[at] + PASSED_M)
