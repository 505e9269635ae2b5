"""One cycle of the controller, from the newest estimate to a plan.

    estimate --predict--> state at the plan's start --linearise--> LTV model along the previous plan --build--> QP
             --solve--> commands at the knots --read--> plan

Where the QP gives no commands the same cycle takes the next rung of the ladder, named in the plan with its reason:

    solved     the QP's plan
    shifted    the rest of the plan solved last, to its end, and thrusts to zero from there on
    zero       lateral thrusts to zero at the slew limit: no plan is left, or the estimate is too old for one. While a
               depth is known it is kept; else the vertical thrust goes to the vehicle's ``failsafe_vertical_N``

Figures: Medagoda & Williams 2012, Fig 5 (dead time), section V (horizon); beyond it: analytic sensitivities, thruster
lag and slew in the model, one convex QP a cycle.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from functools import cached_property
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.control import line_search, nominal_trajectory
from ltv_mpc.control.config import STAGE_NS, ControllerConfig
from ltv_mpc.control.delay import Delay
from ltv_mpc.control.disturbance import CurrentBias
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.linearisation import Linearisation
from ltv_mpc.control.prediction import Prediction, Start, current_at_depth, fill_currents, profile_of
from ltv_mpc.control.problem_data import pack_constants
from ltv_mpc.control.qp.failed_qp import FailedQp
from ltv_mpc.control.qp.sparse import SparseQp
from ltv_mpc.control.scaling import resolve_weights
from ltv_mpc.control.sent_commands import SentCommands
from ltv_mpc.control.solvers import Solver, make
from ltv_mpc.control.vertical import VerticalLaw, VerticalPlan, ramp
from ltv_mpc.messages import (
    Applied,
    Array,
    Authority,
    ControllerState,
    CycleTiming,
    Estimate,
    Health,
    Plan,
    PlanOrigin,
    Solve,
    SolveStatus,
    Times,
)
from ltv_mpc.node import Stopwatch, no_stopwatch
from ltv_mpc.references import Reference
from ltv_mpc.references.follower import NO_PROGRESS, Follower, FollowerState
from ltv_mpc.safety.command_arbiter import ThrustOverride
from ltv_mpc.safety.estimate_gate import EstimateGate
from ltv_mpc.safety.health import FAILSAFE_PERIODS, health, timeout_ns, worst
from ltv_mpc.safety.input_monitor import Period
from ltv_mpc.vehicle.flow import STATES
from ltv_mpc.vehicle.parameters import Vehicle

STAGE_S = STAGE_NS * 1e-9

LONGEST_SHIFT_NS = 10_000_000_000
"""After its plan was solved a vehicle follows it no longer than this: the water is not what was foreseen then."""

MOST_RESIDUAL = 1.0
"""Of a solve that ended early, primal, scaled (1: a metre, or all of a thruster): beyond, it says nothing."""


LONGEST_WHY = 200

FROM_A_SOLVE = (PlanOrigin.SOLVED, PlanOrigin.SHIFTED)
"""Origins of plans that the next cycle can begin from."""

NOT_RUN = Solve(status=SolveStatus.NOT_RUN)


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
        self.config = config = resolve_weights(config or ControllerConfig(), vehicle)
        self.vehicle = vehicle
        self._numbers = pack_constants(vehicle, config.weights, config.knots, STAGE_S, config.limits.max_abs)
        self._lap = stopwatch
        self._new_solver: Callable[[], Solver] = lambda: make(vehicle, config)
        self._solver = self._new_solver()
        self._lin = Linearisation.empty(config.stages)
        self._knots = config.knots
        self._ahead_ns = np.round(self._knots * STAGE_NS).astype(np.int64)
        self._target = np.zeros((config.stages + 1, 2))
        self._nothing = np.zeros((config.stages + 1, 2))
        self._commands = SentCommands(vehicle)
        self._vertical = VerticalLaw(vehicle, self._numbers)
        self._prediction = Prediction(vehicle)
        self._bias = None if config.disturbance.sd_mps == 0 else CurrentBias(config.disturbance)
        self._first_delay_ns = round(config.first_delay_s * 1e9)
        self._delay = self._new_delay(self._first_delay_ns)
        self._last: Plan | None = None  # the last plan that was sent
        self._solved_until_ns = 0  # what a shifted plan may still be made of
        self._shifts_ns = min(int(self._ahead_ns[-1]), LONGEST_SHIFT_NS)
        self._doubtful = False  # the solver has not given what it should
        self._fresh_ns = round(config.ages.degraded_s * 1e9)
        self._period = Period()  # of the estimates believed
        self.estimate_gate = EstimateGate(vehicle)
        """Which estimates are believed, and how many were not."""
        self.failed: FailedQp | None = None
        """The problem that was not solved last, if ever one was not."""
        self.follow(reference)

    def follow(self, reference: Reference) -> None:
        """Another reference from the next cycle on. It begins at the first estimate after its start."""
        self._follower = Follower(reference, self.vehicle)

    def report(self, applied: Applied) -> None:
        """What the actuators say they do."""
        self._delay.add_receipt(applied)
        self._prediction.add_report(applied)
        self._commands.correct(applied.t_ns, applied.command_N)

    def timing(self, timing: CycleTiming) -> None:
        """What the last cycle took."""
        self._delay.add_timing(timing)

    def health(self, t_ns: int) -> Health:
        """How well the estimates that are believed keep up at ``t_ns``."""
        believed = self.estimate_gate.accepted
        age_ns = None if believed is None else t_ns - believed.t_ns
        if age_ns is not None and -self._fresh_ns <= age_ns <= self._fresh_ns:
            return Health.NOMINAL  # whatever their period
        return health(age_ns=age_ns, period_ns=self._period.median_ns, ages=self.config.ages)

    def plan(
        self,
        estimate: Estimate,
        *,
        t_ns: int | None = None,
        applied: Applied | None = None,
        override: ThrustOverride | None = None,
        health: Health = Health.NOMINAL,
    ) -> Plan:
        """One cycle.

        ``estimate``: the newest; ``t_ns``: now, the estimate's own time if left out; ``applied``: the actuators'
        report, without which the controller assumes that its plans were followed; ``override``: someone else commands
        the thrusters; ``health``: of inputs that the caller watches, of which the plan says the worst. Never raises:
        a plan that is not the QP's says so in ``origin`` and ``why``.
        """
        now = estimate.t_ns if t_ns is None else t_ns
        try:
            if applied is not None:
                self.report(applied)
            return self._cycle(estimate, now, override, health)
        except Exception as error:  # whatever numpy or a solver raises: the thrusters are not left without a command
            return self._let_go(now, override, f"{type(error).__name__}: {error}"[:LONGEST_WHY])

    def _cycle(self, newest: Estimate, now: int, override: ThrustOverride | None, health: Health) -> Plan:
        """The cycle where nothing raises."""
        doubt, estimate = self._believed(newest, now)
        own = Health.FAILSAFE if doubt else self.health(now)
        if own is not Health.NOMINAL:
            health = worst(health, own)
        if self._bias is not None and not doubt:
            estimate = self._bias.correct(estimate, self._prediction, self._commands)
        begun, idle, rest = False, doubt, False
        if own is not Health.NOMINAL and abs(now - estimate.t_ns) > self._oldest_ns():
            idle = f"the newest estimate is {(now - estimate.t_ns) * 1e-9:.1f} s old"
            # Not to be rolled over such a time, nor to begin at.
            estimate = msgspec.structs.replace(estimate, t_ns=now)
        stops = health is Health.HOLD and override is None
        if override is not None:
            idle = override.why
        elif idle:
            rest = True
        elif stops:
            idle = "" if self._follower.target_m is not None else "the reference has not started yet"
        elif not (begun := self._follower.begin(estimate)):
            idle = "the reference has not started yet"
        if not (idle or self.config.lateral):
            idle = "lateral control is off"
        delay_ns = self._delay.expected_ns()
        start = self._prediction.state_at(estimate, now + delay_ns, self._commands)
        knots = start.t_ns + self._ahead_ns
        profile = profile_of(estimate)
        if begun:
            here = current_at_depth(profile.depth_m, profile.north_mps, profile.east_mps, start.depth_m)
            self._follower.advance(knots, start.lateral, here)
        goal = None if override is None else override.targets(knots)
        if goal is not None:
            vertical = self._vertical.ramp_to(start, knots, goal[:, 2])
        elif rest:
            vertical = self._rested(start, knots)
        elif stops:
            vertical = self._vertical_hold(start, knots, estimate)
        else:
            vertical = self._vertical_plan(start, knots, begun and estimate.depth_m is not None)
        fill_currents(profile.depth_m, profile.north_mps, profile.east_mps, vertical.depth_m, self._lin.C)
        self._lap("predict")
        if idle:
            lateral = self._released(start, idle, goal)
        elif stops:
            lateral = self._released(start, f"the newest estimate is {(now - estimate.t_ns) * 1e-9:.1f} s old", None)
        else:
            self._follower.fill(knots, self._target)
            lateral = self._solve(start)
        progress = self._follower.progress if begun else NO_PROGRESS
        thrust = np.empty((len(knots), 3))
        thrust[:, :2], thrust[:, 2] = lateral.U, vertical.thrust_N
        if not math.isfinite(np.vdot(vertical.thrust_N, vertical.thrust_N)):  # the lateral ones are looked at above
            raise ArithmeticError("a thrust is not finite")
        plan = Plan(
            cycle_t_ns=now,
            t_ns=knots,
            thrust_N=thrust,
            states=lateral.X[:, :6].copy(),
            origin=lateral.origin,
            solve=lateral.solve,
            why=lateral.why,
            authority=Authority.CONTROLLER if override is None else override.authority,
            health=health,
            estimate_t_ns=estimate.t_ns,
            expected_delay_ns=delay_ns,
            reference_m=self._follower.target_m if begun else None,
            reference_depth_m=self._follower.depth_m if begun else None,
            progress=progress.share,
            cross_track_m=progress.cross_track_m,
            remaining_m=progress.remaining_m,
        )
        self._sent(plan)
        self._vertical.advance_integral(vertical, start.t_ns)
        self._lap("read")
        return plan

    def solve_with(self, instead: Callable[[Solver], Solver]) -> None:
        """Another solver than the settings': what ``instead`` makes of theirs, now and when it is made anew."""
        settings = self._new_solver
        self._new_solver = lambda: instead(settings())
        self._solver = instead(self._solver)

    def warm_up(self) -> None:
        """Take each rung below the solved plan once, so that nothing is left to be compiled when it is needed.

        For a controller that is thrown away.
        """
        start = self._prediction.state_at(Estimate.at_rest(), 0, self._commands)
        self._lin.C[...] = 0.0
        thrust = np.zeros((len(self._ahead_ns), 3))
        self._shifted(start, start.t_ns - STAGE_NS // 2, thrust, NOT_RUN)
        self._released(start, "", self._nothing)
        self._commands.correct(start.t_ns, (0.0, 0.0, 0.0))
        self._keep(NOT_RUN)

    def save(self, t_ns: int) -> ControllerState:
        """Return the state that another controller of the same reference continues from; not the solver's warm start.

        Parameters
        ----------
        t_ns : time of the state, vehicle time.

        Returns
        -------
        The state, without what belongs to the node around the controller: authority, reference, model check.
        """
        follower = self._follower.save()
        plan_delays_ns, cycle_times_ns = self._delay.save()
        return ControllerState(
            t_ns=t_ns,
            reference_start=follower.reference_start,
            schedule_t_ns=follower.t_ns,
            schedule_s=follower.tau_s,
            schedule_rate=follower.rate,
            progress=self._follower.progress.share,
            depth_integral_N=self._vertical.integral_N,
            plan_delays_ns=plan_delays_ns,
            cycle_times_ns=cycle_times_ns,
            plan=self._last,
        )

    def restore(self, state: ControllerState, t_ns: int) -> None:
        """Continue at ``t_ns`` from the state of another controller that followed the same reference.

        Parameters
        ----------
        state : what the other one saved; its plan is the one in force at the actuators.
        t_ns : now, vehicle time.
        """
        first_ns = self._first_delay_ns
        if state.plan is not None:
            first_ns = max(state.plan.expected_delay_ns, first_ns)
            self._sent(state.plan)
            self._solved_until_ns = int(state.plan.t_ns[0]) + self._shifts_ns
            if not np.array_equal(state.plan.t_ns - state.plan.t_ns[0], self._ahead_ns):
                self._last = None  # of another horizon: its commands are in force, but no cycle can begin from it
        self._delay = self._new_delay(first_ns)
        self._delay.restore(state.plan_delays_ns, state.cycle_times_ns)
        self._vertical.integral_N = state.depth_integral_N
        followed = FollowerState(state.reference_start, state.schedule_t_ns, state.schedule_s, state.schedule_rate)
        self._follower.restore(followed, t_ns)

    @property
    def follower(self) -> Follower:
        """How far the reference is followed."""
        return self._follower

    # --- the parts of a cycle ---

    def _new_delay(self, first_ns: int) -> Delay:
        """One that has learned nothing yet."""
        return Delay(first_ns, self.config.delay_quantile, round(self.config.min_delay_s * 1e9))

    def _believed(self, newest: Estimate, now: int) -> tuple[str, Estimate]:
        """The newest estimate that is believed, and why there is none: then one that says nothing, of now."""
        before = self.estimate_gate.accepted
        doubt = self.estimate_gate.check(newest)
        believed = self.estimate_gate.accepted
        if believed is None:
            return f"no valid estimate: {doubt}", msgspec.structs.replace(Estimate.at_rest(), t_ns=now)
        if believed is not before:
            self._period.add(believed.t_ns)
        return "", believed

    def _oldest_ns(self) -> int:
        """Beyond this age an estimate says nothing of where the vehicle is."""
        return timeout_ns(FAILSAFE_PERIODS, self._period.median_ns, self.config.ages.failsafe_s)

    def _vertical_plan(self, start: Start, knots: Times, follows: bool) -> VerticalPlan:
        """The vertical thruster's law; at rest before the start, and where no depth is wanted or none is known."""
        wanted = self._follower.depths(knots) if follows else None
        if wanted is None:
            rest = self._commands.at(knots)[:, 2]
            return VerticalPlan(np.full(len(knots), start.depth_m), rest, 0.0)
        return self._vertical.track(start, *wanted)

    def _room(self) -> tuple[Array, Array]:
        """For states (N+1, 8) and commands (N+1, 2) of a plan."""
        return np.empty((self.config.stages + 1, STATES)), np.empty((self.config.stages + 1, 2))

    def _vertical_hold(self, start: Start, knots: Times, estimate: Estimate) -> VerticalPlan:
        """The depth of an estimate that is too old is kept, as far as it is known."""
        if estimate.depth_m is None or self._follower.depth_m is None:
            return self._vertical_plan(start, knots, False)
        still = np.zeros(len(knots))
        return self._vertical.track(start, still + estimate.depth_m, still)

    def _rested(self, start: Start, knots: Times) -> VerticalPlan:
        """The vertical thruster goes to what the vehicle's file wants of it when all else fails."""
        return self._vertical.ramp_to(start, knots, np.full(len(knots), self.vehicle.failsafe_vertical_N))

    def _released(self, start: Start, why: str, goal: Array | None) -> _Lateral:
        """The lateral thrusters go to goal (N+1, 3), zero where there is none, at the slew limit."""
        X, U = self._room()
        lateral = self._nothing if goal is None else np.ascontiguousarray(goal[:, :2])
        nominal_trajectory.ramp_to(self._numbers, start.lateral, lateral, self._lin.C, X, U)
        origin = PlanOrigin.MANUAL if goal is not None and goal.any() else PlanOrigin.ZERO
        return _Lateral(np.nan_to_num(X, posinf=0.0, neginf=0.0), U, origin, NOT_RUN, why)

    def _solve(self, start: Start) -> _Lateral:
        """The QP's plan, or the first rung below it that there is."""
        try:
            if self._doubtful:  # it may keep what it saw: NaN stays in a workspace
                self._solver, self._doubtful = self._new_solver(), False
            lateral, solve = self._solved(start)
        except Exception as error:  # each solver has its own, and a failed solve is a value here
            why = f"{type(error).__name__}: {error}"[:LONGEST_WHY]
            lateral, solve = None, Solve(status=SolveStatus.FAILED, why=why)
        return self._fallback(start, solve) if lateral is None else lateral

    def _solved(self, start: Start) -> tuple[_Lateral | None, Solve]:
        """QPs, as many as the settings say: one along the previous plan, each other along what the one before came to;
        None where that gives no plan.
        """
        lin, target, numbers = self._lin, self._target, self._numbers
        self._linearise(start)
        X, U = self._room()
        for left in range(self.config.sqp_iterations, 0, -1):
            self._lap("linearise")
            self._solver.build(lin, target)
            self._lap("build")
            self._solver.update()
            self._lap("update")
            commands, solve = self._solver.solve()
            self._lap("solve")
            if solve.status is not SolveStatus.SOLVED:
                self._keep(solve)
                if not _of_use(commands, solve):
                    return None, solve
                # As far as it came: brought into box and slew, and taken only as far as the exact flow is no worse.
            elif not math.isfinite(np.vdot(commands, commands)):
                return None, Solve(status=SolveStatus.NON_FINITE, why="the solver's commands are not finite")
            part = line_search.line_search(numbers, lin, target, commands, X, U)
            # A step that was taken has a finite cost, and that takes finite states and commands.
            if part == 0.0 and not (np.isfinite(X).all() and np.isfinite(U).all()):
                return None, Solve(status=SolveStatus.NON_FINITE, why="the predicted motion is not finite")
            if left > 1:
                nominal_trajectory.relinearise(numbers, lin, X, U)
        return _Lateral(X, U, PlanOrigin.SOLVED, solve, ""), solve

    @cached_property
    def _form(self) -> SparseQp:
        """The QP's layout, for a problem that was not solved."""
        limits = HorizonLimits.from_vehicle(self.vehicle, STAGE_S, self.config.limits.max_abs)
        return SparseQp(self._knots, limits, self.config.weights)

    def _keep(self, solve: Solve) -> None:
        """Keep the problem that was not solved, for whoever wants to look at it."""
        with contextlib.suppress(Exception):  # a problem that cannot even be laid out must not cost the cycle
            self.failed = FailedQp(self._form.build(self._lin, self._target), self._form.row_names, solve)

    def _sent(self, plan: Plan) -> None:
        """Keep a plan that was sent: its commands are in force from its first knot on."""
        self._commands.add(plan)
        self._last = plan
        if plan.origin is PlanOrigin.SOLVED:
            self._solved_until_ns = int(plan.t_ns[0]) + self._shifts_ns

    def _followed(self) -> Plan | None:
        """Return the last plan if it came from a solve: the next one begins from it."""
        return self._last if self._last is not None and self._last.origin in FROM_A_SOLVE else None

    def _linearise(self, start: Start) -> None:
        """Linearise along the previous plan on the new knots, or along a steered one if that is better.

        Tell the solver which.
        """
        old = self._followed()
        if old is None:
            stages, commands = math.nan, self._nothing
        else:
            stages = (start.t_ns - int(old.t_ns[0])) / STAGE_NS
            commands = np.ascontiguousarray(old.thrust_N[:, :2])
        kind = nominal_trajectory.choose_nominal(
            self._numbers, start.lateral, self._target, commands, stages, self._lin
        )
        if kind == nominal_trajectory.PREVIOUS_PLAN:
            self._solver.shift_warm_start(stages)
        else:
            self._solver.reset_warm_start()

    def _fallback(self, start: Start, solve: Solve) -> _Lateral:
        """The rungs below the solved plan. The solver is made anew before it is asked again."""
        self._doubtful = True
        np.nan_to_num(self._lin.C, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
        old = self._followed()
        shifted = None
        if old is not None and start.t_ns < self._solved_until_ns:
            shifted = self._shifted(start, int(old.t_ns[0]), old.thrust_N, solve)
        return shifted or self._released(start, solve.why, None)._replace(solve=solve)

    def _shifted(self, start: Start, began_ns: int, thrust_N: Array, solve: Solve) -> _Lateral | None:
        """Return the rest of the plan solved last, on the new knots, inside box and slew, and zero beyond its end.

        ``thrust_N`` (N+1, 3) is of that plan, which began at ``began_ns``. None where the motion is not finite.
        """
        X, U = self._room()
        commands, stages = np.ascontiguousarray(thrust_N[:, :2]), (start.t_ns - began_ns) / STAGE_NS
        nominal_trajectory.shifted_trajectory(self._numbers, start.lateral, commands, stages, self._lin.C, X, U)
        goal = U.copy()
        goal[start.t_ns + self._ahead_ns > self._solved_until_ns] = 0.0
        nominal_trajectory.ramp_to(self._numbers, start.lateral, goal, self._lin.C, X, U)
        if not (np.isfinite(X).all() and np.isfinite(U).all()):
            return None
        return _Lateral(X, U, PlanOrigin.SHIFTED, solve, solve.why)

    def _let_go(self, now: int, override: ThrustOverride | None, why: str) -> Plan:
        """The ladder's end where the cycle itself broke: from the command in force to rest, by nothing else."""
        self._doubtful, self._last = True, None
        delay_ns = self._delay.expected_ns()
        knots = now + delay_ns + self._ahead_ns
        command = np.zeros(3)
        with contextlib.suppress(Exception):
            command = self._commands.at(knots[:1])[0]
        rest = 0.0 if override is not None else self.vehicle.failsafe_vertical_N
        thrust = np.empty((len(knots), 3))
        for i, (thruster, goal) in enumerate(zip(self.vehicle.thrusters, (0.0, 0.0, rest), strict=True)):
            thrust[:, i] = ramp(float(command[i]), np.full(len(knots), goal), knots, thruster.slew_N_per_s)
        states = np.zeros((len(knots), 6))
        believed = self.estimate_gate.accepted
        if believed is not None:
            states[:, :2], states[:, 4] = (believed.north_m, believed.east_m), believed.heading_rad
        plan = Plan(
            cycle_t_ns=now,
            t_ns=knots,
            thrust_N=thrust,
            states=states,
            origin=PlanOrigin.ZERO,
            solve=NOT_RUN,
            why=why,
            authority=Authority.CONTROLLER if override is None else override.authority,
            health=self.health(now),
            estimate_t_ns=now if believed is None else believed.t_ns,
            expected_delay_ns=delay_ns,
        )
        with contextlib.suppress(Exception):
            self._sent(plan)
        return plan


def _of_use(commands: Array, solve: Solve) -> bool:
    """Whether a solve that ended early says something."""
    return (
        solve.status is SolveStatus.ITERATION_LIMIT
        and solve.primal_residual <= MOST_RESIDUAL
        and bool(np.isfinite(commands).all())
    )
