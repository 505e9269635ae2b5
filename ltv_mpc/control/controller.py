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
from ltv_mpc.control.limits import ThrustLimits
from ltv_mpc.control.prediction import Prediction, Start, currents, profile_of
from ltv_mpc.control.solvers import make
from ltv_mpc.control.vertical import VerticalPlan, follow
from ltv_mpc.node import Stopwatch, no_stopwatch
from ltv_mpc.references import Reference
from ltv_mpc.references.kinds import Anchor
from ltv_mpc.signals import (
    Applied,
    Array,
    CycleTiming,
    Estimate,
    Pair,
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

USABLE_RESIDUAL = 1e-3
"""A solve that ends at its iteration limit is used where both residuals are below this: its step is tried against the
exact flow like any other, and its commands are inside box and slew like any other's."""


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
        self.config = config = config or ControllerConfig()
        self.vehicle = vehicle
        self._numbers = pack(vehicle, config.weights, config.knots, STAGE_S)
        self._lap = stopwatch
        self._solver = make(vehicle, config)
        self._lin = Linearisation.empty(config.stages)
        self._knots = config.knots
        self._ahead_ns = np.round(self._knots * STAGE_NS).astype(np.int64)
        self._target = np.zeros((config.stages + 1, 2))
        self._nothing = np.zeros((config.stages + 1, 2))
        self._limits = ThrustLimits.of(vehicle, STAGE_S)
        self._passes = COLD_PASSES
        self._commands = SentCommands(vehicle)
        self._prediction = Prediction(vehicle)
        self._bias = CurrentBias(config.disturbance) if config.disturbance.sd_mps > 0 else None
        self._delay = Delay(round(config.first_delay_s * 1e9), config.delay_quantile)
        self._memory: _Memory | None = None
        self._integral_N = 0.0
        self._integrated_ns: int | None = None
        self.follow(reference)

    def follow(self, reference: Reference) -> None:
        """Another reference from the next cycle on. It begins at the first estimate after its start."""
        self._reference = reference
        self._anchor: Anchor | None = None

    def report(self, applied: Applied) -> None:
        """What the actuators say they do."""
        self._delay.receipt(applied)
        self._prediction.report(applied)
        self._commands.reported(applied.t_ns, applied.command_N)

    def timing(self, timing: CycleTiming) -> None:
        """What the last cycle took."""
        self._delay.timing(timing)

    def plan(self, estimate: Estimate, *, t_ns: int | None = None, applied: Applied | None = None) -> Plan:
        """One cycle.

        ``estimate``: the newest; ``t_ns``: now, the estimate's own time if left out; ``applied``: the actuators'
        report, without which the controller assumes that its plans were followed. Never raises for what an input
        holds: a plan that is not the QP's says so in ``origin`` and ``why``.
        """
        now = estimate.t_ns if t_ns is None else t_ns
        if applied is not None:
            self.report(applied)
        if self._bias is not None:
            estimate = self._bias.corrected(estimate, self._prediction, self._commands)
        begun, idle = None, ""
        if abs(now - estimate.t_ns) > OLDEST_ESTIMATE_NS:
            idle = f"the newest estimate is {(now - estimate.t_ns) * 1e-9:.0f} s old"
            # Not to be rolled over such a time, nor to begin at; the thrusters go to rest, the vertical one too.
            estimate = msgspec.structs.replace(estimate, t_ns=now)
        elif (begun := self._begun(estimate)) is None:
            idle = "the reference has not begun"
        elif not self.config.lateral:
            idle = "lateral control is off"
        if not idle:
            self._delay.solves_from(now)
        delay_ns = self._delay.expected_ns()
        start = self._prediction.roll(estimate, now + delay_ns, self._commands)
        knots = start.t_ns + self._ahead_ns
        vertical = self._vertical_plan(start, knots, begun)
        profile = profile_of(estimate)
        currents(profile.depth_m, profile.north_mps, profile.east_mps, vertical.depth_m, self._lin.flat)
        self._lap("predict")
        wanted = None if begun is None else self._reference.position(begun)
        if wanted is None or idle:
            lateral = self._released(start, idle)
        else:
            lateral = self._solve(start, wanted)
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
            estimate_t_ns=estimate.t_ns,
            expected_delay_ns=delay_ns,
            reference_m=wanted,
            reference_depth_m=None if begun is None else self._reference.depth_m,
        )
        self._commands.sent(plan)
        self._integrate(vertical, start.t_ns)
        self._lap("read")
        return plan

    def remember(self, other: Controller) -> None:
        """Go on from where ``other`` is: its reference, the plans that it sent, its last plan. The solver's own warm
        start stays: so several controllers can be held against each other on the same problems.
        """
        self._reference, self._anchor = other._reference, other._anchor
        self._memory, self._passes = other._memory, other._passes
        self._integral_N, self._integrated_ns = other._integral_N, other._integrated_ns
        self._commands = copy.deepcopy(other._commands)
        self._prediction = copy.deepcopy(other._prediction)
        self._delay = copy.deepcopy(other._delay)

    # --- the parts of a cycle ---

    def _begun(self, estimate: Estimate) -> Anchor | None:
        if self._anchor is None and self._reference.begun(estimate.t_ns):
            self._anchor = self._reference.anchor(estimate)
        return self._anchor

    def _vertical_plan(self, start: Start, knots: Times, begun: Anchor | None) -> VerticalPlan:
        """The vertical thruster at rest before the start and where no depth is wanted, else its law."""
        wanted = None if begun is None else self._reference.depths(knots, begun)
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

    def _released(self, start: Start, why: str) -> _Lateral:
        """The lateral thrusters go to zero at the slew limit."""
        X, U = self._room()
        trajectory.release(self._numbers, start.lateral, self._lin.C, X, U)
        self._memory = None
        return _Lateral(X, U, PlanOrigin.ZERO, Solve(status=SolveStatus.NOT_RUN), why)

    def _solve(self, start: Start, wanted: Pair) -> _Lateral:
        """One linearisation and one QP; several where there is no plan yet."""
        lin, target, numbers = self._lin, self._target, self._numbers
        target[:-1] = wanted
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
            if not _usable(solve):
                return self._fallback(start, solve)
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
        """The trajectory linearised along: the previous plan on the new knots, inside box and slew already."""
        lin = self._lin
        X, U = lin.X.copy(), lin.U.copy()
        if self._memory is None or not (np.isfinite(X).all() and np.isfinite(U).all()):
            self._memory = None
            U[1:] = 0.0
            U = self._limits.enforced(U, self._knots)
            return _Lateral(X, U, PlanOrigin.ZERO, solve, solve.why)
        self._solver.forget()
        self._memory = _Memory(start.t_ns, U)
        return _Lateral(X, U, PlanOrigin.SHIFTED, solve, solve.why)


def _usable(solve: Solve) -> bool:
    if solve.status is SolveStatus.SOLVED:
        return True
    near = max(solve.primal_residual, solve.dual_residual) <= USABLE_RESIDUAL
    return solve.status is SolveStatus.ITERATION_LIMIT and near
