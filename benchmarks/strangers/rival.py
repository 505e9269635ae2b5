"""What most vehicles of this kind have: PID at a point, line-of-sight guidance with an integral along a path.

At a point    ``benchmarks.rivals.pid.Pid``
Along a path  chi = course of the leg - atan((e + k_i I) / lookahead),  I' = lookahead e / (lookahead^2 + (e + k_i I)^2)
              M = k_psi (chi - psi) - k_r r,   T = drag of the file at the wanted speed + k_u (U - u) + k_ui int(U - u)

e is the distance to starboard of the leg and u the speed over ground ahead. Near the end of a leg the next one is
followed, and near the end of the path its PID holds that point. Where the course is off by more than a right angle the
vehicle turns first.
Source: Borhaug, Pavlov and Pettersen 2008; Fossen 2021, section 12.3. Gains were tuned once a hull: lookahead_m,
k_i (1/s), k_psi (N m/rad), k_r (N m s/rad), k_u (N s/m), k_ui (N/m).
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.rivals import pid
from benchmarks.rivals.pid import PERIOD_S
from ltv_mpc.frames import wrap_angle
from ltv_mpc.messages import Applied, Array, Estimate, Pair
from ltv_mpc.vehicle.parameters import Vehicle

SWITCH_M = 1.0
"""Distance from the end of a leg at which the next one begins."""


def gains_of(hull: str) -> dict[str, dict[str, float]]:
    """Return the tuned gains of a hull: of points and of paths."""
    gains: dict[str, dict[str, float]] = tomllib.loads(Path(__file__).with_name("gains.toml").read_text())[hull]
    return gains


class Rival:
    """Pilot with gains of its own for points and for paths."""

    cycle_steps, delay_steps = 10, 0
    nominal = True

    def __init__(self, vehicle: Vehicle, gains: dict[str, dict[str, float]], target: Sequence[Pair], speed_mps: float):
        """Begin with a target: one point, or the corners of a path."""
        self._vehicle, self._gains = vehicle, gains
        port, starboard = vehicle.thrusters[:2]
        self._arms_m = port.arm_m + starboard.arm_m
        self._limits = np.array([[t.min_N, t.max_N] for t in (port, starboard)])
        surge = vehicle.surge
        self._drag_N = (surge.linear_damping_kgps + surge.quadratic_damping_kgpm * speed_mps) * speed_mps
        self._speed_mps = speed_mps
        self.follow(target)

    def follow(self, target: Sequence[Pair]) -> None:
        """Follow another target."""
        self._corners = [np.array(place) for place in target]
        self._leg, self._across, self._ahead = 0, 0.0, 0.0
        self._pid = pid.Pid(self._vehicle, self._gains["point"])

    def plan(self, estimate: Estimate, t_ns: int, applied: Applied | None) -> tuple[npt.NDArray[np.int64], Array]:
        """Return a constant thrust from now on."""
        del applied
        here = np.array([estimate.north_m, estimate.east_m])
        last = len(self._corners) - 1
        while self._leg < last and self._left_m(here) < SWITCH_M:
            self._leg += 1
        if self._leg == last:
            target = float(self._corners[-1][0]), float(self._corners[-1][1])
            pair = np.array(self._pid.thrust(estimate, target))
        else:
            pair = self._along(estimate, here)
        pair = pair.clip(*self._limits.T)
        return np.array([t_ns]), pair[None]

    def _left_m(self, here: Array) -> float:
        way = self._corners[self._leg + 1] - self._corners[self._leg]
        return float((self._corners[self._leg + 1] - here) @ way / np.hypot(*way))

    def _along(self, estimate: Estimate, here: Array) -> Array:
        k, psi = self._gains["path"], estimate.heading_rad
        way = self._corners[self._leg + 1] - self._corners[self._leg]
        course = math.atan2(way[1], way[0])
        off = here - self._corners[self._leg]
        e = -math.sin(course) * off[0] + math.cos(course) * off[1]
        look = k["lookahead_m"]
        aimed = e + k["k_i"] * self._across
        wanted = course - math.atan2(aimed, look)
        error = wrap_angle(wanted - psi)
        u = math.cos(psi) * estimate.velocity_north_mps + math.sin(psi) * estimate.velocity_east_mps
        speed = self._speed_mps * max(0.0, math.cos(error))
        ahead = self._drag_N * speed / self._speed_mps + k["k_u"] * (speed - u) + k["k_ui"] * self._ahead
        moment = k["k_psi"] * error - k["k_r"] * estimate.yaw_rate_radps
        pair = np.array([0.5 * ahead + moment / self._arms_m, 0.5 * ahead - moment / self._arms_m])
        if ((self._limits[:, 0] < pair) & (pair < self._limits[:, 1])).all():  # else the integrals wait
            self._across += PERIOD_S * look * e / (look**2 + aimed**2)
            self._ahead += PERIOD_S * (speed - u)
        return pair
