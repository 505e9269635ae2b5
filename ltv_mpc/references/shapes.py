"""Path shapes with a desired speed: line, waypoints, lawnmower, circle, spiral."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, TypeAlias

import numpy as np
from msgspec import Meta
from msgspec.structs import asdict

from ltv_mpc.messages import Array, ReferenceStart
from ltv_mpc.references.base import BaseReference
from ltv_mpc.references.feasibility import descent_notes, path_notes
from ltv_mpc.references.geodesy import Place, local
from ltv_mpc.references.leg_fit import ACCURACY_M, DENSE_M, LegFit, fit_legs_between, outliers
from ltv_mpc.references.limits import path_limits
from ltv_mpc.references.path import MAX_POINTS, Path, chord_count, first_leg, round_corners, smooth_curve, with_lead_in
from ltv_mpc.references.schedule import Schedule, fastest_schedule
from ltv_mpc.vehicle.parameters import Vehicle

Size: TypeAlias = Annotated[float, Meta(gt=0, le=100_000)]
Speed: TypeAlias = Annotated[float, Meta(gt=0, le=20)]
Turns: TypeAlias = Annotated[float, Meta(gt=0, le=100)]
Angle: TypeAlias = Annotated[float, Meta(ge=-360, le=360)]

SAME_M, ROUNDING_M = 1e-3, 1e-6
"""Smallest extent of a path, and distance below which two successive waypoints are one."""
MIN_TURN_RAD = math.radians(15.0)
"""Angle between heading and first leg above which the schedule starts with time to turn."""
MIN_COURSE_SPEED_MPS = 0.05
"""Speed over ground below which the vehicle counts as at rest, because its course is undefined."""


class Shape(BaseReference, frozen=True, kw_only=True):
    """Base class of paths with a desired speed over ground. Corners are rounded by arcs within ``corner_m`` of them."""

    speed_mps: Speed
    corner_m: Annotated[float, Meta(ge=0, le=1000)] = 0.4  # 0: the vehicle stops at each corner and turns

    def path(self) -> Path:
        """Return the geometry. Raises ``ValueError`` if the fields contradict each other."""
        raise NotImplementedError

    def __post_init__(self) -> None:
        """Reject fields that contradict each other, and a path with too many points."""
        if len(self.path().points) > MAX_POINTS:
            raise ValueError(f"the path needs more than {MAX_POINTS} points: split it into several references")

    def schedule(self, vehicle: Vehicle, anchor: ReferenceStart | None = None) -> Schedule:
        """Return the schedule of the target.

        Parameters
        ----------
        vehicle : parameters of the vehicle, which limit the speed.
        anchor : start of the reference, from which a straight leg leads to the path; None: start at the first point.
        """
        path, lead_m, begin, turn = self.path(), 0.0, 0.0, 0.0
        if anchor is not None:
            path, lead_m = with_lead_in(path, np.array([anchor.north_m, anchor.east_m]))
            begin, turn = _initial_motion(path, anchor)
        return fastest_schedule(
            path,
            path_limits(vehicle),
            descent_rate_mps=self.descent_rate_mps,
            start_mps=begin,
            lead_m=lead_m,
            first_turn_rad=turn,
        )

    def notes(self, vehicle: Vehicle) -> list[str]:
        """Return sentences about what the vehicle cannot do of this reference, and what it does instead.

        Parameters
        ----------
        vehicle : parameters of the vehicle.
        """
        path = self.path()
        notes = path_notes(path, path_limits(vehicle), self.descent_rate_mps)
        return notes if np.isnan(path.depth).all() else notes + descent_notes(vehicle, self.descent_rate_mps)

    def _depths(self, count: int) -> Array:
        return np.full(count, math.nan if self.depth_m is None else self.depth_m)


def _initial_motion(path: Path, anchor: ReferenceStart) -> tuple[float, float]:
    """Return the vehicle's speed along the first piece (m/s) and the angle to turn before it (rad)."""
    way = first_leg(path)
    course = math.atan2(way[1], way[0])
    north, east = anchor.velocity_mps
    if math.hypot(north, east) > MIN_COURSE_SPEED_MPS:
        return max(north * math.cos(course) + east * math.sin(course), 0.0), 0.0
    turn = abs(math.remainder(course - anchor.heading_rad, 2.0 * math.pi))
    return 0.0, turn if turn > MIN_TURN_RAD else 0.0


class Line(Shape, frozen=True, kw_only=True, tag="line"):
    """Straight line from ``start`` to ``end``; the target stays at the end."""

    start: Place
    end: Place

    def path(self) -> Path:
        """Return the geometry: one leg."""
        points = np.array([local(self.start, self.origin), local(self.end, self.origin)])
        depth = _depths_between(points, [self.start, self.end], self.depth_m)
        if np.hypot(*(points[1] - points[0])) < 1e-3:
            raise ValueError("start and end are the same position")
        return round_corners(points, depth, self.corner_m, self.speed_mps)


