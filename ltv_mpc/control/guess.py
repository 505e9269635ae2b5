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
from ltv_mpc.control.config import Weights
from ltv_mpc.control.horizon import velocity_over_ground
from ltv_mpc.control.limits import ThrustLimits
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
def steer(
    X0: Array,
    U0: Array,
    C: Array,
    ref: Array,
    h: float,
    low: Array,
    high: Array,
    change: Array,
    astern: bool,
    p: Coefficients,
) -> tuple[Array, Array]:
    """States (N+1, 8) and commands (N+1, 2) under the law.

    C (N+1, 2) current and ref (N, 2) position wanted, at the knots; low, high (N, 2) box; change (2,) between knots.
    """
    N = ref.shape[0]
    X, U = np.empty((N + 1, STATES)), np.empty((N + 1, 2))
    X[0], U[0] = X0, U0
    fastest = speed_at(high[0, 0] + high[0, 1], p)
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
        F1 = (surge * p.arm_starboard + yaw) / arms
        F2 = (surge * p.arm_port - yaw) / arms
        U[k + 1, 0] = min(max(F1, low[k, 0], U[k, 0] - change[0]), high[k, 0], U[k, 0] + change[0])
        U[k + 1, 1] = min(max(F2, low[k, 1], U[k, 1] - change[1]), high[k, 1], U[k, 1] + change[1])
        advance_stage(X[k], U[k], U[k + 1], C[k], C[k + 1], h, p, X[k + 1])
    return X, U


def cost(X: Array, U: Array, C: Array, reference: Array, limits: ThrustLimits, weights: Weights) -> float:
    """What a trajectory X (N+1, 8), U (N+1, 2) in a current C (N+1, 2) costs against ref (N, 2): as in the QP."""
    velocity, _ = velocity_over_ground(X[-1], C[-1])
    square = ((X[1:, :2] - reference) ** 2).sum(axis=1)
    u = U / limits.scale
    return float(
        weights.position_per_m2 * square.sum()
        + weights.terminal_position_per_m2 * square[-1]
        + weights.terminal_velocity_s2_per_m2 * (velocity**2).sum()
        + weights.thrust * (u[1:] ** 2).sum()
        + weights.thrust_change * (np.diff(u, axis=0) ** 2).sum()
    )
