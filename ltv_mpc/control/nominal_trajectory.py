"""Nominal trajectory: the solution of the equations of motion that a cycle linearises along.

It starts at the predicted state. It is the previous plan on the new knots, or a steering guess where that costs less
(initial_guess.py).

Arguments of the kernels in this file:

    packed   packed constants (problem_data.py)
    start    (10,) state n, e, u, v, psi, r, F1, F2 at the first knot, then the commands of port and starboard there
    target   (N+1, 3) as in ``Solver.build``
    old      (N+1, 2) commands of the previous plan (N)
    stages   by how many first stages the previous plan began earlier
    flat     ``Linearisation.flat``
    C        (N+1, 2) current at the knots, north and east (m/s)
    X, U     (N+1, 8) states and (N+1, 2) commands (N) at the knots; overwritten
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.control.cost import cost
from ltv_mpc.control.fence_clearance import Scene, entry_s, fence_cost, is_near
from ltv_mpc.control.horizon_limits import clip_to_limits
from ltv_mpc.control.initial_guess import steering_guess
from ltv_mpc.control.linearisation import linearise_rollout, propagate, unpack_linearisation
from ltv_mpc.control.problem_data import Objective, unpack_constants
from ltv_mpc.control.shooting_grid import locate
from ltv_mpc.control.terminal_check import TerminalCheck, check_terminal
from ltv_mpc.jit import copy_to, jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import STATES

PREVIOUS_PLAN, STEERED_AHEAD, STEERED_ASTERN = range(3)
"""Origin of the nominal trajectory: the previous plan, or the steering law ahead or astern."""

FAR_LESS = 0.1
"""Largest cost for the zones of a guess, over that of the previous plan, with which it may replace it."""


@jit
def shift_controls(old: Array, t: Array, stages: float, U: Array) -> None:
    """Interpolate the commands of a previous plan at the new knots 1 .. N; its last ones are held beyond its end.

    Parameters
    ----------
    old : (N+1, 2) commands of the previous plan (N).
    t : (N+1,) knots in first stages.
    stages : by how many first stages the previous plan began earlier.
    U : (N+1, 2); U[1:] is overwritten.
    """
    low = 0
    for k in range(1, U.shape[0]):
        low, part = locate(t, t[k] + stages, low)
        for i in range(2):
            U[k, i] = (1.0 - part) * old[low, i] + part * old[low + 1, i]


@jit
def shifted_trajectory(packed: Array, start: Array, old: Array, stages: float, C: Array, X: Array, U: Array) -> None:
    """Evaluate the previous plan on the new knots, inside box and slew.

    Parameters
    ----------
    packed, start, old, stages, C, X, U : as at the head of this file.
    """
    constants = unpack_constants(packed)
    _set_initial_knot(start, X, U)
    _shift_into_limits(old, stages, constants.objective, U)
    propagate(X, U, C, constants.objective.t, constants.stage_s, constants.p)


@jit
def _set_initial_knot(start: Array, X: Array, U: Array) -> None:
    """Set the first knot of X (N+1, 8) and U (N+1, 2)."""
    copy_to(X[0], start[:STATES])
    copy_to(U[0], start[STATES:])


@jit
def _shift_into_limits(old: Array, stages: float, objective: Objective, U: Array) -> None:
    """Shift the previous plan's commands to the new knots, then clip them to box and slew."""
    shift_controls(old, objective.t, stages, U)
    clip_to_limits(U, objective.t, objective.low, objective.high, objective.max_change)


