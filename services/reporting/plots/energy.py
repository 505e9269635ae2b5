"""Propulsive energy since t = 0, from the delivered thrusts and the inflow of the propellers."""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.messages import Applied, Estimate, Pair, Truth
from ltv_mpc.vehicle.parameters import Vehicle
from services.reporting.plots.vehicle_from_above import current_at


class Energy:
    """Trapezoidal integral of the propulsive power."""

    def __init__(self) -> None:
        self.joules: Pair | None = None
        """Energy of all thrusters and of the lateral ones (J); None before t = 0, or without torque coefficients."""
        self._last: tuple[int, float, float] | None = None  # time, and power of both

    def add(self, applied: Applied, vehicle: Vehicle, truth: Truth | None, estimate: Estimate | None) -> None:
        """Add the delivered thrusts; the inflow is the true one if it is known, otherwise the estimated one."""
        from ltv_mpc.vehicle.propulsion import propulsive_power_W  # here: it imports numba, which would delay the page

        surge_mps, heave_mps = _inflow(truth, estimate)
        thrust_N = np.array([applied.thrust_N])
        power_W = propulsive_power_W(vehicle, thrust_N, np.array([surge_mps]), np.array([heave_mps]))
        if power_W is None or applied.t_ns < 0:
            return
        powers_W = float(power_W.sum()), float(power_W[0, :2].sum())
        total, lateral = self.joules or (0.0, 0.0)
        if self._last is not None and applied.t_ns > self._last[0]:
            half_s = 0.5e-9 * (applied.t_ns - self._last[0])
            total += half_s * (powers_W[0] + self._last[1])
            lateral += half_s * (powers_W[1] + self._last[2])
        self.joules = total, lateral
        self._last = applied.t_ns, *powers_W


def _inflow(truth: Truth | None, estimate: Estimate | None) -> Pair:
    """Return the velocity through the water, ahead and down (m/s)."""
    if truth is not None:
        return truth.water_velocity_mps[0], truth.water_velocity_mps[2]
    if estimate is None:
        return 0.0, 0.0
    north, east = (0.0, 0.0) if estimate.current is None else current_at(estimate.current, estimate.depth_m or 0.0)
    c, s = math.cos(estimate.heading_rad), math.sin(estimate.heading_rad)
    ahead = c * (estimate.velocity_north_mps - north) + s * (estimate.velocity_east_mps - east)
    return ahead, estimate.velocity_down_mps or 0.0
