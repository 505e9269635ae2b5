"""Nominal trajectory: the solution of the equations of motion that a cycle linearises along.

It starts at the predicted state. It is the previous plan on the new knots, or a steering guess where that costs less
(``initial_guess.py``).
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.control.cost import cost
from ltv_mpc.control.horizon_limits import clip_to_limits
from ltv_mpc.control.initial_guess import steering_guess
from ltv_mpc.control.linearisation import linearise_rollout, propagate, views
from ltv_mpc.control.problem_data import Objective, unpack_constants
from ltv_mpc.control.shooting_grid import locate
from ltv_mpc.control.terminal_check import TerminalCheck, check_terminal
from ltv_mpc.jit import copy_to, jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import STATES

PREVIOUS_PLAN, STEERED_AHEAD, STEERED_ASTERN = range(3)
"""Where the trajectory linearised along comes from: the previous plan, or a law that steers either way."""


@jit
def shift_controls(old: Array, t: Array, stages: float, U: Array) -> None:
    """U[1:] (N+1, 2) at knots t (N+1,) from the commands of a plan that began so many first stages earlier; its last
    ones are kept.
    """
    low = 0
    for k in range(1, U.shape[0]):
        low, part = locate(t, t[k] + stages, low)
        for i in range(2):
            U[k, i] = (1.0 - part) * old[low, i] + part * old[low + 1, i]


@jit
def shifted_trajectory(numbers: Array, start: Array, old: Array, stages: float, C: Array, X: Array, U: Array) -> None:
    """Evaluate the previous plan on the new knots, inside box and slew: states X (N+1, 8) and commands U (N+1, 2).

    The other arguments are those of ``choose_nominal``.
    """
    c = unpack_constants(numbers)
    _set_initial_knot(start, X, U)
    _shift_into_limits(old, stages, c.objective, U)
    propagate(X, U, C, c.objective.t, c.stage_s, c.p)


@jit
def _set_initial_knot(start: Array, X: Array, U: Array) -> None:
    """The first knot of X (N+1, 8) and U (N+1, 2)."""
    copy_to(X[0], start[:STATES])
    copy_to(U[0], start[STATES:])


@jit
def _shift_into_limits(old: Array, stages: float, o: Objective, U: Array) -> None:
    """``shift_controls``, inside box and slew."""
    shift_controls(old, o.t, stages, U)
    clip_to_limits(U, o.t, o.low, o.high, o.max_change)


@jit
def choose_nominal(numbers: Array, start: Array, target: Array, old: Array, stages: float, flat: Array) -> int:
    """The trajectory to linearise along and the linearisation, into ``flat`` (``horizon.views``), whose C is given.

    ``numbers`` are packed constants; ``start`` (10,) the state at the first knot and the commands in force there;
    ``target`` as in ``Solver``; ``old`` (N+1, 2) the previous plan's commands, ``stages`` how many first stages earlier
    it began, NaN where there is none.
    Returns where it comes from.
    """
    c, lin = unpack_constants(numbers), views(flat, len(target) - 1)
    o = c.objective
    X, U = lin.X, lin.U
    _set_initial_knot(start, X, U)
    kind, least = STEERED_AHEAD, np.inf
    end = TerminalCheck(False, 0.0)
    if not np.isnan(stages):
        _shift_into_limits(old, stages, o, U)
        linearise_rollout(lin, o.t, c.stage_s, c.p)
        kind, least = PREVIOUS_PLAN, cost(X, U, lin.C, target, o)
        end = check_terminal(X, lin.C, target, c)
    other_X, other_U = np.empty_like(X), np.empty_like(U)
    _set_initial_knot(start, other_X, other_U)
    for astern in (False, True):
        other = steering_guess(other_X, other_U, lin.C, target, astern, np.inf if end.stuck else least, c)
        if np.isinf(other) and not np.isinf(least):
            continue
        other_end = check_terminal(other_X, lin.C, target, c)
        counts = 1.0 if end.stuck or other_end.stuck else 0.0
        if other + counts * other_end.tail_cost < least + counts * end.tail_cost or np.isinf(least):
            copy_to(X, other_X)
            copy_to(U, other_U)
            kind, least, end = STEERED_ASTERN if astern else STEERED_AHEAD, other, other_end
    if kind != PREVIOUS_PLAN:
        linearise_rollout(lin, o.t, c.stage_s, c.p)
    return kind


@jit
def relinearise(numbers: Array, flat: Array, N: int, X: Array, U: Array) -> None:
    """Linearise once more, along X (N+1, 8) and U (N+1, 2)."""
    c, lin = unpack_constants(numbers), views(flat, N)
    copy_to(lin.X, X)
    copy_to(lin.U, U)
    linearise_rollout(lin, c.objective.t, c.stage_s, c.p)


@jit
def ramp_to(numbers: Array, start: Array, goal: Array, C: Array, X: Array, U: Array) -> None:
    """X (N+1, 8) and U (N+1, 2) where the lateral thrusters go to goal (N+1, 2) at the slew limit; ``start`` as in
    ``choose_nominal``.
    """
    c = unpack_constants(numbers)
    o = c.objective
    copy_to(U, goal)
    _set_initial_knot(start, X, U)
    clip_to_limits(U, o.t, o.low, o.high, o.max_change)
    propagate(X, U, C, o.t, c.stage_s, c.p)
