"""Linear time-varying (LTV) model of the horizontal motion along the horizon.

State at a knot  X = [n, e, u, v, psi, r, F1, F2] (8,): vehicle/flow.py. Commands U (N+1, 2) at the knots, linear
between them; current C (N+1, 2) at the knots. Along a trajectory Xbar (N+1, 8), Ubar (N+1, 2) and for k = 0 .. N-1:

    X[k+1] = Phi[k] + A[k] (X[k] - Xbar[k]) + B0[k] (U[k] - Ubar[k]) + B1[k] (U[k+1] - Ubar[k+1])

with Phi[k] the exact flow from Xbar[k]. Xbar need not be a solution of the equations of motion: the gap
Phi[k] - Xbar[k+1] goes into the QP (multiple shooting).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ltv_mpc.jit import jit, jit_outlined
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.dynamics import coefficients
from ltv_mpc.vehicle.flow import STATES, advance_stage, lag_table
from ltv_mpc.vehicle.parameters import Coefficients
from ltv_mpc.vehicle.sensitivity import SCRATCH, read, thrust_gains


class Linearisation(NamedTuple):
    """First-order model of the motion along a trajectory of N stages."""

    X: Array  # (N+1, 8) nominal states; X[0] is the state at the plan's start
    U: Array  # (N+1, 2) nominal commands (N); U[0] is the command in force at the plan's start
    C: Array  # (N+1, 2) current, north and east (m/s)
    Phi: Array  # (N, 8) exact flow of each stage from X[k]
    A: Array  # (N, 8, 8) derivative of the flow with respect to X[k]
    B0: Array  # (N, 8, 2) with respect to U[k]
    B1: Array  # (N, 8, 2) with respect to U[k+1]

    @classmethod
    def empty(cls, stages: int) -> Linearisation:
        """Allocate a linearisation; its numbers are undefined.

        Parameters
        ----------
        stages : N.
        """
        K, N, n = stages + 1, stages, STATES
        return cls(*map(np.empty, ((K, n), (K, 2), (K, 2), (N, n), (N, n, n), (N, n, 2), (N, n, 2))))


@jit_outlined
def propagate(X: Array, U: Array, C: Array, t: Array, stage_s: float, p: Coefficients) -> None:
    """Propagate the state along the horizon by the exact flow.

    Parameters
    ----------
    X : (N+1, 8) states; X[0] is given, X[1:] is overwritten.
    U : (N+1, 2) commands at the knots (N).
    C : (N+1, 2) current at the knots, north and east (m/s).
    t : (N+1,) knots in first stages.
    stage_s : length of the first stage.
    p : coefficients of the vehicle.
    """
    h = (t[1] - t[0]) * stage_s
    lag = lag_table(h, p)
    for k in range(U.shape[0] - 1):
        before, h = h, (t[k + 1] - t[k]) * stage_s
        if h != before:
            lag = lag_table(h, p)
        advance_stage(X[k], U[k], U[k + 1], C[k], C[k + 1], h, p, lag, X[k + 1])


def roll_out(X0: Array, U: Array, C: Array, h: Array, p: Coefficients) -> Array:
    """Return the states along a horizon, by the exact flow.

    Parameters
    ----------
    X0 : (8,) state at the first knot.
    U : (N+1, 2) commands at the knots (N).
    C : (N+1, 2) current at the knots, north and east (m/s).
    h : (N,) lengths of the stages (s).
    p : coefficients of the vehicle.

    Returns
    -------
    (N+1, 8) states.
    """
    X = np.empty((len(U), STATES))
    X[0] = X0
    propagate(X, U, C, np.concatenate([[0.0], np.cumsum(h)]), 1.0, p)
    return X


@jit_outlined
def linearise_along(lin: Linearisation, t: Array, stage_s: float, flat: Array) -> None:
    """Linearise the flow along a trajectory.

    Parameters
    ----------
    lin : X, U and C are given; Phi, A, B0 and B1 are overwritten.
    t : (N+1,) knots in first stages.
    stage_s : length of the first stage.
    flat : (21,) coefficients of the vehicle.
    """
    X, U, C, p = lin.X, lin.U, lin.C, coefficients(flat)
    h = (t[1] - t[0]) * stage_s
    lag = lag_table(h, p)
    gain = thrust_gains(lag, p)
    Z = np.empty(SCRATCH)
    for k in range(U.shape[0] - 1):
        before, h = h, (t[k + 1] - t[k]) * stage_s
        if h != before:
            lag = lag_table(h, p)
            gain = thrust_gains(lag, p)
        advance_stage(X[k], U[k], U[k + 1], C[k], C[k + 1], h, p, lag, lin.Phi[k], gain, Z)
        read(Z, lag[-1], lin.A[k], lin.B0[k], lin.B1[k])


def linearise(X: Array, U: Array, C: Array, h: float, p: Coefficients) -> Linearisation:
    """Return the linearisation along a trajectory with equidistant knots.

    Parameters
    ----------
    X : (N+1, 8) states.
    U : (N+1, 2) commands (N).
    C : (N+1, 2) current, north and east (m/s).
    h : length of each stage (s).
    p : coefficients of the vehicle.

    Returns
    -------
    The linearisation; it holds copies of X, U and C.
    """
    lin = Linearisation.empty(len(U) - 1)
    lin.X[...], lin.U[...], lin.C[...] = X, U, C
    linearise_along(lin, np.arange(float(len(U))), h, np.array(p))
    return lin


@jit
def velocity_over_ground(x: Array, c: Array) -> tuple[Array, Array]:
    """Return the velocity over ground and its derivative.

    Parameters
    ----------
    x : (8,) state.
    c : (2,) current, north and east (m/s).

    Returns
    -------
    [n', e'] (2,) in m/s, and its derivative with respect to [u, v, psi] (2, 3).
    """
    cos, sin = np.cos(x[4]), np.sin(x[4])
    velocity, slope = np.empty(2), np.empty((2, 3))
    # n' = cos psi u - sin psi v + c_n,  e' = sin psi u + cos psi v + c_e
    velocity[0] = cos * x[2] - sin * x[3] + c[0]
    velocity[1] = sin * x[2] + cos * x[3] + c[1]
    slope[0, 0], slope[0, 1], slope[0, 2] = cos, -sin, -sin * x[2] - cos * x[3]
    slope[1, 0], slope[1, 1], slope[1, 2] = sin, cos, cos * x[2] - sin * x[3]
    return velocity, slope


def describe_non_finite(lin: Linearisation, target: Array) -> str:
    """Describe which input of a QP is not finite, and from which knot or stage on.

    Parameters
    ----------
    lin : linearisation.
    target : (N+1, 3) as in ``ocp/terms.py``.

    Returns
    -------
    One sentence for the report of a solve.
    """
    names = (*Linearisation._fields, "target")
    for name, values in zip(names, (*lin, target), strict=True):
        finite = np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
        if not finite.all():
            return f"{name} is not finite from index {int(np.argmin(finite))} on"
    return "the QP's numbers are not finite"
