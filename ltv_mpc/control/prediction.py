"""From the newest estimate to the instant at which the plan will take effect: dead time compensated.

The estimate is valid at its own time; the plan that is being computed takes effect later. Until then the commands that
were already sent act, through the thrusters' lag. The delivered thrust is followed by the lag model, corrected by what
the actuators report.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from ltv_mpc.control.commands import SentCommands
from ltv_mpc.control.horizon import roll_out
from ltv_mpc.signals import Applied, Array, CurrentProfile, Estimate, Triple
from ltv_mpc.vehicle.flow import advance_heave, lag_weights
from ltv_mpc.vehicle.parameters import Vehicle

STEP_NS = 100_000_000
"""Longest piece of the roll; pieces end where the commands have a knot."""

REPORTS = 32
"""Reports of the actuators that are kept: 3 s at 10 Hz, more than any estimate is late."""


@dataclass(frozen=True, slots=True)
class Start:
    """The vehicle at the instant at which the plan takes effect."""

    t_ns: int
    X: Array  # (8,) n, e, u, v, psi, r, F1, F2
    command: Array  # (3,) in force
    depth_m: float
    sinking_mps: float
    vertical_N: float  # delivered


def current_at(profile: CurrentProfile | None, depth_m: Array) -> Array:
    """North and east current (M, 2) at depths (M,): linear between the profile's depths, constant beyond; else zero."""
    if profile is None:
        return np.zeros((len(depth_m), 2))
    return np.stack(
        [np.interp(depth_m, profile.depth_m, profile.north_mps), np.interp(depth_m, profile.depth_m, profile.east_mps)],
        axis=1,
    )


class Prediction:
    """Rolls estimates forward through the commands sent."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._p = vehicle.coefficients()
        self._lag_s = tuple(t.lag_s for t in vehicle.thrusters)
        self._reports: deque[tuple[int, Triple]] = deque(maxlen=REPORTS)

    def report(self, applied: Applied) -> None:
        """The actuators say what they deliver."""
        if not self._reports or applied.t_ns > self._reports[-1][0]:
            self._reports.append((applied.t_ns, applied.thrust_N))

    def delivered(self, t_ns: int, commands: SentCommands) -> Array:
        """Thrust delivered (3,) at t_ns: the last report before it, brought there by the lag; else the commands."""
        before = [report for report in self._reports if report[0] <= t_ns]
        if not before:
            thrust: Array = commands.at(np.array([t_ns], dtype=np.int64))[0]
            return thrust
        times = commands.between(before[-1][0], t_ns)
        F, u = np.array(before[-1][1]), commands.at(times)
        for k in range(len(times) - 1):
            h = float(times[k + 1] - times[k]) * 1e-9
            if h > 0.0:
                for i in range(3):
                    a, b0, b1 = lag_weights(h, h, self._lag_s[i])
                    F[i] = a * F[i] + b0 * u[k, i] + b1 * u[k + 1, i]
        return F

    def roll(self, estimate: Estimate, t_ns: int, commands: SentCommands) -> Start:
        """The vehicle at ``t_ns``, not before the estimate's own time."""
        t_ns = max(t_ns, estimate.t_ns)
        F = self.delivered(estimate.t_ns, commands)
        z = 0.0 if estimate.depth_m is None else estimate.depth_m
        w = 0.0 if estimate.velocity_down_mps is None else estimate.velocity_down_mps
        times = self._pieces(commands.between(estimate.t_ns, t_ns))
        u = commands.at(times)
        h = np.diff(times) * 1e-9
        # The depth does not depend on the rest: it goes first, and gives the current on the way.
        depth = np.empty(len(times))
        depth[0] = z
        F3 = float(F[2])
        for k in range(len(h)):
            if estimate.depth_m is None:
                depth[k + 1] = z
                continue
            z, w, F3 = advance_heave(z, w, F3, u[k, 2], u[k + 1, 2], h[k], self._p)
            z, w = (z, w) if z > 0.0 else (0.0, max(w, 0.0))  # the surface
            depth[k + 1] = z
        c = current_at(estimate.current, depth)
        X = roll_out(self._state(estimate, c[0], F), np.ascontiguousarray(u[:, :2]), c, h, self._p)[-1]
        return Start(t_ns, X, u[-1], z, w, F3)

    @staticmethod
    def _pieces(knots: np.ndarray) -> np.ndarray:
        """Knots with further ones in between, at most STEP_NS apart."""
        out = [int(knots[0])]
        for t in knots[1:]:
            n = max(1, -(-(int(t) - out[-1]) // STEP_NS))
            start, way = out[-1], int(t) - out[-1]
            if way > 0:
                out.extend(start + way * (i + 1) // n for i in range(n))
        return np.array(out, dtype=np.int64)

    @staticmethod
    def _state(estimate: Estimate, c: Array, F: Array) -> Array:
        """X (8,) at the estimate's time: [u, v] = R(psi)' (velocity over ground - current)."""
        cos, sin = np.cos(estimate.heading_rad), np.sin(estimate.heading_rad)
        north, east = estimate.velocity_north_mps - c[0], estimate.velocity_east_mps - c[1]
        return np.array(
            [
                estimate.north_m,
                estimate.east_m,
                cos * north + sin * east,
                -sin * north + cos * east,
                estimate.heading_rad,
                estimate.yaw_rate_radps,
                F[0],
                F[1],
            ]
        )
