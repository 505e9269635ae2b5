"""Kernels of the controller with one part switched off, for ``controller.py``.

Each has the arguments of the kernel that it stands in for, and flags after them. With all flags set it returns the
same bits.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.control.cost import cost
from ltv_mpc.control.horizon_limits import LIMITED_STATES, clip_to_limits
from ltv_mpc.control.initial_guess import steering_guess
from ltv_mpc.control.line_search import STEPS
from ltv_mpc.control.linearisation import (
    linearise_rollout,
    multiply_A_transposed,
    propagate,
    unpack_linearisation,
    velocity_over_ground,
)
from ltv_mpc.control.nominal_trajectory import (
    PREVIOUS_PLAN,
    STEERED_AHEAD,
    STEERED_ASTERN,
    _set_initial_knot,
    _shift_into_limits,
)
from ltv_mpc.control.problem_data import (
    is_limited,
    limited_state_count,
    stage_length,
    state_scale,
    unpack_constants,
    unpack_objective,
)
from ltv_mpc.control.qp.sparse import STAGE_VARIABLES, EntryMap, Indices, fill
from ltv_mpc.control.solvers.osqp import (
    ACTIVE,
    EQUALITY_ROW,
    EXCESS_ROW,
    LIMIT_ROW,
    MAX_LIMIT_ROW,
    MOTION_ACTIVE,
    MOTION_ROW,
    NOT_ACTIVE,
    SolveArrays,
    _forward_states,
    _guess_commands,
    _guess_excesses,
    _shift_limits,
    dual_scale,
)
from ltv_mpc.control.terminal_check import TerminalCheck, check_terminal
from ltv_mpc.jit import copy_to, jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import STATES

OWN, FIXED, NONE = range(3)
"""Scales of OSQP's rows: as they are; without the active limits; all 1."""


@jit
def begin(
    packed: Array,
    start: Array,
    target: Array,
    old: Array,
    stages: float,
    flat: Array,
    steers: bool,
    looks: bool,
) -> int:
    """Choose the nominal trajectory (``choose_nominal``); ``steers``: steered guesses, ``looks``: terminal check."""
    c, lin = unpack_constants(packed), unpack_linearisation(flat, len(target) - 1)
    o = c.objective
    X, U = lin.X, lin.U
    _set_initial_knot(start, X, U)
    kind, least = STEERED_AHEAD, np.inf
    end = TerminalCheck(False, 0.0)
    if not np.isnan(stages):
        _shift_into_limits(old, stages, o, U)
        linearise_rollout(lin, o.t, c.stage_s, c.p)
        kind, least = PREVIOUS_PLAN, cost(X, U, lin.C, target, o)
        if looks:
            end = check_terminal(X, lin.C, target, c)
    if not steers:
        if kind != PREVIOUS_PLAN:
            for k in range(1, U.shape[0]):
                U[k, 0] = U[k, 1] = 0.0
            clip_to_limits(U, o.t, o.low, o.high, o.max_change)
            linearise_rollout(lin, o.t, c.stage_s, c.p)
        return kind
    other_X, other_U = np.empty_like(X), np.empty_like(U)
    _set_initial_knot(start, other_X, other_U)
    for astern in (False, True):
        other = steering_guess(other_X, other_U, lin.C, target, astern, np.inf if end.stuck else least, c)
        if np.isinf(other) and not np.isinf(least):
            continue
        other_end = TerminalCheck(False, 0.0)
        if looks:
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
def step(
    packed: Array, flat: Array, target: Array, commands: Array, X: Array, U: Array, searches: bool, looks: bool
) -> float:
    """Take a step: with the line search (``searches``) or the whole step; ``looks``: with the terminal check."""
    c, lin = unpack_constants(packed), unpack_linearisation(flat, len(target) - 1)
    o = c.objective
    before = cost(lin.X, lin.U, lin.C, target, o)
    copy_to(X[0], lin.X[0])
    for part in STEPS:
        for k in range(U.shape[0]):
            for i in range(2):
                U[k, i] = lin.U[k, i] + part * (commands[k, i] - lin.U[k, i])
        clip_to_limits(U, o.t, o.low, o.high, o.max_change)
        propagate(X, U, lin.C, o.t, c.stage_s, c.p)
        if not searches:
            return part
        if cost(X, U, lin.C, target, o) <= before:
            if (
                looks
                and check_terminal(X, lin.C, target, c).stuck
                and not check_terminal(lin.X, lin.C, target, c).stuck
            ):
                break
            return part
    copy_to(X, lin.X)
    copy_to(U, lin.U)
    return 0.0


