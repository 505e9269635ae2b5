"""Estimate gate: reject estimates that the vehicle cannot have reached, before the controller uses them.

An estimate is accepted if

    position, heading, velocities, yaw rate, depth, sinking speed, covariance and current are finite
    the depths of the current increase, and each has its velocities
    |velocity over ground|  <=  2 x top speed through the water + 3 m/s of current
    |yaw rate|              <=  3 x the steady rate at full opposite thrusts + 0.5 rad/s
    |sinking speed|         <=  2 x the steady rate at full thrust and net buoyancy + 1 m/s

and if it is reachable from the last accepted one, a time dt before. With s the sum of the standard deviations of both
estimates, from their covariances (5 m and 0.5 rad for an estimate without covariance):

    |p - (p0 + v0 dt)|      <=  speed bound x dt + 1 m, or 5 s
    |psi - (psi0 + r0 dt)|  <=  yaw rate bound x dt + 0.5 rad, or 5 s
    |z - z0|                <=  sinking bound x dt + 2 m

A correct filter can also jump, after a fix that ends a long drift. Therefore a jump is rejected only once: the second
of two successive estimates that are consistent with each other is accepted. While estimates are rejected, the last
accepted one stays in use and ages, so a source of implausible estimates has the same effect as a silent one.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import NamedTuple

import numpy as np

from ltv_mpc.messages import CurrentProfile, Estimate
from ltv_mpc.safety.health import InputAge
from ltv_mpc.validation import relation_reason
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.resistance import steady_speed

CURRENT_MPS = 3.0
JUMP_M, JUMP_RAD, JUMP_DEPTH_M = 1.0, 0.5, 2.0
SIGMAS = 5.0
UNKNOWN_SD_M, UNKNOWN_SD_RAD = 5.0, 0.5
"""Standard deviations of an estimate without covariance: those of a plain satellite fix."""

NOT_FINITE = "a number is not finite"
JUMPED = "jumped farther than the vehicle can move"


class Bounds(NamedTuple):
    """Bounds of a vehicle's motion."""

    speed_mps: float  # over ground
    yaw_rate_radps: float
    sinking_mps: float

    @classmethod
    def of(cls, vehicle: Vehicle) -> Bounds:
        """Return the steady speeds at full thrust against the damping, widened as in the module docstring.

        Parameters
        ----------
        vehicle : parameters of the vehicle.
        """
        surge, yaw, sinking = max(vehicle.pushes_N), max(vehicle.couples_Nm), 0.0
        if vehicle.heave is not None:
            vertical = vehicle.thrusters[2]
            heave = max(vertical.max_N, -vertical.min_N) + abs(vehicle.net_buoyancy_N)
            sinking = steady_speed(heave, vehicle.heave.linear_damping_kgps, vehicle.heave.quadratic_damping_kgpm)
        top = steady_speed(surge, vehicle.surge.linear_damping_kgps, vehicle.surge.quadratic_damping_kgpm)
        turning = steady_speed(yaw, vehicle.yaw.linear_damping_Nms, vehicle.yaw.quadratic_damping_kgm2)
        return cls(2.0 * top + CURRENT_MPS, 3.0 * turning + 0.5, 2.0 * sinking + 1.0)


class EstimateGate:
    """Filter for incoming estimates that keeps the newest accepted one."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.rejected: Counter[str] = Counter()
        """Number of rejected estimates, by reason."""
        self.accepted: Estimate | None = None
        """Newest accepted estimate."""
        self.age = InputAge()
        """Age of the accepted estimates, by their stamps."""
        self._bounds = Bounds.of(vehicle)
        self._jumped: Estimate | None = None  # the last estimate, if it was rejected as a jump
        self._last: tuple[Estimate | None, str] = (None, "")  # the last rejected estimate, and the reason

    def check(self, estimate: Estimate) -> str:
        """Return the reason why ``estimate`` is rejected; empty if it is accepted now or was before.

        Parameters
        ----------
        estimate : newest estimate.
        """
        if estimate is self.accepted:
            return ""
        last, reason = self._last
        if estimate is last:
            return reason
        reason = self.out_of_bounds(estimate)
        if reason:
            self._jumped = None
        elif self.accepted is not None and self.jumps(self.accepted, estimate):
            before, self._jumped = self._jumped, estimate
            if before is None or before.t_ns == estimate.t_ns or self.jumps(before, estimate):
                reason = JUMPED
        if reason:
            self.rejected[reason] += 1
            self._last = estimate, reason
            return reason
        self.age.add(estimate.t_ns)
        self.accepted, self._jumped = estimate, None
        return ""

    def restart(self) -> None:
        """Begin with another source: its next plausible estimate is accepted, and its period is its own."""
        self.accepted = self._jumped = None
        self.age = InputAge()

    def out_of_bounds(self, e: Estimate) -> str:
        """Return which bound an estimate exceeds by itself; NaN exceeds every bound.

        Parameters
        ----------
        e : any estimate.
        """
        bounds = self._bounds
        vn, ve = e.velocity_north_mps, e.velocity_east_mps
        if not math.isfinite(e.north_m + e.east_m + e.heading_rad + vn + ve + e.yaw_rate_radps):
            return NOT_FINITE
        if not vn * vn + ve * ve <= bounds.speed_mps * bounds.speed_mps:
            return "velocity over ground above what the vehicle can reach"
        if not abs(e.yaw_rate_radps) <= bounds.yaw_rate_radps:
            return "yaw rate above what the vehicle can reach"
        P = e.covariance
        if not math.isfinite(e.depth_m or 0.0) or not (P is None or math.isfinite(np.vdot(P, P))):
            return NOT_FINITE
        if not abs(e.velocity_down_mps or 0.0) <= bounds.sinking_mps:
            return "sinking speed above what the vehicle can reach"
        return "" if e.current is None else _problem(e.current)

    def jumps(self, old: Estimate, new: Estimate) -> bool:
        """Return True if the vehicle cannot have moved from ``old`` to ``new`` in the time between them.

        Parameters
        ----------
        old, new : two estimates.
        """
        bounds = self._bounds
        dt = abs(new.t_ns - old.t_ns) * 1e-9
        off_n = new.north_m - old.north_m - old.velocity_north_mps * dt
        off_e = new.east_m - old.east_m - old.velocity_east_mps * dt
        reach = bounds.speed_mps * dt + JUMP_M
        if off_n * off_n + off_e * off_e > reach * reach:
            sd = sum(standard_deviation(e, (0, 1), UNKNOWN_SD_M) for e in (old, new))
            if math.hypot(off_n, off_e) > max(reach, SIGMAS * sd):
                return True
        turned = abs(math.remainder(new.heading_rad - old.heading_rad - old.yaw_rate_radps * dt, math.tau))
        reach = bounds.yaw_rate_radps * dt + JUMP_RAD
        if turned > reach and turned > SIGMAS * sum(standard_deviation(e, (4,), UNKNOWN_SD_RAD) for e in (old, new)):
            return True
        if old.depth_m is None or new.depth_m is None:
            return False
        return abs(new.depth_m - old.depth_m) > bounds.sinking_mps * dt + JUMP_DEPTH_M


def _problem(profile: CurrentProfile) -> str:
    """Return what makes a profile of the current useless; empty if nothing does."""
    reason = relation_reason(profile)
    if reason is not None:
        return f"current: {reason}"
    north, east = profile.north_mps, profile.east_mps
    return "" if math.isfinite(np.vdot(north, north) + np.vdot(east, east)) else NOT_FINITE


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
