"""Stability of the closed loop with a given horizon, from its poles at station keeping.

The controller applies the first stage of a plan and then plans again: a feedback that need not be stable. The optimal
plan of a finite horizon can postpone beyond the horizon what has to be done within it. About a steady state, with no
limit active, the feedback is linear. State z = [X; U] (10,) is the state X of vehicle/flow.py and the commands in
force, over stages k = 1 .. N of length g_k:

    z+ = A_k z + B_k U+,  A_k = [[A, B0], [0, 0]],  B_k = [B1; I]                                     linearisation.py
    J  = sum g_k (w |p|^2 + r |U+ / F|^2) + s / g_k |(U+ - U) / F|^2 + w_N |p_N|^2 + m |p'_N|^2       cost.py

The Riccati recursion from the last stage to the first ends with U+ = - K z, and the eigenvalues of A_1 - B_1 K are the
poles. A hull without linear sway drag keeps a small sway velocity for ever, whatever the thrusters do: a pole at 1,
which does not grow.

The station is held with the bow into a current; with the stern into it the poles are the same.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.control.config import STAGE_NS, ResolvedConfig
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.linearisation import linearise, velocity_over_ground
from ltv_mpc.control.scaling import characteristic_scales
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import STATES
from ltv_mpc.vehicle.parameters import Coefficients, Vehicle

CURRENT_RATIOS = (0.1, 0.2, 0.35, 0.5)
"""Currents in which the poles are checked, over the vehicle's top speed."""

POLE_TOLERANCE = 1e-6
"""Rounding error that a pole at 1 may have."""

AUGMENTED_STATES = STATES + 2
"""Size of z = [X; U]."""


def is_stable(vehicle: Vehicle, config: ResolvedConfig) -> bool:
    """Return True if no pole grows in any of ``CURRENT_RATIOS``.

    Parameters
    ----------
    vehicle : vehicle to be controlled.
    config : weights and horizon of the controller.

    Returns
    -------
    True if the largest pole is at most 1.
    """
    return all(spectral_radius(vehicle, config, share) <= 1.0 + POLE_TOLERANCE for share in CURRENT_RATIOS)


def spectral_radius(vehicle: Vehicle, config: ResolvedConfig, share: float) -> float:
    """Return the magnitude of the largest pole, per cycle.

    Parameters
    ----------
    vehicle, config : as in ``is_stable``.
    share : current over the vehicle's top speed.

    Returns
    -------
    Spectral radius of A_1 - B_1 K; infinite if the stages are too long for the vehicle's motion to be integrated.
    """
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            A, B, K = closed_loop(vehicle, config, share)
            return float(np.abs(np.linalg.eigvals(A - B @ K)).max())
    except np.linalg.LinAlgError:  # drag that is faster than a step makes A_k overflow
        return math.inf


def closed_loop(vehicle: Vehicle, config: ResolvedConfig, share: float) -> tuple[Array, Array, Array]:
    """Linearise the closed loop, heading north into a current to the south.

    Parameters
    ----------
    vehicle, config : as in ``is_stable``.
    share : current over the vehicle's top speed.

    Returns
    -------
    A_1 (10, 10), B_1 (10, 2) and K (2, 10).
    """
    p, weights = vehicle.coefficients(), config.weights
    X, C = steady_state(vehicle, share)
    stage_s = STAGE_NS * 1e-9
    scale = HorizonLimits.from_vehicle(vehicle, stage_s).thrust_scale
    thrust, change = np.diag(weights.thrust / scale**2), np.diag(weights.thrust_change / scale**2)
    position = np.diag([1.0, 1.0, *np.zeros(AUGMENTED_STATES - 2)])
    commands = np.hstack([np.zeros((2, STATES)), np.eye(2)])  # of z
    velocity = np.zeros((2, AUGMENTED_STATES))
    velocity[:, 2:5] = velocity_over_ground(X, C)[1]

    P = weights.terminal_position_per_m2 * position + weights.terminal_velocity_s2_per_m2 * velocity.T @ velocity
    A = B = K = np.empty(0)
    for g in np.diff(config.knots)[::-1]:
        A, B = _stage(X, C, g * stage_s, p)
        P = P + g * weights.position_per_m2 * position
        S = change / g
        both = B.T @ P @ A - S @ commands
        K = np.linalg.solve(g * thrust + S + B.T @ P @ B, both)
        P = A.T @ P @ A + commands.T @ S @ commands - both.T @ K
        P = 0.5 * (P + P.T)
    return A, B, K


def steady_state(vehicle: Vehicle, share: float) -> tuple[Array, Array]:
    """Return the steady state of station keeping, heading north into a current to the south.

    Parameters
    ----------
    vehicle : vehicle to be controlled.
    share : current over the vehicle's top speed.

    Returns
    -------
    State X (8,) and current C (2,), north and east (m/s).
    """
    p, speed = vehicle.coefficients(), share * characteristic_scales(vehicle).speed_mps
    push = (p.linear_surge + p.quadratic_surge * speed) * speed
    port, starboard = p.arm_starboard, p.arm_port  # no moment
    X = np.array([0.0, 0.0, speed, 0.0, 0.0, 0.0, port, starboard])
    X[6:] *= push / (port + starboard)
    return X, np.array([-speed, 0.0])


def _stage(X: Array, C: Array, h: float, p: Coefficients) -> tuple[Array, Array]:
    """Return A (10, 10) and B (10, 2) of a stage of h seconds."""
    lin = linearise(np.tile(X, (2, 1)), np.tile(X[6:], (2, 1)), np.tile(C, (2, 1)), h, p)
    A = np.zeros((AUGMENTED_STATES, AUGMENTED_STATES))
    A[:STATES, :STATES], A[:STATES, STATES:] = lin.A[0], lin.B0[0]
    return A, np.vstack([lin.B1[0], np.eye(2)])
