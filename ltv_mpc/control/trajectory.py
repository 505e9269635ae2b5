"""The trajectory that a cycle linearises along, and the one that it ends with.

Both are solutions of the equations of motion from the predicted start. The first is the previous plan on the new knots,
or a steered one where that is better (``guess.py``); the second lies as far towards the QP's commands as does not cost
more along the exact flow: the QP knows the motion to first order only, and where it is wrong a full step is worse than
none.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.compiled import kernel
from ltv_mpc.control.constants import Constants, Objective, constants
from ltv_mpc.control.guess import steer
from ltv_mpc.control.horizon import linearise_along, velocity_over_ground, views
from ltv_mpc.control.limits import bring_in
from ltv_mpc.signals import Array
from ltv_mpc.vehicle.flow import STATES, advance_stage

CARRIED, AHEAD, ASTERN = range(3)
"""Where the trajectory linearised along comes from: the previous plan, or a law that steers either way."""

STEPS = (1.0, 0.5, 0.25, 0.1)
"""Parts of the QP's step that are tried in turn until the cost along the exact flow does not rise."""


@kernel
def cost(X: Array, U: Array, C: Array, ref: Array, o: Objective) -> float:
    """What a trajectory X (N+1, 8), U (N+1, 2) in a current C (N+1, 2) costs against ref (N, 2): as in the QP."""
    N = ref.shape[0]
    total = square = 0.0
    for k in range(1, N + 1):
        dn, de = X[k, 0] - ref[k - 1, 0], X[k, 1] - ref[k - 1, 1]
        square = dn * dn + de * de
        total += o.position * square
        for i in range(2):
            here, before = U[k, i] / o.scale[i], U[k - 1, i] / o.scale[i]
            total += o.thrust * here * here + o.thrust_change * (here - before) * (here - before)
    velocity, _ = velocity_over_ground(X[N], C[N])
    total += o.terminal_position * square + o.terminal_velocity * (velocity[0] ** 2 + velocity[1] ** 2)
    return float(total)


@kernel
def roll(X: Array, U: Array, C: Array, c: Constants) -> None:
    """X[1:] from X[0]: the exact flow of every stage."""
    for k in range(U.shape[0] - 1):
        advance_stage(X[k], U[k], U[k + 1], C[k], C[k + 1], c.stage_s, c.p, X[k + 1])


@kernel
def carry(old: Array, stages: float, U: Array) -> None:
    """U[1:] (N+1, 2) from the commands of a plan whose knots lie so many stages earlier; its last ones are kept."""
    N = U.shape[0] - 1
    for k in range(1, N + 1):
        at = min(max(k + stages, 0.0), float(N))
        low = min(int(at), N - 1)
        part = at - low
        for i in range(2):
            U[k, i] = (1.0 - part) * old[low, i] + part * old[low + 1, i]


@kernel
def begin(numbers: Array, start: Array, ref: Array, old: Array, stages: float, flat: Array) -> int:
    """The trajectory to linearise along and the linearisation, into ``flat`` (``horizon.views``), whose C is given.

    ``numbers`` are packed constants; ``start`` (10,) the state at the first knot and the commands in force there;
    ``old`` (N+1, 2) the previous plan's commands, ``stages`` how much earlier its knots lie, NaN where there is none.
    Returns where it comes from.
    """
    c, lin = constants(numbers), views(flat, ref.shape[0])
    X, U = lin.X, lin.U
    X[0], U[0] = start[:STATES], start[STATES:]
    kind, least = AHEAD, np.inf
    if not np.isnan(stages):
        carry(old, stages, U)
        bring_in(U, c.objective.low, c.objective.high, c.objective.change)
        roll(X, U, lin.C, c)
        kind, least = CARRIED, cost(X, U, lin.C, ref, c.objective)
    for astern in (False, True):
        steered_X, steered_U = steer(X[0], U[0], lin.C, ref, astern, c)
        other = cost(steered_X, steered_U, lin.C, ref, c.objective)
        if other < least or np.isinf(least):
            X[:], U[:] = steered_X, steered_U
            kind, least = ASTERN if astern else AHEAD, other
    linearise_along(lin, c.stage_s, c.p)
    return kind


@kernel
def again(numbers: Array, flat: Array, N: int, X: Array, U: Array) -> None:
    """Linearise once more, along X (N+1, 8) and U (N+1, 2)."""
    c, lin = constants(numbers), views(flat, N)
    lin.X[:], lin.U[:] = X, U
    linearise_along(lin, c.stage_s, c.p)


@kernel
def step(numbers: Array, flat: Array, ref: Array, commands: Array, X: Array, U: Array) -> float:
    """X (N+1, 8) and U (N+1, 2): from the trajectory linearised along towards ``commands``, the largest part of the
    way that is no worse. Returns that part, 0 where none is.

    The solver meets box and slew to its tolerance; what is returned meets them exactly.
    """
    c, lin = constants(numbers), views(flat, ref.shape[0])
    before = cost(lin.X, lin.U, lin.C, ref, c.objective)
    X[0] = lin.X[0]
    for part in STEPS:
        for k in range(U.shape[0]):
            for i in range(2):
                U[k, i] = lin.U[k, i] + part * (commands[k, i] - lin.U[k, i])
        bring_in(U, c.objective.low, c.objective.high, c.objective.change)
        roll(X, U, lin.C, c)
        if cost(X, U, lin.C, ref, c.objective) <= before:
            return part
    X[:], U[:] = lin.X, lin.U
    return 0.0


@kernel
def release(numbers: Array, start: Array, C: Array, X: Array, U: Array) -> None:
    """X (N+1, 8) and U (N+1, 2) where the lateral thrusters go to zero at the slew limit; ``start`` as in ``begin``."""
    c = constants(numbers)
    X[0] = start[:STATES]
    U[:] = 0.0
    U[0] = start[STATES:]
    bring_in(U, c.objective.low, c.objective.high, c.objective.change)
    roll(X, U, C, c)
