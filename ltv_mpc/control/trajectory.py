"""The trajectory that a cycle linearises along, and the one that it ends with.

Both are solutions of the equations of motion from the predicted start. The first is the previous plan on the new knots,
or a steered one where that is better (``guess.py``); the second lies as far towards the QP's commands as does not cost
more along the exact flow: the QP knows the motion to first order only, and where it is wrong a full step is worse than
none.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.compiled import assign, kernel
from ltv_mpc.control.constants import Constants, Objective, constants, length
from ltv_mpc.control.grid import position
from ltv_mpc.control.guess import steer
from ltv_mpc.control.horizon import linearise_along, velocity_over_ground, views
from ltv_mpc.control.limits import LIMITED, PENALTY, bring_in
from ltv_mpc.signals import Array
from ltv_mpc.vehicle.flow import STATES, advance_stage

CARRIED, AHEAD, ASTERN = range(3)
"""Where the trajectory linearised along comes from: the previous plan, or a law that steers either way."""

STEPS = (1.0, 0.5, 0.25, 0.1)
"""Parts of the QP's step that are tried in turn until the cost along the exact flow does not rise."""


@kernel
def cost(X: Array, U: Array, C: Array, target: Array, o: Objective) -> float:
    """What a trajectory X (N+1, 8), U (N+1, 2) in a current C (N+1, 2) costs against target (N+1, 2): as in the QP."""
    N = U.shape[0] - 1
    total = square = 0.0
    for k in range(1, N + 1):
        g = length(o, k)
        dn, de = X[k, 0] - target[k - 1, 0], X[k, 1] - target[k - 1, 1]
        square = dn * dn + de * de
        total += o.position * g * square
        for i in range(2):
            here, before = U[k, i] / o.scale[i], U[k - 1, i] / o.scale[i]
            total += o.thrust * g * here * here + o.thrust_change / g * (here - before) * (here - before)
            beyond = abs(X[k, LIMITED[i]]) - o.most[i]
            if beyond > 0.0:
                total += PENALTY * g * beyond / o.state_scale[LIMITED[i]]
    velocity, _ = velocity_over_ground(X[N], C[N])
    wn, we = velocity[0] - target[N, 0], velocity[1] - target[N, 1]
    total += o.terminal_position * square + o.terminal_velocity * (wn * wn + we * we)
    return float(total)


@kernel
def roll(X: Array, U: Array, C: Array, c: Constants) -> None:
    """X[1:] from X[0]: the exact flow of every stage."""
    for k in range(U.shape[0] - 1):
        advance_stage(X[k], U[k], U[k + 1], C[k], C[k + 1], length(c.objective, k + 1) * c.stage_s, c.p, X[k + 1])


@kernel
def carry(old: Array, t: Array, stages: float, U: Array) -> None:
    """U[1:] (N+1, 2) at knots t (N+1,) from the commands of a plan that began so many first stages earlier; its last
    ones are kept.
    """
    low = 0
    for k in range(1, U.shape[0]):
        low, part = position(t, t[k] + stages, low)
        for i in range(2):
            U[k, i] = (1.0 - part) * old[low, i] + part * old[low + 1, i]


@kernel
def shifted(numbers: Array, start: Array, old: Array, stages: float, C: Array, X: Array, U: Array) -> None:
    """X (N+1, 8) and U (N+1, 2): the previous plan on the new knots, inside box and slew; arguments as in ``begin``."""
    c = constants(numbers)
    o = c.objective
    assign(X[0], start[:STATES])
    assign(U[0], start[STATES:])
    carry(old, o.t, stages, U)
    bring_in(U, o.t, o.low, o.high, o.change)
    roll(X, U, C, c)


@kernel
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
    assign(X[0], start[:STATES])
    assign(U[0], start[STATES:])
    kind, least = AHEAD, np.inf
    if not np.isnan(stages):
        shifted(numbers, start, old, stages, lin.C, X, U)
        kind, least = CARRIED, cost(X, U, lin.C, target, o)
    for astern in (False, True):
        steered_X, steered_U = steer(X[0], U[0], lin.C, target, astern, c)
        other = cost(steered_X, steered_U, lin.C, target, o)
        if other < least or np.isinf(least):
            assign(X, steered_X)
            assign(U, steered_U)
            kind, least = ASTERN if astern else AHEAD, other
    linearise_along(lin, o.t, c.stage_s, c.p)
    return kind


@kernel
def again(numbers: Array, flat: Array, N: int, X: Array, U: Array) -> None:
    """Linearise once more, along X (N+1, 8) and U (N+1, 2)."""
    c, lin = constants(numbers), views(flat, N)
    assign(lin.X, X)
    assign(lin.U, U)
    linearise_along(lin, c.objective.t, c.stage_s, c.p)


@kernel
def step(numbers: Array, flat: Array, target: Array, commands: Array, X: Array, U: Array) -> float:
    """X (N+1, 8) and U (N+1, 2): from the trajectory linearised along towards ``commands``, the largest part of the
    way that is no worse. Returns that part, 0 where none is.

    The solver meets box and slew to its tolerance; what is returned meets them exactly.
    """
    c, lin = constants(numbers), views(flat, len(target) - 1)
    o = c.objective
    before = cost(lin.X, lin.U, lin.C, target, o)
    assign(X[0], lin.X[0])
    for part in STEPS:
        for k in range(U.shape[0]):
            for i in range(2):
                U[k, i] = lin.U[k, i] + part * (commands[k, i] - lin.U[k, i])
        bring_in(U, o.t, o.low, o.high, o.change)
        roll(X, U, lin.C, c)
        if cost(X, U, lin.C, target, o) <= before:
            return part
    assign(X, lin.X)
    assign(U, lin.U)
    return 0.0


@kernel
def release(numbers: Array, start: Array, goal: Array, C: Array, X: Array, U: Array) -> None:
    """X (N+1, 8) and U (N+1, 2) where the lateral thrusters go to goal (N+1, 2) at the slew limit; ``start`` as in
    ``begin``.
    """
    c = constants(numbers)
    assign(X[0], start[:STATES])
    assign(U, goal)
    assign(U[0], start[STATES:])
    o = c.objective
    bring_in(U, o.t, o.low, o.high, o.change)
    roll(X, U, C, c)
