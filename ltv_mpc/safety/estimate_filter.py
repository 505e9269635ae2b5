"""Estimate filter: what of an accepted estimate the controller uses.

Position and velocity, and heading and yaw rate, have a ``KinematicFilter`` each. A navigation filter gives a position
that is the integral of its velocity, up to small corrections: as long as noise and contradictions are small, the
estimates are used as they are. A position with a covariance is not filtered.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from ltv_mpc.messages import Estimate, Health
from ltv_mpc.references.limits import path_limits
from ltv_mpc.safety.health import NOMINAL, HealthState
from ltv_mpc.safety.kinematic_filter import KinematicFilter
from ltv_mpc.vehicle.parameters import Vehicle

CHECKED = "sign, unit and axes, and that they are filled in and over ground"

CLEAN_M = 0.03
"""Noise of the positions up to which they are used as they are."""


class EstimateFilter:
    """Filter of the estimates of one source."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Begin without an estimate.

        Parameters
        ----------
        vehicle : its largest rates and accelerations are the scales of the check.
        """
        limits, thrusters = path_limits(vehicle), vehicle.thrusters[:2]
        turning_radps2 = sum(t.max_N * t.arm_m for t in thrusters) / vehicle.yaw.inertia_kgm2
        self.velocity = KinematicFilter(
            limits.top_mps, sum(t.max_N for t in thrusters) / vehicle.surge.mass_kg, CLEAN_M
        )
        """Check of the velocity over ground against the position."""
        self.yaw_rate = KinematicFilter(limits.yaw_radps, turning_radps2)
        """Check of the yaw rate against the heading."""
        self._heading_rad = 0.0  # unwrapped

    @property
    def failed(self) -> tuple[bool, bool]:
        """True for the velocity and for the yaw rate while each is derived."""
        return self.velocity.failed, self.yaw_rate.failed

    @property
    def health(self) -> HealthState:
        """Degraded while a rate is derived, or a value stands still."""
        found = []
        for check, rates, values in (
            (self.velocity, "velocities", "positions"),
            (self.yaw_rate, "yaw rates", "headings"),
        ):
            if check.failed:
                found.append(f"the {rates} of the estimates are not those of the {values}: check {CHECKED}")
            if check.stands:
                found.append(f"the {values} of the estimates stand still, their {rates} do not")
        return HealthState(Health.DEGRADED, "; ".join(found)) if found else NOMINAL

    def update(self, estimate: Estimate) -> Estimate:
        """Return an estimate with filtered position and derived rates; itself where nothing needs it.

        Parameters
        ----------
        estimate : the newest one.
        """
        e = estimate
        self._heading_rad += math.remainder(e.heading_rad - self._heading_rad, math.tau)
        place, over_ground = np.array([e.north_m, e.east_m]), np.array([e.velocity_north_mps, e.velocity_east_mps])
        heading, yaw_rate = np.array([self._heading_rad]), np.array([e.yaw_rate_radps])
        sd = [standard_deviation(e, states, 0.0) for states in ((0, 1), (2, 3), (4,), (5,))]
        x, v = self.velocity.update(e.t_ns, place, over_ground, (sd[0], sd[1]))
        psi, r = self.yaw_rate.update(e.t_ns, heading, yaw_rate, (sd[2], sd[3]))
        if x is place and v is over_ground and psi is heading and r is yaw_rate:
            return estimate
        (north_m, east_m), (velocity_north_mps, velocity_east_mps) = x.tolist(), v.tolist()
        return msgspec.structs.replace(
            estimate,
            north_m=north_m,
            east_m=east_m,
            velocity_north_mps=velocity_north_mps,
            velocity_east_mps=velocity_east_mps,
            heading_rad=math.remainder(float(psi[0]), math.tau),
            yaw_rate_radps=float(r[0]),
        )


def standard_deviation(estimate: Estimate, indices: tuple[int, ...], unknown: float) -> float:
    """Return the standard deviation of some states, from the diagonal of the covariance.

    Parameters
    ----------
    estimate : any estimate.
    indices : places of the states in the covariance.
    unknown : result for an estimate without covariance.
    """
    P = estimate.covariance
    return unknown if P is None else math.sqrt(sum(max(float(P[i, i]), 0.0) for i in indices))