@jit
def choose_nominal(
    packed: Array,
    start: Array,
    target: Array,
    old: Array,
    stages: float,
    flat: Array,
    scene: Scene,
    was_clear: bool,
) -> tuple[int, bool]:
    """Choose the nominal trajectory, and linearise along it.

    The candidates are the previous plan and two steering guesses, ahead and astern; the one of least cost is chosen.
    Where one of two ends stuck (terminal_check.py), the cost beyond the horizon counts too, unless the candidate comes
    nearer to the zones than the best one so far. A plan that was clear of the zones may lack clearance a cycle later,
    as the motion astern is not stable. The QP mends that, but seldom a guess through a zone. So a guess replaces such a
    plan only if it lacks ``FAR_LESS`` of what the plan lacks.

    Parameters
    ----------
    packed, start, target, old : as at the head of this file.
    stages : as there; NaN if there is no previous plan.
    flat : has the current C; all the rest is overwritten.
    scene : zones and obstacles, whose clearances count in the cost.
    was_clear : True if the previous plan lacked no clearance when it was made.

    Returns
    -------
    PREVIOUS_PLAN, STEERED_AHEAD or STEERED_ASTERN; and True if the trajectory comes near to a zone.
    """
    constants, lin = unpack_constants(packed), unpack_linearisation(flat, len(target) - 1)
    objective = constants.objective
    X, U = lin.X, lin.U
    _set_initial_knot(start, X, U)
    kind, lowest, clearances = STEERED_AHEAD, np.inf, np.inf
    end = TerminalCheck(False, 0.0)
    if not np.isnan(stages):
        _shift_into_limits(old, stages, objective, U)
        linearise_rollout(lin, objective.t, constants.stage_s, constants.p)
        kind, clearances = PREVIOUS_PLAN, fence_cost(X, scene, objective)
        lowest = cost(X, U, lin.C, target, objective) + clearances
        end = check_terminal(X, lin.C, target, constants)
    other_X, other_U = np.empty_like(X), np.empty_like(U)
    _set_initial_knot(start, other_X, other_U)
    for astern in (False, True):
        if astern and objective.low_state[0] >= 0.0:  # the bow goes first
            continue
        other = steering_guess(other_X, other_U, lin.C, target, astern, np.inf if end.stuck else lowest, constants)
        if np.isinf(other) and not np.isinf(lowest):
            continue
        other_clearances = fence_cost(other_X, scene, objective)
        if was_clear and kind == PREVIOUS_PLAN and other_clearances > FAR_LESS * clearances:
            continue
        other += other_clearances
        other_end = check_terminal(other_X, lin.C, target, constants)
        # A way through a zone leads to no end, so what comes after it does not count in its favour.
        tail_weight = 1.0 if (end.stuck or other_end.stuck) and other_clearances <= clearances else 0.0
        if other + tail_weight * other_end.tail_cost < lowest + tail_weight * end.tail_cost or np.isinf(lowest):
            copy_to(X, other_X)
            copy_to(U, other_U)
            kind, lowest, clearances = STEERED_ASTERN if astern else STEERED_AHEAD, other, other_clearances
            end = other_end
    if kind != PREVIOUS_PLAN:
        linearise_rollout(lin, objective.t, constants.stage_s, constants.p)
    return kind, is_near(X, scene, objective)


@jit
def relinearise(packed: Array, flat: Array, X: Array, U: Array, scene: Scene) -> bool:
    """Linearise along another trajectory, in the same current.

    Parameters
    ----------
    packed : as at the head of this file.
    flat : as there; all but C is overwritten.
    X : (N+1, 8) its states; only the first is used.
    U : (N+1, 2) its commands (N).
    scene : zones and obstacles.

    Returns
    -------
    True if the trajectory comes near to a zone.
    """
    constants, lin = unpack_constants(packed), unpack_linearisation(flat, U.shape[0] - 1)
    copy_to(lin.X, X)
    copy_to(lin.U, U)
    linearise_rollout(lin, constants.objective.t, constants.stage_s, constants.p)
    return is_near(lin.X, scene, constants.objective)


@jit
def ramp_to(packed: Array, start: Array, goal: Array, C: Array, X: Array, U: Array) -> None:
    """Move the lateral thrusters to given commands at the slew limit, and predict the motion.

    Parameters
    ----------
    packed, start, C, X, U : as at the head of this file.
    goal : (N+1, 2) wanted commands of port and starboard (N).
    """
    constants = unpack_constants(packed)
    objective = constants.objective
    copy_to(U, goal)
    _set_initial_knot(start, X, U)
    clip_to_limits(U, objective.t, objective.low, objective.high, objective.max_change)
    propagate(X, U, C, objective.t, constants.stage_s, constants.p)


@jit
def coasting_entry_s(
    packed: Array, X: Array, U: Array, C: Array, end: int, t_s: Array, scene: Scene, hull_m: float
) -> float:
    """Return when the hull enters a zone if the lateral thrusters ramp to zero from a knot on; infinite for never.

    Parameters
    ----------
    packed, C : as at the head of this file.
    X, U : a motion and its commands, which are kept until knot ``end`` - 1.
    end : first knot with the goal zero, at least 1.
    t_s : (N+1,) times of the knots after the first one (s).
    scene : zones and obstacles.
    hull_m : radius of the hull (m).

    Returns
    -------
    Time after the first knot (s).
    """
    constants = unpack_constants(packed)
    o, moved, thrust = constants.objective, X.copy(), U.copy()
    thrust[end:] = 0.0
    clip_to_limits(thrust, o.t, o.low, o.high, o.max_change)
    k = end - 1
    propagate(moved[k:], thrust[k:], C[k:], o.t[k:], constants.stage_s, constants.p)
    return entry_s(moved, t_s, scene, hull_m)
