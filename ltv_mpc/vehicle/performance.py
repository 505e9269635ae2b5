"""Performance of a vehicle from its equations of motion: steady states by root finding, the rest by integration.

All figures are for still water and thrusts at their limits, with slew and lag, from rest unless stated. Straight means
F1 a1 = F2 a2 with the largest thrusts that satisfy it. Turning means one thruster full ahead and the other full astern.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec
import numpy as np
from scipy.optimize import brentq, root

from ltv_mpc.messages import Array
from ltv_mpc.vehicle.dynamics import rates
from ltv_mpc.vehicle.flow import STATES, advance_stage
from ltv_mpc.vehicle.parameters import Vehicle

STEP_S = 0.05
MAX_TIME_S = 900.0
MAX_SPEED_MPS = 50.0
"""Largest top speed; a vehicle that still accelerates at this speed counts as without damping."""

STOPPED_SHARE = 0.02
"""Share of the top speed at which the vehicle counts as stopped."""

TIME_CONSTANT_SHARE = 1.0 - math.exp(-1.0)
"""Share of a steady value that is reached after one time constant."""

SWAY_SHARE = 0.1
"""Share of the top speed as initial sway, whose decay is timed."""

SWAY_OVER_SURGE = 0.3
"""Ratio of sway to surge speed in a tight turn."""

STILL = np.zeros(2)


class Performance(msgspec.Struct, frozen=True, kw_only=True):
    """Performance figures; None if a figure does not exist, because there is no damping or no thrust."""

    top_speed_ahead_mps: float | None
    top_speed_astern_mps: float | None
    turning_rate_starboard_radps: float | None
    turning_rate_port_radps: float | None
    turn_90deg_s: float | None  # from rest to rest, to the slower side
    stopping_distance_m: float | None  # from top speed ahead, both thrusters full astern, to 2 % of it
    stopping_time_s: float | None
    strongest_current_bow_mps: float | None  # held with the bow into the current, from any direction after turning
    strongest_current_stern_mps: float | None
    surge_s: float | None  # to 63 % of top speed
    sway_s: float | None  # a tenth of top speed falls to 37 % of itself
    yaw_s: float | None  # to 63 % of the turning rate
    thruster_s: float  # the slower lateral thruster from zero to 63 % of its maximum: slew and lag


def performance(vehicle: Vehicle) -> Performance:
    """Return the performance of a vehicle."""
    ahead, astern = straight_thrusts(vehicle, ahead=True), straight_thrusts(vehicle, ahead=False)
    top, back = top_speed(vehicle, ahead), top_speed(vehicle, astern)
    right, left = (_steady_yaw_rate(vehicle, turning_thrusts(vehicle, starboard=side)) for side in (True, False))
    stop = _stop(vehicle, top, ahead, astern)
    slower_right = right is None or left is None or abs(right) <= abs(left)
    turn = turning_thrusts(vehicle, starboard=slower_right)
    rate = right if slower_right else left
    return Performance(
        top_speed_ahead_mps=top,
        top_speed_astern_mps=back,
        turning_rate_starboard_radps=right,
        turning_rate_port_radps=left,
        turn_90deg_s=None if rate is None else _quarter_turn(vehicle, slower_right),
        stopping_distance_m=None if stop is None else stop[0],
        stopping_time_s=None if stop is None else stop[1],
        strongest_current_bow_mps=top,
        strongest_current_stern_mps=back,
        surge_s=None if not top else _time_until(vehicle, ahead, _reaches_speed(TIME_CONSTANT_SHARE * top)),
        sway_s=None if not top else _sway(vehicle, SWAY_SHARE * top),
        yaw_s=None if not rate else _time_until(vehicle, turn, _reaches_yaw_rate(TIME_CONSTANT_SHARE * abs(rate))),
        thruster_s=_thruster(vehicle),
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
    left, right = vehicle.thrusters[:2]
    return np.array([left.max_N, right.min_N] if starboard else [left.min_N, right.max_N])


def top_speed(vehicle: Vehicle, F: Array) -> float | None:
    """Return |u| (m/s) at which u' = 0; None without damping, 0 without thrust.

    Parameters
    ----------
    vehicle : parameters of the vehicle.
    F : (2,) thrusts without a yaw moment (N).
    """
    p, push = vehicle.coefficients(), float(F.sum())
    if push == 0.0:
        return 0.0
    sign = math.copysign(1.0, push)

    def acceleration(speed: float) -> float:
        """Return the acceleration (m/s2) along the direction of the thrust at a speed (m/s)."""
        return sign * rates(sign * speed, 0.0, 0.0, 0.0, F[0], F[1], 0.0, 0.0, 0.0, 0.0, p)[2]

    return float(brentq(acceleration, 0.0, MAX_SPEED_MPS)) if acceleration(MAX_SPEED_MPS) < 0.0 else None


def fastest_drag_rate_per_s(vehicle: Vehicle) -> float:
    """Return the largest rate (1/s) at which drag changes the motion.

    It is the largest of surge at top speed, sway at ``SWAY_OVER_SURGE`` of it, and yaw at the steady yaw rate.
    """
    p, top = vehicle.coefficients(), top_speed(vehicle, straight_thrusts(vehicle, ahead=True)) or 0.0
    turn = max(
        abs(_steady_yaw_rate(vehicle, turning_thrusts(vehicle, starboard=side)) or 0.0) for side in (True, False)
    )
    return max(
        (p.linear_surge + 2.0 * p.quadratic_surge * top) / p.mass_surge,
        (p.linear_sway + 2.0 * p.quadratic_sway * SWAY_OVER_SURGE * top) / p.mass_sway,
        (p.linear_yaw + 2.0 * p.quadratic_yaw * turn) / p.inertia_yaw,
    )


def _steady_yaw_rate(vehicle: Vehicle, F: Array) -> float | None:
    """Return r (rad/s) with u' = v' = r' = 0 under ``F``, starting from the settled motion; None without damping."""
    p = vehicle.coefficients()
    if p.linear_yaw + p.quadratic_yaw <= 0.0 or p.linear_sway + p.quadratic_sway <= 0.0:
        return None

    def left(w: Array) -> list[float]:
        """Return u', v', r' at w = [u, v, r]."""
        _, _, du, dv, _, dr = rates(w[0], w[1], 0.0, w[2], F[0], F[1], 0.0, 0.0, 0.0, 0.0, p)
        return [du, dv, dr]

    found = root(left, _settled_motion(vehicle, F))
    return float(found.x[2]) if found.success else None


