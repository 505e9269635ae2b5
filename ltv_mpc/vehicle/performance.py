"""What a vehicle can do, from its own equations of motion: steady states by root finding, the rest by integration.

STILL water, thrusts at their limits, through slew and lag, from rest unless said. Straight means F1 a1 = F2 a2, with as
much of both thrusters as that leaves; turning means one thruster full ahead and the other full astern.
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
LONGEST_S = 900.0
FASTEST_MPS = 50.0
"""A vehicle that nothing brakes below this speed has no top speed."""

SLOW = 0.02
"""Of the top speed: a vehicle this slow has stopped."""

SHARE = 1.0 - math.exp(-1.0)
"""Of a steady value, after one time constant."""

SWAY_SHARE = 0.1
"""Of the top speed: the sway whose decay is timed."""

DRIFT = 0.3
"""Sway over surge in a tight turn."""

STILL = np.zeros(2)


class Performance(msgspec.Struct, frozen=True, kw_only=True):
    """What it can do; None where there is no such thing: nothing brakes it, or nothing drives it."""

    top_speed_ahead_mps: float | None
    top_speed_astern_mps: float | None
    turning_rate_starboard_radps: float | None
    turning_rate_port_radps: float | None
    turn_90deg_s: float | None  # from rest to rest, to the slower side
    stopping_distance_m: float | None  # from top speed ahead, both thrusters full astern, to 2 % of it
    stopping_time_s: float | None
    strongest_current_bow_mps: float | None  # held with the bow into it; from any direction once it has turned
    strongest_current_stern_mps: float | None
    surge_s: float | None  # to 63 % of top speed
    sway_s: float | None  # a tenth of top speed falls to 37 % of itself
    yaw_s: float | None  # to 63 % of the turning rate
    thruster_s: float  # the slower lateral thruster from zero to 63 % of its maximum: slew and lag


def performance(vehicle: Vehicle) -> Performance:
    """All of it."""
    ahead, astern = straight(vehicle, ahead=True), straight(vehicle, ahead=False)
    top, back = top_speed(vehicle, ahead), top_speed(vehicle, astern)
    right, left = (_turning_rate(vehicle, couple(vehicle, starboard=side)) for side in (True, False))
    stop = _stop(vehicle, top, ahead, astern)
    slower_right = right is None or left is None or abs(right) <= abs(left)
    turn = couple(vehicle, starboard=slower_right)
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
        surge_s=None if not top else _until(vehicle, ahead, _going_at(SHARE * top)),
        sway_s=None if not top else _sway(vehicle, SWAY_SHARE * top),
        yaw_s=None if not rate else _until(vehicle, turn, _turning_at(SHARE * abs(rate))),
        thruster_s=_thruster(vehicle),
    )


def straight(vehicle: Vehicle, *, ahead: bool) -> Array:
    """Thrusts (2,) that push the hardest ahead, or astern, without a yaw moment: F1 a1 = F2 a2."""
    port, starboard = vehicle.thrusters[:2]
    most = (port.max_N, starboard.max_N) if ahead else (-port.min_N, -starboard.min_N)
    sign = 1.0 if ahead else -1.0
    if port.arm_m == starboard.arm_m:
        return sign * np.full(2, min(most))
    if port.arm_m == 0.0 or starboard.arm_m == 0.0:  # the one on the centre line drives alone
        return sign * np.array([most[0] * (port.arm_m == 0.0), most[1] * (starboard.arm_m == 0.0)])
    moment = min(most[0] * port.arm_m, most[1] * starboard.arm_m)
    return sign * np.array([moment / port.arm_m, moment / starboard.arm_m])


def couple(vehicle: Vehicle, *, starboard: bool) -> Array:
    """Thrusts (2,) that turn the hardest to starboard, or to port."""
    left, right = vehicle.thrusters[:2]
    return np.array([left.max_N, right.min_N] if starboard else [left.min_N, right.max_N])


def top_speed(vehicle: Vehicle, F: Array) -> float | None:
    """|u| (m/s) at which u' = 0 under straight thrusts ``F``; None where nothing brakes, 0 where nothing pushes."""
    p, push = vehicle.coefficients(), float(F.sum())
    if push == 0.0:
        return 0.0
    sign = math.copysign(1.0, push)

    def acceleration(speed: float) -> float:
        return sign * rates(sign * speed, 0.0, 0.0, 0.0, F[0], F[1], 0.0, 0.0, 0.0, 0.0, p)[2]

    return float(brentq(acceleration, 0.0, FASTEST_MPS)) if acceleration(FASTEST_MPS) < 0.0 else None


