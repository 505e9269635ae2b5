"""A law that stops the vehicle, for where there is no plan to go by: damping of surge and yaw through the water.

With T = 2 (lag + h), the longer of both lateral thrusters' lags and the length of the stage to come:

    X = - M_x u / T,   N = - I_z r / T                                    force (N) and moment (N m) wanted
    F1 = (a2 X + N) / (a1 + a2),   F2 = (a1 X - N) / (a1 + a2)            which give them, then box and slew

T is that long so that the thruster's lag and the way from knot to knot leave the loop well damped. Nothing is wanted
of sway, which no thruster reaches: the hull's own drag takes it. Relative to the water, not to the ground: that takes
neither a position nor a current, a wrong estimate cannot make it push for ever, and where it ends it needs no thrust.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import advance_stage
from ltv_mpc.vehicle.parameters import Vehicle


class Damping:
    """The law for one vehicle on one grid of knots."""

    def __init__(self, vehicle: Vehicle, knots: Array, stage_s: float) -> None:
        """``knots`` (N+1,) in stages of ``stage_s``."""
        port, starboard, _ = vehicle.thrusters
        self._p = vehicle.coefficients()
        self._h = np.diff(knots) * stage_s
        self._limits = [(t.min_N, t.max_N, t.slew_N_per_s) for t in (port, starboard)]
        self._arms = port.arm_m, starboard.arm_m
        self._lag_s = max(port.lag_s, starboard.lag_s)

    def wanted(self, u: float, r: float, stage_s: float) -> tuple[float, float]:
        """F1 and F2 (N) at surge u (m/s, through the water) and yaw rate r (rad/s), before box and slew."""
        T = 2.0 * (self._lag_s + stage_s)
        X, N = -self._p.mass_surge * u / T, -self._p.inertia_yaw * r / T
        a1, a2 = self._arms
        return (a2 * X + N) / (a1 + a2), (a1 * X - N) / (a1 + a2)

    def fill(self, X: Array, U: Array, C: Array, first: int) -> None:
        """States X (N+1, 8) and commands U (N+1, 2) after knot ``first``, up to which they are given, by the exact flow
        in a current C (N+1, 2).
        """
        for k in range(first, len(self._h)):
            h = float(self._h[k])
            wanted = self.wanted(float(X[k, 2]), float(X[k, 5]), h)
            for i, (low, high, slew) in enumerate(self._limits):
                reach = slew * h
                before = float(U[k, i])
                # A command outside a box that was just lowered is brought in at the slew limit.
                inside = min(max(wanted[i], low), high)
                U[k + 1, i] = min(max(inside, before - reach), before + reach)
            advance_stage(X[k], U[k], U[k + 1], C[k], C[k + 1], h, self._p, X[k + 1])
