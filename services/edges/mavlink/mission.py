"""Mission and fence of the autopilot as commands to the controller: the legs of the mission one after the other.

A leg follows the one before when the vehicle has arrived and waited. An operator's ``follow`` or ``hold`` ends the
mission. It begins again when the ground station sends it again, and at the item that the station sets as the current.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from msgspec import structs

from ltv_mpc.messages import Acknowledgement, Action, Command, Pair, Plan
from ltv_mpc.references import Origin
from services.edges.edge import Output
from services.edges.mavlink.download import Download, ListKind, ListRefused
from services.edges.mavlink.fence_items import fence_of
from services.edges.mavlink.mission_items import Leg, legs_of

MISSION, FENCE = ListKind.MISSION, ListKind.FENCE

NEAR_M, PASSED_M = 2.0, 4.0
"""Distance of the vehicle from a place on its way at which it counts as reached, and that of the target behind it."""

RECEIVED = "Flight plan received"
"""Text of ArduPilot when a ground station has sent a mission."""


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
        self._legs: list[Leg] = []
        self._at = 0
        self._follows_ns: int | None = None  # time since which the controller follows the leg
        self._reached = 0  # number of places of the leg
        self._leaves_us: float | None = None  # end of the wait
        self._first = 1  # item at which the mission begins
        self._current: int | None = None  # item of the autopilot
        self.here: Pair | None = None
        """Where the vehicle is, north and east (m)."""
        self.texts: deque[str] = deque()
        """Texts for the ground station."""

    def requests(self, make: Any, target: tuple[int, int], now_us: int) -> Iterator[Any]:
        """Yield the requests that are due."""
        for download in self._downloads.values():
            if (request := download.request(make, target, now_us)) is not None:
                yield request

    def origin(self, message: Any, _: int) -> Iterable[Output]:
        """Take a GPS_GLOBAL_ORIGIN."""
        self._origin = Origin(latitude_deg=message.latitude * 1e-7, longitude_deg=message.longitude * 1e-7)
        return self._convert()

    def count(self, message: Any, now_us: int) -> Iterable[Output]:
        """Take a MISSION_COUNT."""
        self._changed |= {kind for kind, of in self._downloads.items() if of.count(message, now_us)}
        return self._convert()

    def item(self, message: Any, now_us: int) -> Iterable[Output]:
        """Take a MISSION_ITEM_INT."""
        self._changed |= {kind for kind, of in self._downloads.items() if of.item(message, now_us)}
        return self._convert()

    def refusal(self, message: Any, now_us: int) -> Iterable[Output]:
        """Take a MISSION_ACK."""
        for download in self._downloads.values():
            download.refusal(message, now_us)
        return ()

    def text(self, message: Any, now_us: int) -> Iterable[Output]:
        """Take a STATUSTEXT: a mission that was sent again begins again."""
        if str(message.text).startswith(RECEIVED):
            self._downloads[MISSION].begin_again(now_us)
        return ()

    def current(self, message: Any, *, is_set: bool) -> Iterable[Output]:
        """Take a MISSION_CURRENT: the mission begins at an item that the ground station has set."""
        before, self._current = self._current, message.seq
        if is_set and before not in (None, message.seq) and self._downloads[MISSION].items:
            self._first = message.seq
            self._changed.add(MISSION)
        return self._convert()

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
        if reply.command_id in self._operators:
            if reply.accepted and self._legs:
                self._end("mission ended by a command of the operator")
            return None
        for kind in ListKind:
            if self._sent.get(kind) == reply.command_id:
                self._due.pop(kind, None)
                if kind is MISSION and reply.accepted:
                    self._follows_ns = reply.t_ns
                    self.texts.extend(_texts(self._legs) if self._at == 0 else ())
                elif kind is MISSION:
                    self._legs = []
                return None if reply.accepted else ListRefused(f"{kind.label} rejected: {reply.why}")
        return None

    def follow(self, plan: Plan, now_us: int) -> list[int]:
        """Take a plan. Return the numbers of the items that are reached, and begin the next leg when it is time."""
        if not self._legs or self._follows_ns is None or plan.cycle_t_ns < self._follows_ns:
            return []
        leg, before = self._legs[self._at], self._reached
        if plan.arrived:
            self._reached = len(leg.stops)
            self._leaves_us = self._leaves_us or now_us + leg.wait_s * 1e6
        while self._reached < len(leg.stops) - 1 and _passed(leg, self._reached, plan):
            self._reached += 1
        numbers = [stop.number for stop in leg.stops[before : self._reached]]
        if plan.arrived and self._leaves_us is not None and now_us >= self._leaves_us:
            self._begin(self._at + 1)
        return numbers

    def _convert(self) -> Iterable[Output]:
        if self._origin is None:
            return ()
        if MISSION in self._changed and self.here is not None:
            self._changed.discard(MISSION)
            items, first, self._first = self._downloads[MISSION].items, self._first, 1
            legs = legs_of(items, self._origin, self._speed_mps, self.here, dives=self._dives, first=first)
            if legs:
                self._legs = legs
                self._begin(0)
            elif self._legs:
                self._end("mission cleared: holds")
                self._ask(MISSION, Command(command_id=0, action=Action.HOLD))
        if FENCE in self._changed:
            self._changed.discard(FENCE)
            fence = fence_of(self._downloads[FENCE].items, self._origin)
            self._ask(FENCE, Command(command_id=0, action=Action.FENCE, fence_toml=fence))
        return ()

    def _begin(self, at: int) -> None:
        """Begin a leg; after the last one nothing follows."""
        self._at, self._follows_ns, self._reached, self._leaves_us = at, None, 0, None
        self._ask(MISSION, Command(command_id=0, action=Action.FOLLOW, reference_toml=self._legs[at].toml))

    def _ask(self, kind: ListKind, command: Command) -> None:
        self._due[kind] = command
        self._sent.pop(kind, None)  # a reply to the one before is none to this one

    def _end(self, text: str) -> None:
        self._legs, self._follows_ns = [], None
        self._due.pop(MISSION, None)
        self.texts.append(text)


def _passed(leg: Leg, at: int, plan: Plan) -> bool:
    """Return True if the vehicle is at a place on its way, or the target, which waits for it, is well behind."""
    stop, state = leg.stops[at], plan.states[0]
    near = math.hypot(state[0] - stop.north_m, state[1] - stop.east_m) <= NEAR_M
    return near or (plan.progress is not None and plan.progress * leg.along_m[-1] >= leg.along_m[at] + PASSED_M)


def _texts(legs: list[Leg]) -> Iterator[str]:
    """Yield the accepted places, speeds and times."""
    for leg in legs:
        wait = ", then holds" if leg.wait_s == math.inf else f", waits {leg.wait_s:g} s" if leg.wait_s else ""
        for stop in leg.stops:
            yield f"{stop.number}: {stop} at {leg.speed_mps:g} m/s{wait if stop is leg.stops[-1] else ''}"
