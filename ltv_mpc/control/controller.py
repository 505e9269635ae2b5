"""One cycle of the controller, from the newest estimate to a plan.

    estimate --predict--> state at the plan's start --linearise--> LTV model along the previous plan --build--> QP
             --solve--> commands at the knots --read--> plan

Figures: Medagoda & Williams 2012, Fig 5 (dead time), section V (horizon); beyond it: analytic sensitivities, thruster
lag and slew in the model, one convex QP a cycle.
"""

from __future__ import annotations

import copy
import math
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.control import trajectory
from ltv_mpc.control.commands import SentCommands
from ltv_mpc.control.config import STAGE_NS, ControllerConfig
from ltv_mpc.control.constants import pack
from ltv_mpc.control.delay import Delay
from ltv_mpc.control.disturbance import CurrentBias
from ltv_mpc.control.horizon import Linearisation
from ltv_mpc.control.prediction import Prediction, Start, current_in, currents, profile_of
from ltv_mpc.control.qp.failed import FailedQp
from ltv_mpc.control.scales import settled
from ltv_mpc.control.solvers import make
from ltv_mpc.control.vertical import VerticalPlan, follow
from ltv_mpc.node import Stopwatch, no_stopwatch
from ltv_mpc.references import Reference
from ltv_mpc.references.follower import NO_PROGRESS, Follower
from ltv_mpc.safety.authority import Override
from ltv_mpc.signals import (
    Applied,
    Array,
    Authority,
    CycleTiming,
    Estimate,
    Plan,
    PlanOrigin,
    Solve,
    SolveStatus,
    Times,
)
from ltv_mpc.vehicle.flow import STATES
from ltv_mpc.vehicle.parameters import Vehicle

STAGE_S = STAGE_NS * 1e-9

COLD_PASSES = 6
"""Linearisations of the first cycle, whose guess is crude."""

LONGEST_INTEGRATION_S = 2.0
"""After a longer silence the depth error was not this all the time."""

OLDEST_ESTIMATE_NS = 10_000_000_000
"""An estimate that is further than this from now says nothing of where the vehicle is."""


class _Memory(NamedTuple):
    """What a cycle leaves to the next."""

    start_ns: int  # of its first knot
    U: Array  # (N+1, 2)


class _Lateral(NamedTuple):
    """What a cycle wants of the lateral thrusters, and how it came to it."""

    X: Array  # (N+1, 8)
    U: Array  # (N+1, 2)
    origin: PlanOrigin
    solve: Solve
    why: str


