"""Fence and obstacles of a controller: what is in force, and the report of what a plan keeps from it.

Rows of the QP (ocp/fence.py) keep the vehicle out. The reference only leads round what stands in the way
(``geofence/allowed_path.py``): a point by the targets of the horizon (target_placement.py), a path by its schedule.

The corridor along a path does not bound while the targets lead round a zone. Each zone asks for a clearance of the
vehicle's origin:

    c = hull + max(margin, k sd) + e

with the standard deviation sd of the position at the first knot, k = ``SD_FACTOR``, and the way e by which the model's
recent error carries the vehicle past the point where it would stop or turn.

Two zones that ask for more than there is between them would cancel: a vehicle that lacks the clearance of both could
drift into one of them at no cost. So each of them then asks for no more than the vehicle has: what it asked for in the
cycle before, but at most ``SLACK`` more than the clearance now, and at least ``ROOM`` less. It asks for hull + margin
at least, or for the hull alone if the vehicle lacks hull + margin of two zones.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from ltv_mpc.control.ocp.fence import CORRIDOR_ROWS, NO_PATH, Scene, disc_at, from_box
from ltv_mpc.control.prediction import Start
from ltv_mpc.control.scaling import characteristic_scales
from ltv_mpc.control.target_placement import bring_near, lead_round
from ltv_mpc.geofence.allowed_path import NO_ZONES, Routes
from ltv_mpc.geofence.fence import Fence, hull_radius_m
from ltv_mpc.geofence.half_planes import ROWS
from ltv_mpc.geofence.obstacles import DISC, OBSTACLE_MARGIN, SD_FACTOR, ObstacleTable, largest_variance_m2
from ltv_mpc.geofence.zones import Zones, clearances, nearest, pack_zones
from ltv_mpc.jit import jit_outlined
from ltv_mpc.messages import Array, Estimate, FenceInForce, FenceReport, Obstacles, Times
from ltv_mpc.references.follower import PathBeside
from ltv_mpc.references.schedule import Schedule
from ltv_mpc.vehicle.parameters import Vehicle

ENTERED_M = 0.01
"""Depth in a margin from which it counts as entered: rounding and the linearisation take millimetres."""

SLOW = 0.1
"""Largest speed of an obstacle that the reference leads round, over the vehicle's top speed."""

SLOW_MPS = 0.16
"""Least value of that speed (m/s), for slow vehicles: AIS has up to 0.3 kn, in any direction, for a ship at anchor."""

ACTIVE_M = 0.05
"""Surplus over the required clearance up to which a zone counts as active."""

DRIFT_S = np.arange(0.0, 600.0, 0.25)
"""Times after the end of a plan at which its drift is looked at (s)."""


