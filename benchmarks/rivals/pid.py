"""Position by PID, heading by PD: what most vehicles of this kind have.

    f   = kp e - kd p' + ki I,  I' = e          wanted force (N, NED), e = target - p
    psi_d = direction of f, or its opposite where that is nearer: the thrusters push both ways
    T   = f . [cos psi, sin psi]                along the vehicle; what is across it waits for the turn
    M   = k_psi (psi_d - psi) - k_r r
    F1, F2 = T / 2 +- M / (a1 + a2)

Below ``hold_N`` the heading is kept: the direction of a small force is noise. I is held while a thruster is saturated.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.frames import wrap_angle
from ltv_mpc.messages import Array, Estimate, Pair
from ltv_mpc.vehicle.parameters import Vehicle

PERIOD_S = 0.1
"""Time between two answers of a rival."""


class Pid:
    """PID with its gains by name.

    kp (N/m), kd (N s/m), ki (N/(m s)), k_psi (N m/rad), k_r (N m s/rad), hold_N.
    """

    def __init__(self, vehicle: Vehicle, gains: dict[str, float]) -> None:
        port, starboard = vehicle.thrusters[:2]
        self._arms_m = port.arm_m + starboard.arm_m
        self._most_N = (port.max_N, starboard.max_N)
        self._gains = gains
        self._integral = np.zeros(2)
        self._heading_rad: float | None = None

    def thrust(self, estimate: Estimate, target_m: Pair) -> Pair:
        """See above."""
        k, psi = self._gains, estimate.heading_rad
        e = np.array(target_m) - (estimate.north_m, estimate.east_m)
        velocity = np.array([estimate.velocity_north_mps, estimate.velocity_east_mps])
        f: Array = k["kp"] * e - k["kd"] * velocity + k["ki"] * self._integral
        if self._heading_rad is None or math.hypot(*f) > k["hold_N"]:
            self._heading_rad = nearer_axis(math.atan2(f[1], f[0]), psi)
        along = f[0] * math.cos(psi) + f[1] * math.sin(psi)
        moment = k["k_psi"] * wrap_angle(self._heading_rad - psi) - k["k_r"] * estimate.yaw_rate_radps
        pair = 0.5 * along + moment / self._arms_m, 0.5 * along - moment / self._arms_m
        if all(abs(F) < most for F, most in zip(pair, self._most_N, strict=True)):
            self._integral += PERIOD_S * e
        return pair


def nearer_axis(direction_rad: float, psi: float) -> float:
    """Return the direction or its opposite, the one that needs the smaller turn from ``psi``."""
    return direction_rad if math.cos(direction_rad - psi) >= 0 else wrap_angle(direction_rad + math.pi)
