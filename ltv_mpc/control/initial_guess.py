"""Initial guess from a steering law: the trajectory to linearise along if no previous plan is as good.

At rest in the water, neither a turn nor a sideways force moves the vehicle to first order. So a drifting plan is a
stationary point of the linearised problem, however far it drifts. The way out is to turn first and to push afterwards;
this law does that, roughly:

    w = (ref - p) / T_p + ref' - c      wanted velocity through the water (m/s, NED), limited to the top speed
    psi_w = direction of w, or its opposite if the vehicle is to go astern
    N = I_z (w0^2 (psi_w - psi) - 2 w0 r),   X = M_x (u_w - u) / T_u + drag at u_w
    u_w = w . e(psi), within the limits of surge

Yaw moment N and surge force X are distributed to port and starboard, inside box and slew. The QP refines the result.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.control.ocp.limits import command_bounds
from ltv_mpc.control.problem_data import STAGE_S, Constants, stage_length
from ltv_mpc.jit import copy_to, jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.dynamics import coefficients
from ltv_mpc.vehicle.flow import STATES, advance_stage, lag_table
from ltv_mpc.vehicle.resistance import steady_speed

APPROACH_S = 4.0
"""T_p of the paper's vehicle: an error is to vanish in about the length of a horizon. This constant and the next two
are scaled to another vehicle by ``Constants.time_ratio``.
"""
SURGE_S = 1.0
"""T_u: time constant of the surge motion at half speed."""
TURN_RADPS = 0.5
"""w0: natural frequency of the heading law."""
MAX_TURN_PER_STAGE = 0.5
"""Largest w0 times a stage's length (rad): commands are linear between knots, so they cannot follow a faster law."""


@jit
def steering_guess(o: Constants, start: Array, target: Array, astern: bool, C: Array, X: Array, U: Array) -> None:
    """Simulate the steering law.

    Parameters
    ----------
    o, start, target, C : as in ``nominal.py``.
    astern : True to steer with the stern ahead.
    X, U : are overwritten.
    """
    p, N = coefficients(o.p), len(target) - 1
    copy_to(X[0], start[:STATES])
    copy_to(U[0], start[STATES:])
    fastest = steady_speed(o.high[0] + o.high[1], p.linear_surge, p.quadratic_surge)
    sign = -1.0 if astern else 1.0
    h = stage_length(o.t, 1) * STAGE_S
    lag = lag_table(h, p)
    for k in range(N):
        x = X[k]
        g = stage_length(o.t, k + 1)
        before, h = h, g * STAGE_S
        if h != before:
            lag = lag_table(h, p)
        # ref' over the stage: the target at knot 0 is not known; with one stage it is the velocity wanted at the end
        vn, ve = target[N, 0], target[N, 1]
        if N > 1:
            end = max(k, 1)
            length = stage_length(o.t, end + 1) * STAGE_S
            vn, ve = (target[end, 0] - target[end - 1, 0]) / length, (target[end, 1] - target[end - 1, 1]) / length
        # w = (ref - p) / T_p + ref' - c, limited
        wn = (target[k, 0] - vn * h - x[0]) / (APPROACH_S * o.time_ratio) + vn - C[k, 0]
        we = (target[k, 1] - ve * h - x[1]) / (APPROACH_S * o.time_ratio) + ve - C[k, 1]
        size = np.sqrt(wn * wn + we * we)
        if size > fastest:
            wn, we = wn * fastest / size, we * fastest / size
        turn = np.arctan2(sign * we, sign * wn) - x[4]
        turn -= 2.0 * np.pi * np.round(turn / (2.0 * np.pi))
        wanted = min(max(wn * np.cos(x[4]) + we * np.sin(x[4]), o.low_state[0]), o.high_state[0])
        w0 = min(TURN_RADPS / o.time_ratio, MAX_TURN_PER_STAGE / h)
        yaw = p.inertia_yaw * (w0 * w0 * turn - 2.0 * w0 * x[5])
        surge = (
            p.mass_surge * (wanted - x[2]) / max(SURGE_S * o.time_ratio, h)
            + (p.linear_surge + p.quadratic_surge * abs(wanted)) * wanted
        )
        # F1 + F2 = X, F1 a1 - F2 a2 = N
        arms = p.arm_port + p.arm_starboard
        F = ((surge * p.arm_starboard + yaw) / arms, (surge * p.arm_port - yaw) / arms)
        for i in range(2):
            low, high = command_bounds(U[0, i], o.t[k + 1] * o.max_change[i], o.low[i], o.high[i])
            U[k + 1, i] = min(max(F[i], low, U[k, i] - g * o.max_change[i]), high, U[k, i] + g * o.max_change[i])
        advance_stage(X[k], U[k], U[k + 1], C[k], C[k + 1], h, p, lag, X[k + 1])
