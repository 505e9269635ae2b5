"""How far along its reference a vehicle is.

The target moves along the path by the schedule's time tau, from cycle to cycle by the time between the plans' first
knots, and never back. It does not run away from the vehicle: with d their distance, both at the plan's first knot,

    tau' = rate = min(near, against)
    near = 1 for d <= L / 2,  2 (L - d) / L between,  0 for d >= L,   L = LEASH_S x cruising speed, at least LEAST_M

until the next cycle, and so along the plan. ``against`` is what the known current leaves of the vehicle's speed
(``schedule.against``). A vehicle that falls behind, or was taken elsewhere, is waited for; one that is ahead waits for
the target. Progress is the target's, along the path, so it never falls. A point, or "here", is a target that stands.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ltv_mpc.messages import Array, Estimate, Pair, ReferenceStart, Times
from ltv_mpc.references.base import ramp
from ltv_mpc.references.limits import limits_of
from ltv_mpc.references.schedule import Schedule, depths, go_on, look_ahead, where
from ltv_mpc.references.types import Hold, Point, Reference
from ltv_mpc.vehicle.parameters import Vehicle

LEASH_S = 2.0
LEAST_M = 0.5
LONGEST_STEP_S = 2.0
"""After a longer silence (a pilot had the thrusters, no estimate came) the target has stood still, but for this."""


class Progress(NamedTuple):
    """Along a path, at a plan's first knot."""

    share: float | None  # of the path's length that the target has behind it, 0 .. 1
    cross_track_m: float | None  # of the vehicle from the path, positive to starboard of it
    remaining_m: float | None  # of the path, before the target


class FollowerState(NamedTuple):
    """State of a follower: where its reference began, and how far its target was at the first knot of the last plan."""

    reference_start: ReferenceStart | None  # None before the reference is in force
    t_ns: int  # that knot
    tau_s: float  # the target's time
    rate: float  # of that time to the vehicle's


NO_PROGRESS = Progress(None, None, None)
"""Of a reference that is no path, or has not begun."""


class Follower:
    """The state of following one reference: where it began, and how far it is."""

    def __init__(self, reference: Reference, vehicle: Vehicle) -> None:
        self.reference = reference
        self._vehicle = vehicle
        self._anchor: ReferenceStart | None = None
        self._still: Pair = (math.nan, math.nan)
        self._schedule: Schedule | None = None
        self._leash_m = LEAST_M
        self._cruise_mps = 0.0
        self._length_m = 0.0
        self._duration_s = 0.0
        self._tau_s = 0.0
        self._rate = 1.0
        self._t_ns = 0
        self._progress = NO_PROGRESS
        self._target: Pair = self._still

    @property
    def target_m(self) -> Pair | None:
        """North and east (m) of the target at the last plan's first knot; None before the reference has begun."""
        return None if self._anchor is None else self._target

    @property
    def depth_m(self) -> float | None:
        """The depth that it ends at, or None."""
        if self._schedule is not None:
            last = float(self._schedule.table[-1, -1])
            return None if math.isnan(last) else last
        return None if self._anchor is None else self.reference.depth_m

    @property
    def progress(self) -> Progress:
        """Along a path; nothing of a point, and before it has begun."""
        return self._progress

    def begin(self, estimate: Estimate) -> bool:
        """Whether it is in force: from the first estimate after its start on that says where the vehicle is."""
        place = (estimate.north_m, estimate.east_m, estimate.heading_rad)
        if self._anchor is None and self.reference.has_started(estimate.t_ns) and all(map(math.isfinite, place)):
            self._start(self.reference.anchor(estimate))
        return self._anchor is not None

    def _start(self, anchor: ReferenceStart) -> None:
        self._anchor = anchor
        self._t_ns = anchor.t_ns
        if isinstance(self.reference, Point | Hold):
            self._target = self.reference.position(anchor)
            return
        self._schedule = self.reference.schedule(self._vehicle, anchor)
        self._target = where(self._schedule.table, 0.0)[1:]
        self._length_m, self._duration_s = self._schedule.length_m, self._schedule.duration_s
        self._cruise_mps = limits_of(self._vehicle).cruise_mps
        self._leash_m = max(LEASH_S * self._cruise_mps, LEAST_M)

    def save(self) -> FollowerState:
        """Return the state that another follower of the same reference continues from."""
        return FollowerState(self._anchor, self._t_ns, self._tau_s, self._rate)

    def restore(self, state: FollowerState, now_ns: int) -> None:
        """Continue from the state of another follower of this reference.

        Since then its target has moved at its rate, as far as a plan takes a vehicle that receives no other.
        """
        if state.reference_start is None:
            return
        self._start(state.reference_start)
        self._rate = min(max(state.rate, 0.0), 1.0)
        way_s = self._rate * max(now_ns - state.t_ns, 0) * 1e-9
        self._tau_s = min(max(state.tau_s + way_s, 0.0), self._duration_s)
        self._t_ns = max(now_ns, state.t_ns)
        if self._schedule is not None:
            self._target = where(self._schedule.table, self._tau_s)[1:]

    def advance(self, t_ns: Times, lateral: Array, current: Pair) -> None:
        """On to the first of a plan's knots (N+1,), where the vehicle's state begins with ``lateral`` = n, e (m).

        ``current`` is the water's velocity there (m/s), north and east.
        """
        if self._schedule is None:
            return
        schedule = self._schedule
        now_ns = int(t_ns[0])
        step_s = min(max(now_ns - self._t_ns, 0) * 1e-9, LONGEST_STEP_S)
        self._t_ns = max(now_ns, self._t_ns)
        self._tau_s = min(self._tau_s + self._rate * step_s, self._duration_s)
        self._rate, way, north, east, cross = go_on(
            schedule.table, self._tau_s, t_ns, lateral, *current, self._leash_m, self._cruise_mps
        )
        self._target = (north, east)
        done = min(max(way - schedule.lead_m, 0.0), self._length_m)
        known = None if math.isnan(cross) else cross  # an estimate that is no number is nowhere
        share = done / self._length_m if self._length_m > 0.0 else 1.0  # a track with times may stay where it is
        self._progress = Progress(share, known, self._length_m - done)

    def fill(self, t_ns: Times, target: Array) -> None:
        """What is wanted at knots t_ns (N+1,), into ``target`` (N+1, 2): see ``schedule.look_ahead``."""
        if self._schedule is None:
            target[:-1] = self._target
            target[-1] = 0.0
        else:
            look_ahead(self._schedule.table, self._tau_s, self._rate, t_ns, target)

    def depths(self, t_ns: Times) -> tuple[Array, Array] | None:
        """Depth (m) and sinking speed (m/s) wanted at knots (N+1,), or None."""
        anchor, rate = self._anchor, self.reference.descent_rate_mps
        if anchor is None or self.depth_m is None:
            return None
        if self._schedule is None:
            return ramp(t_ns, anchor.t_ns, anchor.depth_m, self.depth_m, rate)
        return depths(self._schedule.table, self._tau_s, self._rate, t_ns, anchor.t_ns, anchor.depth_m, rate)