def _settled_motion(vehicle: Vehicle, F: Array) -> Array:
    """Return u, v, r (3,) after a long time under ``F``."""
    run = _StillWaterRun(vehicle)
    before = np.zeros(3)
    while run.t_s < MAX_TIME_S:
        for _ in range(round(5.0 / STEP_S)):
            run.step(F)
        now = run.X[[2, 3, 5]]
        if np.abs(now - before).max() < 1e-4:
            break
        before = now
    return before


class _StillWaterRun:
    """Motion in still water from rest, with commands that change at the slew limit."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._p = vehicle.coefficients()
        self._change = STEP_S * np.array([t.slew_N_per_s for t in vehicle.thrusters[:2]])
        self.X = np.zeros(STATES)
        self.U = np.zeros(2)
        self.t_s = 0.0

    def step(self, F: Array) -> None:
        """Advance by ``STEP_S``, with commands towards ``F`` (2,).

        Parameters
        ----------
        F : (2,) requested thrusts (N).
        """
        U = self.U + np.clip(F - self.U, -self._change, self._change)
        out = np.empty(STATES)
        advance_stage(self.X, self.U, U, STILL, STILL, STEP_S, self._p, out)
        self.X, self.U = out, U
        self.t_s += STEP_S


def _time_until(vehicle: Vehicle, F: Array, there: Callable[[Array], bool]) -> float | None:
    """Return the time (s) under ``F`` until the state satisfies ``there``; None if it never does."""
    run = _StillWaterRun(vehicle)
    while run.t_s < MAX_TIME_S:
        run.step(F)
        if there(run.X):
            return run.t_s
    return None


def _reaches_speed(speed: float) -> Callable[[Array], bool]:
    return lambda X: bool(X[2] >= speed)


def _reaches_yaw_rate(rate: float) -> Callable[[Array], bool]:
    return lambda X: bool(abs(X[5]) >= rate)


def _stop(vehicle: Vehicle, top: float | None, ahead: Array, astern: Array) -> tuple[float, float] | None:
    """Return distance (m) and time (s) from top speed to ``STOPPED_SHARE`` of it, with thrusters full astern."""
    if not top:
        return None
    run = _StillWaterRun(vehicle)
    run.X[2], run.X[6:], run.U = top, ahead, ahead
    while run.X[2] > STOPPED_SHARE * top:
        if run.t_s > MAX_TIME_S:
            return None
        run.step(astern)
    return float(run.X[0]), run.t_s


def _quarter_turn(vehicle: Vehicle, starboard: bool) -> float | None:
    """Return the time (s) of a turn by 90 deg from rest to rest: full thrusts, reversed at the best instant."""
    there, back = turning_thrusts(vehicle, starboard=starboard), turning_thrusts(vehicle, starboard=not starboard)
    sign = 1.0 if starboard else -1.0

    def turned(switch_s: float) -> tuple[float, float]:
        """Return the heading (rad) at which the vehicle is at rest again, and the time (s)."""
        run = _StillWaterRun(vehicle)
        while run.t_s < MAX_TIME_S and (run.t_s < switch_s or sign * run.X[5] > 0.0):
            run.step(there if run.t_s < switch_s else back)
        return sign * float(run.X[4]), run.t_s

    late = _time_until(vehicle, there, lambda X: sign * X[4] >= 0.5 * math.pi)
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


def _sway(vehicle: Vehicle, speed: float) -> float | None:
    run = _StillWaterRun(vehicle)
    run.X[3] = speed
    while run.X[3] > (1.0 - TIME_CONSTANT_SHARE) * speed:
        if run.t_s > MAX_TIME_S:
            return None
        run.step(STILL)
    return run.t_s


def _thruster(vehicle: Vehicle) -> float:
    full = np.array([t.max_N for t in vehicle.thrusters[:2]])
    run = _StillWaterRun(vehicle)
    while run.t_s < MAX_TIME_S and (run.X[6:] < TIME_CONSTANT_SHARE * full).any():
        run.step(full)
    return run.t_s
