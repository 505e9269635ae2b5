"""Tasks of the strangers: what is flown, and the figures of a flight."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
import shapely

from benchmarks.strangers.flight import Conditions, Flight, Ours, Pilot, Start, fly, load
from benchmarks.strangers.rival import Rival
from ltv_mpc.messages import Applied, Array, Estimate, Pair, Times
from ltv_mpc.references import Line, Point, Reference, Waypoints
from ltv_mpc.references.shapes import Waypoint

Corners: TypeAlias = tuple[Pair, ...]
"""One point, or the corners of a path."""

SPEEDS_MPS = {"catamaran": 1.0, "ellipsoid": 0.6, "light_boat": 0.8}
"""Wanted speed along paths: about half of the top speed, which leaves thrust for turning and for the wind."""
NEAR_M = 0.5
"""Distance at which the vehicle has arrived."""
SETTLING_S = 15.0
"""Time from the arrival, or from a disturbance's end, after which the error at a point counts."""
FAR_M = 1.0
"""Error at which a pilot must not report that all is well."""
STAY_S = 40.0
"""Time for each point of the mission, the way to it and the stay."""


class Task(NamedTuple):
    """Targets by the time at which they begin."""

    targets: tuple[tuple[float, Corners], ...]
    duration_s: float
    within_m: float  # largest distance of the start from the origin
    ahead_deg: float | None = None  # heading of the start; None: random


SQUARE: Corners = ((0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0), (0.0, 0.0))
TASKS = {
    "hold": Task(((0.0, ((4.0, 3.0),)),), 100.0, 0.3),
    "line": Task(((0.0, ((0.0, 0.0), (20.0, 0.0))),), 90.0, 0.3),
    "square": Task(((0.0, SQUARE),), 210.0, 0.3),
    "behind": Task(((0.0, ((-5.0, 0.0),)),), 90.0, 0.3, ahead_deg=0.0),
    "mission": Task(((0.0, ((8.0, 0.0),)), (STAY_S, ((8.0, 8.0),)), (2 * STAY_S, ((0.0, 0.0),))), 3 * STAY_S, 0.3),
}

CONDITIONS = {
    "nominal": Conditions(),
    "no reports": Conditions(reports_s=0.0),
    "offset 0.15 m": Conditions(offset_m=(0.15, 0.0)),
    "noise 0.3 m": Conditions(noise_m=0.3),
    "1 Hz": Conditions(period_s=1.0),
    "latency 0.5 s": Conditions(latency_s=0.5),
    "side force 10 %": Conditions(side_force=0.1),
    "reports stop": Conditions(reports_s=20.0),
    "released 30 s": Conditions(released_s=(20.0, 50.0)),
}
ONLY_OURS = ("no reports", "reports stop")
"""Conditions that a rival does not notice: it reads no reports."""


class Figures(NamedTuple):
    """Figures of one flight."""

    mean_m: float  # of the error: distance from the path until the arrival, from the point after it
    max_m: float
    arrival_s: float  # infinite: it has not arrived
    force: float  # mean |F| over the largest thrust
    wrongly_nominal: float  # share of the time in which the error counts and is above FAR_M, and the pilot is content


def speed_mps(name: str) -> float:
    """Return the wanted speed of a hull along paths."""
    return SPEEDS_MPS.get(name) or 0.4 * load(name)[0].top_speed_mps()


def reference(corners: Corners, speed_mps: float) -> Reference:
    """Return a target as a reference of the controller."""
    places = tuple(Waypoint(north_m=north, east_m=east) for north, east in corners)
    if len(corners) == 1:
        return Point(north_m=corners[0][0], east_m=corners[0][1])
    if len(corners) == 2:
        return Line(start=places[0], end=places[1], speed_mps=speed_mps)
    return Waypoints(waypoints=places, speed_mps=speed_mps)


