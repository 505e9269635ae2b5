"""Mission items (MAV_CMD) as waypoints: one table for the missions of an autopilot and for mission files.

The items of ``DRIVEN`` are driven, any other one is refused by number and name. A waypoint without coordinates is at
the place before it. A vehicle that dives has depths: altitudes relative to home, 0 or negative.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np
from msgspec import structs

from ltv_mpc.messages import Pair
from ltv_mpc.references.geodesy import MAX_DISTANCE_M, Origin, local
from ltv_mpc.references.path import MAX_POINTS
from ltv_mpc.references.shapes import SAME_M, Waypoint

WAYPOINT, LOITER, LOITER_TURNS, LOITER_TIME, RETURN, LAND = 16, 17, 18, 19, 20, 21  # MAV_CMD
SPLINE, DELAY, JUMP, CHANGE_SPEED = 82, 93, 177, 178
PLACES = (WAYPOINT, LOITER, LOITER_TURNS, LOITER_TIME, LAND, SPLINE)
TIMED, LAST = (WAYPOINT, LOITER_TIME, SPLINE), (LOITER, RETURN)
"""Commands with a time to wait (param 1), and those behind which nothing is driven."""
SPEED_TYPES = (0.0, 1.0)
"""Through the air and over ground: here one speed, that of the target."""
DRIVEN = (*PLACES, RETURN, DELAY, JUMP, CHANGE_SPEED)
"""Commands that are driven; ``LAND``, which surfaces, by a vehicle that dives."""

GLOBAL, RELATIVE = (0, 5), (3, 6)
"""MAV_FRAME of an altitude above the sea, and above home: global, and the same with integers."""

MAX_SPEED_MPS, MAX_WAIT_S, MAX_DEPTH_M = 20.0, 1e6, 11_000.0
"""Bounds of a waypoint."""

MAX_STEPS = 2000
"""Largest number of items that are driven, with all repetitions."""
OFF_CIRCLE_M, LEAST_CORNERS = 0.1, 24
"""Largest distance of a circle from the waypoints that stand for it, and their least number for a turn."""


class Item(NamedTuple):
    """Item of a mission."""

    number: int
    command: int
    frame: int
    parameters: tuple[float, ...]  # 4
    latitude_deg: float
    longitude_deg: float
    altitude_m: float

    @property
    def has_place(self) -> bool:
        """False for an item that is driven at the place before it."""
        return self.latitude_deg != 0.0 or self.longitude_deg != 0.0


class Stop(NamedTuple):
    """Waypoint of a mission."""

    number: int  # of the item that is reached with it; 0: none
    place: Waypoint
    speed_mps: float  # on the way to it


class ItemRefused(ValueError):
    """Item that cannot be driven."""

    def __init__(self, item: Item, why: str) -> None:
        """Name number and command.

        Parameters
        ----------
        item : cannot be driven.
        why : continues the sentence.
        """
        super().__init__(f"item {item.number} {command_name(item.command)} ({item.command}) {why}")


def command_name(command: int) -> str:
    """Return the name of a command (MAV_CMD); without pymavlink, whose table it is, "command".

    Parameters
    ----------
    command : its number.
    """
    try:
        from pymavlink.dialects.v20 import ardupilotmega as dialect
    except ImportError:
        return "command"
    entry = dialect.enums["MAV_CMD"].get(command)
    return str(entry.name) if entry else "command"


def refusals(items: Sequence[Item], *, dives: bool) -> list[ItemRefused]:
    """Return the refusals of all items that cannot be driven.

    Parameters
    ----------
    items : of a mission; the first one is home.
    dives : the vehicle follows depths.
    """
    whys = ((item, _problem(item, items, dives)) for item in items[1:])
    return [ItemRefused(item, why) for item, why in whys if why]


def stops_of(
    items: Sequence[Item], origin: Origin, speed_mps: float, here: Pair | None, *, dives: bool, first: int = 1
) -> list[Stop]:
    """Return the waypoints of a mission from an item on; none if it has none. Raises ``ItemRefused``.

    Parameters
    ----------
    items : of the mission; the first one is home. None of them is refused.
    origin : of the local frame.
    speed_mps : holds until the mission sets another one.
    here : where the vehicle is, north and east (m); None: not known.
    dives : the vehicle follows depths.
    first : place of the first item that is driven among the items.
    """
    writer, jumps = _Writer(origin, speed_mps, here, dives), Counter[int]()
    place_of = {item.number: k for k, item in enumerate(items)}
    for item in items[1:first]:
        writer.change_speed(item)
    at, steps = max(first, 1), 0
    while at < len(items):
        item, at, steps = items[at], at + 1, steps + 1
        if item.command == JUMP:
            if steps > MAX_STEPS:
                raise ItemRefused(item, f"makes more than {MAX_STEPS} steps of the mission")
            jumps[item.number] += 1
            at = place_of[int(item.parameters[0])] if jumps[item.number] <= item.parameters[1] else at
        elif item.command == CHANGE_SPEED:
            writer.change_speed(item)
        elif item.command == DELAY:
            writer.wait(item, item.parameters[0])
        else:
            writer.drive(item, items[0] if item.command == RETURN else item)
        if item.command in LAST:
            break
    return writer.stops if any(stop.number for stop in writer.stops) else []


def reference_table(stops: Sequence[Stop], origin: Origin, here: Pair | None = None) -> dict[str, Any]:
    """Return the table of a reference, as a TOML file holds it: a path, or a point for a single place.

    Parameters
    ----------
    stops : at least one waypoint.
    origin : of the local frame.
    here : where the vehicle is, north and east (m): a path to a single place begins there.
    """
    if len(stops) == 1 and here is not None:
        stops = [Stop(0, _at(*here, None), stops[0].speed_mps), *stops]
    table: dict[str, Any] = {"origin": msgspec.to_builtins(origin)}
    places: list[dict[str, Any]] = [msgspec.to_builtins(stop.place) for stop in stops]
    north, east = np.ptp([local(stop.place, origin) for stop in stops], axis=0)
    depths = {stop.place.depth_m for stop in stops} - {None}
    if math.hypot(north, east) < SAME_M and len(depths) < 2:
        return table | {"kind": "point"} | {key: value for key, value in places[-1].items() if key != "wait_s"}
    for place, before, behind in zip(places, stops, stops[1:], strict=False):
        if behind.speed_mps != before.speed_mps:
            place["speed_mps"] = behind.speed_mps
    return table | {"kind": "waypoints", "speed_mps": stops[0].speed_mps, "waypoints": places}


class _Writer:
    """Waypoints of a mission, written item by item."""

    def __init__(self, origin: Origin, speed_mps: float, here: Pair | None, dives: bool) -> None:
        self.stops: list[Stop] = []
        self._origin, self._dives = origin, dives
        self._speed_mps = self._default_mps = speed_mps
        self._begin = None if here is None else _at(*here, None)

    def change_speed(self, item: Item) -> None:
        """Set the speed from here on: that of the item, for -1 the one before it, for -2 that of the settings.

        Parameters
        ----------
        item : changes the speed; another one does not.
        """
        speed = item.parameters[1]
        if item.command == CHANGE_SPEED and speed != -1.0:
            self._speed_mps = speed if speed > 0.0 else self._default_mps

    def wait(self, item: Item, wait_s: float) -> None:
        """Wait at the newest place, or where the vehicle is.

        Parameters
        ----------
        item : asks for the wait.
        wait_s : is added to what the place has (s).
        """
        if not self.stops:
            self._add(0, self._last(item))
        number, place, speed_mps = self.stops[-1]
        if place.wait_s + wait_s > MAX_WAIT_S:
            raise ItemRefused(item, f"cannot wait for {place.wait_s + wait_s:g} s, more than {MAX_WAIT_S:g} s")
        self.stops[-1] = Stop(number, structs.replace(place, wait_s=place.wait_s + wait_s), speed_mps)

    def drive(self, item: Item, of: Item) -> None:
        """Write an item with a place.

        Parameters
        ----------
        item : without coordinates it is at the newest place.
        of : has the place: the item, or home, to which it goes back at the depth of the newest place.
        """
        here = self._place(item, of) if of.has_place else self._last(item)
        depth_m = abs(item.altitude_m) if self._dives else None
        if item.command == RETURN:
            depth_m = self.stops[-1].place.depth_m if self.stops else None
        place = structs.replace(here, depth_m=depth_m, wait_s=0.0)
        if item.command == LOITER_TURNS:
            self._circle(item, place)
            return
        self._add(0 if item.command == LAND else item.number, place)
        if item.command == LAND:
            self._add(item.number, structs.replace(place, depth_m=0.0))
        if item.command in TIMED and item.parameters[0] > 0.0:
            self.wait(item, item.parameters[0])

    def _circle(self, item: Item, centre: Waypoint) -> None:
        """Add a circle, clockwise if its radius is positive, from the side at which the vehicle comes."""
        turns, r = item.parameters[0], abs(item.parameters[2])
        north, east = local(centre, self._origin)
        last = self.stops[-1].place if self.stops else self._begin
        from_north, from_east = (north, east) if last is None else local(last, self._origin)
        bearing = math.atan2(from_east - east, from_north - north)
        corners = max(LEAST_CORNERS, math.ceil(math.pi / math.acos(max(1.0 - OFF_CIRCLE_M / r, 0.0))))
        if len(self.stops) + corners * turns > MAX_POINTS:
            raise ItemRefused(item, f"needs more than {MAX_POINTS:,} waypoints")
        count = max(math.ceil(corners * turns), 1)
        angles = bearing + math.copysign(2.0 * math.pi * turns, item.parameters[2]) * np.arange(count + 1) / count
        for k, angle in enumerate(angles.tolist()):
            corner = _at(north + r * math.cos(angle), east + r * math.sin(angle), centre.depth_m)
            self._add(item.number if k == count else 0, corner)

    def _place(self, item: Item, of: Item) -> Waypoint:
        """Return the place of an item, to which another one leads."""
        place = Waypoint(latitude_deg=of.latitude_deg, longitude_deg=of.longitude_deg)
        try:
            local(place, self._origin)
        except ValueError as error:
            raise ItemRefused(item, str(error)) from None
        return place

    def _last(self, item: Item) -> Waypoint:
        """Return the newest place, or where the vehicle is."""
        last = self.stops[-1].place if self.stops else self._begin
        if last is None:
            raise ItemRefused(item, "has no place before it")
        return last

    def _add(self, number: int, place: Waypoint) -> None:
        self.stops.append(Stop(number, place, self._speed_mps))


def _at(north_m: float, east_m: float, depth_m: float | None) -> Waypoint:
    return Waypoint(north_m=round(north_m, 3), east_m=round(east_m, 3), depth_m=depth_m)


def _problem(item: Item, items: Sequence[Item], dives: bool) -> str:
    """Return why an item is not driven; empty if it is."""
    command, (first, second, third, _) = item.command, item.parameters
    if command not in DRIVEN or (command == LAND and not dives):
        return "is not driven here"
    if command in PLACES and item.frame not in (*GLOBAL, *RELATIVE):
        return f"frame {item.frame} must be global"
    if command in PLACES and dives and (item.frame not in RELATIVE or not -MAX_DEPTH_M <= item.altitude_m <= 0.0):
        return f"altitude {item.altitude_m:g} m in frame {item.frame} must be {-MAX_DEPTH_M:g} to 0, relative to home"
    if command == LOITER_TURNS and not (0.0 < first < math.inf and 0.0 < abs(third) <= MAX_DISTANCE_M):
        return f"needs turns (param 1) and a radius (param 3) of at most {MAX_DISTANCE_M:g} m"
    if command == RETURN and not items[0].has_place:
        return "has no home"
    if command == DELAY and not 0.0 < first < math.inf:
        return "needs seconds (param 1)"
    if command == JUMP and not (first in {one.number for one in items[1:]} and 0.0 <= second < math.inf):
        return f"must go to an item from 1 to {items[-1].number}, and not for ever"
    if command in TIMED and (first < 0.0 or first == math.inf or (command == LOITER_TIME and math.isnan(first))):
        return f"cannot wait for {first:g} s (param 1)"
    if command == CHANGE_SPEED and first not in SPEED_TYPES:
        return f"type of speed {first:g} (param 1) must be 0 or 1: those of climb and descent are not driven"
    if command == CHANGE_SPEED and not (0.0 < second <= MAX_SPEED_MPS or second in (-1.0, -2.0)):
        bound = f"at most {MAX_SPEED_MPS:g} m/s" if MAX_SPEED_MPS < second < math.inf else "above 0, and finite"
        return f"speed {second:g} m/s must be {bound}"
    return ""
