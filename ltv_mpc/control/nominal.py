"""Nominal trajectory: the motion that a cycle linearises along, the problem along it, and the step from it.

It starts at the predicted state. It is the previous plan on the new knots, or a steering guess where that costs less.
From there a line search along the exact flow goes towards the QP's commands.

Arguments of the functions in this file:

    o        constants of the controller (problem_data.py)
    start    (10,) state n, e, u, v, psi, r, F1, F2 at the first knot, then the commands of port and starboard there
    goal     (N+1, 2) commands to follow as far as box and slew allow (N); the first row does not count
    target   (N+1, 3) as in ``ocp/terms.py``
    C        (N+1, 2) current at the knots, north and east (m/s)
    X, U     (N+1, 8) states and (N+1, 2) commands (N) at the knots

Each kernel does one thing, and several places call it: its machine code is then still in the processor's cache.

The steering guess is the trajectory to linearise along if no previous plan is as good. At rest in the water, neither a
turn nor a sideways force moves the vehicle to first order. So a drifting plan is a stationary point of the linearised
problem, however far it drifts. The way out is to turn first and to push afterwards; this law does that, roughly:

    w = (ref - p) / T_p + ref' - c      wanted velocity through the water (m/s, NED), limited to the top speed
    psi_w = direction of w, or its opposite if the vehicle is to go astern
    N = I_z (w0^2 (psi_w - psi) - 2 w0 r),   X = M_x (u_w - u) / T_u + drag at u_w
    u_w = w . e(psi), within the limits of surge

Yaw moment N and surge force X are distributed to port and starboard, inside box and slew. The QP refines the result.

``Cycle`` has what the trajectories and the problem of one cycle are made from, and the problem itself. The arrays stay
the same from cycle to cycle, and each cycle overwrites them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ltv_mpc.control import shooting_grid
from ltv_mpc.control.linearisation import Linearisation, linearise_along, propagate
from ltv_mpc.control.ocp import assembly, fence, limits
from ltv_mpc.control.ocp.assembly import cost
from ltv_mpc.control.ocp.extension import Extensions, Limit, Term
from ltv_mpc.control.ocp.fence import Scene, fence_cost
from ltv_mpc.control.ocp.limits import clip_to_limits, command_bounds
from ltv_mpc.control.ocp.problem import Problem
from ltv_mpc.control.problem_data import CHANGES, COMMANDS, STAGE_S, Constants
from ltv_mpc.control.terminal_check import check_terminal
from ltv_mpc.jit import copy_to, jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.dynamics import coefficients
from ltv_mpc.vehicle.flow import STATES, advance_stage, lag_table
from ltv_mpc.vehicle.resistance import steady_speed


class Score(NamedTuple):
    """Costs of a trajectory, and how it ends."""

    cost: float  # without fence and corridor
    fence: float  # cost of too small clearances
    stuck: bool  # as in ``TerminalCheck``
    tail: float  # cost beyond the horizon


UNKNOWN = Score(math.inf, math.inf, False, 0.0)
"""Score of no trajectory."""


class Cycle:
    """Constants, target, zones and linearisation of a cycle, and its problem."""

    def __init__(self, constants: Constants, scene: Scene, terms: Sequence[Term | Limit] = ()) -> None:
        """Allocate the arrays.

        Parameters
        ----------
        constants : of the controller; a cycle may begin with others.
        scene : zones and obstacles.
        terms : of a user, beside those of ``ocp/``.
        """
        stages = len(constants.t) - 1
        self.constants, self.scene = constants, scene
        self.target = np.zeros((stages + 1, 3))
        """Target at the knots (``ocp/terms.py``)."""
        self.lin = Linearisation.empty(stages)
        """The motion along the nominal trajectory."""
        self.start = np.zeros(CHANGES)
        """State at the first knot, and commands there."""
        self.score = UNKNOWN
        """Score of the nominal trajectory."""
        self.further = Extensions(terms, np.diff(constants.t), self.target) if terms else None
        """Terms and limits of a user."""
        self._own_rows = 0 if self.further is None else self.further.rows
        self.fence_rows = 0
        """Rows of fence and corridor at a knot, the last ones of the problem."""
        self.problem = assembly.empty(stages, self._own_rows)
        """Problem of the cycle."""

    def linearise(self) -> None:
        """Linearise along the nominal trajectory."""
        linearise_along(self.lin, self.constants.t, STAGE_S, self.constants.p)

    def set_fence_rows(self, rows: int) -> bool:
        """Set how many rows of a knot are those of fence and corridor, and return True if the problem is another one.

        Parameters
        ----------
        rows : 0 without a fence.
        """
        if rows == self.fence_rows:
            return False
        self.fence_rows, self.problem = rows, assembly.empty(len(self.target) - 1, self._own_rows + rows)
        return True

    def fill(self) -> None:
        """Fill in the problem along the nominal trajectory."""
        self._fill(self.problem, self.lin, self.target)
        if self.fence_rows:
            fence.fill(self.constants, self.lin.X, self.scene, self.fence_rows, self.problem)

    def _fill(self, problem: Problem, lin: Linearisation, target: Array) -> None:
        """Fill in all but the rows of the fence."""
        o = self.constants
        assembly.fill(o, lin, target, problem)
        if self.further is not None:
            scale = np.concatenate([o.state_scale, o.thrust_scale, o.thrust_scale])
            self.further.add(problem, limits.ROWS, lin.X, lin.U, scale)

    def commands(self, z: Array) -> Array:
        """Return the commands (N+1, 2) of a solution (N).

        Parameters
        ----------
        z : (N+1, 12) solution; the first row is the command in force.
        """
        commands = z[:, COMMANDS:CHANGES] * self.constants.thrust_scale
        commands += self.lin.U
        return commands

    @property
    def position_scale_m(self) -> float:
        """Scale S of a position."""
        return float(self.constants.state_scale[0])

    def full_problem(self) -> Problem:
        """Return a problem in which every number that can differ from zero does: it gives the pattern.

        Otherwise the pattern, and with it the rounding, would depend on what was solved before.
        """
        N, n, m, M = self.problem.sizes
        full, first = Problem.empty(N, n, m, M), M - self.fence_rows
        self._fill(full, _any_motion(self.constants), np.ones_like(self.target))
        full.G[1:, first:, :2], full.low[1:, first:], full.penalty[1:, first:] = 1.0, -1.0, 1.0
        return full


APPROACH_S = 4.0
"""T_p of the paper's vehicle: an error is to vanish in about the length of a horizon. This constant and the next two
are scaled to another vehicle by ``Constants.time_ratio``.
"""
SURGE_S = 1.0
"""T_u: time constant of the surge motion at half speed."""
TURN_RADPS = 0.5
"""w0: natural frequency of the heading law."""
MAX_TURN_PER_STAGE = 0.5
"""Largest w0 times a stage's length (rad): commands are linear between knots, so they cannot follow a faster law."""


