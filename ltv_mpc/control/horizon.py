"""The horizon: knots 0.3 s apart, the motion along them, and its linearisation (LTV: linear time-varying).

State at a knot  X = [n, e, u, v, psi, r, F1, F2] (8,): flow.py. Commands U (N+1, 2) at the knots, linear between them;
current C (N+1, 2) at the knots. Along a trajectory Xbar (N+1, 8), Ubar (N+1, 2) and for k = 0 .. N-1:

    X[k+1] = Phi[k] + A[k] (X[k] - Xbar[k]) + B0[k] (U[k] - Ubar[k]) + B1[k] (U[k+1] - Ubar[k+1])

with Phi[k] the exact flow from Xbar[k]. Xbar need not be a solution of the equations of motion: the gap
Phi[k] - Xbar[k+1] goes into the QP (multiple shooting).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ltv_mpc.compiled import kernel
from ltv_mpc.signals import Array
from ltv_mpc.vehicle.flow import STATES, advance_stage
from ltv_mpc.vehicle.parameters import Coefficients
from ltv_mpc.vehicle.sensitivity import SCRATCH, lag_tables, linearise_stage


class Linearisation(NamedTuple):
    """The motion to first order along a trajectory of N stages."""

    X: Array  # (N+1, 8) the trajectory; X[0] is the state at the plan's start
    U: Array  # (N+1, 2) its commands; U[0] is the command in force at the plan's start
    C: Array  # (N+1, 2) current, north and east
    Phi: Array  # (N, 8) exact flow of each stage from X[k]
    A: Array  # (N, 8, 8)
    B0: Array  # (N, 8, 2) with respect to U[k]
    B1: Array  # (N, 8, 2) with respect to U[k+1]


@kernel
def roll_out(X0: Array, U: Array, C: Array, h: Array, p: Coefficients) -> Array:
    """States (M+1, 8) from X0 (8,) under commands U (M+1, 2) in a current C (M+1, 2); stage k lasts h[k] seconds."""
    X = np.empty((U.shape[0], STATES))
    X[0] = X0
    for k in range(U.shape[0] - 1):
        advance_stage(X[k], U[k], U[k + 1], C[k], C[k + 1], h[k], p, X[k + 1])
    return X


@kernel
def _linearise(
    X: Array, U: Array, C: Array, h: float, p: Coefficients, Phi: Array, A: Array, B0: Array, B1: Array
) -> None:
    lag, gain = lag_tables(h, p)
    Z = np.empty(SCRATCH)
    for k in range(U.shape[0] - 1):
        linearise_stage(X[k], U[k], U[k + 1], C[k], C[k + 1], h, p, lag, gain, Z, Phi[k], A[k], B0[k], B1[k])


def linearise(X: Array, U: Array, C: Array, h: float, p: Coefficients) -> Linearisation:
    """The motion to first order along X (N+1, 8), U (N+1, 2), in a current C (N+1, 2); every stage lasts h seconds."""
    N = len(U) - 1
    Phi, A = np.empty((N, STATES)), np.empty((N, STATES, STATES))
    B0, B1 = np.empty((N, STATES, 2)), np.empty((N, STATES, 2))
    _linearise(X, U, C, h, p, Phi, A, B0, B1)
    return Linearisation(X, U, C, Phi, A, B0, B1)


def velocity_over_ground(x: Array, c: Array) -> tuple[Array, Array]:
    """[n', e'] (2,) at a state x (8,) in a current c (2,), and its derivative with respect to [u, v, psi], (2, 3)."""
    cos, sin = np.cos(x[4]), np.sin(x[4])
    # n' = cos psi u - sin psi v + c_n,  e' = sin psi u + cos psi v + c_e
    velocity = np.array([cos * x[2] - sin * x[3] + c[0], sin * x[2] + cos * x[3] + c[1]])
    slope = np.array([[cos, -sin, -sin * x[2] - cos * x[3]], [sin, cos, cos * x[2] - sin * x[3]]])
    return velocity, slope
