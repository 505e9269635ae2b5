"""A plan from a steering law: where to linearise when the previous plan is not there, or no longer good.

At rest in the water neither a turn nor a sideways force moves the vehicle to first order, so a plan that drifts is a
stationary point of the linearised problem however far it drifts. Turning first and pushing then is what gets out of it,
and this law does that, crudely:

    w = (ref - p) / T_p + ref' - c      water velocity wanted (m/s, NED), limited to what the thrusters can hold
    psi_w = direction of w, or its opposite if the vehicle shall go astern
    N = I_z (w0^2 (psi_w - psi) - 2 w0 r),   X = M_x (w . e(psi) - u) / T_u + drag at w . e(psi)

shared between port and starboard, inside box and slew. The QP does the rest.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.control.cost import stage_cost, terminal_cost
from ltv_mpc.control.horizon_limits import command_bounds
from ltv_mpc.control.problem_data import Constants, Objective, stage_length
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import advance_by, lag_table
from ltv_mpc.vehicle.resistance import steady_speed

APPROACH_S = 4.0
"""T_p: an error is to be gone in about the length of a horizon. Like the other two of the paper's vehicle: another's
go with its own time, ``Constants.time_ratio``.
"""
SURGE_S = 1.0
"""T_u: the surge's own time constant at half speed."""
TURN_RADPS = 0.5
"""w0 of the turn."""
TURN_A_STAGE = 0.5
"""Most that w0 is of a stage's length: commands between two knots are a line."""


@jit
def _wanted_velocity(target: Array, k: int, o: Objective, stage_s: float) -> tuple[float, float]:
    """ref' over the stage from knot k: between the positions at its ends; before the first of them is none."""
    N = len(target) - 1
    if N == 1:
        return target[1, 0], target[1, 1]
    end = max(k, 1)
    h = stage_length(o, end + 1) * stage_s
    return (target[end, 0] - target[end - 1, 0]) / h, (target[end, 1] - target[end - 1, 1]) / h


@jit
def steering_guess(X: Array, U: Array, C: Array, target: Array, astern: bool, most: float, c: Constants) -> float:
    """X[1:] (N, 8) and U[1:] (N, 2) under the law from X[0] and U[0], and what that costs; infinity as soon as it costs
    more than ``most``: the rest is then left as it was.

    C (N+1, 2) current at the knots; ``target`` (N+1, 2) as in ``Solver``.
    """
    N, p, o = len(target) - 1, c.p, c.objective
    fastest = steady_speed(o.high[0] + o.high[1], p.linear_surge, p.quadratic_surge)
    sign = -1.0 if astern else 1.0
    total, h = 0.0, stage_length(o, 1) * c.stage_s
    lag = lag_table(h, p)
    for k in range(N):
        x = X[k]
        g = stage_length(o, k + 1)
        before, h = h, g * c.stage_s
        if h != before:
            lag = lag_table(h, p)
        # w = (ref - p) / T_p + ref' - c, limited
        vn, ve = _wanted_velocity(target, k, o, c.stage_s)
        wn = (target[k, 0] - vn * h - x[0]) / (APPROACH_S * c.time_ratio) + vn - C[k, 0]
        we = (target[k, 1] - ve * h - x[1]) / (APPROACH_S * c.time_ratio) + ve - C[k, 1]
        size = np.sqrt(wn * wn + we * we)
        if size > fastest:
            wn, we = wn * fastest / size, we * fastest / size
        turn = np.arctan2(sign * we, sign * wn) - x[4]
        turn -= 2.0 * np.pi * np.round(turn / (2.0 * np.pi))
        wanted = wn * np.cos(x[4]) + we * np.sin(x[4])
        w0 = min(TURN_RADPS / c.time_ratio, TURN_A_STAGE / h)
        yaw = p.inertia_yaw * (w0 * w0 * turn - 2.0 * w0 * x[5])
        surge = (
            p.mass_surge * (wanted - x[2]) / max(SURGE_S * c.time_ratio, h)
            + (p.linear_surge + p.quadratic_surge * abs(wanted)) * wanted
        )
        # F1 + F2 = X, F1 a1 - F2 a2 = N
        arms = p.arm_port + p.arm_starboard
        F = ((surge * p.arm_starboard + yaw) / arms, (surge * p.arm_port - yaw) / arms)
        for i in range(2):
            low, high = command_bounds(U[0, i], o.t[k + 1] * o.max_change[i], o.low[i], o.high[i])
            U[k + 1, i] = min(max(F[i], low, U[k, i] - g * o.max_change[i]), high, U[k, i] + g * o.max_change[i])
        advance_by(X[k], U[k], U[k + 1], C[k], C[k + 1], h, p, lag, X[k + 1])
        total += stage_cost(X, U, target, k + 1, o)
        if total > most:
            return np.inf
    return total + terminal_cost(X, C, target, o)