@jit
def steering_guess(o: Constants, start: Array, target: Array, astern: bool, C: Array, X: Array, U: Array) -> None:
    """Simulate the steering law.

    Parameters
    ----------
    o, start, target, C : as at the head of this file.
    astern : True to steer with the stern ahead.
    X, U : are overwritten.
    """
    p, N = coefficients(o.p), len(target) - 1
    copy_to(X[0], start[:STATES])
    copy_to(U[0], start[STATES:])
    fastest = steady_speed(o.high[0] + o.high[1], p.linear_surge, p.quadratic_surge)
    sign = -1.0 if astern else 1.0
    h = (o.t[1] - o.t[0]) * STAGE_S
    lag = lag_table(h, p)
    for k in range(N):
        x = X[k]
        g = o.t[k + 1] - o.t[k]
        before, h = h, g * STAGE_S
        if h != before:
            lag = lag_table(h, p)
        # ref' over the stage: the target at knot 0 is not known; with one stage it is the velocity wanted at the end
        vn, ve = target[N, 0], target[N, 1]
        if N > 1:
            end = max(k, 1)
            length = (o.t[end + 1] - o.t[end]) * STAGE_S
            vn, ve = (target[end, 0] - target[end - 1, 0]) / length, (target[end, 1] - target[end - 1, 1]) / length
        # w = (ref - p) / T_p + ref' - c, limited
        wn = (target[k, 0] - vn * h - x[0]) / (APPROACH_S * o.time_ratio) + vn - C[k, 0]
        we = (target[k, 1] - ve * h - x[1]) / (APPROACH_S * o.time_ratio) + ve - C[k, 1]
        size = np.sqrt(wn * wn + we * we)
        if size > fastest:
            wn, we = wn * fastest / size, we * fastest / size
        turn = np.arctan2(sign * we, sign * wn) - x[4]
        turn -= 2.0 * np.pi * np.round(turn / (2.0 * np.pi))
        wanted = min(max(wn * np.cos(x[4]) + we * np.sin(x[4]), o.low_state[0]), o.high_state[0])
        w0 = min(TURN_RADPS / o.time_ratio, MAX_TURN_PER_STAGE / h)
        yaw = p.inertia_yaw * (w0 * w0 * turn - 2.0 * w0 * x[5])
        surge = (
            p.mass_surge * (wanted - x[2]) / max(SURGE_S * o.time_ratio, h)
            + (p.linear_surge + p.quadratic_surge * abs(wanted)) * wanted
        )
        # F1 + F2 = X, F1 a1 - F2 a2 = N
        arms = p.arm_port + p.arm_starboard
        F = ((surge * p.arm_starboard + yaw) / arms, (surge * p.arm_port - yaw) / arms)
        for i in range(2):
            low, high = command_bounds(U[0, i], o.t[k + 1] * o.max_change[i], o.low[i], o.high[i])
            U[k + 1, i] = min(max(F[i], low, U[k, i] - g * o.max_change[i]), high, U[k, i] + g * o.max_change[i])
        advance_stage(X[k], U[k], U[k + 1], C[k], C[k + 1], h, p, lag, X[k + 1])


