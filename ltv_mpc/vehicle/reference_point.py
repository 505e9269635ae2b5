"""Reference point: point of the vehicle whose position and velocity the estimates give, and the plans predict.

With the lever arm l (2,), forward and starboard of the vehicle's origin, p and v over ground at the reference point:

    origin      p - R l,   v - r R S l,   depth - l_down                       S = [[0, -1], [1, 0]], so dR/dpsi = R S
    covariance  J P J',    dp/dpsi = -R S l,   dv/dpsi = r R l,   dv/dr = -R S l         J is the identity elsewhere

R (2, 2) rotates by the heading psi, and r is the yaw rate. Estimates give no roll and no pitch, so the vehicle counts
as level, and ``down_m`` matters for the depth alone.
Source  Groves 2013, Principles of GNSS, inertial and multisensor integrated navigation systems, section 2.5.
"""

from __future__ import annotations

import math
from typing import Annotated, TypeAlias

import msgspec
import numpy as np
from msgspec import Meta

from ltv_mpc.conversion import exact
from ltv_mpc.messages import Array, Estimate, Pair, Plan

Offset: TypeAlias = Annotated[float, Meta(ge=-100, le=100)]

SURGE, SWAY, HEADING, YAW_RATE = 2, 3, 4, 5
"""Indices of the states of a plan."""


class ReferencePoint(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Offset of the reference point from the vehicle's origin, in the body frame."""

    forward_m: Offset = 0.0
    starboard_m: Offset = 0.0
    down_m: Offset = 0.0

    def to_origin(self, estimate: Estimate) -> Estimate:
        """Return the estimate of the vehicle's origin; the estimate itself if the reference point is the origin.

        Parameters
        ----------
        estimate : estimate of the reference point.
        """
        if self == ORIGIN:
            return estimate
        estimate = exact(estimate)
        (north, east), (north_ahead, east_ahead) = self._arm(estimate.heading_rad)
        r = estimate.yaw_rate_radps
        return msgspec.structs.replace(
            estimate,
            north_m=estimate.north_m - north,
            east_m=estimate.east_m - east,
            velocity_north_mps=estimate.velocity_north_mps - r * north_ahead,
            velocity_east_mps=estimate.velocity_east_mps - r * east_ahead,
            depth_m=None if estimate.depth_m is None else estimate.depth_m - self.down_m,
            altitude_m=None if estimate.altitude_m is None else max(estimate.altitude_m + self.down_m, 0.0),
            covariance=None if estimate.covariance is None else self._covariance(estimate, estimate.covariance),
        )

    def of_plan(self, plan: Plan) -> Plan:
        """Return the plan with its positions and velocities at the reference point: states, target, depths.

        Parameters
        ----------
        plan : plan for the vehicle's origin.
        """
        if self == ORIGIN:
            return plan
        states = plan.states.copy()
        cos, sin, r = np.cos(states[:, HEADING]), np.sin(states[:, HEADING]), states[:, YAW_RATE]
        states[:, 0] += cos * self.forward_m - sin * self.starboard_m
        states[:, 1] += sin * self.forward_m + cos * self.starboard_m
        states[:, SURGE] -= r * self.starboard_m
        states[:, SWAY] += r * self.forward_m
        target, depth_m, limit_m = plan.reference_m, plan.reference_depth_m, plan.depth_limit_m
        if target is not None:
            north, east = self._arm(float(states[0, HEADING]))[0]
            target = target[0] + north, target[1] + east
        return msgspec.structs.replace(
            plan,
            states=states,
            reference_m=target,
            reference_depth_m=None if depth_m is None else depth_m + self.down_m,
            depth_limit_m=None if limit_m is None else limit_m + self.down_m,
        )

    def _arm(self, heading_rad: float) -> tuple[Pair, Pair]:
        """Return R l and its derivative by the heading, R S l (m, north and east)."""
        cos, sin = math.cos(heading_rad), math.sin(heading_rad)
        north, east = cos * self.forward_m - sin * self.starboard_m, sin * self.forward_m + cos * self.starboard_m
        return (north, east), (-east, north)

    def _covariance(self, estimate: Estimate, P: Array) -> Array:
        """Return J P J' (6, 6), over north, east, velocity north, velocity east, heading and yaw rate."""
        (north, east), (north_ahead, east_ahead) = self._arm(estimate.heading_rad)
        r = estimate.yaw_rate_radps
        J = np.eye(6)
        J[:4, 4] = -north_ahead, -east_ahead, r * north, r * east
        J[2:4, 5] = -north_ahead, -east_ahead
        return J @ P @ J.T


ORIGIN = ReferencePoint()
"""Reference point of a vehicle file without [reference_point]: the vehicle's origin."""
