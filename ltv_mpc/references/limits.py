"""Limits of a vehicle along a path, from its equations of motion: speed, curvature, acceleration, turning on the spot.

They use ``SUSTAINED_SHARE`` of the thrusters' limits. The rest is a reserve for waves, for errors of the known current,
and for steering. The known current is taken into account in each cycle (``schedule.feasible_rate``).

Straight    (d_x + D_x U) U <= sum of the largest thrusts
Turning     steadily at speed U along a curvature k: yaw rate r = U k, sideslip b with u = U cos b, v = -U sin b, where

    (d_y + D_y U sin b) sin b = M_x U k cos b                      drag against the centrifugal force
    F1 + F2         = (d_x + D_x u) u + M_y |v| r                  surge
    F1 a1 - F2 a2   = (d_psi + D_psi r) r + (M_x - M_y) u |v|      yaw

F1 and F2 must lie between min and max. A turn on the spot by an angle phi takes phi / r + r I_z / N, with r the steady
yaw rate and N the moment of one thruster full ahead and the other full astern; it takes 2 sqrt(phi I_z / N) if the yaw
rate stays below r.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ltv_mpc.messages import Array
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.resistance import steady_speed

SUSTAINED_SHARE = 0.8
"""Share of each thruster's limits that a steady motion may use."""
ACCELERATION_SHARE = 0.4
"""Share of the thrust ahead and astern that acceleration and braking may use: in a current the vehicle also turns."""

CURVATURES = np.geomspace(1e-3, 1e2, 61)
"""Curvatures (1/m) at which the speed is computed; between them log speed is linear in log curvature."""
ROUNDING_N = 1e-9
"""Tolerance for rounding: straight on at the cruising speed, the thrusts equal their limits."""
SPEEDS = 200
"""Number of speeds tried at each curvature."""


class SurgeLimits(NamedTuple):
    """Forces along the path, and the mass and damping they act on."""

    full_N: float  # ``SUSTAINED_SHARE`` of the thrust ahead of both thrusters
    ahead_N: float  # ``ACCELERATION_SHARE`` of it
    astern_N: float  # ``ACCELERATION_SHARE`` of the thrust astern
    mass_kg: float
    linear_kgps: float
    quadratic_kgpm: float


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of one vehicle in still water."""

    top_mps: float  # at full thrust
    cruise_mps: float  # at ``SUSTAINED_SHARE`` of it
    speed_mps: Array  # (61,) at each of ``CURVATURES``
    yaw_radps: float  # turning on the spot
    yaw_radps2: float
    turn_in_m: float  # way at cruising speed while the yaw rate builds up, at least the length of the hull
    surge: SurgeLimits

    def speed_at(self, curvature: Array) -> Array:
        """Return the fastest steady speed (m/s) along curvatures (1/m) of any shape.

        Parameters
        ----------
        curvature : curvatures (1/m).
        """
        k = np.clip(curvature, CURVATURES[0], CURVATURES[-1])
        return np.exp(np.interp(np.log(k), np.log(CURVATURES), np.log(self.speed_mps)))

    def turning_s(self, angle: Array) -> Array:
        """Return the time (s) of turns on the spot by angles >= 0 (rad) of any shape.

        Parameters
        ----------
        angle : angles (rad).
        """
        r, a = self.yaw_radps, self.yaw_radps2
        return np.where(angle >= r * r / a, angle / r + r / a, 2.0 * np.sqrt(angle / a))


@lru_cache(maxsize=8)
def path_limits(vehicle: Vehicle) -> Limits:
    """Return the limits of a vehicle."""
    ahead, astern = vehicle.pushes_N
    linear, quadratic = vehicle.surge.linear_damping_kgps, vehicle.surge.quadratic_damping_kgpm
    cruise = _steady(SUSTAINED_SHARE * ahead, linear, quadratic)
    moment = SUSTAINED_SHARE * min(vehicle.couples_Nm)
    yaw_radps = max(_steady(moment, vehicle.yaw.linear_damping_Nms, vehicle.yaw.quadratic_damping_kgm2), 1e-3)
    yaw_radps2 = max(moment / vehicle.yaw.inertia_kgm2, 1e-4)
    return Limits(
        top_mps=_steady(ahead, linear, quadratic),
        cruise_mps=cruise,
        speed_mps=_steady_turning_speeds(vehicle, cruise),
        yaw_radps=yaw_radps,
        yaw_radps2=yaw_radps2,
        turn_in_m=max(cruise * yaw_radps / yaw_radps2, vehicle.hull.length_m if vehicle.hull else 0.0),
        surge=SurgeLimits(
            full_N=SUSTAINED_SHARE * ahead,
            ahead_N=ACCELERATION_SHARE * ahead,
            astern_N=ACCELERATION_SHARE * astern,
            mass_kg=vehicle.surge.mass_kg,
            linear_kgps=linear,
            quadratic_kgpm=quadratic,
        ),
    )


def _steady(force: float, linear: float, quadratic: float) -> float:
    """Return the steady speed at a force or moment, at most 100 for a hull without damping."""
    return min(steady_speed(force, linear, quadratic), 100.0)


def _steady_turning_speeds(vehicle: Vehicle, cruise: float) -> Array:
    """Return the fastest possible steady speed (61,) at each of ``CURVATURES``."""
    U = cruise * np.arange(1, SPEEDS + 1)[None, :] / SPEEDS
    k = CURVATURES[:, None]
    r = U * k
    sin, cos = _sideslip(vehicle, U, k)
    u, v = U * cos, U * sin
    p = vehicle.coefficients()
    surge = (p.linear_surge + p.quadratic_surge * u) * u + p.mass_sway * v * r
    yaw = (p.linear_yaw + p.quadratic_yaw * r) * r + (p.mass_surge - p.mass_sway + p.added_munk) * u * v
    port, starboard, _ = vehicle.thrusters
    arms = p.arm_port + p.arm_starboard
    possible = np.ones(r.shape, dtype=bool)
    for side in (1.0, -1.0):  # to starboard, to port
        F1 = (surge * p.arm_starboard + side * yaw) / arms
        F2 = (surge * p.arm_port - side * yaw) / arms
        for F, thruster in ((F1, port), (F2, starboard)):
            possible &= (SUSTAINED_SHARE * thruster.min_N <= F) & (SUSTAINED_SHARE * thruster.max_N + ROUNDING_N >= F)
    # take the fastest: slower speeds may be impossible, because linear yaw damping can need thrust astern
    # that the surge drag does not balance
    steps = np.where(possible.any(axis=1), SPEEDS - np.argmax(possible[:, ::-1], axis=1), 0)
    return cruise * np.maximum(steps, 0.5) / SPEEDS


def _sideslip(vehicle: Vehicle, U: Array, k: Array) -> tuple[Array, Array]:
    """Return sin b and cos b: the root of drag - centrifugal force in [0, pi/2], by bisection to 1e-6 rad."""
    p = vehicle.coefficients()
    low, high = np.zeros(np.broadcast(U, k).shape), np.full(np.broadcast(U, k).shape, 0.5 * np.pi)
    for _ in range(21):
        b = 0.5 * (low + high)
        s = np.sin(b)
        too_much = (p.linear_sway + p.quadratic_sway * U * s) * s > p.mass_surge * U * k * np.cos(b)
        low, high = np.where(too_much, low, b), np.where(too_much, b, high)
    return np.sin(b), np.cos(b)
