"""Paths that are followed at a speed: line, waypoints, lawnmower, circle, spiral."""

from __future__ import annotations

import math
from typing import Annotated, TypeAlias

import numpy as np
from msgspec import Meta

from ltv_mpc.messages import Array, ReferenceStart
from ltv_mpc.references.base import BaseReference
from ltv_mpc.references.feasibility import descent_notes, path_notes
from ltv_mpc.references.geodesy import Place, local
from ltv_mpc.references.limits import limits_of
from ltv_mpc.references.path import MOST_POINTS, Path, bend, pieces, rounded, with_lead_in
from ltv_mpc.references.schedule import Schedule, along
from ltv_mpc.vehicle.parameters import Vehicle

Size: TypeAlias = Annotated[float, Meta(gt=0, le=100_000)]
Turns: TypeAlias = Annotated[float, Meta(gt=0, le=100)]
Angle: TypeAlias = Annotated[float, Meta(ge=-360, le=360)]

LEAD_IN_M = 0.5
"""A vehicle that is farther from the first point is led there on a straight line."""
ABOUT_RAD = math.radians(15.0)
"""A vehicle that points away from the first leg by more is given the time to turn."""
SLOWEST_MPS = 0.05
"""One that is slower over ground is at rest: its velocity has no direction to begin with."""


class Shape(BaseReference, frozen=True, kw_only=True):
    """A path with a desired speed over ground. Corners are rounded: cut by at most ``corner_m``."""

    speed_mps: Annotated[float, Meta(gt=0, le=20)]
    corner_m: Annotated[float, Meta(ge=0, le=1000)] = 0.4  # 0: it stops at each corner and turns

    def path(self) -> Path:
        """Its geometry. Raises ``ValueError`` for what no single field can tell."""
        raise NotImplementedError

    def __post_init__(self) -> None:
        """Refuse what contradicts itself."""
        if len(self.path().points) > MOST_POINTS:
            raise ValueError(f"the path takes more than {MOST_POINTS} points: make several files of it")

    def schedule(self, vehicle: Vehicle, anchor: ReferenceStart | None = None) -> Schedule:
        """The target's way from ``anchor``: led to the first point in a straight line; without one, from that point."""
        path, lead_m, begin, turn = self.path(), 0.0, 0.0, 0.0
        if anchor is not None:
            path, lead_m = with_lead_in(path, np.array([anchor.north_m, anchor.east_m]), LEAD_IN_M)
            begin, turn = _begin(path, anchor)
        return along(
            path,
            self.speed_mps,
            limits_of(vehicle),
            descent_rate_mps=self.descent_rate_mps,
            start_mps=begin,
            lead_m=lead_m,
            first_turn_rad=turn,
        )

    def notes(self, vehicle: Vehicle) -> list[str]:
        """What the vehicle cannot do of it, and what it does instead: plain sentences, none where it can do all."""
        path = self.path()
        said = path_notes(path, self.speed_mps, limits_of(vehicle), self.descent_rate_mps)
        return said if np.isnan(path.depth).all() else said + descent_notes(vehicle, self.descent_rate_mps)

    def _depths(self, count: int) -> Array:
        return np.full(count, math.nan if self.depth_m is None else self.depth_m)

    def _bend(self, points: Array, curvature: Array) -> Path:
        return bend(points, curvature)._replace(depth=self._depths(len(points)))


def _begin(path: Path, anchor: ReferenceStart) -> tuple[float, float]:
    """Speed along the first piece (m/s) and angle to turn before it (rad) of a vehicle as it is at the anchor."""
    way = path.points[1] - path.points[0]
    course = math.atan2(way[1], way[0])
    north, east = anchor.velocity_mps
    if math.hypot(north, east) > SLOWEST_MPS:
        return max(north * math.cos(course) + east * math.sin(course), 0.0), 0.0
    turn = abs(math.remainder(course - anchor.heading_rad, 2.0 * math.pi))
    return 0.0, turn if turn > ABOUT_RAD else 0.0


class Line(Shape, frozen=True, kw_only=True, tag="line"):
    """A straight line from ``start`` to ``end``, and stay there."""

    start: Place
    end: Place

    def path(self) -> Path:
        """One leg."""
        points = np.array([local(self.start, self.origin), local(self.end, self.origin)])
        depth = _along(points, [self.start, self.end], self.depth_m)
        if np.hypot(*(points[1] - points[0])) < 1e-3:
            raise ValueError("start and end are the same place")
        return rounded(points, depth, self.corner_m)


class Waypoints(Shape, frozen=True, kw_only=True, tag="waypoints"):
    """From waypoint to waypoint on straight legs; ``closed``: and back to the first; so ``laps`` times."""

    waypoints: Annotated[tuple[Place, ...], Meta(min_length=2, max_length=10_000)]
    closed: bool = False
    laps: Annotated[int, Meta(ge=1, le=1000)] = 1

    def path(self) -> Path:
        """The legs, their corners rounded."""
        places = list(self.waypoints)
        for k, place in enumerate(places):
            try:
                local(place, self.origin)
            except ValueError as error:
                raise ValueError(f"waypoints[{k}]: {error}") from None
        if self.laps > 1 and not self.closed:
            raise ValueError("laps > 1 needs closed = true")
        if self.closed:
            if self.laps * len(places) > MOST_POINTS:
                raise ValueError(f"laps x waypoints must be <= {MOST_POINTS}")
            places = places * self.laps + places[:1]
        points = np.array([local(place, self.origin) for place in places])
        same = np.hypot(*np.diff(points, axis=0).T) < 1e-3
        if same.any():
            k = int(np.argmax(same)) % len(self.waypoints)
            raise ValueError(f"waypoints[{k}] and the one after it are the same place")
        return rounded(points, _along(points, places, self.depth_m), self.corner_m)


