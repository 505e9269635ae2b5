"""Follower: position of the target along its reference, from cycle to cycle.

The schedule time tau of the target advances with the time between the first knots of successive plans, and never
decreases. The target waits for the vehicle. With d their distance at the first knot of the plan,

    tau' = rate = near x current
    near = 1 for d <= L / 2,  2 (L - d) / L between,  0 for d >= L,   L = LEASH_S x cruising speed, at least MIN_LEASH_M

holds until the next cycle and along the plan. ``current`` is the rate for which the vehicle's largest speed S through
the water suffices in the current c (``schedule.feasible_rate``). S is the cruising speed in a weak current. In a
stronger one the reserve of thrust gives way to progress, without a jump, because c is an estimate:

    S = top - reserve (top - cruise)
    reserve = 1 for |c| <= 0.6 top,  linear between,  0 for |c| >= 0.87 top

A limit of the speed through the water is the top speed, and ``LIMIT_SHARE`` of it the cruising speed. A vehicle ahead
of the target waits for it. Progress is that of the target along the path, so it never decreases. A point, or "here", is
a schedule without length: a target at rest.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from ltv_mpc.messages import Array, Estimate, Pair, ReferenceStart, Times
from ltv_mpc.references.limits import path_limits
from ltv_mpc.references.schedule import DEPTH, EAST, NORTH, TIME, WAY, Schedule, advance_target, target_at
from ltv_mpc.references.types import Hold, Point, Reference
from ltv_mpc.vehicle.parameters import Vehicle

LEASH_S = 2.0
MIN_LEASH_M = 0.5
WEAK_CURRENT, STRONG_CURRENT = 0.6, 0.87
"""Current over top speed up to which the whole reserve of thrust is kept, and from which none is. With a shorter span a
hull of linear drag (cruise = 0.8 top) would be faster across a stronger current.
"""
LIMIT_SHARE = 0.9
"""Cruising speed over a limit of the vehicle's speed: the vehicle must be able to catch up."""
MAX_STEP_S = 2.0
"""Longest advance of the target between two cycles: after a longer gap (a pilot had the thrusters, no estimates) it has
waited.
"""

ARRIVAL_M = 0.5
"""Distance from the end of a reference at which the vehicle has arrived: where the estimates describe a point that is
not quite the origin, a vehicle that has come to its end keeps within it.
"""

AWAY_M, AWAY_NS, NEARER_M = 1.0, 30_000_000_000, 0.1
"""Distance from the target, beyond the lag that a path allows, at which a vehicle is away from it; the time within
which it has to come nearer, and by how much.
"""

SAME_PLACE_M = 1e-6
"""Length of a path within which two columns of a schedule are the same place, at which the target rests."""


class Progress(NamedTuple):
    """Progress along a path at the first knot of a plan."""

    share: float | None  # completed share of the path, by the target, 0 .. 1
    cross_track_m: float | None  # distance of the vehicle from the path, positive to starboard
    remaining_m: float | None  # length of the path ahead of the target


Allowed: TypeAlias = Callable[[Schedule], tuple[Schedule, float]]
"""Restriction of a schedule: returns its allowed part, and the length that is left out (m)."""


class FollowerState(NamedTuple):
    """State from which another follower of the same reference continues."""

    reference_start: ReferenceStart | None  # None before the reference is in force
    t_ns: int  # first knot of the last plan
    tau_s: float  # schedule time of the target at that knot
    rate: float  # schedule seconds per vehicle second


NO_PROGRESS = Progress(None, None, None)
"""Progress of a reference that is no path, or has not started."""

PATH_POINTS = 96
"""Number of points of the path beside a plan."""


class PathBeside(NamedTuple):
    """Path beside a plan: straight pieces between points of equal distance."""

    points: Array  # (K, 2) north and east (m)
    targets: npt.NDArray[np.int64]  # (N,) point before the target of each knot
    reach: int  # number of pieces that the vehicle may be away from the target


class _Speeds(NamedTuple):
    """Speeds of the vehicle through the water (m/s), within its limits and the wanted one."""

    cruise_mps: float
    top_mps: float