class Fencing:
    """Fence, obstacles and corridor of one vehicle."""

    def __init__(self, vehicle: Vehicle, knots_ns: Times, corridor_m: float | None = None) -> None:
        """Begin without a fence and without obstacles.

        Parameters
        ----------
        vehicle : its file needs [hull] for a fence or an obstacle.
        knots_ns : (N+1,) knots after a plan's start (ns).
        corridor_m : largest cross-track distance on a path (m); None: no corridor.
        """
        self._has_corridor = corridor_m is not None
        self._vehicle = vehicle
        self._times_s = knots_ns.astype(np.float64) * 1e-9
        self._scales = characteristic_scales(vehicle)
        self.fence: Fence | None = None
        """Fence in force."""
        self.obstacles = ObstacleTable()
        """Obstacles that are known."""
        self.scene = Scene(
            zones=NO_ZONES,
            need=np.empty(0),
            exits=np.empty((0, 4)),
            discs=np.empty((0, DISC)),
            disc_need_m=np.zeros(1),
            stage_s=float(self._times_s[1]),
            path=NO_PATH,
            targets=np.zeros(len(knots_ns) - 1, dtype=np.int64),
            path_reach=0,
            half_width_m=corridor_m or 0.0,
        )
        """Zones and obstacles of this cycle."""
        self._labels: list[str] = []
        self._routes = Routes()
        self.way: Literal["straight", "round", "none"] = "straight"
        """Way to the target of a point that was led in the last cycle: "round" the zones, or "none" is found."""
        self.meeting_margins: tuple[str, ...] = ()
        """Zones whose required clearances the vehicle lacks at once, because late estimates have made them grow."""
        self._dropped: tuple[int, ...] = ()

    @property
    def is_active(self) -> bool:
        """True if there is a fence or an obstacle."""
        return self.fence is not None or len(self.obstacles) > 0

    @property
    def rows(self) -> int:
        """Number of half-planes of a stage."""
        if self._has_corridor:
            return ROWS + CORRIDOR_ROWS
        return ROWS if self.is_active else 0

    def set_fence(self, fence: Fence | None) -> None:
        """Keep another fence.

        Parameters
        ----------
        fence : keep-in and keep-out zones; None: no fence.

        Raises
        ------
        ConfigError : the hull is not known.
        """
        zones, labels = NO_ZONES, []
        need = np.empty(0)
        if fence is not None:
            zones, labels = pack_zones(fence), [zone.label for zone in fence.zones()]
            need = hull_radius_m(self._vehicle) + zones.margin
        self.fence, self._labels = fence, labels
        self._routes.set_zones(zones, need)
        self.scene = self.scene._replace(zones=zones, need=need, exits=np.zeros((len(need), 4)))

    def allowed_path(self, schedule: Schedule) -> tuple[Schedule, float]:
        """Return the part of a schedule that is allowed, and the length that is left out (m): ``Routes``.

        Parameters
        ----------
        schedule : motion of the target.
        """
        return self._routes.allowed_path(schedule)

    def set_path(self, path: PathBeside | None) -> None:
        """Set the path of the corridor for this cycle.

        Parameters
        ----------
        path : beside the horizon; None: the corridor does not bound.
        """
        if not self._has_corridor:
            return
        if path is None:
            self.scene = self.scene._replace(path=NO_PATH)
        else:
            self.scene = self.scene._replace(path=path.points, targets=path.targets, path_reach=path.reach)

    def add_obstacles(self, obstacles: Obstacles) -> None:
        """Take reports of obstacles.

        Parameters
        ----------
        obstacles : positions and velocities in the world frame, north and east (m, m/s).

        Raises
        ------
        ConfigError : the hull is not known.
        """
        need = (1.0 + OBSTACLE_MARGIN) * hull_radius_m(self._vehicle)
        self.obstacles.add(obstacles)
        self.scene.disc_need_m[0] = need

    def predict_obstacles(self, t_ns: int) -> bool:
        """Begin a cycle: take the new reports, drop those that are too old or from the future, and predict the others.

        Parameters
        ----------
        t_ns : time of the first knot (ns).

        Returns
        -------
        True if other obstacles stand in the way than before: the allowed part of a path has changed.
        """
        self._dropped = self.obstacles.update(t_ns)
        if not (len(self.obstacles) or len(self.scene.discs)):
            return False
        self.scene = self.scene._replace(discs=self.obstacles.discs(t_ns))
        slow_mps, need_m = max(SLOW * self._scales.speed_mps, SLOW_MPS), float(self.scene.disc_need_m[0])
        return self._routes.set_standing(self.obstacles.standing(t_ns, slow_mps, need_m))

    def update(self, start: Start, estimate: Estimate, growth_m: float, model_error_mps2: float = 0.0) -> None:
        """Update required clearances and exits for this cycle.

        Parameters
        ----------
        start : the vehicle at the plan's start.
        estimate : its covariance counts.
        growth_m : growth of the standard deviation of the position since the estimate (m).
        model_error_mps2 : acceleration that the model has not explained lately (m/s^2). In the time in which the
            vehicle stops or turns, it carries the vehicle half of its square times the acceleration too far.
        """
        self.way = "straight"
        self.meeting_margins = ()
        if self.fence is None:  # in most cycles, which then spend no time here
            return
        zones, need, hull_m, sd_m = self.scene.zones, self.scene.need, hull_radius_m(self._vehicle), growth_m
        if estimate.covariance is not None:
            (nn, ne), (_, ee) = estimate.covariance[:2, :2].tolist()
            sd_m += math.sqrt(largest_variance_m2(nn, ne, ee))
        north_m, east_m = start.lateral[:2].tolist()
        stop_s = math.hypot(*start.lateral[2:4].tolist()) / self._scales.speed_mps * self._scales.time_s
        error_m = 0.5 * model_error_mps2 * stop_s * stop_s
        lacking = update_required(zones, north_m, east_m, hull_m, sd_m, need, self.scene.exits, error_m)
        if growth_m > 0.0 and lacking > 1 and SD_FACTOR * sd_m > zones.margin.min():
            asked = hull_m + np.maximum(zones.margin, SD_FACTOR * sd_m)
            lacks = clearances(zones, start.lateral[None, :2])[0] < asked
            self.meeting_margins = tuple(self._labels[z] for z in np.flatnonzero(lacks))
        self._routes.require(need)

    def bend(self, position: Array, current: Array, target: Array, *, limited: bool) -> None:
        """Lead the targets of a horizon round the zones, where the line through them is blocked; bring far ones nearer.

        Parameters
        ----------
        position, current, target : as in ``lead_round``.
        limited : True if a limit of motion is set. Without one, and without a fence, far targets stay where they are.
        """
        router = self._routes.router
        if router is not None and router.chain_is_blocked(position, target[:-1, :2]):
            self.set_path(None)
            arrives = lead_round(router, position, current, target, self._times_s, self._scales)
            self.way = "round" if arrives else "none"
        if limited or self.is_active:
            bring_near(position, current, target, float(self._times_s[-1]), self._scales.speed_mps)

    def enters_s(self, X: Array) -> float:
        """Return when the hull enters a zone or an obstacle first (s after the first knot); infinite for never.

        Parameters
        ----------
        X : (N+1, 6) or (N+1, 8) states at the knots.
        """
        hull = self._vehicle.hull if self.is_active else None
        return math.inf if hull is None else float(entry_s(X, self._times_s, self.scene, hull.radius_m))

    def _drift_s(self, X: Array) -> float:
        """Return when the hull enters a zone or obstacle if it drifts on after the last of the states X (s)."""
        hull, end_s = self._vehicle.hull, float(self._times_s[-1])
        if hull is None:
            return math.inf
        velocity = (X[-1, :2] - X[-2, :2]) / (end_s - self._times_s[-2])
        drift = X[-1, :2] + DRIFT_S[:, None] * velocity
        return float(entry_s(drift, end_s + DRIFT_S, self.scene, hull.radius_m))

    def report(self, X: Array, skipped_m: float, *, drifts: bool) -> FenceReport | None:
        """Return what a plan keeps from zones and obstacles; None without any.

        Parameters
        ----------
        X : (N+1, 6) states at the knots.
        skipped_m : length of the path that is left out (m).
        drifts : True for a plan that does not come from the QP: the drift after its end counts, too.
        """
        hull, obstacles = self._vehicle.hull, self.obstacles.reports
        dropped, self._dropped = self._dropped, ()
        if hull is None or not (self.is_active or dropped):
            return None
        hull_m = hull.radius_m
        table, first_s = clearance_table(X, self._times_s, self.scene, hull_m)
        if drifts and math.isinf(first_s):
            first_s = self._drift_s(X)
        labels = self._labels + [f"obstacle {report.id}" for report in obstacles]
        margins = self.scene.zones.margin.tolist() + [OBSTACLE_MARGIN * hull_m] * len(obstacles)
        least_m, nearest, active, in_margin, inside, exceeded = math.inf, "", [], [], [], 0
        for (row_m, now_m, surplus_m, lacking), label, margin_m in zip(table.tolist(), labels, margins, strict=True):
            if row_m < least_m:
                least_m, nearest = row_m, label
            if surplus_m < ACTIVE_M:
                active.append(label)
                exceeded += int(lacking)
            if now_m < hull_m + margin_m - ENTERED_M:
                in_margin.append(label)
            if now_m < hull_m:
                inside.append(label)
        return FenceReport(
            clearance_m=least_m - hull_m if labels else None,
            nearest=nearest,
            active=tuple(active),
            in_margin=tuple(in_margin),
            inside=tuple(inside),
            exceeded=exceeded,
            skipped_m=skipped_m,
            no_way=self.way == "none",
            time_to_zone_ns=round(first_s * 1e9) if math.isfinite(first_s) else None,
            dropped=dropped,
        )

    def in_force(self, t_ns: int) -> FenceInForce:
        """Return what is in force as a message.

        Parameters
        ----------
        t_ns : time of the message, vehicle time (ns).
        """
        hull = self._vehicle.hull
        return FenceInForce(
            t_ns=t_ns,
            hull_radius_m=0.0 if hull is None else hull.radius_m,
            zones=() if self.fence is None else tuple(self.fence.zones()),
            obstacles=self.obstacles.reports,
        )


