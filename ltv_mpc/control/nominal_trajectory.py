"""The trajectory that a cycle linearises along, and the one that it ends with.

Both are solutions of the equations of motion from the predicted start. The first is the previous plan on the new knots,
or a steered one where that is better (``initial_guess.py``); the second lies as far towards the QP's commands as
does not cost
more along the exact flow: the QP knows the motion to first order only, and where it is wrong a full step is worse than
none.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.control.cost import cost
from ltv_mpc.control.horizon_limits import bring_in
from ltv_mpc.control.initial_guess import steer
from ltv_mpc.control.linearisation import linearise_ahead, roll, views
from ltv_mpc.control.problem_data import Objective, constants
from ltv_mpc.control.shooting_grid import position
from ltv_mpc.control.terminal_check import Outlook, outlook
from ltv_mpc.jit import copy_to, jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import STATES

CARRIED, AHEAD, ASTERN = range(3)
"""Where the trajectory linearised along comes from: the previous plan, or a law that steers either way."""

STEPS = (1.0, 0.5, 0.25, 0.1)
"""Parts of the QP's step that are tried in turn until the cost along the exact flow does not rise."""


@jit
def carry(old: Array, t: Array, stages: float, U: Array) -> None:
    """U[1:] (N+1, 2) at knots t (N+1,) from the commands of a plan that began so many first stages earlier; its last
    ones are kept.
    """
    low = 0
    for k in range(1, U.shape[0]):
        low, part = position(t, t[k] + stages, low)
        for i in range(2):
            U[k, i] = (1.0 - part) * old[low, i] + part * old[low + 1, i]


@jit
def shifted(numbers: Array, start: Array, old: Array, stages: float, C: Array, X: Array, U: Array) -> None:
    """X (N+1, 8) and U (N+1, 2): the previous plan on the new knots, inside box and slew; arguments as in ``begin``."""
    c = constants(numbers)
    _set_out(start, X, U)
    _carry_in(old, stages, c.objective, U)
    roll(X, U, C, c.objective.t, c.stage_s, c.p)


@jit
def _set_out(start: Array, X: Array, U: Array) -> None:
    """The first knot of X (N+1, 8) and U (N+1, 2)."""
    copy_to(X[0], start[:STATES])
    copy_to(U[0], start[STATES:])


@jit
def _carry_in(old: Array, stages: float, o: Objective, U: Array) -> None:
    """``carry``, inside box and slew."""
    carry(old, o.t, stages, U)
    bring_in(U, o.t, o.low, o.high, o.change)


@jit
def begin(numbers: Array, start: Array, target: Array, old: Array, stages: float, flat: Array) -> int:
    """The trajectory to linearise along and the linearisation, into ``flat`` (``horizon.views``), whose C is given.

    ``numbers`` are packed constants; ``start`` (10,) the state at the first knot and the commands in force there;
    ``target`` as in ``Solver``; ``old`` (N+1, 2) the previous plan's commands, ``stages`` how many first stages earlier
    it began, NaN where there is none.
    Returns where it comes from.
    """
    c, lin = constants(numbers), views(flat, len(target) - 1)
    o = c.objective
    X, U = lin.X, lin.U
    _set_out(start, X, U)
    kind, least = AHEAD, np.inf
    end = Outlook(False, 0.0)
    if not np.isnan(stages):
        _carry_in(old, stages, o, U)
        linearise_ahead(lin, o.t, c.stage_s, c.p)
        kind, least = CARRIED, cost(X, U, lin.C, target, o)
        end = outlook(X, lin.C, target, c)
    other_X, other_U = np.empty_like(X), np.empty_like(U)
    _set_out(start, other_X, other_U)
    for astern in (False, True):
        other = steer(other_X, other_U, lin.C, target, astern, np.inf if end.stuck else least, c)
        if np.isinf(other) and not np.isinf(least):
            continue
        other_end = outlook(other_X, lin.C, target, c)
        counts = 1.0 if end.stuck or other_end.stuck else 0.0
        if other + counts * other_end.beyond < least + counts * end.beyond or np.isinf(least):
            copy_to(X, other_X)
            copy_to(U, other_U)
            kind, least, end = ASTERN if astern else AHEAD, other, other_end
    if kind != CARRIED:
        linearise_ahead(lin, o.t, c.stage_s, c.p)
    return kind


@jit
def again(numbers: Array, flat: Array, N: int, X: Array, U: Array) -> None:
    """Linearise once more, along X (N+1, 8) and U (N+1, 2)."""
    c, lin = constants(numbers), views(flat, N)
    copy_to(lin.X, X)
    copy_to(lin.U, U)
    linearise_ahead(lin, c.objective.t, c.stage_s, c.p)


@jit
def step(numbers: Array, flat: Array, target: Array, commands: Array, X: Array, U: Array) -> float:
    """X (N+1, 8) and U (N+1, 2): from the trajectory linearised along towards ``commands``, the largest part of the
    way that is no worse. Returns that part, 0 where none is.

    The solver meets box and slew to its tolerance; what is returned meets them exactly.
    """
    c, lin = constants(numbers), views(flat, len(target) - 1)
    o = c.objective
    before = cost(lin.X, lin.U, lin.C, target, o)
    copy_to(X[0], lin.X[0])
    for part in STEPS:
        for k in range(U.shape[0]):
            for i in range(2):
                U[k, i] = lin.U[k, i] + part * (commands[k, i] - lin.U[k, i])
        bring_in(U, o.t, o.low, o.high, o.change)
        roll(X, U, lin.C, o.t, c.stage_s, c.p)
        if cost(X, U, lin.C, target, o) <= before:
            if outlook(X, lin.C, target, c).stuck and not outlook(lin.X, lin.C, target, c).stuck:
                break  # within the horizon it is cheaper not to turn
            return part
    copy_to(X, lin.X)
    copy_to(U, lin.U)
    return 0.0


@jit
def release(numbers: Array, start: Array, goal: Array, C: Array, X: Array, U: Array) -> None:
    """X (N+1, 8) and U (N+1, 2) where the lateral thrusters go to goal (N+1, 2) at the slew limit; ``start`` as in
    ``begin``.
    """
    c = constants(numbers)
    o = c.objective
    copy_to(U, goal)
    _set_out(start, X, U)
    bring_in(U, o.t, o.low, o.high, o.change)
    roll(X, U, C, o.t, c.stage_s, c.p)
