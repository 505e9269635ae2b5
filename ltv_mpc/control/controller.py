"""One cycle of the controller, from the newest estimate to a plan.

    estimate --predict--> state at the plan's start --linearise--> LTV model along the previous plan --build--> QP
             --solve--> commands at the knots --read--> plan

Figures: Medagoda & Williams 2012, Fig 5 (dead time), section V (horizon); beyond it: analytic sensitivities, thruster
lag and slew in the model, one convex QP a cycle.
"""

from __future__ import annotations

from dataclasses import dataclass

import msgspec
import numpy as np

from ltv_mpc.control.commands import SentCommands
from ltv_mpc.control.config import STAGE_NS, ControllerConfig
from ltv_mpc.control.delay import Delay
from ltv_mpc.control.guess import cost, steer
from ltv_mpc.control.horizon import Linearisation, linearise, roll_out
from ltv_mpc.control.limits import ThrustLimits
from ltv_mpc.control.prediction import Prediction, Start, current_at
from ltv_mpc.control.qp.sparse import SparseForm
from ltv_mpc.control.solvers import make
from ltv_mpc.control.vertical import VerticalLaw, VerticalPlan
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
from ltv_mpc.vehicle.parameters import Vehicle

STAGE_S = STAGE_NS * 1e-9

COLD_PASSES = 6
"""Linearisations of the first cycle, whose guess is crude."""

STEPS = (1.0, 0.5, 0.25, 0.1)
"""Parts of the QP's step that are tried in turn until the cost along the exact flow does not rise."""

LONGEST_INTEGRATION_S = 2.0
"""After a longer silence the depth error was not this all the time."""

OLDEST_ESTIMATE_NS = 10_000_000_000
"""An estimate that is further than this from now says nothing of where the vehicle is."""

USABLE_RESIDUAL = 1e-3
"""A solve that ends at its iteration limit is used where both residuals are below this: its step is tried against the
exact flow like any other, and its commands are inside box and slew like any other's."""