class Controller:
    """Plans the thrusts of one vehicle along one reference."""

    def __init__(
        self,
        vehicle: Vehicle,
        reference: Reference,
        config: ControllerConfig | None = None,
        *,
        stopwatch: Stopwatch = no_stopwatch,
    ) -> None:
        """``stopwatch`` is called with a stage's name when that stage of a cycle ends. Raises ``ConfigError``."""
        self.config = config = settled(config or ControllerConfig(), vehicle)
        self.vehicle = vehicle
        self._numbers = pack(vehicle, config.weights, config.knots, STAGE_S)
        self._lap = stopwatch
        self._solver = make(vehicle, config)
        self._lin = Linearisation.empty(config.stages)
        self._knots = config.knots
        self._ahead_ns = np.round(self._knots * STAGE_NS).astype(np.int64)
        self._target = np.zeros((config.stages + 1, 2))
        self._nothing = np.zeros((config.stages + 1, 2))
        self._passes = COLD_PASSES
        self._commands = SentCommands(vehicle)
        self._prediction = Prediction(vehicle)
        self._bias = None if config.disturbance.sd_mps == 0 else CurrentBias(config.disturbance)
        self._delay = Delay(round(config.first_delay_s * 1e9), config.delay_quantile)
        self._memory: _Memory | None = None
        self._integral_N = 0.0
        self._integrated_ns: int | None = None
        self.failed: FailedQp | None = None
        """The problem that was not solved last, if ever one was not."""
        self.follow(reference)

    def follow(self, reference: Reference) -> None:
        """Another reference from the next cycle on. It begins at the first estimate after its start."""
        self._follower = Follower(reference, self.vehicle)

    def report(self, applied: Applied) -> None:
        """What the actuators say they do."""
        self._delay.receipt(applied)
        self._prediction.report(applied)
        self._commands.reported(applied.t_ns, applied.command_N)

    def timing(self, timing: CycleTiming) -> None:
        """What the last cycle took."""
        self._delay.timing(timing)

    def plan(
        self,
        estimate: Estimate,
        *,
        t_ns: int | None = None,
        applied: Applied | None = None,
        override: Override | None = None,
    ) -> Plan:
        """One cycle.

        ``estimate``: the newest; ``t_ns``: now, the estimate's own time if left out; ``applied``: the actuators'
        report, without which the controller assumes that its plans were followed; ``override``: someone else commands
        the thrusters. Never raises for what an input holds: a plan that is not the QP's says so in ``origin`` and
        ``why``.
        """
        now = estimate.t_ns if t_ns is None else t_ns
        if applied is not None:
            self.report(applied)
        if self._bias is not None:
            estimate = self._bias.corrected(estimate, self._prediction, self._commands)
        begun, idle = False, ""
        if abs(now - estimate.t_ns) > OLDEST_ESTIMATE_NS:
            idle = f"the newest estimate is {(now - estimate.t_ns) * 1e-9:.0f} s old"
            # Not to be rolled over such a time, nor to begin at; the thrusters go to rest, the vertical one too.
            estimate = msgspec.structs.replace(estimate, t_ns=now)
        elif override is not None:
            idle = override.why
        elif not (begun := self._follower.begin(estimate)):
            idle = "the reference has not begun"
        elif not self.config.lateral:
            idle = "lateral control is off"
        if not idle:
            self._delay.solves_from(now)
        delay_ns = self._delay.expected_ns()
        start = self._prediction.roll(estimate, now + delay_ns, self._commands)
        knots = start.t_ns + self._ahead_ns
        profile = profile_of(estimate)
        if begun:
            here = current_in(profile.depth_m, profile.north_mps, profile.east_mps, start.depth_m)
            self._follower.advance(knots, start.lateral, here)
        goal = None if override is None else override.goal(knots)
        if goal is None:
            vertical = self._vertical_plan(start, knots, begun and estimate.depth_m is not None)
        else:
            vertical = self._overridden(start, knots, goal)
        currents(profile.depth_m, profile.north_mps, profile.east_mps, vertical.depth_m, self._lin.flat)
        self._lap("predict")
        if idle:
            lateral = self._released(start, idle, goal)
        else:
            self._follower.fill(knots, self._target)
            lateral = self._solve(start)
        progress = self._follower.progress if begun else NO_PROGRESS
        thrust = np.empty((len(knots), 3))
        thrust[:, :2], thrust[:, 2] = lateral.U, vertical.thrust_N
        plan = Plan(
            cycle_t_ns=now,
            t_ns=knots,
            thrust_N=thrust,
            states=lateral.X[:, :6].copy(),
            origin=lateral.origin,
            solve=lateral.solve,
            why=lateral.why,
            authority=Authority.CONTROLLER if override is None else override.authority,
            estimate_t_ns=estimate.t_ns,
            expected_delay_ns=delay_ns,
            reference_m=self._follower.target_m if begun else None,
            reference_depth_m=self._follower.depth_m if begun else None,
            progress=progress.share,
            cross_track_m=progress.cross_track_m,
            remaining_m=progress.remaining_m,
        )
        self._commands.sent(plan)
        self._integrate(vertical, start.t_ns)
        self._lap("read")
        return plan

    def remember(self, other: Controller) -> None:
        """Go on from where ``other`` is: its reference, the plans that it sent, its last plan. The solver's own warm
        start stays: so several controllers can be held against each other on the same problems.
        """
        self._follower = other._follower.copy()
        self._memory, self._passes = other._memory, other._passes
        self._integral_N, self._integrated_ns = other._integral_N, other._integrated_ns
        self._commands = copy.deepcopy(other._commands)
        self._prediction = copy.deepcopy(other._prediction)
        self._delay = copy.deepcopy(other._delay)

    # --- the parts of a cycle ---

    def _vertical_plan(self, start: Start, knots: Times, follows: bool) -> VerticalPlan:
        """The vertical thruster's law; at rest before the start, and where no depth is wanted or none is known."""
        wanted = self._follower.depths(knots) if follows else None
        if wanted is None:
            rest = self._commands.at(knots)[:, 2]
            return VerticalPlan(np.full(len(knots), start.depth_m), rest, 0.0)
        plan = follow(
            self._numbers,
            start.depth_m,
            start.sinking_mps,
            start.vertical_N,
            start.vertical_command_N,
            self._integral_N,
            *wanted,
        )
        return VerticalPlan(*plan)

    def _integrate(self, vertical: VerticalPlan, start_ns: int) -> None:
        """The integral goes on from the last plan's start to this one's."""
        if self._integrated_ns is not None:
            seconds = min(max(start_ns - self._integrated_ns, 0) * 1e-9, LONGEST_INTEGRATION_S)
            self._integral_N += vertical.integral_rate_N_per_s * seconds
        self._integrated_ns = start_ns

    def _room(self) -> tuple[Array, Array]:
        """For states (N+1, 8) and commands (N+1, 2) of a plan."""
        return np.empty((self.config.stages + 1, STATES)), np.empty((self.config.stages + 1, 2))

    def _overridden(self, start: Start, knots: Times, goal: Array) -> VerticalPlan:
        """The vertical thruster goes to what someone else asks for, goal (N+1, 3), at the slew limit."""
        vertical = self.vehicle.thrusters[2]
        thrust = np.empty(len(knots))
        thrust[0] = start.vertical_command_N
        for k, reach in enumerate(np.diff(knots) * (1e-9 * vertical.slew_N_per_s)):
            thrust[k + 1] = thrust[k] + min(max(goal[k + 1, 2] - thrust[k], -reach), reach)
        return VerticalPlan(np.full(len(knots), start.depth_m), thrust, 0.0)

    def _released(self, start: Start, why: str, goal: Array | None) -> _Lateral:
        """The lateral thrusters go to goal (N+1, 3), zero where there is none, at the slew limit."""
        X, U = self._room()
        lateral = self._nothing if goal is None else np.ascontiguousarray(goal[:, :2])
        trajectory.release(self._numbers, start.lateral, lateral, self._lin.C, X, U)
        self._memory = None
        origin = PlanOrigin.MANUAL if goal is not None and goal.any() else PlanOrigin.ZERO
        return _Lateral(X, U, origin, Solve(status=SolveStatus.NOT_RUN), why)

    def _solve(self, start: Start) -> _Lateral:
        """One linearisation and one QP; several where there is no plan yet."""
        lin, target, numbers = self._lin, self._target, self._numbers
        self._linearise(start)
        X, U = self._room()
        for left in range(self._passes, 0, -1):
            self._lap("linearise")
            self._solver.build(lin, target)
            self._lap("build")
            self._solver.update()
            self._lap("update")
            commands, solve = self._solver.solve()
            self._lap("solve")
            if solve.status is not SolveStatus.SOLVED:
                self.failed = FailedQp(self._solver.problem(), self._solver.rows(), solve)
                if not (solve.status is SolveStatus.ITERATION_LIMIT and np.isfinite(commands).all()):
                    return self._fallback(start, solve)
                # As far as it came: brought into box and slew, and taken only as far as the exact flow is no worse.
            trajectory.step(numbers, lin.flat, target, commands, X, U)
            if left > 1:
                trajectory.again(numbers, lin.flat, self.config.stages, X, U)
        self._passes = 1
        self._memory = _Memory(start.t_ns, U)
        return _Lateral(X, U, PlanOrigin.SOLVED, solve, "")

    def _linearise(self, start: Start) -> None:
        """Along the previous plan on the new knots, or a steered one if that is better; the solver is told which."""
        old = self._memory
        if old is None:
            self._passes = COLD_PASSES
            stages, commands = math.nan, self._nothing
        else:
            stages, commands = (start.t_ns - old.start_ns) / STAGE_NS, old.U
        kind = trajectory.begin(self._numbers, start.lateral, self._target, commands, stages, self._lin.flat)
        if kind == trajectory.CARRIED:
            self._solver.shift(stages)
        else:
            self._solver.forget()

    def _fallback(self, start: Start, solve: Solve) -> _Lateral:
        """The previous plan on the new knots, inside box and slew; without one the thrusters go to zero."""
        old, (X, U) = self._memory, self._room()
        if old is not None:
            stages = (start.t_ns - old.start_ns) / STAGE_NS
            trajectory.shifted(self._numbers, start.lateral, old.U, stages, self._lin.C, X, U)
        if old is None or not (np.isfinite(X).all() and np.isfinite(U).all()):
            return self._released(start, solve.why, None)._replace(solve=solve)
        self._solver.forget()
        self._memory = _Memory(start.t_ns, U)
        return _Lateral(X, U, PlanOrigin.SHIFTED, solve, solve.why)
