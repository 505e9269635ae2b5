"""Problem of one cycle: the motion along the nominal trajectory, the terms of the cost and the limits.

State and input of the problem (ocp/problem.py) are deviations from the nominal trajectory, over their scales:

    x = [n, e, u, v, psi, r, F1, F2, U1, U2]    the vehicle's state, delivered thrusts and commands at a knot
    u = [change of U1, change of U2]            from that knot to the next

so that box and slew are bounds of a state and of an input. The commands are linear between the knots. With the
derivatives A, B0, B1 of the flow (linearisation.py) by state, commands at the begin and at the end of a stage,

    dX_(k+1) = A dX_k + (B0 + B1) dU_k + B1 (change of dU) + Phi_k - Xbar_(k+1),    dU_(k+1) = dU_k + (change of dU)

The gap Phi_k - Xbar_(k+1) is 0 along a solution of the equations of motion.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.ocp import limits, terms
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import CHANGES, COMMANDS, Constants
from ltv_mpc.control.scaling import state_scale, thrust_scale
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import STATES
from ltv_mpc.vehicle.parameters import Vehicle

SIZE = CHANGES + 2
"""Numbers of a stage: 10 states and 2 inputs."""


def empty(stages: int, rows: int = 0) -> Problem:
    """Return a problem of a cycle without numbers.

    Parameters
    ----------
    stages : N.
    rows : of further limits at a knot, behind those of ``ocp/limits.py``.
    """
    return Problem.empty(stages, CHANGES, 2, limits.ROWS + rows)


@jit
def fill(o: Constants, lin: Linearisation, target: Array, p: Problem) -> None:
    """Fill in the motion, all terms of the cost and the limits that have rows at every knot.

    Parameters
    ----------
    o : constants of the controller.
    lin : the motion along the nominal trajectory.
    target : (N+1, 3) as in ``ocp/terms.py``.
    p : is overwritten; further rows are empty.
    """
    for part in (p.F, p.H, p.G):
        part[:, :, :] = 0.0
    p.h[:, :] = 0.0
    for i in range(p.low.size):
        p.low.flat[i] = -np.inf
        p.high.flat[i] = p.penalty.flat[i] = np.inf
    F, f, X, Phi, A, B0, B1 = p.F, p.f, lin.X, lin.Phi, lin.A, lin.B0, lin.B1
    S = np.empty(SIZE)
    for i in range(SIZE):
        S[i] = o.state_scale[i] if i < 6 else o.thrust_scale[i % 2]
    for k in range(len(Phi)):
        for i in range(STATES):
            over = 1.0 / S[i]
            f[k, i] = (Phi[k, i] - X[k + 1, i]) * over
            for j in range(STATES):
                F[k, i, j] = A[k, i, j] * S[j] * over
            for j in range(2):
                F[k, i, COMMANDS + j] = (B0[k, i, j] + B1[k, i, j]) * S[COMMANDS + j] * over
                F[k, i, CHANGES + j] = B1[k, i, j] * S[CHANGES + j] * over
        for j in range(2):
            F[k, COMMANDS + j, COMMANDS + j] = F[k, COMMANDS + j, CHANGES + j] = 1.0
    terms.cost(X, lin.U, lin.C, target, o, p)
    limits.add(p, lin, target, o)


@jit
def cost(X: Array, U: Array, C: Array, target: Array, o: Constants) -> float:
    """Return the cost of a trajectory along the exact flow, without that of fence and corridor.

    Parameters
    ----------
    X, U, C, target, o : as in ``ocp/terms.py``.
    """
    return terms.cost(X, U, C, target, o, None) + limits.cost(X, target, o)


def scales(vehicle: Vehicle) -> Array:
    """Return what is 1 in each number of a stage (12,)."""
    return np.concatenate([state_scale(vehicle), np.tile(thrust_scale(vehicle), 3)])


def problem_along(lin: Linearisation, target: Array, o: Constants) -> Problem:
    """Return a new problem along a motion, without fence and further terms.

    Parameters
    ----------
    lin : the motion.
    target : (N+1, 3) as in ``ocp/terms.py``; the headings may be left out where the weights have none.
    o : constants of the controller.
    """
    problem, wanted = empty(len(lin.Phi)), np.zeros((len(target), 3))
    wanted[:, : target.shape[1]] = target
    fill(o, lin, wanted, problem)
    return problem
