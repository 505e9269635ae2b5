"""Nominal trajectory: the solution of the equations of motion that a cycle linearises along, and the step from it.

It starts at the predicted state. It is the previous plan on the new knots, or a steering guess where that costs less
(initial_guess.py). From there a line search along the exact flow goes towards the QP's commands.

Arguments of the kernels in this file:

    packed   packed constants (problem_data.py)
    start    (10,) state n, e, u, v, psi, r, F1, F2 at the first knot, then the commands of port and starboard there
    target   (N+1, 3) as in ``ocp/terms``
    old      (N+1, 2) commands of the previous plan (N)
    stages   by how many first stages the previous plan began earlier
    flat     ``Linearisation.flat``
    C        (N+1, 2) current at the knots, north and east (m/s)
    X, U     (N+1, 8) states and (N+1, 2) commands (N) at the knots; overwritten
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.control.fence_clearance import Scene, entry_s, fence_cost, is_near
from ltv_mpc.control.horizon_limits import clip_to_limits
from ltv_mpc.control.initial_guess import steering_guess
from ltv_mpc.control.linearisation import Linearisation, linearise_rollout, propagate, unpack_linearisation
from ltv_mpc.control.ocp.assembly import cost
from ltv_mpc.control.ocp.cycle import UNKNOWN, Cycle, Score
from ltv_mpc.control.problem_data import Constants, Objective, unpack_constants
from ltv_mpc.control.shooting_grid import locate
from ltv_mpc.control.terminal_check import check_terminal
from ltv_mpc.jit import copy_to, jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.flow import STATES

PREVIOUS_PLAN, STEERED_AHEAD, STEERED_ASTERN = range(3)
"""Origin of the nominal trajectory: the previous plan, or the steering law ahead or astern."""

FAR_LESS = 0.1
"""Largest cost for the zones of a guess, over that of the previous plan, with which it may replace it."""

STEPS = (1.0, 0.5, 0.25, 0.1)
"""Fractions of the QP's step, tried in this order until the cost along the exact flow does not rise."""


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
    start, old : as at the head of this file.
    stages : as there; NaN if there is no previous plan.
    was_clear : True if the previous plan lacked no clearance when it was made.

    Returns
    -------
    PREVIOUS_PLAN, STEERED_AHEAD or STEERED_ASTERN.
    """
    packed, target, lin, guess, scene = cycle.packed, cycle.target, cycle.lin, cycle.guess, cycle.scene
    kind, best = STEERED_AHEAD, UNKNOWN
    if not math.isnan(stages):
        best = Score(*_continue(packed, start, old, stages, target, lin.flat, scene))
        kind, best = PREVIOUS_PLAN, best._replace(cost=best.cost + cycle.further.cost(lin.X, lin.U))
    guess.C[...] = lin.C
    for other_kind in (STEERED_AHEAD, STEERED_ASTERN):
        least = math.inf if best.stuck else best.cost + best.fence
        other = Score(*_steer(packed, start, target, other_kind == STEERED_ASTERN, least, guess.flat, scene))
        if math.isinf(other.cost):
            continue
        other = other._replace(cost=other.cost + cycle.further.cost(guess.X, guess.U))
        if was_clear and kind == PREVIOUS_PLAN and other.fence > FAR_LESS * best.fence:
            continue
        # A way through a zone leads to no end, so what comes after it does not count in its favour.
        tail = 1.0 if (best.stuck or other.stuck) and other.fence <= best.fence else 0.0
        before = best.cost + best.fence + tail * best.tail
        if other.cost + other.fence + tail * other.tail < before or math.isinf(best.cost):
            lin.X[...], lin.U[...] = guess.X, guess.U
            kind, best = other_kind, other
    if kind != PREVIOUS_PLAN:
        relinearise(packed, lin.flat, lin.X, lin.U)
    cycle.score = best
    return kind


def any_motion(cycle: Cycle) -> Linearisation:
    """Return a linearisation along a motion that is like no other: no number is zero by chance.

    Parameters
    ----------
    cycle : has the constants.
    """
    lin = Linearisation.empty(len(cycle.target) - 1)
    lin.flat[:] = np.random.default_rng(0).normal(size=lin.flat.shape)
    relinearise(cycle.packed, lin.flat, lin.X.copy(), lin.U.copy())
    return lin


@jit
def _continue(
    packed: Array, start: Array, old: Array, stages: float, target: Array, flat: Array, scene: Scene
) -> tuple[float, float, bool, float]:
    """Linearise along the previous plan on the new knots; return its ``Score``."""
    c, lin = unpack_constants(packed), unpack_linearisation(flat, len(target) - 1)
    _set_initial_knot(start, lin.X, lin.U)
    _shift_into_limits(old, stages, c.objective, lin.U)
    linearise_rollout(lin, c.objective.t, c.stage_s, c.p)
    return _score(lin.X, lin.U, lin.C, target, scene, c)


@jit
def _steer(
    packed: Array, start: Array, target: Array, astern: bool, least: float, flat: Array, scene: Scene
) -> tuple[float, float, bool, float]:
    """Make a steering guess, X and U; return its ``Score``, with infinite cost if it costs more than ``least``."""
    c, guess = unpack_constants(packed), unpack_linearisation(flat, len(target) - 1)
    _set_initial_knot(start, guess.X, guess.U)
    if astern and c.objective.low_state[0] >= 0.0:  # the bow goes first
        return np.inf, np.inf, False, 0.0
    of_terms = steering_guess(guess.X, guess.U, guess.C, target, astern, least, c)
    if np.isinf(of_terms):
        return np.inf, np.inf, False, 0.0
    end = check_terminal(guess.X, guess.C, target, c)
    return of_terms, fence_cost(guess.X, scene, c.objective), end.stuck, end.tail_cost


@jit
def _score(X: Array, U: Array, C: Array, target: Array, scene: Scene, c: Constants) -> tuple[float, float, bool, float]:
    """Return the ``Score`` of a trajectory."""
    end = check_terminal(X, C, target, c)
    return cost(X, U, C, target, c.objective), fence_cost(X, scene, c.objective), end.stuck, end.tail_cost


@jit
def relinearise(packed: Array, flat: Array, X: Array, U: Array) -> None:
    """Linearise along another trajectory, in the same current.

    Parameters
    ----------
    packed : as at the head of this file.
    flat : as there; all but C is overwritten.
    X : (N+1, 8) its states; only the first is used.
    U : (N+1, 2) its commands (N).
    """
    constants, lin = unpack_constants(packed), unpack_linearisation(flat, U.shape[0] - 1)
    copy_to(lin.X, X)
    copy_to(lin.U, U)
    linearise_rollout(lin, constants.objective.t, constants.stage_s, constants.p)


def comes_near(cycle: Cycle) -> bool:
    """Return True if the nominal trajectory comes near to a zone, an obstacle or the edge of the corridor.

    Parameters
    ----------
    cycle : has trajectory and zones.
    """
    return bool(_is_near(cycle.packed, cycle.lin.X, cycle.scene))


@jit
def _is_near(packed: Array, X: Array, scene: Scene) -> bool:
    """Return ``is_near`` of a trajectory."""
    return is_near(X, scene, unpack_constants(packed).objective)


def line_search(cycle: Cycle, commands: Array, X: Array, U: Array) -> tuple[float, bool]:
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
    The fraction of the step taken, and True if the whole step comes too near to a zone, where the nominal trajectory
    does not. The fraction is 0 if no step qualifies, and X and U are then the nominal trajectory.
    """
    packed, target, lin, scene = cycle.packed, cycle.target, cycle.lin, cycle.scene
    before, enters = cycle.score, False
    for part in STEPS:
        after = Score(*_step(packed, lin.flat, target, commands, part, X, U, scene))
        after = after._replace(cost=after.cost + cycle.further.cost(X, U))
        if part == STEPS[0]:
            enters = after.fence > before.fence == 0.0
        if after.cost + after.fence <= before.cost + before.fence:
            if after.stuck and not before.stuck and after.fence >= before.fence:
                break  # within the horizon it costs less not to turn; but a way out of a zone is taken
            cycle.score = after
            return part, enters
    X[...], U[...] = lin.X, lin.U
    return 0.0, enters


@jit
def _step(
    packed: Array, flat: Array, target: Array, commands: Array, part: float, X: Array, U: Array, scene: Scene
) -> tuple[float, float, bool, float]:
    """Take a part of the step towards commands; return the ``Score`` of where it leads, X and U."""
    c, lin = unpack_constants(packed), unpack_linearisation(flat, len(target) - 1)
    o = c.objective
    copy_to(X[0], lin.X[0])
    for k in range(U.shape[0]):
        for i in range(2):
            U[k, i] = lin.U[k, i] + part * (commands[k, i] - lin.U[k, i])
    clip_to_limits(U, o.t, o.low, o.high, o.max_change)
    propagate(X, U, lin.C, o.t, c.stage_s, c.p)
    return _score(X, U, lin.C, target, scene, c)


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
