"""Mission and fence of the autopilot: their download by the mission protocol, and their conversion.

Each list is requested every 10 s. A request without an answer is repeated after 0.5 s. A list that has not changed
gives no command again.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from ltv_mpc import config
from ltv_mpc.config import to_toml
from ltv_mpc.geofence.fence import Disc, Fence, Polygon
from ltv_mpc.messages import Acknowledgement, Action, Command, Plan
from ltv_mpc.references.geodesy import Origin, Place, local
from ltv_mpc.validation import rejection_reason
from services.edges.edge import Output, Refused

POLL_US, RETRY_US = 10_000_000, 500_000
MAX_ITEMS = 500
WAYPOINT, LOITER, CHANGE_SPEED = 16, 17, 178  # MAV_CMD
KEEP_IN, KEEP_OUT, CIRCLE_IN, CIRCLE_OUT = 5001, 5002, 5003, 5004  # MAV_CMD_NAV_FENCE
MARGIN_M = 1.0
"""Margin of the zones of an autopilot, which sends none."""

MAX_RADIUS_M = 100_000.0
CORNERS = 32
"""Vertices of the polygon in a circle that the vehicle must not leave."""

ABSOLUTE, RELATIVE = (0, 5), (3, 6)
"""MAV_FRAME of an altitude above the sea, and above home: global, and the same with integers."""


class ListKind(enum.IntEnum):
    """Kind of a list of items (MAV_MISSION_TYPE)."""

    MISSION = 0
    FENCE = 1

    @property
    def label(self) -> str:
        """Name of the list in a reason."""
        return self.name.lower()


class ListRefused(Refused):
    """Mission or fence that cannot be used. The ground station receives the reason."""


class Download:
    """Download of the items of one kind of list. ``items`` is the list that arrived last."""

    def __init__(self, kind: ListKind) -> None:
        self._kind = kind
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
            return make.mission_request_list_encode(*target, self._kind)
        missing = next(at for at in range(self._count) if at not in self._got)
        return make.mission_request_int_encode(*target, missing, self._kind)

    def count(self, message: Any, now_us: int) -> bool:
        """Take a MISSION_COUNT. Return True if it empties the list. Raises ``ListRefused`` if it is too long."""
        if message.mission_type != self._kind or self._count is not None:
            return False
        if message.count > MAX_ITEMS:
            self._poll_us = now_us + POLL_US
            raise ListRefused(f"{self._kind.label}: {message.count} items, at most {MAX_ITEMS}")
        if message.count == 0:
            changed, self.items, self._poll_us = bool(self.items), (), now_us + POLL_US
            return changed
        self._count, self._got, self._due_us = message.count, {}, now_us
        return False

    def item(self, message: Any, now_us: int) -> bool:
        """Take a MISSION_ITEM_INT. Return True if it completes a list that differs from the last one."""
        if message.mission_type != self._kind or self._count is None or not 0 <= message.seq < self._count:
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
    """Commands for the mission and the fence of the autopilot, which are repeated until the controller has replied."""

    def __init__(self, speed_mps: float, *, dives: bool) -> None:
        self._speed_mps, self._dives = speed_mps, dives
        self._origin_deg: tuple[float, float] | None = None
        self._downloads = {kind: Download(kind) for kind in ListKind}
        self._changed: set[ListKind] = set()
        self._texts: dict[ListKind, str] = {}  # reference and fence file that the controller has not acknowledged
        self._sent: dict[ListKind, int] = {}  # newest command of each kind
        self._last_item: int | None = None  # number of the last place of the mission
        self._follows = False  # the controller has accepted it
        self._arrived = False  # by the last plan

    def requests(self, make: Any, target: tuple[int, int], now_us: int) -> Iterator[Any]:
        """Yield the requests that are due."""
        for download in self._downloads.values():
            if (request := download.request(make, target, now_us)) is not None:
                yield request

    def origin(self, message: Any, _: int) -> Iterable[Output]:
        """Take a GPS_GLOBAL_ORIGIN."""
        self._origin_deg = message.latitude * 1e-7, message.longitude * 1e-7
        return self._convert()

    def count(self, message: Any, now_us: int) -> Iterable[Output]:
        """Take a MISSION_COUNT."""
        self._changed |= {kind for kind, of in self._downloads.items() if of.count(message, now_us)}
        return self._convert()

    def item(self, message: Any, now_us: int) -> Iterable[Output]:
        """Take a MISSION_ITEM_INT."""
        self._changed |= {kind for kind, of in self._downloads.items() if of.item(message, now_us)}
        return self._convert()

    def commands(self, command_id: Callable[[], int]) -> Iterator[Command]:
        """Yield the commands that have no reply yet, with new identifiers."""
        for kind, text in list(self._texts.items()):
            self._sent[kind] = command_id()
            if kind is ListKind.MISSION:
                yield Command(command_id=self._sent[kind], action=Action.FOLLOW, reference_toml=text)
            else:
                yield Command(command_id=self._sent[kind], action=Action.FENCE, fence_toml=text)

    def acknowledged(self, reply: Acknowledgement) -> ListRefused | None:
        """Take a reply of the controller. Return the refusal if it rejects the newest mission or fence."""
        for kind in ListKind:
            if self._sent.get(kind) == reply.command_id:
                self._texts.pop(kind, None)
                if kind is ListKind.MISSION:
                    self._follows, self._arrived = reply.accepted, False
                return None if reply.accepted else ListRefused(f"{kind.label} rejected: {reply.why}")
        return None

    def reached(self, plan: Plan) -> int | None:
        """Return the number of the last item if the vehicle has come to it since the plan before."""
        before, self._arrived = self._arrived, plan.arrived
        return self._last_item if plan.arrived and not before and self._follows else None

    def _convert(self) -> Iterable[Output]:
        if self._origin_deg is None:
            return ()
        if ListKind.MISSION in self._changed:
            self._changed.discard(ListKind.MISSION)
            items = self._downloads[ListKind.MISSION].items
            if text := reference_of(items, self._origin_deg, self._speed_mps, dives=self._dives):
                self._texts[ListKind.MISSION] = text
                self._last_item = [item.seq for item in items[1:] if item.command in (WAYPOINT, LOITER)][-1]
                self._follows = False
        if ListKind.FENCE in self._changed:
            self._changed.discard(ListKind.FENCE)
            self._texts[ListKind.FENCE] = fence_of(self._downloads[ListKind.FENCE].items, self._origin_deg)
        return ()


def reference_of(items: Iterable[Any], origin_deg: tuple[float, float], speed_mps: float, *, dives: bool) -> str:
    """Return the reference file of a mission; empty if it has no place. Item 0 is the home of ArduPilot.

    Raises ``ListRefused`` for a place that is not in a global frame.
    """
    places = []
    for item in list(items)[1:]:
        if item.command == CHANGE_SPEED and item.param2 > 0.0:
            speed_mps = float(item.param2)
        if item.command not in (WAYPOINT, LOITER):
            continue
        if item.frame not in (*ABSOLUTE, *RELATIVE):
            raise ListRefused(f"mission: frame {item.frame} of item {item.seq} must be global")
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


def fence_of(items: Iterable[Any], origin_deg: tuple[float, float]) -> str:
    """Return the fence file of the items of a fence; empty if it has no zone.

    The vertices of a polygon follow one another, and each has their number. A circle not to leave becomes the polygon
    in it. Raises ``ListRefused`` for a polygon that is not complete or that crosses itself.
    """
    origin = Origin(latitude_deg=origin_deg[0], longitude_deg=origin_deg[1])
    polygons: dict[int, list[Polygon]] = {KEEP_IN: [], KEEP_OUT: []}
    discs: list[Disc] = []
    ring: list[Any] = []
    try:
        for item in items:
            centre = Place(latitude_deg=item.x * 1e-7, longitude_deg=item.y * 1e-7)
            if ring and item.command != ring[0].command:
                raise ListRefused(
                    f"fence: polygon before item {item.seq} has {len(ring)} of {ring[0].param1:g} vertices"
                )
            if item.command in polygons:
                ring.append(item)
                if len(ring) == item.param1:
                    places = (Place(latitude_deg=one.x * 1e-7, longitude_deg=one.y * 1e-7) for one in ring)
                    polygons[item.command].append(Polygon(vertices=tuple(places)))
                    ring = []
            elif item.command in (CIRCLE_IN, CIRCLE_OUT) and not 0.0 < item.param1 <= MAX_RADIUS_M:
                raise ListRefused(
                    f"fence: radius of item {item.seq} = {item.param1:g} m, must be 0 to {MAX_RADIUS_M:g}"
                )
            elif item.command == CIRCLE_OUT:
                discs.append(Disc(centre=centre, radius_m=item.param1))
            elif item.command == CIRCLE_IN:
                north_m, east_m = local(centre, origin)
                angles = np.linspace(0.0, 2.0 * np.pi, CORNERS, endpoint=False)
                corners = item.param1 * np.column_stack([np.cos(angles), np.sin(angles)]) + (north_m, east_m)
                places = (Place(north_m=float(north), east_m=float(east)) for north, east in corners)
                polygons[KEEP_IN].append(Polygon(vertices=tuple(places)))
        if ring:
            raise ListRefused(f"fence: the last polygon has {len(ring)} of {ring[0].param1:g} vertices")
        if not (discs or any(polygons.values())):
            return ""
        fence = Fence(
            margin_m=MARGIN_M,
            origin=origin,
            keep_in=tuple(polygons[KEEP_IN]),
            keep_out=tuple(polygons[KEEP_OUT]),
            keep_out_disc=tuple(discs),
        )
        text = to_toml(fence)
        config.parse(config.loads(text), Fence, source="fence")  # with the bounds of each field
    except ListRefused:
        raise
    except ValueError as error:
        raise ListRefused(f"fence: {error}") from None
    if (reason := rejection_reason(Command(command_id=0, action=Action.FENCE, fence_toml=text))) is not None:
        raise ListRefused(f"fence: {reason}")
    return text


def _content(item: Any) -> tuple[Any, ...]:
    return item.command, item.frame, item.x, item.y, item.z, item.param1, item.param2