@dataclass(frozen=True, slots=True)
class _Memory:
    """What a cycle leaves to the next."""

    t_ns: Times  # (N+1,) knots
    X: Array  # (N+1, 8)
    U: Array  # (N+1, 2)
    y: Array  # dual of the QP


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
        self._p = vehicle.coefficients()
        self._stage_s = np.full(config.stages, STAGE_S)
        self._lap = stopwatch
        self._limits = ThrustLimits.of(vehicle, STAGE_S)
        self._form = SparseForm(config.stages, self._limits, config.weights)
        self._solver = make(config)
        self._vertical = VerticalLaw(vehicle)
        self._commands = SentCommands(vehicle)
        self._prediction = Prediction(vehicle)
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
        knots = start.t_ns + np.arange(self.config.stages + 1, dtype=np.int64) * STAGE_NS
        vertical = self._vertical_plan(start, knots, begun)
        current = current_at(estimate.current, vertical.depth_m)
        self._lap("predict")
        if begun is None or idle:
            X, U = self._released(start, knots, current)
            origin, solve, why = PlanOrigin.ZERO, Solve(status=SolveStatus.NOT_RUN), idle
            self._memory = None
        else:
            X, U, origin, solve, why = self._solve(start, knots, current, self._reference.position(begun))
        plan = Plan(
            cycle_t_ns=now,
            t_ns=knots,
            thrust_N=np.column_stack([U, vertical.thrust_N]),
            states=X[:, :6].copy(),
            origin=origin,
            solve=solve,
            why=why,
            estimate_t_ns=estimate.t_ns,
            expected_delay_ns=delay_ns,
            reference_m=None if begun is None else self._reference.position(begun),
            reference_depth_m=None if begun is None else self._reference.depth_m,
        )
        self._commands.sent(plan)
        self._integrate(vertical, start.t_ns)
        self._lap("read")
        return plan

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
        return self._vertical.plan(
            depth_m=start.depth_m,
            sinking_mps=start.sinking_mps,
            thrust_N=start.vertical_N,
            command_N=float(start.command[2]),
            integral_N=self._integral_N,
            depth_ref_m=wanted[0],
            sinking_ref_mps=wanted[1],
            stage_s=STAGE_S,
        )

    def _integrate(self, vertical: VerticalPlan, start_ns: int) -> None:
        """The integral goes on from the last plan's start to this one's."""
        if self._integrated_ns is not None:
            seconds = min(max(start_ns - self._integrated_ns, 0) * 1e-9, LONGEST_INTEGRATION_S)
            self._integral_N += vertical.integral_rate_N_per_s * seconds
        self._integrated_ns = start_ns

    def _released(self, start: Start, knots: Times, current: Array) -> tuple[Array, Array]:
        """The lateral thrusters go to zero at the slew limit."""
        U = np.zeros((len(knots), 2))
        U[0] = start.command[:2]
        U = self._limits.enforced(U)
        return self._roll(start.X, U, current), U

    def _roll(self, X0: Array, U: Array, current: Array) -> Array:
        """The exact flow over the horizon, (N+1, 8)."""
        return roll_out(X0, U, current, self._stage_s, self._p)

    def _solve(
        self, start: Start, knots: Times, current: Array, target: Pair
    ) -> tuple[Array, Array, PlanOrigin, Solve, str]:
        """States, commands and where they come from."""
        reference = np.broadcast_to(np.array(target), (self.config.stages, 2))
        X, U, y = self._guess(start, knots, current, reference)
        passes = COLD_PASSES if self._memory is None else 1
        for _ in range(passes):
            lin = linearise(X, U, current, STAGE_S, self._p)
            self._lap("linearise")
            qp = self._form.build(lin, reference)
            self._lap("build")
            solution = self._solver.solve(qp, np.zeros(self._form.variables), y)
            self._lap("solve")
            if not _usable(solution.solve):
                return self._fallback(lin, knots, solution.solve)
            X, U = self._step(lin, self._form.commands(lin, solution.x), current, reference)
            y = solution.y
        self._memory = _Memory(knots, X, U, y)
        return X, U, PlanOrigin.SOLVED, solution.solve, ""

    def _cost(self, X: Array, U: Array, current: Array, reference: Array) -> float:
        return cost(X, U, current, reference, self._limits, self.config.weights)

    def _step(self, lin: Linearisation, U: Array, current: Array, reference: Array) -> tuple[Array, Array]:
        """From the trajectory linearised along towards the QP's commands: the largest part that is no worse.

        The solver meets box and slew to its tolerance; what is returned meets them exactly.
        """
        before = self._cost(lin.X, lin.U, current, reference)
        for part in STEPS:
            commands = self._limits.enforced(lin.U + part * (U - lin.U))
            X = self._roll(lin.X[0], commands, current)
            if self._cost(X, commands, current, reference) <= before:
                return X, commands
        return lin.X, lin.U

    def _guess(self, start: Start, knots: Times, current: Array, reference: Array) -> tuple[Array, Array, Array]:
        """Trajectory to linearise along, and dual: the previous plan on the new grid, or a steered one if better."""
        N = self.config.stages
        low, high = self._limits.box(start.command[:2], N)
        candidates = []
        for astern in (False, True):
            X, U = steer(
                start.X, start.command[:2], current, reference, STAGE_S, low, high, self._limits.change, astern, self._p
            )
            candidates.append((self._cost(X, U, current, reference), X, U, np.zeros(self._form.rows)))
        old = self._memory
        if old is not None:
            t, told = (knots - old.t_ns[0]) * 1e-9, (old.t_ns - old.t_ns[0]) * 1e-9
            U = np.stack([np.interp(t, told, old.U[:, i]) for i in range(2)], axis=1)
            U[0] = start.command[:2]
            U = self._limits.enforced(U)
            X = self._roll(start.X, U, current)
            candidates.append(
                (self._cost(X, U, current, reference), X, U, self._form.shifted_dual(old.y, t[0] / STAGE_S))
            )
        _, X, U, y = min(candidates, key=lambda candidate: candidate[0])
        return X, U, y

    def _fallback(self, lin: Linearisation, knots: Times, solve: Solve) -> tuple[Array, Array, PlanOrigin, Solve, str]:
        """The previous plan on the new grid, already inside box and slew; it stays the guess of the next cycle."""
        finite = np.isfinite(lin.X).all() and np.isfinite(lin.U).all()
        if self._memory is None or not finite:
            U = np.zeros_like(lin.U)
            U[0] = lin.U[0]
            self._memory = None
            return lin.X, self._limits.enforced(U), PlanOrigin.ZERO, solve, solve.why
        self._memory = _Memory(knots, lin.X, lin.U, np.zeros_like(self._memory.y))
        return lin.X, lin.U, PlanOrigin.SHIFTED, solve, solve.why


def _usable(solve: Solve) -> bool:
    if solve.status is SolveStatus.SOLVED:
        return True
    near = max(solve.primal_residual, solve.dual_residual) <= USABLE_RESIDUAL
    return solve.status is SolveStatus.ITERATION_LIMIT and near