PREVIOUS_PLAN, STEERED_AHEAD, STEERED_ASTERN = range(3)
"""Origin of the nominal trajectory: the previous plan, or the steering law ahead or astern."""

FAR_LESS = 0.1
"""Largest cost for the zones of a guess, over that of the previous plan, with which it may replace it."""

STEPS = (1.0, 0.5, 0.25, 0.1)
"""Fractions of the QP's step, tried in this order until the cost along the exact flow does not rise."""


@jit
def ramp_to(o: Constants, start: Array, goal: Array, C: Array, X: Array, U: Array) -> None:
    """Move the lateral thrusters to given commands at the slew limit, and predict the motion.

    Parameters
    ----------
    o, start, goal, C : as at the head of this file.
    X, U : are overwritten.
    """
    copy_to(U, goal)
    copy_to(X[0], start[:STATES])
    copy_to(U[0], start[STATES:])
    clip_to_limits(U, o.t, o.low, o.high, o.max_change)
    propagate(X, U, C, o.t, STAGE_S, coefficients(o.p))


@jit
def _measure(o: Constants, X: Array, U: Array, C: Array, target: Array) -> tuple[float, bool, float]:
    """Return cost, ``stuck`` and ``tail`` of the ``Score`` of a trajectory."""
    end = check_terminal(X, C, target, o)
    return cost(X, U, C, target, o), end.stuck, end.tail_cost


def _score(cycle: Cycle, X: Array, U: Array, most: float = math.inf) -> Score:
    """Return the score of a trajectory; ``UNKNOWN`` if its terms cost more than ``most``."""
    of_terms, stuck, tail = _measure(cycle.constants, X, U, cycle.lin.C, cycle.target)
    if of_terms > most:
        return UNKNOWN
    further = 0.0 if cycle.further is None else cycle.further.cost(X, U)
    zones = fence_cost(X, cycle.scene, cycle.constants.t, cycle.position_scale_m) if cycle.fence_rows else 0.0
    return Score(of_terms + further, zones, stuck, tail)