class Waypoint(Place, frozen=True, kw_only=True, omit_defaults=True):
    """Place on a path, at which the vehicle may wait, and behind which it may have another speed over ground."""

    speed_mps: Speed | None = None  # from here on; None: as before
    wait_s: Annotated[float, Meta(ge=0, le=1e6)] = 0.0


class Waypoints(Shape, frozen=True, kw_only=True, tag="waypoints"):
    """Straight legs between waypoints; ``closed`` adds the leg back to the first, ``laps`` repeats the closed path.

    Two waypoints at one position with different depths are a change of depth there.
    """

    waypoints: Annotated[tuple[Waypoint, ...], Meta(min_length=2, max_length=MAX_POINTS)]
    closed: bool = False
    laps: Annotated[int, Meta(ge=1, le=1000)] = 1

    def path(self) -> Path:
        """Return the geometry: the legs, with rounded corners."""
        return self._fit()[0]

    def notes(self, vehicle: Vehicle) -> list[str]:
        """Return sentences about doubled and noisy waypoints, and about what the vehicle cannot do.

        Parameters
        ----------
        vehicle : parameters of the vehicle.
        """
        _, fit, doubled, aside = self._fit()
        notes = []
        if len(aside):
            notes.append(
                f"{len(aside)} waypoints are far beside those around them, the first is "
                f"waypoints[{aside[0] % len(self.waypoints)}]: the path leads there and back; remove outliers of a log"
            )
        if doubled:
            notes.append(
                f"waypoints at the position of the one before them count as one with it: {len(doubled)}, the first is "
                f"waypoints[{doubled[0] % len(self.waypoints)}]"
            )
        if fit.deviation_m > ACCURACY_M:
            notes.append(
                f"the {len(self.waypoints)} waypoints scatter: the path of {len(fit.ends) - 1} legs smooths them and "
                f"is up to {fit.deviation_m:.2g} m away from them"
            )
        if fit.curve_m > ACCURACY_M:
            notes.append(
                "waypoints that turn evenly are samples of a curve: the path through them is up to "
                f"{fit.curve_m:.2g} m beside the straight lines between them"
            )
        return notes + super().notes(vehicle)

    def _fit(self) -> tuple[Path, LegFit, list[int], list[int]]:
        """Return path and legs near the waypoints, and numbers: of those at the place of the one before, of outliers.

        A waypoint at which the vehicle waits, sinks or changes its speed is the end of a leg, as is an outlier.
        """
        places, points = self._places()
        speed = [self.speed_mps]
        for place in places:
            speed.append(place.speed_mps or speed[-1])
        steps = np.diff(np.nan_to_num(points), axis=0)
        still = np.concatenate([[False], np.hypot(steps[:, 0], steps[:, 1]) < ROUNDING_M])
        doubled = np.flatnonzero(still[1:] & (np.abs(steps[:, 2]) < ROUNDING_M)) + 1
        first = np.delete(np.arange(len(places)), doubled)  # of those at one place
        points, still = points[first], still[first]
        if len(first) < 2 or (np.hypot(*np.ptp(points[:, :2], axis=0)) < SAME_M and not still.any()):
            raise ValueError("all waypoints are the same position")
        wait = np.add.reduceat([place.wait_s for place in places], first)
        leaves = np.array(speed)[np.append(first[1:], len(places))]  # speed behind each of them
        fixed = (wait > 0.0) | still | np.append(still[1:], False) | (np.diff(leaves, prepend=speed[0]) != 0.0)
        aside = outliers(points, max(self.corner_m, ACCURACY_M), np.arange(float(len(points))), DENSE_M)
        fixed[np.concatenate([aside - 1, aside, aside + 1])] = True
        fit = fit_legs_between(points, self.corner_m, fixed)
        at = np.rint(fit.at[fixed]).astype(np.int64)
        rest = np.zeros(len(fit.ends))
        rest[at] = wait[fixed]
        before = np.searchsorted(at, np.arange(len(rest) - 1), side="right")  # fixed points before each leg
        wanted = np.concatenate([[leaves[0]], leaves[fixed]])[before]
        path = round_corners(fit.ends[:, :2], fit.ends[:, 2], self.corner_m, wanted, rest)
        return path, fit, doubled.tolist(), first[aside].tolist()

    def _places(self) -> tuple[list[Waypoint], Array]:
        """Return the waypoints of all laps, and their north, east and depth (K, 3) in m."""
        places = [place if isinstance(place, Waypoint) else Waypoint(**asdict(place)) for place in self.waypoints]
        if self.laps > 1 and not self.closed:
            raise ValueError("laps > 1 needs closed = true")
        if self.closed:
            if self.laps * len(places) > MAX_POINTS:
                raise ValueError(f"laps x waypoints must be <= {MAX_POINTS}")
            places = places * self.laps + places[:1]
        points = np.empty((len(places), 2))
        for k, place in enumerate(places):
            try:
                points[k] = local(place, self.origin)
            except ValueError as error:
                raise ValueError(f"waypoints[{k % len(self.waypoints)}]: {error}") from None
        return places, np.column_stack([points, _depths_between(points, places, self.depth_m)])


