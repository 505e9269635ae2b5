"""Line search along the exact flow, from the nominal trajectory towards the QP's commands.

The QP knows the motion to first order only. Where that is wrong, a full step can cost more than no step.
"""

from __future__ import annotations

from ltv_mpc.control.cost import cost
from ltv_mpc.control.fence_clearance import Scene, fence_cost
from ltv_mpc.control.horizon_limits import clip_to_limits
from ltv_mpc.control.linearisation import propagate, unpack_linearisation
from ltv_mpc.control.problem_data import unpack_constants
from ltv_mpc.control.terminal_check import check_terminal
from ltv_mpc.jit import copy_to, jit
from ltv_mpc.messages import Array

STEPS = (1.0, 0.5, 0.25, 0.1)
"""Fractions of the QP's step, tried in this order until the cost along the exact flow does not rise."""


@jit
def line_search(
    packed: Array, flat: Array, target: Array, commands: Array, X: Array, U: Array, scene: Scene
) -> tuple[float, bool]:
    """Find the largest step from the nominal trajectory towards the QP's commands that does not raise the cost.

    The solver meets box and slew to its tolerance; the trajectory found here meets them exactly.

    Parameters
    ----------
    packed : packed constants (problem_data.py).
    flat : ``Linearisation.flat``; X, U and C are the nominal trajectory and the current.
    target : (N+1, 3) as in ``Solver.build``.
    commands : (N+1, 2) port and starboard thrust that the QP asks for (N).
    X : (N+1, 8) is overwritten with the states of the trajectory found.
    U : (N+1, 2) is overwritten with its commands (N).
    scene : zones and obstacles, whose clearances count in the cost.

    Returns
    -------
    The fraction of the step taken, and True if the whole step comes too near to a zone, where the nominal trajectory
    does not. The fraction is 0 if no step qualifies, and X and U are then the nominal trajectory.
    """
    c, lin = unpack_constants(packed), unpack_linearisation(flat, len(target) - 1)
    o = c.objective
    fence_before, enters = fence_cost(lin.X, scene, o), False
    before = cost(lin.X, lin.U, lin.C, target, o) + fence_before
    copy_to(X[0], lin.X[0])
    for part in STEPS:
        for k in range(U.shape[0]):
            for i in range(2):
                U[k, i] = lin.U[k, i] + part * (commands[k, i] - lin.U[k, i])
        clip_to_limits(U, o.t, o.low, o.high, o.max_change)
        propagate(X, U, lin.C, o.t, c.stage_s, c.p)
        of_fence = fence_cost(X, scene, o)
        if part == STEPS[0]:
            enters = of_fence > fence_before == 0.0
        if cost(X, U, lin.C, target, o) + of_fence <= before:
            ends_stuck = check_terminal(X, lin.C, target, c).stuck and not check_terminal(lin.X, lin.C, target, c).stuck
            if ends_stuck and of_fence >= fence_before:
                break  # within the horizon it costs less not to turn; but a way out of a zone is taken
            return part, enters
    copy_to(X, lin.X)
    copy_to(U, lin.U)
    return 0.0, enters