def quickest_rate_per_s(vehicle: Vehicle) -> float:
    """The largest rate (1/s) at which drag acts: on surge at top speed, sway at ``DRIFT`` of it, yaw at a full turn."""
    p, top = vehicle.coefficients(), top_speed(vehicle, straight(vehicle, ahead=True)) or 0.0
    turn = max(abs(_turning_rate(vehicle, couple(vehicle, starboard=side)) or 0.0) for side in (True, False))
    return max(
        (p.linear_surge + 2.0 * p.quadratic_surge * top) / p.mass_surge,
        (p.linear_sway + 2.0 * p.quadratic_sway * DRIFT * top) / p.mass_sway,
        (p.linear_yaw + 2.0 * p.quadratic_yaw * turn) / p.inertia_yaw,
    )


def _turning_rate(vehicle: Vehicle, F: Array) -> float | None:
    """r (rad/s) where u' = v' = r' = 0 under ``F``, from where the motion itself ends; None where nothing brakes."""
    p = vehicle.coefficients()
    if p.linear_yaw + p.quadratic_yaw <= 0.0 or p.linear_sway + p.quadratic_sway <= 0.0:
        return None

    def left(w: Array) -> list[float]:
        """u', v', r' at w = [u, v, r]."""
        _, _, du, dv, _, dr = rates(w[0], w[1], 0.0, w[2], F[0], F[1], 0.0, 0.0, 0.0, 0.0, p)
        return [du, dv, dr]

    found = root(left, _settled(vehicle, F))
    return float(found.x[2]) if found.success else None


def _settled(vehicle: Vehicle, F: Array) -> Array:
    """u, v, r (3,) after a long time under ``F``."""
    drive = _Drive(vehicle)
    before = np.zeros(3)
    while drive.t_s < LONGEST_S:
        for _ in range(round(5.0 / STEP_S)):
            drive.step(F)
        now = drive.X[[2, 3, 5]]
        if np.abs(now - before).max() < 1e-4:
            break
        before = now
    return before


class _Drive:
    """The vehicle in still water, from rest, its commands going to what is asked at the slew limit."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._p = vehicle.coefficients()
        self._change = STEP_S * np.array([t.slew_N_per_s for t in vehicle.thrusters[:2]])
        self.X = np.zeros(STATES)
        self.U = np.zeros(2)
        self.t_s = 0.0

    def step(self, F: Array) -> None:
        """``STEP_S`` on, towards commands ``F`` (2,)."""
        U = self.U + np.clip(F - self.U, -self._change, self._change)
        out = np.empty(STATES)
        advance_stage(self.X, self.U, U, STILL, STILL, STEP_S, self._p, out)
        self.X, self.U = out, U
        self.t_s += STEP_S


def _until(vehicle: Vehicle, F: Array, there: Callable[[Array], bool]) -> float | None:
    """Seconds under ``F`` until the state is ``there``."""
    drive = _Drive(vehicle)
    while drive.t_s < LONGEST_S:
        drive.step(F)
        if there(drive.X):
            return drive.t_s
    return None


def _going_at(speed: float) -> Callable[[Array], bool]:
    return lambda X: bool(X[2] >= speed)


def _turning_at(rate: float) -> Callable[[Array], bool]:
    return lambda X: bool(abs(X[5]) >= rate)


def _stop(vehicle: Vehicle, top: float | None, ahead: Array, astern: Array) -> tuple[float, float] | None:
    """Metres and seconds from top speed to ``SLOW`` of it, thrusters full astern."""
    if not top:
        return None
    drive = _Drive(vehicle)
    drive.X[2], drive.X[6:], drive.U = top, ahead, ahead
    while drive.X[2] > SLOW * top:
        if drive.t_s > LONGEST_S:
            return None
        drive.step(astern)
    return float(drive.X[0]), drive.t_s


def _quarter_turn(vehicle: Vehicle, starboard: bool) -> float | None:
    """Seconds from rest to rest over 90 deg: full couple, and the opposite one from the best instant on."""
    there, back = couple(vehicle, starboard=starboard), couple(vehicle, starboard=not starboard)
    sign = 1.0 if starboard else -1.0

    def turned(switch_s: float) -> tuple[float, float]:
        """Heading (rad) at which it stands still again, and when."""
        drive = _Drive(vehicle)
        while drive.t_s < LONGEST_S and (drive.t_s < switch_s or sign * drive.X[5] > 0.0):
            drive.step(there if drive.t_s < switch_s else back)
        return sign * float(drive.X[4]), drive.t_s

    late = _until(vehicle, there, lambda X: sign * X[4] >= 0.5 * math.pi)
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
    drive = _Drive(vehicle)
    drive.X[3] = speed
    while drive.X[3] > (1.0 - SHARE) * speed:
        if drive.t_s > LONGEST_S:
            return None
        drive.step(STILL)
    return drive.t_s


def _thruster(vehicle: Vehicle) -> float:
    most = np.array([t.max_N for t in vehicle.thrusters[:2]])
    drive = _Drive(vehicle)
    while drive.t_s < LONGEST_S and (drive.X[6:] < SHARE * most).any():
        drive.step(most)
    return drive.t_s