class Lawnmower(Shape, frozen=True, kw_only=True, tag="lawnmower"):
    """Parallel tracks of ``length_m`` along ``course_deg``, ``spacing_m`` apart, the first from ``start``.

    They cover ``width_m`` to starboard of the first track, or to port if ``port`` is true.
    """

    start: Place
    course_deg: Angle
    length_m: Size
    width_m: Size
    spacing_m: Size
    port: bool = False

    def path(self) -> Path:
        """Return the geometry: the tracks and the legs between them."""
        across = self.width_m / self.spacing_m + 1e-9
        if across >= MAX_POINTS // 200:  # infinite too
            raise ValueError(f"width_m / spacing_m must be <= {MAX_POINTS // 200 - 1}")
        tracks = int(across) + 1
        course = math.radians(self.course_deg)
        ahead = np.array([math.cos(course), math.sin(course)])
        aside = np.array([-math.sin(course), math.cos(course)]) * (-1.0 if self.port else 1.0)
        first = np.array(local(self.start, self.origin))
        points = []
        for k in range(tracks):
            ends = (0.0, self.length_m) if k % 2 == 0 else (self.length_m, 0.0)
            points += [first + k * self.spacing_m * aside + end * ahead for end in ends]
        return round_corners(np.array(points), self._depths(len(points)), self.corner_m, self.speed_mps)


class Circle(Shape, frozen=True, kw_only=True, tag="circle"):
    """Circle about a centre, clockwise or not as seen from above, from a bearing (degrees) of the centre on."""

    centre: Place
    radius_m: Size
    bearing_deg: Angle = 0.0
    clockwise: bool = True
    turns: Turns = 1.0

    def path(self) -> Path:
        """Return the geometry: short pieces along the circle."""
        whole = 2.0 * math.pi * self.turns
        at = np.linspace(0.0, whole, chord_count(whole, self.radius_m) + 1)
        points = _polar(local(self.centre, self.origin), self.bearing_deg, self.clockwise, at, self.radius_m)
        curvature = np.full(len(at) - 1, 1.0 / self.radius_m)
        return smooth_curve(points, self._depths(len(at)), curvature, self.speed_mps)


class Spiral(Shape, frozen=True, kw_only=True, tag="spiral"):
    """Archimedean spiral about a centre, from ``inner_m`` to ``outer_m``, with ``spacing_m`` between two turns."""

    centre: Place
    inner_m: Annotated[float, Meta(ge=0, le=100_000)]
    outer_m: Size
    spacing_m: Size
    bearing_deg: Angle = 0.0
    clockwise: bool = True
    inwards: bool = False  # from the outer radius to the inner one

    def path(self) -> Path:
        """Return the geometry; the curvature is (r^2 + 2 b^2) / (r^2 + b^2)^(3/2) with b = spacing / 2 pi."""
        if self.outer_m <= self.inner_m:
            raise ValueError(f"outer_m = {self.outer_m:g}: must be > inner_m = {self.inner_m:g}")
        turns = (self.outer_m - self.inner_m) / self.spacing_m
        if turns > 100.0:
            raise ValueError(f"(outer_m - inner_m) / spacing_m = {turns:g}: must be <= 100 turns")
        whole, b = 2.0 * math.pi * turns, self.spacing_m / (2.0 * math.pi)
        at = np.linspace(0.0, whole, chord_count(whole, self.outer_m) + 1)
        r = self.inner_m + b * at
        points = _polar(local(self.centre, self.origin), self.bearing_deg, self.clockwise, at, r)
        middle = 0.5 * (r[1:] + r[:-1])
        curvature = (middle**2 + 2.0 * b * b) / (middle**2 + b * b) ** 1.5
        if self.inwards:
            points, curvature = points[::-1].copy(), curvature[::-1].copy()
        return smooth_curve(points, self._depths(len(at)), curvature, self.speed_mps)


def _polar(centre: tuple[float, float], bearing_deg: float, clockwise: bool, at: Array, r: Array | float) -> Array:
    """Return points (K, 2) at angles (K,) from a bearing and at distances r from the centre."""
    bearing = math.radians(bearing_deg) + (at if clockwise else -at)
    return np.array(centre) + np.stack([r * np.cos(bearing), r * np.sin(bearing)], axis=1)


def _depths_between(points: Array, places: Sequence[Place], depth_m: float | None) -> Array:
    """Return depths (K,): linear along the path between places with a depth; else ``depth_m``, else NaN."""
    known = [k for k, place in enumerate(places) if place.depth_m is not None]
    if not known:
        return np.full(len(places), math.nan if depth_m is None else depth_m)
    if depth_m is not None:
        raise ValueError("depth_m is given for the whole path and for places on it: remove one of them")
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    given = [places[k].depth_m or 0.0 for k in known]
    depths: Array = np.interp(way, way[known], given)
    depths[known] = given  # two at one position keep theirs
    return depths
