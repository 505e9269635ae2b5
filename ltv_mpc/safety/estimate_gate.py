"""What a controller asks of an estimate before it plans on it.

An estimate is believed if

    every number is finite
    |velocity over ground|  <=  2 x top speed through the water + 3 m/s of current
    |yaw rate|              <=  3 x the steady rate at full opposite thrusts + 0.5 rad/s
    |sinking speed|         <=  2 x the steady rate at full thrust and net buoyancy + 1 m/s

and if, dt after the last one believed, it is where it can be: with s the standard deviations of both by their
covariance (5 m and 0.5 rad without one),

    |p - (p0 + v0 dt)|      <=  speed bound x dt + 1 m, or 5 s
    |psi - (psi0 + r0 dt)|  <=  yaw rate bound x dt + 0.5 rad, or 5 s
    |z - z0|                <=  sinking bound x dt + 2 m

A filter may be right and jump all the same, after a fix that ends a long drift. So a jump is refused once: the second
of two estimates that agree with each other is believed. In place of a refused one stands the last one believed, which
is as old as it is: whoever says nonsense for long is the same as silent.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import NamedTuple

from ltv_mpc.messages import Estimate
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.resistance import steady

CURRENT_MPS = 3.0
JUMP_M, JUMP_RAD, JUMP_DEPTH_M = 1.0, 0.5, 2.0
SIGMAS = 5.0
UNKNOWN_SD_M, UNKNOWN_SD_RAD = 5.0, 0.5
"""Of an estimate without a covariance: as a plain satellite fix."""


class Bounds(NamedTuple):
    """What a vehicle's motion stays within."""

    speed_mps: float  # over ground
    yaw_rate_radps: float
    sinking_mps: float

    @classmethod
    def of(cls, vehicle: Vehicle) -> Bounds:
        """By what its thrusters do against its damping at most, widened as above."""
        port, starboard, vertical = vehicle.thrusters
        surge = max(port.max_N + starboard.max_N, -port.min_N - starboard.min_N)
        yaw = max(
            port.max_N * port.arm_m - starboard.min_N * starboard.arm_m,
            starboard.max_N * starboard.arm_m - port.min_N * port.arm_m,
        )
        sinking = 0.0
        if vehicle.heave is not None:
            heave = max(vertical.max_N, -vertical.min_N) + abs(vehicle.net_buoyancy_N)
            sinking = steady(heave, vehicle.heave.linear_damping_kgps, vehicle.heave.quadratic_damping_kgpm)
        top = steady(surge, vehicle.surge.linear_damping_kgps, vehicle.surge.quadratic_damping_kgpm)
        turning = steady(yaw, vehicle.yaw.linear_damping_Nms, vehicle.yaw.quadratic_damping_kgm2)
        return cls(2.0 * top + CURRENT_MPS, 3.0 * turning + 0.5, 2.0 * sinking + 1.0)


class EstimateGate:
    """The newest estimate that is believed."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.rejected: Counter[str] = Counter()
        """Estimates that were not believed, by reason."""
        self.accepted: Estimate | None = None
        self._bounds = Bounds.of(vehicle)
        self._jumped: Estimate | None = None  # refused last, for a jump

    def check(self, estimate: Estimate) -> str:
        """Why ``estimate`` is not believed; empty where it is, and was before."""
        if estimate is self.accepted:
            return ""
        if self._jumped is not None and estimate is self._jumped:
            return JUMPED
        doubt = self._doubt(estimate)
        if doubt:
            self._jumped = None
        elif self.accepted is not None and self._jumps(self.accepted, estimate):
            before, self._jumped = self._jumped, estimate
            if before is None or before.t_ns == estimate.t_ns or self._jumps(before, estimate):
                doubt = JUMPED
        if doubt:
            self.rejected[doubt] += 1
            return doubt
        self.accepted, self._jumped = estimate, None
        return ""

    def _doubt(self, e: Estimate) -> str:
        """What no vehicle of its kind can be; written so that NaN is outside."""
        bounds = self._bounds
        vn, ve = e.velocity_north_mps, e.velocity_east_mps
        if not math.isfinite(e.north_m + e.east_m + e.heading_rad + vn + ve + e.yaw_rate_radps):
            return "a number is not finite"
        if not vn * vn + ve * ve <= bounds.speed_mps * bounds.speed_mps:
            return "velocity over ground beyond what the vehicle can do"
        if not abs(e.yaw_rate_radps) <= bounds.yaw_rate_radps:
            return "yaw rate beyond what the vehicle can do"
        if not math.isfinite(e.depth_m or 0.0):
            return "a number is not finite"
        if not abs(e.velocity_down_mps or 0.0) <= bounds.sinking_mps:
            return "sinking speed beyond what the vehicle can do"
        return ""

    def _jumps(self, old: Estimate, new: Estimate) -> bool:
        """Whether the vehicle cannot have got from ``old`` to ``new``."""
        bounds = self._bounds
        dt = abs(new.t_ns - old.t_ns) * 1e-9
        off_n = new.north_m - old.north_m - old.velocity_north_mps * dt
        off_e = new.east_m - old.east_m - old.velocity_east_mps * dt
        reach = bounds.speed_mps * dt + JUMP_M
        if off_n * off_n + off_e * off_e > reach * reach:
            sd = sum(_sd(e, (0, 1), UNKNOWN_SD_M) for e in (old, new))
            if math.hypot(off_n, off_e) > max(reach, SIGMAS * sd):
                return True
        turned = abs(math.remainder(new.heading_rad - old.heading_rad - old.yaw_rate_radps * dt, math.tau))
        reach = bounds.yaw_rate_radps * dt + JUMP_RAD
        if turned > reach and turned > SIGMAS * sum(_sd(e, (4,), UNKNOWN_SD_RAD) for e in (old, new)):
            return True
        if old.depth_m is None or new.depth_m is None:
            return False
        return abs(new.depth_m - old.depth_m) > bounds.sinking_mps * dt + JUMP_DEPTH_M


JUMPED = "a jump that the vehicle cannot have made"


def _sd(estimate: Estimate, at: tuple[int, ...], unknown: float) -> float:
    """Standard deviation by the covariance's diagonal."""
    P = estimate.covariance
    return unknown if P is None else math.sqrt(sum(max(float(P[i, i]), 0.0) for i in at))