class _Changing:
    """Pilot whose target changes by time."""

    def __init__(self, pilot: Ours | Rival, later: Sequence[tuple[float, Corners]], speed_mps: float) -> None:
        self._pilot, self._later, self._speed_mps = pilot, list(later), speed_mps
        self.cycle_steps, self.delay_steps = pilot.cycle_steps, pilot.delay_steps

    @property
    def nominal(self) -> bool:
        return self._pilot.nominal

    def plan(self, estimate: Estimate, t_ns: int, applied: Applied | None) -> tuple[Times, Array]:
        while self._later and t_ns * 1e-9 >= self._later[0][0]:
            corners = self._later.pop(0)[1]
            if isinstance(self._pilot, Ours):
                self._pilot.controller.follow(reference(corners, self._speed_mps))
            else:
                self._pilot.follow(corners)
        return self._pilot.plan(estimate, t_ns, applied)


def make_pilot(hull: str, task: Task, gains: dict[str, dict[str, float]] | None) -> Pilot:
    """Return the pilot of a task: this project's controller, or with gains the rival."""
    (_, first), *later = task.targets
    vehicle, speed = load(hull)[1], SPEEDS_MPS[hull]
    pilot = Ours(vehicle, reference(first, speed)) if gains is None else Rival(vehicle, gains, first, speed)
    return _Changing(pilot, later, speed)


def fly_task(
    hull: str, task: str, conditions: Conditions, seed: int, gains: dict[str, dict[str, float]] | None = None
) -> Figures:
    """Fly one task and return its figures."""
    what = TASKS[task]
    start = Start.drawn(seed, what.within_m)
    if what.ahead_deg is not None:
        start = start._replace(heading_rad=math.radians(what.ahead_deg))
    flight = fly(hull, make_pilot(hull, what, gains), conditions, start, duration_s=what.duration_s)
    return figures(what, flight, conditions, load(hull)[0].max_N)


def figures(task: Task, flight: Flight, conditions: Conditions, max_N: float) -> Figures:
    """Return the figures of a flight."""
    errors, nominal, arrivals = [], [], []
    ends = [*(begin for begin, _ in task.targets[1:]), task.duration_s]
    for (begin_s, corners), end_s in zip(task.targets, ends, strict=True):
        during = flight.between(begin_s, end_s)
        point, t_s = flight.point[during], flight.t_s[during]
        distance = np.hypot(*(point - corners[-1]).T)
        near = distance < NEAR_M
        if len(corners) > 1:  # a square ends where it begins
            near &= _covered(point, corners)
        arrived = bool(near.any())
        arrival_s = float(t_s[np.argmax(near)]) if arrived else end_s
        arrivals.append(arrival_s - begin_s if arrived else math.inf)
        if len(corners) == 1:
            settled_s = min(arrival_s + SETTLING_S, end_s - SETTLING_S)
            if begin_s <= conditions.released_s[1] < end_s - 2 * SETTLING_S:
                settled_s = max(settled_s, conditions.released_s[1] + SETTLING_S)
            counts, error = t_s >= settled_s, distance
        else:
            counts, error = t_s <= arrival_s, shapely.distance(shapely.LineString(corners), shapely.points(point))
        errors.append(error[counts])
        nominal.append(flight.nominal[during][counts])
    error = np.concatenate(errors)
    content = np.concatenate(nominal) & (error > FAR_M)
    force = float(np.abs(flight.track[:, -2:]).mean()) / max_N
    return Figures(float(error.mean()), float(error.max()), float(np.mean(arrivals)), force, float(content.mean()))


def _covered(point: Array, corners: Corners) -> Array:
    """Return the mask (M,) of the times by which every corner but the first has been within two metres, in order."""
    covered = np.ones(len(point), dtype=bool)
    for corner in corners[1:-1]:
        near = (np.hypot(*(point - corner).T) < 4 * NEAR_M) & covered
        covered = np.maximum.accumulate(near)
    return covered


def mean_figures(flights: Sequence[Figures]) -> Figures:
    """Return the mean over seeds; the largest error is the largest of all, and the arrival infinite if one is."""
    table = np.array(flights)
    mean = table.mean(axis=0)
    return Figures(mean[0], table[:, 1].max(), mean[2], mean[3], mean[4])
