"""Performance of a vehicle from its equations of motion: steady speeds by their roots, the rest by integration.

All figures are for motion through still water. The integrated ones include thruster slew and lag, and begin at rest
unless stated. "Straight" means the largest thrusts without a yaw moment, F1 a1 = F2 a2 with the arms a1 and a2.
"Turning" means one lateral thruster full ahead and the other full astern.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec
import numpy as np

from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import STATES, advance_stage, lag_table
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.resistance import steady_speed

STEP_S = 0.05
"""Integration step, and so the resolution of the times (s)."""

MAX_TIME_S = 900.0
"""Longest motion that is integrated: a figure that is not reached by then is None (s)."""

MAX_SPEED_MPS = 50.0
"""Largest top speed; a vehicle that still accelerates at this speed counts as without damping."""

STOPPED_SHARE = 0.02
"""Share of the top speed at which the vehicle counts as stopped."""

TIME_CONSTANT_SHARE = 1.0 - math.exp(-1.0)
"""Share of a steady value that is reached after one time constant."""

SWAY_SHARE = 0.1
"""Initial sway, as a share of the top speed: under quadratic drag the time of the decay depends on it."""

SWAY_OVER_SURGE = 0.3
"""Sway speed in a tight turn as a share of the top speed: an assumption for the largest sway drag."""

SETTLED = 1e-9
"""Change of a steady motion in 5 s (m/s, rad/s)."""

STILL = np.zeros(2)


class Performance(msgspec.Struct, frozen=True, kw_only=True):
    """Performance figures; None if a figure does not exist.

    A figure does not exist if its motion has no damping or no thrust, or takes longer than ``MAX_TIME_S``. The top
    speed without thrust is 0. A time constant is the time to 63 % (1 - 1/e) of the steady value.
    """

    top_speed_ahead_mps: float | None  # also the strongest current in which it holds its position, bow into it
    top_speed_astern_mps: float | None  # the same, stern into the current
    turning_rate_starboard_radps: float | None  # steady yaw rate, positive
    turning_rate_port_radps: float | None  # steady yaw rate, negative
    turn_90deg_s: float | None  # to the side of the smaller turning rate, until the yaw rate is zero again
    stopping_distance_m: float | None  # from top speed ahead to 2 % of it, with the straight thrusts astern
    stopping_time_s: float | None  # of the same motion
    surge_s: float | None  # time constant of surge: from rest, straight ahead
    sway_s: float | None  # time constant of sway: a tenth of top speed falls to 37 % (1/e) without thrust
    yaw_s: float | None  # time constant of yaw: from rest, to the side of the smaller turning rate
    thruster_s: float  # time constant of the slower lateral thruster, from zero to its maximum


def performance(vehicle: Vehicle) -> Performance:
    """Return the performance of a vehicle."""
    ahead, astern = straight_thrusts(vehicle, ahead=True), straight_thrusts(vehicle, ahead=False)
    top, top_astern = top_speed(vehicle, ahead), top_speed(vehicle, astern)
    rate_starboard, rate_port = _steady_yaw_rates(vehicle)
    stop = stopping(vehicle, top or 0.0)
    to_starboard = rate_starboard is None or rate_port is None or abs(rate_starboard) <= abs(rate_port)
    turn = turning_thrusts(vehicle, starboard=to_starboard)
    rate = rate_starboard if to_starboard else rate_port
    full = np.array([thruster.max_N for thruster in vehicle.thrusters[:2]])
    decayed_mps = (1.0 - TIME_CONSTANT_SHARE) * SWAY_SHARE * (top or 0.0)
    return Performance(
        top_speed_ahead_mps=top,
        top_speed_astern_mps=top_astern,
        turning_rate_starboard_radps=rate_starboard,
        turning_rate_port_radps=rate_port,
        turn_90deg_s=_quarter_turn(vehicle, to_starboard),
        stopping_distance_m=None if stop is None else stop[0],
        stopping_time_s=None if stop is None else stop[1],
        surge_s=_time_until(vehicle, ahead, lambda X: X[2] >= TIME_CONSTANT_SHARE * top) if top else None,
        sway_s=_time_until(vehicle, STILL, lambda X: X[3] <= decayed_mps, SWAY_SHARE * top) if top else None,
        yaw_s=_time_until(vehicle, turn, lambda X: abs(X[5]) >= TIME_CONSTANT_SHARE * abs(rate)) if rate else None,
        thruster_s=_time_until(vehicle, full, lambda X: bool(np.all(X[6:] >= TIME_CONSTANT_SHARE * full)))
        or MAX_TIME_S,
    )


def straight_thrusts(vehicle: Vehicle, *, ahead: bool) -> Array:
    """Return the largest thrusts (2,) in N ahead or astern without a yaw moment: F1 a1 = F2 a2.

    Parameters
    ----------
    vehicle : parameters of the vehicle.
    ahead : True for ahead, False for astern.
    """
    port, starboard = vehicle.thrusters[:2]
    limits = (port.max_N, starboard.max_N) if ahead else (-port.min_N, -starboard.min_N)
    sign = 1.0 if ahead else -1.0
    if port.arm_m == starboard.arm_m:
        return sign * np.full(2, min(limits))
    if port.arm_m == 0.0 or starboard.arm_m == 0.0:  # only the thruster on the centre line is used
        return sign * np.array([limits[0] * (port.arm_m == 0.0), limits[1] * (starboard.arm_m == 0.0)])
    moment = min(limits[0] * port.arm_m, limits[1] * starboard.arm_m)
    return sign * np.array([moment / port.arm_m, moment / starboard.arm_m])


def turning_thrusts(vehicle: Vehicle, *, starboard: bool) -> Array:
    """Return the thrusts (2,) in N with the largest yaw moment to starboard or to port.

    Parameters
    ----------
    vehicle : parameters of the vehicle.
    starboard : True for starboard, False for port.
    """
    port_thruster, starboard_thruster = vehicle.thrusters[:2]
    if starboard:
        return np.array([port_thruster.max_N, starboard_thruster.min_N])
    return np.array([port_thruster.min_N, starboard_thruster.max_N])


def top_speed(vehicle: Vehicle, F: Array) -> float | None:
    """Return |u| (m/s) at which u' = 0: 0 without thrust, None if it is above ``MAX_SPEED_MPS`` (no damping).

    Parameters
    ----------
    vehicle : parameters of the vehicle.
    F : (2,) thrusts without a yaw moment (N).
    """
    push, surge = abs(float(F.sum())), vehicle.surge
    speed = steady_speed(push, surge.linear_damping_kgps, surge.quadratic_damping_kgpm) if push else 0.0
    return speed if speed < MAX_SPEED_MPS else None


def stopping(vehicle: Vehicle, speed_mps: float) -> tuple[float, float] | None:
    """Return distance (m) and time (s) from a steady speed to ``STOPPED_SHARE`` of it; None if it does not stop.

    Parameters
    ----------
    vehicle : parameters of the vehicle; its straight thrusts astern are commanded.
    speed_mps : speed ahead through the water (m/s); None is returned for 0.
    """
    if speed_mps <= 0.0:
        return None
    ahead, astern = straight_thrusts(vehicle, ahead=True), straight_thrusts(vehicle, ahead=False)
    drag_N = (vehicle.surge.linear_damping_kgps + vehicle.surge.quadratic_damping_kgpm * speed_mps) * speed_mps
    motion = _StillWaterMotion(vehicle)
    motion.X[2] = speed_mps
    motion.X[6:] = motion.U = ahead * min(drag_N / ahead.sum(), 1.0)
    stopped = motion.until(lambda X: X[2] <= STOPPED_SHARE * speed_mps, astern)
    return (float(motion.X[0]), motion.t_s) if stopped else None


def sideways_drag_N(vehicle: Vehicle, current_mps: float, angle_deg: float) -> float:
    """Return the force with which a current pushes the hull sideways while the vehicle is at rest over ground (N).

    Parameters
    ----------
    vehicle : parameters of the vehicle.
    current_mps : speed of the water (m/s).
    angle_deg : angle between heading and current (degrees).
    """
    sway_mps = current_mps * abs(math.sin(math.radians(angle_deg)))
    return (vehicle.sway.linear_damping_kgps + vehicle.sway.quadratic_damping_kgpm * sway_mps) * sway_mps


def fastest_drag_rate_per_s(vehicle: Vehicle) -> float:
    """Return the largest rate (1/s) at which drag changes the motion.

    It is the largest of surge at top speed, sway at ``SWAY_OVER_SURGE`` of it, and yaw at the steady yaw rate.
    """
    p, top = vehicle.coefficients(), top_speed(vehicle, straight_thrusts(vehicle, ahead=True)) or 0.0
    turn = max(abs(rate or 0.0) for rate in _steady_yaw_rates(vehicle))
    return max(
        (p.linear_surge + 2.0 * p.quadratic_surge * top) / p.mass_surge,
        (p.linear_sway + 2.0 * p.quadratic_sway * SWAY_OVER_SURGE * top) / p.mass_sway,
        (p.linear_yaw + 2.0 * p.quadratic_yaw * turn) / p.inertia_yaw,
    )


def _steady_yaw_rates(vehicle: Vehicle) -> tuple[float | None, float | None]:
    """Return the steady yaw rates (rad/s) to starboard and to port."""
    starboard, port = (turning_thrusts(vehicle, starboard=side) for side in (True, False))
    return _steady_yaw_rate(vehicle, starboard), _steady_yaw_rate(vehicle, port)


def _steady_yaw_rate(vehicle: Vehicle, F: Array) -> float | None:
    """Return r (rad/s) under the thrusts ``F`` (2,) in N from rest, once u, v and r hardly change in 5 s.

    Return None without damping in yaw or sway, or if the motion does not settle.
    """
    p = vehicle.coefficients()
    if p.linear_yaw + p.quadratic_yaw <= 0.0 or p.linear_sway + p.quadratic_sway <= 0.0:
        return None
    motion, before, now = _StillWaterMotion(vehicle), np.ones(3), np.zeros(3)
    while np.abs(now - before).max() >= SETTLED:
        if motion.t_s >= MAX_TIME_S:
            return None
        before = now
        motion.until(lambda _: False, F, longest_s=motion.t_s + 5.0)
        now = motion.X[[2, 3, 5]]
    return float(now[2])


class _StillWaterMotion:
    """Motion in still water from rest, with commands that change at the slew limit."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._p = vehicle.coefficients()
        self._lag = lag_table(STEP_S, self._p)
        self._change = STEP_S * np.array([t.slew_N_per_s for t in vehicle.thrusters[:2]])
        self.X = np.zeros(STATES)
        self.U = np.zeros(2)
        self.t_s = 0.0

    def until(self, reached: Callable[[Array], bool], F: Array, *, longest_s: float = MAX_TIME_S) -> bool:
        """Advance in steps of ``STEP_S`` until ``reached(X)``; return False if that takes longer than ``longest_s``.

        Parameters
        ----------
        reached : end of the motion.
        F : (2,) requested thrusts (N), towards which the commands change.
        longest_s : longest time of the motion (s).
        """
        while not reached(self.X):
            if self.t_s > longest_s:
                return False
            U = self.U + np.clip(F - self.U, -self._change, self._change)
            out = np.empty(STATES)
            advance_stage(self.X, self.U, U, STILL, STILL, STEP_S, self._p, self._lag, out)
            self.X, self.U = out, U
            self.t_s += STEP_S
        return True


