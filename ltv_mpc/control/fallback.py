"""Fallback levels: lateral plans for a cycle in which the QP gives none.

    shifted   the rest of the last solved plan, on the new knots. At the end of that plan, and at the latest
              ``MAX_SHIFT_NS`` after its start, the thrusters ramp to zero
    zero      both lateral thrusters ramp to zero at their slew limits

In the mode HOLD the lateral plan is ``stop``: it stops the vehicle through the water. With surge mass M_u, yaw inertia
I, predicted surge u and yaw rate r at the plan's start, and t from there on,

    F1 + F2 = -M_u u / T exp(-t / T),    F1 a1 - F2 a2 = -I r / T exp(-t / T),    T = 2 (lag + 0.3 s)

inside box and slew. Each cycle begins the law again from its own prediction; at rest it gives zero.

A plan of the QP, or the rest of one, may lead the vehicle into a zone of the fence if no other plan follows it: the
actuators follow it until its end, then the vehicle coasts. Such a plan gets a braking tail: from the time on at which
the second plan after it is missing, it stops the vehicle by the law above.

The level is named in the plan (``Plan.origin``), with the reason (``Plan.why``). Every level keeps box and slew, and
begins at the commands in force.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ltv_mpc.control import nominal, shooting_grid
from ltv_mpc.control.config import STAGE_NS
from ltv_mpc.control.nominal import Cycle
from ltv_mpc.control.prediction import Start
from ltv_mpc.control.vertical import ramp
from ltv_mpc.messages import Array, Pair, Plan, PlanOrigin, Solve, SolveStatus, Times
from ltv_mpc.safety.health import REPLACEMENTS_MISSING, plan_end_ns
from ltv_mpc.vehicle.flow import STATES
from ltv_mpc.vehicle.parameters import Vehicle

MAX_SHIFT_NS = 10_000_000_000
"""Longest time after its start for which a solved plan is followed: its preview of the current becomes outdated."""

NOT_RUN = Solve(status=SolveStatus.NOT_RUN)
"""Report of a solver that was not called."""


class LateralPlan(NamedTuple):
    """Lateral part of a plan."""

    X: Array  # (N+1, 8) states at the knots
    U: Array  # (N+1, 2) commands of port and starboard at the knots (N)
    origin: PlanOrigin
    solve: Solve
    why: str  # reason why it is not the QP's plan; empty if it is


class PreviousPlan:
    """Plan that was sent last: the next cycle linearises along it, or sends the rest of it.

    The next cycle uses it only if its origin is "solved" or "shifted".
    """

    def __init__(self, knots_ns: Times) -> None:
        """Start without a plan; ``knots_ns`` (N+1,) are the knots after the plan's start (ns)."""
        self.knots_ns = knots_ns
        self.plan: Plan | None = None
        """The plan, whatever it came from."""
        self.solved_until_ns = 0
        """Vehicle time (ns) until which the last solved plan may be followed; a shifted plan then ramps to zero."""
        self.shares: Pair = (1.0, 1.0)
        """Shares of their commands that port and starboard deliver."""
        self.unbraked: Array | None = None
        """(N+1, 2) commands of a plan that came from a solve, before it got a braking tail (N)."""
        self._no_commands = np.zeros((len(knots_ns), 2))
        self._max_shift_ns = min(int(knots_ns[-1]), MAX_SHIFT_NS)

    def record(self, plan: Plan) -> None:
        """Record the plan of a cycle.

        Parameters
        ----------
        plan : is sent by this cycle.
        """
        self.plan = plan
        if plan.origin is PlanOrigin.SOLVED:
            self._set_end(plan)

    def restore(self, plan: Plan) -> None:
        """Continue from the last plan of another controller.

        Parameters
        ----------
        plan : is in force at the actuators. If its horizon is another one, no cycle can begin from it.
        """
        if plan.origin is PlanOrigin.SHIFTED:  # its end of the solved part shows in its commands alone
            moving = np.flatnonzero(plan.thrust_N[:, :2].any(axis=1))
            self.solved_until_ns = int(plan.t_ns[moving[-1] if len(moving) else 0])
        else:
            self._set_end(plan)
        self.unbraked = None
        same_knots = np.array_equal(plan.t_ns - plan.t_ns[0], self.knots_ns)
        self.plan = plan if same_knots else None

    def lateral_commands(self, start_ns: int) -> tuple[float, Array]:
        """Return the lateral commands of a plan that came from a solve.

        Parameters
        ----------
        start_ns : start of the new plan, vehicle time (ns).

        Returns
        -------
        How many stages of 0.3 s the plan began before ``start_ns``, and its commands (N+1, 2) in N, times the shares
        that are delivered. NaN and zeros if there is no such plan.
        """
        plan = self.plan
        if plan is None or (plan.origin is not PlanOrigin.SOLVED and plan.origin is not PlanOrigin.SHIFTED):
            return math.nan, self._no_commands
        commands = plan.thrust_N[:, :2] if self.unbraked is None else self.unbraked
        return (start_ns - int(plan.t_ns[0])) / STAGE_NS, commands * self.shares

    def _set_end(self, plan: Plan) -> None:
        self.solved_until_ns = int(plan.t_ns[0]) + self._max_shift_ns