class Lawnmower(Shape, frozen=True, kw_only=True, tag="lawnmower"):
    """Parallel tracks of ``length_m`` from ``start`` along ``course_deg``, each ``spacing_m`` beside the last.

    They cover ``width_m`` to starboard of the first, or to port where ``port`` is true.
    """

    start: Place
    course_deg: Angle
    length_m: Size
    width_m: Size
    spacing_m: Size
    port: bool = False

    def path(self) -> Path:
        """The tracks and the legs between them."""
        across = self.width_m / self.spacing_m + 1e-9
        if across >= MOST_POINTS // 200:  # infinite too
            raise ValueError(f"width_m / spacing_m must be <= {MOST_POINTS // 200 - 1}")
        tracks = int(across) + 1
        course = math.radians(self.course_deg)
        ahead = np.array([math.cos(course), math.sin(course)])
        aside = np.array([-math.sin(course), math.cos(course)]) * (-1.0 if self.port else 1.0)
        first = np.array(local(self.start, self.origin))
        points = []
        for k in range(tracks):
            ends = (0.0, self.length_m) if k % 2 == 0 else (self.length_m, 0.0)
            points += [first + k * self.spacing_m * aside + end * ahead for end in ends]
        return rounded(np.array(points), self._depths(len(points)), self.corner_m)


class Circle(Shape, frozen=True, kw_only=True, tag="circle"):
    """Round a centre, clockwise as seen from above or not, from a bearing (degrees from north) seen from the centre."""

    centre: Place
    radius_m: Size
    bearing_deg: Angle = 0.0
    clockwise: bool = True
    turns: Turns = 1.0

    def path(self) -> Path:
        """Short pieces round the circle."""
        whole = 2.0 * math.pi * self.turns
        at = np.linspace(0.0, whole, pieces(whole, self.radius_m) + 1)
        points = _polar(local(self.centre, self.origin), self.bearing_deg, self.clockwise, at, self.radius_m)
        return self._bend(points, np.full(len(at) - 1, 1.0 / self.radius_m))


class Spiral(Shape, frozen=True, kw_only=True, tag="spiral"):
    """Archimedes' spiral about a centre, from ``inner_m`` to ``outer_m``, each turn ``spacing_m`` outside the last."""

    centre: Place
    inner_m: Annotated[float, Meta(ge=0, le=100_000)]
    outer_m: Size
    spacing_m: Size
    bearing_deg: Angle = 0.0
    clockwise: bool = True
    inwards: bool = False  # from the outer radius to the inner one

    def path(self) -> Path:
        """Short pieces along it; its curvature is (r^2 + 2 b^2) / (r^2 + b^2)^(3/2) with b = spacing / 2 pi."""
        if self.outer_m <= self.inner_m:
            raise ValueError(f"outer_m = {self.outer_m:g}: must be > inner_m = {self.inner_m:g}")
        turns = (self.outer_m - self.inner_m) / self.spacing_m
        if turns > 100.0:
            raise ValueError(f"(outer_m - inner_m) / spacing_m = {turns:g}: must be <= 100 turns")
        whole, b = 2.0 * math.pi * turns, self.spacing_m / (2.0 * math.pi)
        at = np.linspace(0.0, whole, pieces(whole, self.outer_m) + 1)
        r = self.inner_m + b * at
        points = _polar(local(self.centre, self.origin), self.bearing_deg, self.clockwise, at, r)
        middle = 0.5 * (r[1:] + r[:-1])
        curvature = (middle**2 + 2.0 * b * b) / (middle**2 + b * b) ** 1.5
        if self.inwards:
            points, curvature = points[::-1].copy(), curvature[::-1].copy()
        return self._bend(points, curvature)


def _polar(centre: tuple[float, float], bearing_deg: float, clockwise: bool, at: Array, r: Array | float) -> Array:
    """(K, 2) points at angles (K,) from a bearing on, at distances r from the centre."""
    bearing = math.radians(bearing_deg) + (at if clockwise else -at)
    return np.array(centre) + np.stack([r * np.cos(bearing), r * np.sin(bearing)], axis=1)


def _along(points: Array, places: list[Place], depth_m: float | None) -> Array:
    """(K,) depths: where some places have one, linear along the path between them; else ``depth_m``, else NaN."""
    known = [k for k, place in enumerate(places) if place.depth_m is not None]
    if not known:
        return np.full(len(places), math.nan if depth_m is None else depth_m)
    if depth_m is not None:
        raise ValueError("depth_m is given for the whole path and for places on it: leave one of them out")
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    depths: Array = np.interp(way, way[known], [places[k].depth_m or 0.0 for k in known])
    return depths
