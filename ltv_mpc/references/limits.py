"""What a vehicle can do along a path, from its own equations of motion: how fast, how tightly, how soon.

All of it with ``SHARE`` of the thrusters' limits: the rest is for waves, for what is not known of the water, and for
steering. The current that is known is reckoned with in each cycle (``schedule.against``).

Straight    (d_x + D_x U) U <= sum of the largest thrusts
Turning     steadily at speed U along a curvature k: yaw rate r = U k, sideslip b with u = U cos b, v = -U sin b, where

    (d_y + D_y U sin b) sin b = M_x U k cos b                      drag against the centrifugal force
    F1 + F2         = (d_x + D_x u) u + M_y |v| r                  surge
    F1 a1 - F2 a2   = (d_psi + D_psi r) r + (M_x - M_y) u |v|      yaw

of which F1 and F2 must lie between min and max. On the spot a turn of angle phi takes phi / r + r I_z / N, with r the
yaw rate and N the moment of one thruster full ahead and the other full astern, and 2 sqrt(phi I_z / N) where it never
gets so fast.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ltv_mpc.messages import Array
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.resistance import steady_speed

SHARE = 0.8
"""Of each thruster's limits, for what lasts."""
CHANGING = 0.4
"""Of the thrust ahead and astern, to speed up and to brake: in a current the vehicle turns meanwhile."""

CURVATURES = np.geomspace(1e-3, 1e2, 61)
"""1/m: where the speed is worked out; between them its logarithm is linear in that of the curvature."""
ROUNDING_N = 1e-9
"""At the cruising speed, straight on, the thrusts are their limits."""
SPEEDS = 200
"""Speeds that are tried at each."""


@dataclass(frozen=True, eq=False)
class Limits:
    """Of one vehicle, in still water."""

    top_mps: float  # at the whole thrust
    cruise_mps: float  # at ``SHARE`` of it
    speed_mps: Array  # (61,) at each of ``CURVATURES``
    yaw_radps: float  # turning on the spot
    yaw_radps2: float
    full_N: float  # ``SHARE`` of what pushes ahead, of both thrusters
    ahead_N: float  # ``CHANGING`` of it: to speed up
    astern_N: float  # and astern, to brake
    mass_kg: float
    linear_kgps: float  # drag in surge
    quadratic_kgpm: float

    def speed_at(self, curvature: Array) -> Array:
        """Fastest steady speed (m/s) along curvatures (1/m) of any shape."""
        k = np.clip(curvature, CURVATURES[0], CURVATURES[-1])
        return np.exp(np.interp(np.log(k), np.log(CURVATURES), np.log(self.speed_mps)))

    def turning_s(self, angle: Array) -> Array:
        """How long it takes to turn by angles >= 0 (rad) on the spot."""
        r, a = self.yaw_radps, self.yaw_radps2
        return np.where(angle >= r * r / a, angle / r + r / a, 2.0 * np.sqrt(angle / a))


@lru_cache(maxsize=8)
def limits_of(vehicle: Vehicle) -> Limits:
    """The limits of a vehicle."""
    port, starboard, _ = vehicle.thrusters
    ahead, astern = port.max_N + starboard.max_N, -(port.min_N + starboard.min_N)
    linear, quadratic = vehicle.surge.linear_damping_kgps, vehicle.surge.quadratic_damping_kgpm
    cruise = _held(SHARE * ahead, linear, quadratic)
    # F1 a1 - F2 a2, the smaller of both sides
    to_starboard = port.max_N * port.arm_m - starboard.min_N * starboard.arm_m
    to_port = starboard.max_N * starboard.arm_m - port.min_N * port.arm_m
    moment = SHARE * min(to_starboard, to_port)
    return Limits(
        top_mps=_held(ahead, linear, quadratic),
        cruise_mps=cruise,
        speed_mps=_turning_speeds(vehicle, cruise),
        yaw_radps=max(_held(moment, vehicle.yaw.linear_damping_Nms, vehicle.yaw.quadratic_damping_kgm2), 1e-3),
        yaw_radps2=max(moment / vehicle.yaw.inertia_kgm2, 1e-4),
        full_N=SHARE * ahead,
        ahead_N=CHANGING * ahead,
        astern_N=CHANGING * astern,
        mass_kg=vehicle.surge.mass_kg,
        linear_kgps=linear,
        quadratic_kgpm=quadratic,
    )


def _held(force: float, linear: float, quadratic: float) -> float:
    """The speed that ``force`` holds; at most 100 where nothing resists."""
    return min(steady_speed(force, linear, quadratic), 100.0)


def _turning_speeds(vehicle: Vehicle, cruise: float) -> Array:
    """(61,) the fastest speed that is possible at each of ``CURVATURES``."""
    U = cruise * np.arange(1, SPEEDS + 1)[None, :] / SPEEDS
    k = CURVATURES[:, None]
    r = U * k
    sin, cos = _sideslip(vehicle, U, k)
    u, v = U * cos, U * sin
    p = vehicle.coefficients()
    surge = (p.linear_surge + p.quadratic_surge * u) * u + p.mass_sway * v * r
    yaw = (p.linear_yaw + p.quadratic_yaw * r) * r + (p.mass_surge - p.mass_sway) * u * v
    port, starboard, _ = vehicle.thrusters
    arms = p.arm_port + p.arm_starboard
    possible = np.ones(r.shape, dtype=bool)
    for side in (1.0, -1.0):  # to starboard, to port
        F1 = (surge * p.arm_starboard + side * yaw) / arms
        F2 = (surge * p.arm_port - side * yaw) / arms
        for F, thruster in ((F1, port), (F2, starboard)):
            possible &= (SHARE * thruster.min_N <= F) & (SHARE * thruster.max_N + ROUNDING_N >= F)
    # Slower ones may not be: damping that is linear takes thrust astern which the drag ahead does not balance.
    steps = np.where(possible.any(axis=1), SPEEDS - np.argmax(possible[:, ::-1], axis=1), 0)
    return cruise * np.maximum(steps, 0.5) / SPEEDS


def _sideslip(vehicle: Vehicle, U: Array, k: Array) -> tuple[Array, Array]:
    """sin b and cos b: the root of drag - centrifugal force in [0, pi/2], by bisection to 1e-6 rad."""
    p = vehicle.coefficients()
    low, high = np.zeros(np.broadcast(U, k).shape), np.full(np.broadcast(U, k).shape, 0.5 * np.pi)
    for _ in range(21):
        b = 0.5 * (low + high)
        s = np.sin(b)
        too_much = (p.linear_sway + p.quadratic_sway * U * s) * s > p.mass_surge * U * k * np.cos(b)
        low, high = np.where(too_much, low, b), np.where(too_much, b, high)
    return np.sin(b), np.cos(b)
