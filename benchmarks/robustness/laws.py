"""Laws of the robustness table: the controller with two efforts, PID with line of sight, and LQR.

PID and LQR are those of ``benchmarks/strangers`` and ``benchmarks/rivals``, asked ten times a second. LQR needs the
current: it is given the steady one exactly, which no other law is. Along a path it follows a point that moves along it.
In axes that move with the point, the point stands still in water of velocity c - w, w the point's velocity, so that the
law of station keeping serves.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import msgspec
import numpy as np
import numpy.typing as npt

from benchmarks.rivals.lqr import Lqr
from benchmarks.rivals.pid import PERIOD_S
from benchmarks.strangers.flight import Ours, Pilot
from benchmarks.strangers.rival import Rival
from benchmarks.strangers.tasks import Corners, reference
from ltv_mpc import ControllerConfig, Estimate, Vehicle
from ltv_mpc.messages import Applied, Array, CurrentProfile, Pair

DEFAULT, HIGH, PID, LQR = LAWS = ("default", "high effort", "PID", "LQR")
RIVALS = (PID, LQR)
AHEAD_M = 1.5
"""Distance between vehicle and moving point above which the point waits."""

Gains = dict[str, dict[str, float]]
"""Gains of a vehicle's rivals by ``point`` and ``path`` (PID) and ``lqr``."""


def tuned_gains() -> dict[str, Gains]:
    """Return the gains by vehicle, which were tuned on the right file."""
    found: dict[str, Gains] = tomllib.loads(Path(__file__).with_name("gains.toml").read_text())
    return found


class LqrPilot:
    """LQR at a point, or behind a point that moves along a path."""

    cycle_steps, delay_steps, nominal = Rival.cycle_steps, 0, True

    def __init__(self, vehicle: Vehicle, weights: dict[str, float], corners: Corners, speed_mps: float, c: Pair):
        """Take the corners of the path, the speed of the point and the current (m/s north and east)."""
        self._law, self._c, self._speed_mps = Lqr(vehicle, weights), np.array(c), speed_mps
        self._corners = np.array(corners)
        ways = np.diff(self._corners, axis=0)
        self._ends_m = np.concatenate([[0.0], np.cumsum(np.hypot(*ways.T))])
        self._velocities = speed_mps * ways / np.maximum(np.hypot(*ways.T), 1e-9)[:, None]
        self._along_m = 0.0
        self._limits = np.array([[t.min_N, t.max_N] for t in vehicle.thrusters[:2]])

    def plan(self, estimate: Estimate, t_ns: int, applied: Applied | None) -> tuple[npt.NDArray[np.int64], Array]:
        """Return a constant thrust from now on."""
        del applied
        point = np.array([np.interp(self._along_m, self._ends_m, axis) for axis in self._corners.T])
        w = np.zeros(2)
        near = np.hypot(estimate.north_m - point[0], estimate.east_m - point[1]) < AHEAD_M
        if near and self._along_m < self._ends_m[-1]:
            w = self._velocities[int(np.searchsorted(self._ends_m, self._along_m, side="right")) - 1]
            self._along_m += PERIOD_S * self._speed_mps
        north, east = self._c - w
        moving = msgspec.structs.replace(
            estimate,
            velocity_north_mps=estimate.velocity_north_mps - w[0],
            velocity_east_mps=estimate.velocity_east_mps - w[1],
            depth_m=0.0,
            current=CurrentProfile(
                depth_m=np.array([0.0, 1.0]), north_mps=np.full(2, north), east_mps=np.full(2, east)
            ),
        )
        pair = np.array(self._law.thrust(moving, (float(point[0]), float(point[1]))))
        return np.array([t_ns]), pair.clip(*self._limits.T)[None]


def pilot(law: str, vehicle: Vehicle, corners: Corners, speed_mps: float, c: Pair, gains: Gains) -> Pilot:
    """Return the pilot of a flight. Raises ``LinAlgError`` for weights of LQR without a gain.

    Parameters
    ----------
    law : one of ``LAWS``.
    vehicle : from its file, right or wrong.
    corners, speed_mps : one point, or a path and the speed along it.
    c : steady current (m/s), north and east, which LQR alone is given.
    gains : of the vehicle's rivals.
    """
    if law == PID:
        return Rival(vehicle, gains, corners, speed_mps)
    if law == LQR:
        return LqrPilot(vehicle, gains["lqr"], corners, speed_mps, c)
    return Ours(vehicle, reference(corners, speed_mps), ControllerConfig(effort="high" if law == HIGH else "normal"))