class _Distances:
    """Distances of a vehicle that is away from its target, over the last ``AWAY_NS``."""

    def __init__(self) -> None:
        self._last: deque[tuple[int, float]] = deque()  # time (ns) and distance (m)
        self.stay = False
        """True while they do not become smaller."""

    def add(self, t_ns: int, distance_m: float, near_m: float) -> None:
        """Add a distance. Within ``near_m``, and after a gap in time, the list starts again.

        Parameters
        ----------
        t_ns : time of the distance (ns).
        distance_m : of the vehicle from its target (m).
        near_m : distance at which the vehicle is not away (m).
        """
        last = self._last
        if distance_m <= near_m or (last and not 0 <= t_ns - last[-1][0] <= MAX_STEP_S * 1e9):
            last.clear()
            self.stay = False
        last.append((t_ns, distance_m))
        while len(last) > 1 and last[1][0] <= t_ns - AWAY_NS:
            last.popleft()
        if t_ns - last[0][0] >= AWAY_NS:  # to be near again takes more than to oscillate
            self.stay = last[0][1] - distance_m < (AWAY_M if self.stay else NEARER_M)


class _Track(NamedTuple):
    """Reference that has started: its schedule, and what a cycle needs of it."""

    schedule: Schedule  # the allowed part
    whole: Schedule  # without restriction; its end need not be allowed
    start: ReferenceStart
    leash_m: float
    distances: _Distances  # of the vehicle from its target

    @property
    def depth_m(self) -> float | None:
        """Depth at the end (m); None without a depth."""
        last = float(self.schedule.table[DEPTH, -1])
        return None if math.isnan(last) else last


