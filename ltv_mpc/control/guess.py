"""A plan from a steering law: where to linearise when the previous plan is not there, or no longer good.

At rest in the water neither a turn nor a sideways force moves the vehicle to first order, so a plan that drifts is a
stationary point of the linearised problem however far it drifts. Turning first and pushing then is what gets out of it,
and this law does that, crudely:

    w = (ref - p) / T_p - c             water velocity wanted (m/s, NED), limited to what the thrusters can hold
    psi_w = direction of w, or its opposite if the vehicle shall go astern
    N = I_z (w0^2 (psi_w - psi) - 2 w0 r),   X = M_x (w . e(psi) - u) / T_u + drag at w . e(psi)

shared between port and starboard, inside box and slew. The QP does the rest.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.compiled import kernel
from ltv_mpc.control.constants import Constants
from ltv_mpc.control.limits import bounds
from ltv_mpc.signals import Array
from ltv_mpc.vehicle.flow import STATES, advance_stage
from ltv_mpc.vehicle.parameters import Coefficients

APPROACH_S = 4.0
"""T_p: an error is to be gone in about the length of a horizon."""
SURGE_S = 1.0
"""T_u: the surge's own time constant at half speed."""
TURN_RADPS = 0.5
"""w0 of the turn."""


@kernel
def speed_at(push: float, p: Coefficients) -> float:
    """Surge speed (m/s) that a steady push (N) holds: push = (d_x + D_x u) u."""
    if p.quadratic_surge <= 0.0:
        return push / max(p.linear_surge, 1e-9)
    root = math.sqrt(p.linear_surge**2 + 4.0 * p.quadratic_surge * push)
    return (root - p.linear_surge) / (2.0 * p.quadratic_surge)


@kernel
def steer(X0: Array, U0: Array, C: Array, ref: Array, astern: bool, c: Constants) -> tuple[Array, Array]:
    """States (N+1, 8) and commands (N+1, 2) under the law.

    C (N+1, 2) current and ref (N, 2) position wanted, at the knots.
    """
    N, h, p, o = ref.shape[0], c.stage_s, c.p, c.objective
    X, U = np.empty((N + 1, STATES)), np.empty((N + 1, 2))
    X[0], U[0] = X0, U0
    fastest = speed_at(o.high[0] + o.high[1], p)
    sign = -1.0 if astern else 1.0
    for k in range(N):
        x = X[k]
        # w = (ref - p) / T_p - c, limited
        wn = (ref[k, 0] - x[0]) / APPROACH_S - C[k, 0]
        we = (ref[k, 1] - x[1]) / APPROACH_S - C[k, 1]
        size = np.sqrt(wn * wn + we * we)
        if size > fastest:
            wn, we = wn * fastest / size, we * fastest / size
        turn = np.arctan2(sign * we, sign * wn) - x[4]
        turn -= 2.0 * np.pi * np.round(turn / (2.0 * np.pi))
        wanted = wn * np.cos(x[4]) + we * np.sin(x[4])
        yaw = p.inertia_yaw * (TURN_RADPS**2 * turn - 2.0 * TURN_RADPS * x[5])
        surge = p.mass_surge * (wanted - x[2]) / SURGE_S + (p.linear_surge + p.quadratic_surge * abs(wanted)) * wanted
        # F1 + F2 = X, F1 a1 - F2 a2 = N
        arms = p.arm_port + p.arm_starboard
        F = ((surge * p.arm_starboard + yaw) / arms, (surge * p.arm_port - yaw) / arms)
        for i in range(2):
            low, high = bounds(U0[i], k + 1, o.low[i], o.high[i], o.change[i])
            U[k + 1, i] = min(max(F[i], low, U[k, i] - o.change[i]), high, U[k, i] + o.change[i])
        advance_stage(X[k], U[k], U[k + 1], C[k], C[k + 1], h, p, X[k + 1])
    return X, U
