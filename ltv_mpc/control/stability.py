"""Whether the loop that a horizon closes is stable: its poles where a place is held.

A plan of which the first stage is flown before it is made anew is a feedback, and nothing makes it a stable one: the
best plan of a finite horizon may leave beyond it what has to be done within. About a steady state, with no limit
active, it is linear. State z = [X; U] (10,), the state X of flow.py and the commands in force, over stages k = 1 .. N
of length g_k:

    z+ = A_k z + B_k U+,  A_k = [[A, B0], [0, 0]],  B_k = [B1; I]                                     linearisation.py
    J  = sum g_k (w |p|^2 + r |U+ / F|^2) + s / g_k |(U+ - U) / F|^2 + w_N |p_N|^2 + m |p'_N|^2       cost.py

The Riccati recursion from the last stage to the first ends with its U+ = - K z, and A_1 - B_1 K has the poles. A hull
without linear drag to the side keeps a small sideways drift for ever, whatever is done: a pole at 1, which does not
grow.

A place is held with the bow into a current; with the stern into it the poles are the same.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.control.config import STAGE_NS, ControllerConfig
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.linearisation import linearise, velocity_over_ground
from ltv_mpc.control.scaling import characteristic_scales, default_weights
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import STATES
from ltv_mpc.vehicle.parameters import Coefficients, Vehicle

CURRENT_RATIOS = (0.1, 0.2, 0.35, 0.5)
"""Currents, over top speed."""

POLE_TOLERANCE = 1e-6
"""Of a pole at 1."""

AUGMENTED_STATES = STATES + 2


def is_stable(vehicle: Vehicle, horizon_s: float) -> bool:
    """In all of ``CURRENT_RATIOS``, with the weights that follow from the vehicle."""
    return all(spectral_radius(vehicle, horizon_s, share) <= 1.0 + POLE_TOLERANCE for share in CURRENT_RATIOS)


def spectral_radius(vehicle: Vehicle, horizon_s: float, share: float) -> float:
    """Size of the largest pole, per cycle, in a current of this share of top speed."""
    A, B, K = closed_loop(vehicle, horizon_s, share)
    return float(np.abs(np.linalg.eigvals(A - B @ K)).max())


def closed_loop(vehicle: Vehicle, horizon_s: float, share: float) -> tuple[Array, Array, Array]:
    """A_1 (10, 10), B_1 (10, 2) and K (2, 10), heading north into a current to the south."""
    p, weights = vehicle.coefficients(), default_weights(vehicle)
    X, C = steady_state(vehicle, share)
    stage_s = STAGE_NS * 1e-9
    scale = HorizonLimits.from_vehicle(vehicle, stage_s).scale
    thrust, change = np.diag(weights.thrust / scale**2), np.diag(weights.thrust_change / scale**2)
    position = np.diag([1.0, 1.0, *np.zeros(AUGMENTED_STATES - 2)])
    commands = np.hstack([np.zeros((2, STATES)), np.eye(2)])  # of z
    velocity = np.zeros((2, AUGMENTED_STATES))
    velocity[:, 2:5] = velocity_over_ground(X, C)[1]

    P = weights.terminal_position_per_m2 * position + weights.terminal_velocity_s2_per_m2 * velocity.T @ velocity
    A = B = K = np.empty(0)
    for g in np.diff(ControllerConfig(horizon_s=horizon_s).knots)[::-1]:
        A, B = _stage(X, C, g * stage_s, p)
        P = P + g * weights.position_per_m2 * position
        S = change / g
        both = B.T @ P @ A - S @ commands
        K = np.linalg.solve(g * thrust + S + B.T @ P @ B, both)
        P = A.T @ P @ A + commands.T @ S @ commands - both.T @ K
        P = 0.5 * (P + P.T)
    return A, B, K


def steady_state(vehicle: Vehicle, share: float) -> tuple[Array, Array]:
    """X (8,) of the place and C (2,): heading north into a current of this share of top speed."""
    p, speed = vehicle.coefficients(), share * characteristic_scales(vehicle).speed_mps
    push = (p.linear_surge + p.quadratic_surge * speed) * speed
    port, starboard = p.arm_starboard, p.arm_port  # no moment
    X = np.array([0.0, 0.0, speed, 0.0, 0.0, 0.0, port, starboard])
    X[6:] *= push / (port + starboard)
    return X, np.array([-speed, 0.0])


def _stage(X: Array, C: Array, h: float, p: Coefficients) -> tuple[Array, Array]:
    """A (10, 10) and B (10, 2) of a stage of h seconds."""
    lin = linearise(np.tile(X, (2, 1)), np.tile(X[6:], (2, 1)), np.tile(C, (2, 1)), h, p)
    A = np.zeros((AUGMENTED_STATES, AUGMENTED_STATES))
    A[:STATES, :STATES], A[:STATES, STATES:] = lin.A[0], lin.B0[0]
    return A, np.vstack([lin.B1[0], np.eye(2)])
