"""Mission of the autopilot as a reference: its download by the mission protocol, and its conversion.

The list is requested every 10 s. A request without an answer is repeated after 0.5 s. A list that has not changed gives
no reference again.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ltv_mpc.messages import Action, Command
from services.edges.edge import Output, Refused

POLL_US, RETRY_US = 10_000_000, 500_000
MAX_ITEMS = 500
MISSION = 0  # MAV_MISSION_TYPE_MISSION
WAYPOINT, LOITER, CHANGE_SPEED = 16, 17, 178  # MAV_CMD
ABSOLUTE, RELATIVE = (0, 5), (3, 6)
"""MAV_FRAME of an altitude above the sea, and above home: global, and the same with integers."""


class Download:
    """Download of the items of the mission. ``items`` is the list that arrived last."""

    def __init__(self) -> None:
        self._due_us = 0
        self._poll_us = 0
        self._count: int | None = None  # of the list that is under way
        self._got: dict[int, Any] = {}
        self.items: tuple[Any, ...] = ()

    def request(self, make: Any, target: tuple[int, int], now_us: int) -> Any | None:
        """Return the request that is due, or None."""
        if now_us < self._due_us or (self._count is None and now_us < self._poll_us):
            return None
        self._due_us = now_us + RETRY_US
        if self._count is None:
            return make.mission_request_list_encode(*target, MISSION)
        missing = next(at for at in range(self._count) if at not in self._got)
        return make.mission_request_int_encode(*target, missing, MISSION)

    def count(self, message: Any, now_us: int) -> None:
        """Take a MISSION_COUNT. Raises ``Refused`` if the list is too long."""
        if message.mission_type != MISSION or self._count is not None:
            return
        if message.count > MAX_ITEMS:
            self._poll_us = now_us + POLL_US
            raise Refused(f"mission: {message.count} items, at most {MAX_ITEMS}")
        if message.count == 0:
            self.items, self._poll_us = (), now_us + POLL_US
            return
        self._count, self._got, self._due_us = message.count, {}, now_us

    def item(self, message: Any, now_us: int) -> bool:
        """Take a MISSION_ITEM_INT. Return True if it completes a list that differs from the last one."""
        if message.mission_type != MISSION or self._count is None or not 0 <= message.seq < self._count:
            return False
        self._got[message.seq] = message
        self._due_us = now_us
        if len(self._got) < self._count:
            return False
        items = tuple(self._got[at] for at in range(self._count))
        self._count, self._poll_us = None, now_us + POLL_US
        changed = [_content(one) for one in items] != [_content(one) for one in self.items]
        self.items = items
        return changed


class MissionFollower:
    """Mission as a reference: ``reference`` is the file that the controller has not acknowledged yet, or empty."""

    def __init__(self, speed_mps: float, *, dives: bool) -> None:
        self._speed_mps, self._dives = speed_mps, dives
        self._origin_deg: tuple[float, float] | None = None
        self._changed = False
        self.download = Download()
        self.reference = ""
        self.command_id = 0  # of the newest command with it

    def origin(self, message: Any, _: int) -> Iterable[Output]:
        """Take a GPS_GLOBAL_ORIGIN."""
        self._origin_deg = message.latitude * 1e-7, message.longitude * 1e-7
        return self._convert()

    def count(self, message: Any, now_us: int) -> Iterable[Output]:
        """Take a MISSION_COUNT."""
        self.download.count(message, now_us)
        return ()

    def item(self, message: Any, now_us: int) -> Iterable[Output]:
        """Take a MISSION_ITEM_INT."""
        self._changed |= self.download.item(message, now_us)
        return self._convert()

    def follow(self, command_id: int) -> Command:
        """Return the command to follow the reference."""
        self.command_id = command_id
        return Command(command_id=command_id, action=Action.FOLLOW, reference_toml=self.reference)

    def _convert(self) -> Iterable[Output]:
        if self._changed and self._origin_deg is not None:
            self._changed = False
            self.reference = reference_of(self.download.items, self._origin_deg, self._speed_mps, dives=self._dives)
        return ()


def reference_of(items: Iterable[Any], origin_deg: tuple[float, float], speed_mps: float, *, dives: bool) -> str:
    """Return the reference file of a mission; empty if it has no place. Item 0 is the home of ArduPilot.

    Raises ``Refused`` for a place that is not in a global frame.
    """
    places = []
    for item in list(items)[1:]:
        if item.command == CHANGE_SPEED and item.param2 > 0.0:
            speed_mps = float(item.param2)
        if item.command not in (WAYPOINT, LOITER):
            continue
        if item.frame not in (*ABSOLUTE, *RELATIVE):
            raise Refused(f"mission: frame {item.frame} of item {item.seq} must be global")
        place = f"latitude_deg = {item.x * 1e-7:.7f}, longitude_deg = {item.y * 1e-7:.7f}"
        if dives and item.frame in RELATIVE:
            place += f", depth_m = {max(-item.z, 0.0):.3f}"
        places.append(place)
    if not places:
        return ""
    origin = f"\n[origin]\nlatitude_deg = {origin_deg[0]:.7f}\nlongitude_deg = {origin_deg[1]:.7f}\n"
    if len(places) == 1:
        return 'kind = "point"\n' + "\n".join(places[0].split(", ")) + origin
    rows = ",\n".join("{" + place + "}" for place in places)
    return f'kind = "waypoints"\nspeed_mps = {speed_mps!r}\nwaypoints = [\n{rows}\n]\n{origin}'


def _content(item: Any) -> tuple[Any, ...]:
    return item.command, item.frame, item.x, item.y, item.z, item.param2