ROOM = 0.5
"""Room that the vehicle keeps between zones that ask for more than there is, in radii of the hull, to either side."""

SLACK = 0.1
"""Clearance that such a zone asks for beyond what there is, in radii of the hull: rounding must not lower it."""


def update_required(
    zones: Zones, north: float, east: float, hull_m: float, sd_m: float, need: Array, exits: Array, error_m: float = 0.0
) -> int:
    """Update the required clearance of each zone, and its exit if the vehicle has entered it.

    Parameters
    ----------
    zones : zones of the fence.
    north, east : position of the vehicle (m).
    hull_m : radius of its hull (m).
    sd_m : standard deviation of the position (m).
    need : (Z,) required clearance (m) in the cycle before; overwritten.
    exits : (Z, 4) as ``half_planes`` takes them. Those of zones that the vehicle was in before stay, and those of zones
        that it is not in are cleared.
    error_m : way by which the model's error carries the vehicle too far (m).

    Returns
    -------
    Number of zones that ask for more than the vehicle has, before any asks for less.
    """
    asked = hull_m + np.maximum(zones.margin, SD_FACTOR * sd_m) + error_m  # by each zone where it is alone
    now = clearances(zones, np.array([[north, east]]))[0]
    exits[now >= 0.0, 0] = 0.0
    for z in np.flatnonzero((now < 0.0) & (exits[:, 0] == 0.0)).tolist():
        _, mn, me, qn, qe = nearest(zones, z, north, east)
        exits[z] = 1.0, mn, me, mn * qn + me * qe
    lacks = now < asked
    lacking = int(lacks.sum())
    need_before, need[:] = need.copy(), asked
    if lacking > 1:
        margin_m = hull_m + zones.margin
        least = margin_m if (now < margin_m).sum() < 2 else hull_m * (1.0 + SLACK)
        kept = np.minimum(np.maximum(need_before, now - ROOM * hull_m), now + SLACK * hull_m)
        need[lacks] = np.minimum(asked, np.maximum(kept, least))[lacks]
    return lacking