def _time_until(vehicle: Vehicle, F: Array, reached: Callable[[Array], bool], sway_mps: float = 0.0) -> float | None:
    """Return the time (s) from rest, or from a sway, until ``reached(X)`` under ``F``; None if it takes too long."""
    motion = _StillWaterMotion(vehicle)
    motion.X[3] = sway_mps
    return motion.t_s if motion.until(reached, F) else None


def _quarter_turn(vehicle: Vehicle, starboard: bool) -> float | None:
    """Return the time (s) of a turn by 90 deg from rest until the yaw rate is zero again; None if it takes too long.

    The turning thrusts are reversed once, at the earliest time that still reaches 90 deg: bisection to ``STEP_S``.
    """
    turning = turning_thrusts(vehicle, starboard=starboard)
    reversed_turning = turning_thrusts(vehicle, starboard=not starboard)
    sign = 1.0 if starboard else -1.0

    def turned(switch_s: float) -> tuple[float, float]:
        """Return the angle (rad) and the time (s) until the yaw rate is zero again, if reversed at ``switch_s``."""
        motion = _StillWaterMotion(vehicle)
        motion.until(lambda _: False, turning, longest_s=switch_s - 0.5 * STEP_S)
        motion.until(lambda X: sign * X[5] <= 0.0, reversed_turning)
        return sign * float(motion.X[4]), motion.t_s

    late = _time_until(vehicle, turning, lambda X: sign * X[4] >= 0.5 * math.pi)
    if late is None:
        return None
    early = STEP_S
    while late - early > STEP_S:
        middle = 0.5 * (early + late)
        if turned(middle)[0] >= 0.5 * math.pi:
            late = middle
        else:
            early = middle
    return turned(late)[1]
