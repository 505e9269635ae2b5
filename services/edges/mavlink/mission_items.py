"""Mission items of an autopilot as legs, which the vehicle follows one after the other.

A leg ends where the vehicle waits, where the speed changes, and at a change of depth in place. On a leg the vehicle
passes the places; a spline waypoint is passed as any other. ``COMMANDS`` are driven, any other command is refused.
"""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple, cast

from pymavlink.dialects.v20 import ardupilotmega as dialect

from ltv_mpc import config
from ltv_mpc.messages import Pair
from ltv_mpc.references import Origin, Place, Reference
from ltv_mpc.references.geodesy import local
from services.edges.mavlink.download import ListRefused

WAYPOINT, LOITER, LOITER_TURNS, LOITER_TIME, RETURN, LAND = 16, 17, 18, 19, 20, 21  # MAV_CMD
SPLINE, DELAY, JUMP, CHANGE_SPEED = 82, 93, 177, 178
PLACES = (WAYPOINT, LOITER, LOITER_TURNS, LOITER_TIME, LAND, SPLINE)
TIMED, LAST = (WAYPOINT, LOITER_TIME, SPLINE), (LOITER, RETURN)
"""Commands with a time to wait (param 1), and those behind which nothing is driven."""

COMMANDS = (*PLACES, RETURN, DELAY, JUMP, CHANGE_SPEED)
"""Commands that are driven; ``LAND``, which surfaces, by a vehicle that dives."""

GLOBAL, RELATIVE = (0, 5), (3, 6)
"""MAV_FRAME of an altitude above the sea, and above home: global, and the same with integers."""

MAX_STEPS = 2000
"""Largest number of items that are driven, with all repetitions."""

SAME_M = 0.01
"""Distance within which two places are one."""


class Stop(NamedTuple):
    """Place of a mission item, north and east (m), as coordinates of a reference file."""

    number: int  # of the item; 0: where the vehicle was
    north_m: float
    east_m: float
    toml: str
    depth_m: float | None = None

    @property
    def full_toml(self) -> str:
        """Coordinates and depth."""
        return self.toml if self.depth_m is None else f"{self.toml}, depth_m = {self.depth_m:.3f}"

    def __str__(self) -> str:
        return self.full_toml.replace("latitude_deg = ", "").replace("longitude_deg = ", "")


class Leg(NamedTuple):
    """Part of a mission: its reference file, and the places on its way."""

    toml: str
    speed_mps: float
    stops: tuple[Stop, ...]
    along_m: tuple[float, ...]  # distance of each place from the begin
    wait_s: float = 0.0  # at its end; inf: for ever

    @property
    def texts(self) -> list[str]:
        """Places, speed and time."""
        wait = ", then holds" if self.wait_s == math.inf else f", waits {self.wait_s:g} s" if self.wait_s else ""
        last = len(self.stops) - 1
        at = f"at {self.speed_mps:g} m/s"
        return [f"{one.number}: {one} {at}{wait if k == last else ''}" for k, one in enumerate(self.stops)]


class _Writer:
    """Legs of a mission, written item by item."""

    def __init__(self, origin: Origin, speed_mps: float, here: Pair) -> None:
        self.legs: list[Leg] = []
        self.speed_mps = speed_mps
        self._origin = origin
        self._begin = _metres(0, *here)
        self._run: list[Stop] = []

    @property
    def last(self) -> Stop:
        """Place at which the legs end so far."""
        return self._run[-1] if self._run else self._begin

    def go(self, stop: Stop) -> None:
        """Add a place; one at the same place, such as another depth, is a leg of its own."""
        if math.dist(stop[1:3], self.last[1:3]) > SAME_M:
            self._run.append(stop)
            return
        self.end()
        self._leg('kind = "point"\n' + stop.full_toml.replace(", ", "\n"), (stop,), (0.0,), stop)

    def circle(self, centre: Stop, radius_m: float, turns: float) -> None:
        """Add a circle, clockwise if the radius is positive, from the side at which the vehicle comes."""
        self.end()
        bearing = math.atan2(self._begin.east_m - centre.east_m, self._begin.north_m - centre.north_m)
        end, r = bearing + math.copysign(2.0 * math.pi * turns, radius_m), abs(radius_m)
        toml = (
            f'kind = "circle"\nspeed_mps = {self.speed_mps!r}\nradius_m = {r!r}\nturns = {turns!r}\n'
            f"bearing_deg = {math.degrees(bearing)!r}\nclockwise = {str(radius_m > 0.0).lower()}\n"
            f"centre = {{{centre.toml}}}" + ("" if centre.depth_m is None else f"\ndepth_m = {centre.depth_m:.3f}")
        )
        begin = _metres(centre.number, centre.north_m + r * math.cos(end), centre.east_m + r * math.sin(end))
        self._leg(toml, (centre,), (0.0,), begin._replace(depth_m=centre.depth_m))

    def end(self, wait_s: float = 0.0) -> None:
        """End the leg; the vehicle waits there."""
        if run := self._run:
            path = run if len(run) > 1 and not self.legs else [self._begin, *run]
            ways = [math.dist(a[1:3], b[1:3]) for a, b in itertools.pairwise(path)]
            along_m = (0.0, *itertools.accumulate(ways))
            rows = ",\n".join("{" + stop.full_toml + "}" for stop in path)
            toml = f'kind = "waypoints"\nspeed_mps = {self.speed_mps!r}\nwaypoints = [\n{rows}\n]'
            self._run = []
            self._leg(toml, tuple(run), along_m[-len(run) :], run[-1])
        if wait_s > 0.0:
            if not self.legs:
                self._leg('kind = "hold"', (), (), self._begin)
            self.legs[-1] = self.legs[-1]._replace(wait_s=self.legs[-1].wait_s + wait_s)

    def _leg(self, toml: str, stops: tuple[Stop, ...], along_m: tuple[float, ...], end: Stop) -> None:
        at = self._origin
        toml += f"\n[origin]\nlatitude_deg = {at.latitude_deg:.7f}\nlongitude_deg = {at.longitude_deg:.7f}\n"
        try:
            source = f"item {stops[0].number}" if stops else "wait"
            config.parse(config.loads(toml), cast(Any, Reference), source=source)
        except ValueError as error:
            raise ListRefused(f"mission: {error}") from None
        self.legs.append(Leg(toml, self.speed_mps, stops, along_m))
        self._begin = end