class Follower:
    """Target of one reference: where the reference started, and how far along it the target is."""

    def __init__(self, reference: Reference, vehicle: Vehicle, max_speed_mps: float = math.inf) -> None:
        """Begin before the reference starts; ``max_speed_mps`` limits the vehicle's speed through the water."""
        self.reference = reference
        """The reference that is followed."""
        self.heading_rad: float | None = None
        """Heading that the reference wants (rad); None: it is free."""
        self.skipped_m = 0.0
        """Length of the path that is left out, because it is not allowed (m)."""
        self.arrived = False
        """The vehicle has been at the end of the reference, after its target."""
        self._vehicle = vehicle
        limits = path_limits(vehicle)
        self._speeds = _Speeds(min(limits.cruise_mps, LIMIT_SHARE * max_speed_mps), min(limits.top_mps, max_speed_mps))
        self._allowed: Allowed = lambda schedule: (schedule, 0.0)  # without restriction
        self._track: _Track | None = None  # None before the reference starts
        self._tau_s = 0.0
        self._rate = 1.0
        self._t_ns = 0
        self.progress = NO_PROGRESS
        """Progress along a path; ``NO_PROGRESS`` for a point, and before the reference starts."""

    @property
    def is_path(self) -> bool:
        """True if the reference in force moves: it is no point."""
        return self._track is not None and not isinstance(self.reference, Point | Hold)

    @property
    def target_m(self) -> Pair | None:
        """North and east (m) of the target at the first knot of the last plan; None before the reference starts."""
        return None if self._track is None else target_at(self._track.schedule.table, self._tau_s)[1:]

    @property
    def depth_m(self) -> float | None:
        """Depth at which the reference ends (m); None if it has no depth or has not started."""
        return None if self._track is None else self._track.depth_m

    @property
    def stays_away(self) -> bool:
        """True while the vehicle is away from its target and does not come nearer."""
        return self._track is not None and self._track.distances.stay

    @property
    def start_distance_m(self) -> float | None:
        """Distance from the vehicle to the reference when it started (m); None before."""
        return None if self._track is None else self._track.schedule.lead_m

    def begin(self, estimate: Estimate) -> bool:
        """Return True if the reference is in force. It starts at the first finite estimate after its start time.

        Parameters
        ----------
        estimate : newest estimate.
        """
        pose = (estimate.north_m, estimate.east_m, estimate.heading_rad)
        if self._track is None and self.reference.has_started(estimate.t_ns) and all(map(math.isfinite, pose)):
            self._start_at(self.reference.anchor(estimate))
        return self._track is not None

    def restrict(self, allowed: Allowed) -> None:
        """Move the target along the allowed part of the path alone; it stays where it is, and rests there as before.

        Parameters
        ----------
        allowed : replaces an earlier restriction.
        """
        self._allowed = allowed
        if self._track is not None:
            way_m = float(target_at(self._track.schedule.table, self._tau_s)[0])
            waited_s = self._tau_s - _stay(self._track.schedule.table, way_m)[0]
            self._track = self._track_from(self._track.start)
            reached_s, left_s = _stay(self._track.schedule.table, way_m)
            self._tau_s = min(reached_s + waited_s, left_s)

    def _start_at(self, start: ReferenceStart) -> None:
        self._t_ns = start.t_ns
        self._track = self._track_from(start)

    def _track_from(self, start: ReferenceStart) -> _Track:
        """Return the allowed part of the reference that starts there."""
        track = self._track
        same = track is not None and track.start == start
        whole = track.whole if track and same else self.reference.schedule(self._vehicle, start)
        schedule, self.skipped_m = self._allowed(whole)
        distances = track.distances if track and same else _Distances()
        return _Track(schedule, whole, start, max(LEASH_S * self._speeds.cruise_mps, MIN_LEASH_M), distances)

    def path_beside(self, t_ns: Times) -> PathBeside | None:
        """Return the path beside a plan: from behind the target at its first knot to ahead of that at its last one.

        Parameters
        ----------
        t_ns : (N+1,) knots of the plan (ns), as ``advance`` took them last.

        Returns
        -------
        The path; None for a point, and before the reference starts.
        """
        track = self._track
        if track is None or not self.is_path:
            return None
        table, tau = track.schedule.table, self._tau_s + self._rate * (t_ns[1:] - t_ns[0]) * 1e-9
        targets = np.interp(tau, table[TIME], table[WAY])
        begin, end = max(targets[0] - 2.0 * track.leash_m, 0.0), targets[-1] + 2.0 * track.leash_m
        way = np.linspace(begin, min(end, float(table[WAY, -1])), PATH_POINTS)
        points = np.column_stack([np.interp(way, table[WAY], table[row]) for row in (NORTH, EAST)])
        step_m = max(float(way[1] - way[0]), 1e-9)
        return PathBeside(points, ((targets - begin) / step_m).astype(np.int64), math.ceil(track.leash_m / step_m))

    def arrive(self, estimate: Estimate, tolerance_m: float) -> None:
        """Note the arrival: the target is at the end, and the vehicle is near the end, also in depth if it can dive.

        Parameters
        ----------
        estimate : newest estimate.
        tolerance_m : distance that counts as near, if it is above ``ARRIVAL_M`` (m).
        """
        track, radius_m = self._track, max(tolerance_m, ARRIVAL_M)
        if self.arrived or track is None or self._tau_s < track.schedule.duration_s:
            return
        deep = True
        if track.depth_m is not None and self._vehicle.can_dive:
            deep = estimate.depth_m is not None and abs(estimate.depth_m - track.depth_m) <= radius_m
        end_m = track.whole.table[[NORTH, EAST], -1]
        self.arrived = deep and math.dist((estimate.north_m, estimate.east_m), end_m) <= radius_m

    def watch(self, estimate: Estimate, tolerance_m: float) -> None:
        """Note whether the vehicle stays away from its target, or comes nearer.

        Parameters
        ----------
        estimate : newest estimate; the vehicle is free to drive straight to the target.
        tolerance_m : distance that counts as near, if it is above ``AWAY_M`` (m).
        """
        track, target = self._track, self.target_m
        if track is not None and target is not None:
            distance_m = math.dist((estimate.north_m, estimate.east_m), target) - track.leash_m * self.is_path
            track.distances.add(estimate.t_ns, distance_m, max(tolerance_m, AWAY_M))

    def save(self) -> FollowerState:
        """Return the state that another follower of the same reference continues from."""
        return FollowerState(None if self._track is None else self._track.start, self._t_ns, self._tau_s, self._rate)

    def restore(self, state: FollowerState, now_ns: int, *, moved_until_ns: int) -> None:
        """Continue from the state of another follower of this reference.

        The target has moved at its rate as long as the vehicle has followed the last plan, and has waited since.

        Parameters
        ----------
        state : saved state.
        now_ns : current time (ns).
        moved_until_ns : time (ns) until which the vehicle has followed the last plan, if that is before ``now_ns``.
        """
        if state.reference_start is None:
            return
        self._start_at(state.reference_start)
        self._rate = min(max(state.rate, 0.0), 1.0)
        way_s = self._rate * max(min(now_ns, moved_until_ns) - state.t_ns, 0) * 1e-9
        self._t_ns = max(now_ns, state.t_ns)
        if self._track is not None:
            self._tau_s = min(max(state.tau_s + way_s, 0.0), self._track.schedule.duration_s)

    def advance(self, t_ns: Times, lateral: Array, current: Pair, target: Array) -> None:
        """Advance the target to the first knot of a plan, and write it at all knots.

        Parameters
        ----------
        t_ns : (N+1,) knots (ns).
        lateral : state of the vehicle at the first knot, which starts with n, e (m).
        current : velocity of the water there, north and east (m/s).
        target : (N+1, 3) output, as in ``Solver.build``; not written before the reference starts. The headings are
            written if there are any.
        """
        if self._track is None:
            return
        schedule, leash_m, now_ns = self._track.schedule, self._track.leash_m, int(t_ns[0])
        table, lead_m, length_m = schedule.table, schedule.lead_m, schedule.length_m
        step_s = min(max(now_ns - self._t_ns, 0) * 1e-9, MAX_STEP_S)
        self._t_ns = max(now_ns, self._t_ns)
        self._tau_s = min(self._tau_s + self._rate * step_s, float(table[TIME, -1]))
        self._rate, way, cross = advance_target(
            table, self._tau_s, t_ns, lateral, current, leash_m, self._speed_in(current), target
        )
        if isinstance(self.reference, Point | Hold):
            self.heading_rad = self.reference.heading_in(current, self.heading_rad)
            if self.heading_rad is not None:
                target[:-1, 2] = self.heading_rad
            return
        done = min(max(way - lead_m, 0.0), length_m)
        known = None if math.isnan(cross) else cross  # NaN: the estimate is not finite
        share = done / length_m if length_m > 0.0 else 1.0  # a timed track may have no length
        self.progress = Progress(share, known, length_m - done)

    def _speed_in(self, current: Pair) -> float:
        """Return the largest speed S through the water (m/s) in a current, by the equation above."""
        cruise_mps, top_mps = self._speeds
        share = math.hypot(*current) / top_mps
        reserve = min(max((STRONG_CURRENT - share) / (STRONG_CURRENT - WEAK_CURRENT), 0.0), 1.0)
        return top_mps - reserve * (top_mps - cruise_mps)

    def depths(self, t_ns: Times) -> tuple[Array, Array] | None:
        """Return depth (m) and sinking speed (m/s) of the target at knots (N+1,); None without a depth.

        Parameters
        ----------
        t_ns : (N+1,) knots of a plan (ns).
        """
        track, max_rate = self._track, self.reference.descent_rate_mps
        if track is None or track.depth_m is None:
            return None
        (time, _, _, _, depths), start = track.schedule.table, track.start
        at = self._tau_s + self._rate * (t_ns - t_ns[0]) * 1e-9
        wanted, way = np.interp(at, time, depths), np.maximum((t_ns - start.t_ns) * 1e-9, 0.0) * max_rate
        depth = np.minimum(np.maximum(wanted, start.depth_m - way), start.depth_m + way)
        i = np.minimum(np.searchsorted(time, at, side="right"), len(time) - 1)  # column behind the target
        step_s = np.where(at < time[-1], time[i] - time[i - 1], np.inf)
        follows = self._rate * (depths[i] - depths[i - 1]) / step_s
        return depth, np.where(depth == wanted, follows, np.copysign(max_rate, wanted - start.depth_m))

    def places_ahead(self, lateral: Array, current: Pair, seconds: Array) -> Array | None:
        """Return where the vehicle will be: on the path from the target on, or on the straight line to a point.

        Parameters
        ----------
        lateral : state of the vehicle, which starts with n, e (m).
        current : velocity of the water there, north and east (m/s).
        seconds : (P,) times from now (s).

        Returns
        -------
        (P, 2) north and east (m), at the earliest; None before the reference starts.
        """
        if self._track is None:
            return None
        table = self._track.schedule.table
        if self.is_path:
            tau = self._tau_s + seconds
            return np.column_stack([np.interp(tau, table[TIME], table[row]) for row in (NORTH, EAST)])
        line = table[(NORTH, EAST), 0] - lateral[:2]
        way = (self._speeds.cruise_mps + math.hypot(*current)) * seconds
        return lateral[:2] + np.minimum(way / max(math.hypot(*line), 1e-9), 1.0)[:, None] * line


def _stay(table: Array, way_m: float) -> tuple[float, float]:
    """Return when the target reaches a place of its path and when it leaves it (s): not the same where it rests."""
    way, time = table[WAY], table[TIME]
    first, last = np.searchsorted(way, [way_m - SAME_PLACE_M, way_m + SAME_PLACE_M])
    if first < last:
        return float(time[first]), float(time[last - 1])
    left_s = float(np.interp(way_m, way, time))
    return left_s, left_s