class Fallback:
    """Lateral plans below the solved one."""

    def __init__(self, vehicle: Vehicle, cycle: Cycle, previous: PreviousPlan, period_ns: int) -> None:
        """Prepare the levels.

        Parameters
        ----------
        vehicle : parameters of the vehicle.
        cycle : has constants and current.
        previous : plan that was sent last; its owner keeps it up to date.
        period_ns : of the plans (ns).
        """
        knots_ns = previous.knots_ns
        end_ns = plan_end_ns(knots_ns, period_ns, vehicle.plan_timeout_s)
        self._end = int(np.searchsorted(knots_ns, end_ns, "right"))  # first knot after the end of a plan
        self._brake = int(np.searchsorted(knots_ns[:-1], round(REPLACEMENTS_MISSING * period_ns)))
        self._cycle = cycle
        self._previous = previous
        self._zero = np.zeros((len(previous.knots_ns), 2))
        port, starboard = vehicle.thruster.port, vehicle.thruster.starboard
        time_s = 2.0 * (max(port.lag_s, starboard.lag_s) + STAGE_NS * 1e-9)
        mixing = [[1.0, 1.0], [port.arm_m, -starboard.arm_m]]  # of F1, F2 (N) to surge force (N) and yaw moment (N m)
        masses = np.diag([vehicle.surge.mass_kg, vehicle.yaw.inertia_kgm2])
        self._stopping_gain = np.linalg.solve(mixing, -masses / time_s)  # of surge and yaw rate to F1, F2
        self._decay = np.exp(-1e-9 * knots_ns / time_s)

    def plan(self, start: Start, solve: Solve) -> LateralPlan:
        """Return the plan of the first level that gives one.

        Parameters
        ----------
        start : the vehicle at the plan's start.
        solve : report of the solve that gave no plan.
        """
        shifted = self.shift(start, solve) if start.t_ns < self._previous.solved_until_ns else None
        return shifted or self.ramp(start, solve.why)._replace(solve=solve)

    def shift(self, start: Start, solve: Solve) -> LateralPlan | None:
        """Return the rest of the previous plan on the new knots, with zero thrust beyond the end of what was solved.

        Parameters
        ----------
        start : the vehicle at the plan's start.
        solve : report of the solve that gave no plan.

        Returns
        -------
        The plan; None if there is no plan to shift, or if the predicted motion is not finite.
        """
        stages, commands = self._previous.lateral_commands(start.t_ns)
        if math.isnan(stages):
            return None
        (X, U), goal = self.empty(), commands.copy()
        shooting_grid.shift(goal, self._previous.knots_ns / STAGE_NS, stages)
        goal[start.t_ns + self._previous.knots_ns > self._previous.solved_until_ns] = 0.0
        nominal.ramp_to(self._cycle.constants, start.lateral, goal, self._cycle.lin.C, X, U)
        if not (np.isfinite(X).all() and np.isfinite(U).all()):
            return None
        return LateralPlan(X, U, PlanOrigin.SHIFTED, solve, solve.why)

    def ramp(self, start: Start, why: str, goal: Array | None = None) -> LateralPlan:
        """Ramp the lateral thrusters to a goal at their slew limits.

        Parameters
        ----------
        start : the vehicle at the plan's start.
        why : reason that the plan gives.
        goal : (N+1, 2) thrusts of port and starboard at the knots (N); zero if None.
        """
        lateral = self._zero if goal is None else goal
        origin = PlanOrigin.MANUAL if goal is not None and goal.any() else PlanOrigin.ZERO
        return self._ramp_to(lateral, start, origin, why)

    def stop(self, start: Start, why: str) -> LateralPlan:
        """Stop the vehicle through the water: the law at the head of this file.

        Parameters
        ----------
        start : the vehicle at the plan's start.
        why : reason that the plan gives.
        """
        thrust = self._stopping_gain @ start.lateral[[2, 5]]  # by surge and yaw rate
        return self._ramp_to(np.outer(self._decay, thrust), start, PlanOrigin.STOP, why)

    def with_braking_tail(self, start: Start, plan: LateralPlan) -> LateralPlan:
        """Return a plan that stops the vehicle from the knot on at which the second plan after it is missing.

        Parameters
        ----------
        start : the vehicle at the plan's start.
        plan : its states and commands.
        """
        goal, b = plan.U.copy(), self._brake
        thrust = self._stopping_gain @ plan.X[b, [2, 5]]
        goal[b + 1 :] = np.outer(self._decay[b + 1 :] / self._decay[b], thrust)
        goal[self._end :] = 0.0
        return self._ramp_to(goal, start, plan.origin, plan.why)._replace(solve=plan.solve)

    def coasting(self, start: Start, plan: LateralPlan) -> LateralPlan:
        """Return what a plan comes to if no other one follows it: the thrusters ramp to zero.

        Parameters
        ----------
        start : the vehicle at the plan's start.
        plan : its commands.
        """
        goal = plan.U.copy()
        goal[self._end :] = 0.0
        return self._ramp_to(goal, start, plan.origin, plan.why)

    def _ramp_to(self, goal: Array, start: Start, origin: PlanOrigin, why: str) -> LateralPlan:
        """Approach the goal (N+1, 2) in box and slew."""
        X, U = self.empty()
        nominal.ramp_to(self._cycle.constants, start.lateral, goal, self._cycle.lin.C, X, U)
        if not math.isfinite(np.vdot(X, X)):
            X = np.nan_to_num(X, posinf=0.0, neginf=0.0)
        return LateralPlan(X, U, origin, NOT_RUN, why)

    def empty(self) -> tuple[Array, Array]:
        """Return uninitialised states (N+1, 8) and commands (N+1, 2) of a plan."""
        knots = len(self._zero)
        return np.empty((knots, STATES)), np.empty((knots, 2))


def ramp_to_rest(vehicle: Vehicle, command_N: Array, knots_ns: Times, vertical_N: float) -> Array:
    """Ramp all thrusters to rest at their slew limits, without any model of the vehicle's motion.

    Parameters
    ----------
    vehicle : slew limits of its thrusters are used.
    command_N : (3,) commands of port, starboard and vertical in force at the first knot (N).
    knots_ns : (N+1,) knots, vehicle time (ns).
    vertical_N : command of the vertical thruster at rest (N); the lateral ones rest at zero.

    Returns
    -------
    (N+1, 3) commands (N).
    """
    thrust = np.empty((len(knots_ns), 3))
    for i, (thruster, rest) in enumerate(zip(vehicle.thrusters, (0.0, 0.0, vertical_N), strict=True)):
        goal = np.full(len(knots_ns), rest)
        thrust[:, i] = ramp(float(command_N[i]), goal, knots_ns, thruster.slew_N_per_s)
    return thrust