def _metres(number: int, north_m: float, east_m: float) -> Stop:
    return Stop(number, north_m, east_m, f"north_m = {north_m!r}, east_m = {east_m!r}")


def legs_of(
    items: Sequence[Any], origin: Origin, speed_mps: float, here: Pair, *, dives: bool, first: int = 1
) -> list[Leg]:
    """Return the legs of a mission from item ``first`` on; none if it has none. Item 0 is the home of ArduPilot.

    ``speed_mps`` holds until the mission sets another one; ``here`` is where the vehicle is, north and east (m). Raises
    ``ListRefused`` with number and name of an item that cannot be driven.
    """
    for item in items[1:]:
        _check(item, items, dives)
    writer, default_mps, jumps = _Writer(origin, speed_mps, here), speed_mps, Counter[int]()
    for item in items[1:first]:
        if item.command == CHANGE_SPEED:
            writer.speed_mps = _speed(item, writer.speed_mps, default_mps)
    at, steps = max(first, 1), 0
    while at < len(items):
        item, at, steps = items[at], at + 1, steps + 1
        if item.command == JUMP:
            if steps > MAX_STEPS:
                raise refused(item, f"makes more than {MAX_STEPS} steps of the mission")
            jumps[item.seq] += 1
            at = int(item.param1) if jumps[item.seq] <= item.param2 else at
        elif item.command == CHANGE_SPEED:
            writer.end()
            writer.speed_mps = _speed(item, writer.speed_mps, default_mps)
        elif item.command == DELAY:
            writer.end(item.param1)
        elif item.command == RETURN:
            writer.go(_stop(items[0], origin, writer.last.depth_m)._replace(number=item.seq))
        else:
            _drive(item, writer, origin, dives)
        if item.command in LAST:
            break
    writer.end(math.inf)
    return writer.legs if any(leg.stops for leg in writer.legs) else []


def _drive(item: Any, writer: _Writer, origin: Origin, dives: bool) -> None:
    """Write an item with a place; without coordinates it is the place before it."""
    depth_m = abs(item.z) if dives else None
    here = item.x == 0 and item.y == 0
    stop = writer.last._replace(number=item.seq, depth_m=depth_m) if here else _stop(item, origin, depth_m)
    if item.command == LOITER_TURNS:
        writer.circle(stop, item.param3, item.param1)
        return
    writer.go(stop)
    if item.command == LAND:
        writer.go(stop._replace(depth_m=0.0))
    if item.command in TIMED and item.param1 > 0.0:
        writer.end(item.param1)


def _check(item: Any, items: Sequence[Any], dives: bool) -> None:
    """Raise ``ListRefused`` for an item that is not driven."""
    command, count = item.command, len(items)
    if command not in COMMANDS or (command == LAND and not dives):
        raise refused(item, "is not driven here")
    if command in PLACES and item.frame not in (*GLOBAL, *RELATIVE):
        raise refused(item, f"frame {item.frame} must be global")
    if command in PLACES and dives and (item.frame not in RELATIVE or not item.z <= 0.0):
        raise refused(item, f"altitude {item.z:g} m in frame {item.frame} must be 0 or negative, relative to home")
    if command == LOITER_TURNS and not (item.param1 > 0.0 and abs(item.param3) > 0.0):
        raise refused(item, "needs turns (param 1) and a radius (param 3)")
    if command == RETURN and items[0].x == items[0].y == 0:
        raise refused(item, "has no home")
    if command == DELAY and not item.param1 > 0.0:
        raise refused(item, "needs seconds (param 1)")
    if command == JUMP and not (1.0 <= item.param1 < count and 0.0 <= item.param2 < math.inf):
        raise refused(item, f"must go to an item from 1 to {count - 1}, and not for ever")
    if command == CHANGE_SPEED and not (item.param2 > 0.0 or item.param2 in (-1.0, -2.0)):
        raise refused(item, f"speed {item.param2:g} m/s must be above 0")


def refused(item: Any, why: str) -> ListRefused:
    """Return the refusal of a mission by number and name of an item."""
    entry = dialect.enums["MAV_CMD"].get(item.command)
    return ListRefused(f"mission: item {item.seq} {entry.name if entry else 'command'} ({item.command}) {why}")


def _speed(item: Any, speed_mps: float, default_mps: float) -> float:
    """Return the speed from an item on: its own, for -1 the one before it, for -2 that of the settings."""
    return float(item.param2) if item.param2 > 0.0 else speed_mps if item.param2 == -1.0 else default_mps


def _stop(item: Any, origin: Origin, depth_m: float | None) -> Stop:
    latitude_deg, longitude_deg = item.x * 1e-7, item.y * 1e-7
    try:
        north_m, east_m = local(Place(latitude_deg=latitude_deg, longitude_deg=longitude_deg), origin)
    except ValueError as error:
        raise refused(item, str(error)) from None
    toml = f"latitude_deg = {latitude_deg:.7f}, longitude_deg = {longitude_deg:.7f}"
    return Stop(item.seq, north_m, east_m, toml, depth_m)