@jit_outlined
def _clearances(X: Array, t_s: Array, scene: Scene, near_m: float) -> tuple[Array, Array]:
    """Return the clearances (K, Z + O) of points from all zones and obstacles, and the required ones (m).

    Farther than ``near_m`` from the circle around a zone, the distance from the circle counts; the true one is larger.
    """
    Z, count = len(scene.need), len(scene.need) + len(scene.discs)
    free, need = np.empty((len(t_s), count)), np.empty((len(t_s), count))
    for k in range(len(t_s)):
        n, e = X[k, 0], X[k, 1]
        for z in range(Z):
            free[k, z], need[k, z] = from_box(scene.zones, z, (n, e, n, e)), scene.need[z]
            if free[k, z] < near_m:
                free[k, z] = nearest(scene.zones, z, n, e)[0]
        for i in range(len(scene.discs)):
            north, east, required = disc_at(scene, i, t_s[k])
            free[k, Z + i] = np.hypot(n - north, e - east) - scene.discs[i, 4]
            need[k, Z + i] = required - scene.discs[i, 4]
    return free, need


def entry_s(X: Array, t_s: Array, scene: Scene, hull_m: float) -> float:
    """Return when the hull enters a zone or an obstacle first (s after the first knot); infinite for never.

    Parameters
    ----------
    X, t_s, scene : as in ``clearance_table``.
    hull_m : radius of the hull (m).
    """
    step_m = np.hypot(np.diff(X[:, 0]), np.diff(X[:, 1])).max()
    free = _clearances(X, t_s, scene, hull_m + step_m)[0] - hull_m
    if free.min(initial=0.0) >= 0.0:
        return math.inf
    if free[0].min() < 0.0:
        return 0.0
    zones = np.flatnonzero(free.min(axis=0) < 0.0)
    k = (free[:, zones] < 0.0).argmax(axis=0)
    before, after = free[k - 1, zones], free[k, zones]
    entries = t_s[k - 1] + before / (before - after) * (t_s[k] - t_s[k - 1])
    return float(entries.min())


def clearance_table(X: Array, t_s: Array, scene: Scene, hull_m: float) -> tuple[Array, float]:
    """Return what a plan keeps from each zone and each obstacle, and when the hull enters one first.

    Parameters
    ----------
    X : (N+1, 6) or (N+1, 8) states at the knots.
    t_s : (N+1,) times of the knots after the first one (s).
    scene : zones and obstacles.
    hull_m : radius of the hull (m).

    Returns
    -------
    (Z + O, 4) least clearance of the vehicle's origin (m), clearance at the first knot (m), smallest surplus over the
    required clearance (m), number of knots that lack more than 1 cm of it; and the time of ``entry_s``. Clearances that
    make a zone neither active nor the nearest one may be too small.
    """
    now = _clearances(X[:1], t_s[:1], scene, math.inf)[0][0]
    near_m = max(now.min(initial=math.inf), scene.need.max(initial=0.0) + ACTIVE_M)
    free, need = _clearances(X, t_s, scene, near_m)
    surplus, least = free - need, free.min(axis=0)
    table = np.column_stack([least, now, surplus.min(axis=0), (surplus < -0.01).sum(axis=0)])
    return table, entry_s(X, t_s, scene, hull_m) if least.min(initial=math.inf) < hull_m else math.inf
