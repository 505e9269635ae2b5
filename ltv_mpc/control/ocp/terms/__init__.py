"""Terms of the cost, one file each: its value along a trajectory, and its quadratic model in the problem.

Every file has two functions:

    cost(X, U, C, target, o)      value along a trajectory, a sum over the knots 1 .. N
    add(p, lin, target, o)        adds gradient and Hessian along the nominal trajectory to a problem

    X       (N+1, 8) states n, e, u, v, psi, r, F1, F2 at the knots
    U       (N+1, 2) commands (N)
    C       (N+1, 2) current, north and east (m/s)
    target  (N+1, 3) positions (m) wanted at the knots 1 .. N, then the velocity over ground (m/s) wanted at the last
            one; third column: the heading (rad) wanted at the knots 1 .. N
    lin     the motion along the nominal trajectory
    o       weights, scales and knots
    p       problem (ocp/problem.py)

This file is the list; nothing else in the program knows the terms by name.
"""

from __future__ import annotations

from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.ocp.terms import (
    heading,
    position,
    terminal_position,
    terminal_velocity,
    thrust,
    thrust_change,
)
from ltv_mpc.control.problem_data import Objective
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array

TERMS = (position, heading, thrust, thrust_change, terminal_position, terminal_velocity)
"""All terms."""


@jit
def cost(X: Array, U: Array, C: Array, target: Array, o: Objective) -> float:
    """Return the value of all terms; arguments as at the head of this file.

    Parameters
    ----------
    X, U, C, target, o : as there.
    """
    return (
        position.cost(X, U, C, target, o)
        + heading.cost(X, U, C, target, o)
        + thrust.cost(X, U, C, target, o)
        + thrust_change.cost(X, U, C, target, o)
        + terminal_position.cost(X, U, C, target, o)
        + terminal_velocity.cost(X, U, C, target, o)
    )


@jit
def add(p: Problem, lin: Linearisation, target: Array, o: Objective) -> None:
    """Add the quadratic model of all terms to a problem.

    Parameters
    ----------
    p, lin, target, o : as at the head of this file.
    """
    position.add(p, lin, target, o)
    heading.add(p, lin, target, o)
    thrust.add(p, lin, target, o)
    thrust_change.add(p, lin, target, o)
    terminal_position.add(p, lin, target, o)
    terminal_velocity.add(p, lin, target, o)