def choose_nominal(cycle: Cycle, start: Array, old: Array, stages: float, *, was_clear: bool) -> int:
    """Choose the nominal trajectory, and linearise along it.

    The candidates are the previous plan and two steering guesses, ahead and astern; the one of least cost is chosen.
    Where one of two ends stuck (terminal_check.py), the cost beyond the horizon counts too, unless the candidate comes
    nearer to the zones than the best one so far. A plan that was clear of the zones may lack clearance a cycle later,
    as the motion astern is not stable. The QP mends that, but seldom a guess through a zone. So a guess replaces such a
    plan only if it lacks ``FAR_LESS`` of what the plan lacks.

    Parameters
    ----------
    cycle : has target, zones and the current; the rest of its linearisation is overwritten.
    start : as at the head of this file.
    old : (N+1, 2) commands of the previous plan (N).
    stages : by how many first stages the previous plan began earlier; NaN if there is none.
    was_clear : True if the previous plan lacked no clearance when it was made.

    Returns
    -------
    PREVIOUS_PLAN, STEERED_AHEAD or STEERED_ASTERN.
    """
    lin, best, kind = cycle.lin, UNKNOWN, STEERED_AHEAD
    cycle.start[:] = start
    if not math.isnan(stages):
        goal = old.copy()
        shooting_grid.shift(goal, cycle.constants.t, stages)
        ramp_to(cycle.constants, start, goal, lin.C, lin.X, lin.U)
        kind, best = PREVIOUS_PLAN, _score(cycle, lin.X, lin.U)
    for other_kind in (STEERED_AHEAD,) if cycle.constants.low_state[0] >= 0.0 else (STEERED_AHEAD, STEERED_ASTERN):
        X, U = np.empty_like(lin.X), np.empty_like(lin.U)
        steering_guess(cycle.constants, start, cycle.target, other_kind == STEERED_ASTERN, lin.C, X, U)
        other = _score(cycle, X, U, math.inf if best.stuck else best.cost + best.fence)
        if other is UNKNOWN:
            continue
        if was_clear and kind == PREVIOUS_PLAN and other.fence > FAR_LESS * best.fence:
            continue
        # A way through a zone leads to no end, so what comes after it does not count in its favour.
        tail = 1.0 if (best.stuck or other.stuck) and other.fence <= best.fence else 0.0
        before = best.cost + best.fence + tail * best.tail
        if other.cost + other.fence + tail * other.tail < before or math.isinf(best.cost):
            kind, best = other_kind, other
            lin.X[...], lin.U[...] = X, U
    cycle.linearise()
    cycle.score = best
    return kind


def _any_motion(o: Constants) -> Linearisation:
    """Return a linearisation along a motion that is like no other: no number is zero by chance."""
    lin, rng = Linearisation.empty(len(o.t) - 1), np.random.default_rng(0)
    lin.C[:] = rng.normal(size=lin.C.shape)
    start, goal = rng.normal(size=CHANGES), rng.normal(size=lin.U.shape)
    p = coefficients(o.p)
    learned = o._replace(p=np.array(p._replace(added_munk=0.5 * p.mass_surge)))  # none may be learned yet
    ramp_to(learned, start, goal, lin.C, lin.X, lin.U)
    linearise_along(lin, learned.t, STAGE_S, learned.p)
    return lin


def line_search(cycle: Cycle, commands: Array, X: Array, U: Array) -> float:
    """Find the largest step from the nominal trajectory towards the QP's commands that does not raise the cost.

    The QP knows the motion to first order only, so a full step can cost more than none. The solver meets box and slew
    to its tolerance; the trajectory found here meets them exactly.

    Parameters
    ----------
    cycle : has the nominal trajectory, its score, target and zones; the score becomes that of the trajectory found.
    commands : (N+1, 2) port and starboard thrust that the QP asks for (N).
    X, U : are overwritten with states and commands of the trajectory found.

    Returns
    -------
    The fraction of the step taken; 0 if no step qualifies, and X and U are then the nominal trajectory.
    """
    lin, before = cycle.lin, cycle.score
    for part in STEPS:
        ramp_to(cycle.constants, cycle.start, lin.U + part * (commands - lin.U), lin.C, X, U)
        after = _score(cycle, X, U)
        if after.cost + after.fence <= before.cost + before.fence:
            if after.stuck and not before.stuck and after.fence >= before.fence:
                break  # within the horizon it costs less not to turn; but a way out of a zone is taken
            cycle.score = after
            return part
    X[...], U[...] = lin.X, lin.U
    return 0.0