@jit
def prepare(
    packed: Array,
    flat: Array,
    target: Array,
    entries: EntryMap,
    shift: float,
    at: SolveArrays,
    guesses: bool,
    scales: int,
) -> float:
    """Prepare the QP (``osqp.prepare``); ``guesses``: Riccati sweeps, ``scales``: how rows are scaled."""
    N = len(target) - 1
    lin = unpack_linearisation(flat, N)
    fill(packed, lin, target, entries, at.problem)
    c = unpack_objective(packed)
    E = N * STATES + 2
    x, y, q = at.x, at.y, at.problem.q
    _shift_limits(y, E, limited_state_count(c), c.t, shift)
    velocity, V = velocity_over_ground(lin.X[N], lin.C[N])
    dU = np.zeros((N + 1, 2))
    if guesses:
        _guess_commands(c, lin, target, dU, y[E:])
    _forward_states(c, lin, dU, x)
    _guess_excesses(c, lin, q, x, y)
    costate = np.zeros(STATES)
    for i in range(2):
        w = velocity[i] - target[N, i]
        for j in range(3):
            w += V[i, j] * x[(N - 1) * STAGE_VARIABLES + 2 + j] * c.state_scale[2 + j]
        x[N * STAGE_VARIABLES + i] = w
        y[N * STATES + i] = c.terminal_velocity * w
        for j in range(3):
            costate[2 + j] += V[i, j] * c.terminal_velocity * w
    before = np.zeros(STATES)
    for k in range(N - 1, -1, -1):
        weight = c.position * stage_length(c, k + 1) + (c.terminal_position if k == N - 1 else 0.0)
        for i in range(2):
            scale = c.state_scale[i]
            costate[i] += q[k * STAGE_VARIABLES + i] / scale + weight * x[k * STAGE_VARIABLES + i] * scale
        row = E + 4 * N + 3 * k * limited_state_count(c)
        for j in range(2):
            if is_limited(c, j):
                costate[LIMITED_STATES[j]] += (y[row] + y[row + 1]) / c.state_scale[LIMITED_STATES[j]]
                row += 3
        for i in range(STATES):
            y[k * STATES + i] = costate[i] * state_scale(i, c)
        multiply_A_transposed(lin.A, k, costate, before)
        copy_to(costate, before)
    if rescale(entries.row, N, at, scales) < 0:
        return -1.0
    return dual_scale(q, N)


@jit
def rescale(row: Indices, N: int, at: SolveArrays, scales: int) -> int:
    """Rescale the rows (``osqp.rescale``); ``scales`` as in ``prepare``."""
    problem, scaled, y = at.problem, at.scaled, at.y
    E = N * STATES + 2
    size = dual_scale(problem.q, N)
    free = min(LIMIT_ROW * size, MAX_LIMIT_ROW)
    changed, total = 0, size
    for i in range(len(at.row_scale)):
        active = scales == OWN and abs(y[i]) > NOT_ACTIVE
        if scales == NONE:
            s = 1.0
        elif i < E:
            s = EQUALITY_ROW
        elif i < E + 4 * N:
            s = free * ACTIVE if active else free
        elif not active:
            s = MOTION_ROW * size
        else:
            s = (EXCESS_ROW if (i - E - 4 * N) % 3 == 2 else MOTION_ACTIVE) * size
        if s != at.row_scale[i]:
            changed, at.row_scale[i] = 1, s
        scaled.l[i], scaled.u[i], at.scaled_y[i] = problem.l[i] * s, problem.u[i] * s, y[i] / s
        total += problem.l[i] + problem.u[i] + y[i]
    for i in range(len(problem.A)):
        scaled.A[i] = problem.A[i] * at.row_scale[row[i]]
        total += scaled.A[i]
    return changed if np.isfinite(total) else -1
