"""Lateral plan: port and starboard thrust over the horizon, by sequential quadratic programming.

    previous plan --choose_nominal--> LTV model along it --fill--> problem --solve--> commands --line_search--> plan
                         ^                                                                                       |
                         +------------------------- linearise, ``sqp_iterations`` times -------------------------+

A cycle whose QP gives no usable commands takes the next fallback level (``fallback.py``).

A weak thruster delivers a share of its command. Every thrust in the planner is the delivered one: the command in force,
the previous plan, box and slew of the QP are multiplied by the share, and the plan is divided by it at the end. So the
model stays right, and the box is as small as the thruster is weak.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence

import msgspec
import numpy as np

from ltv_mpc.control import nominal
from ltv_mpc.control.config import ResolvedConfig
from ltv_mpc.control.disturbance import heading_free_mps
from ltv_mpc.control.fallback import Fallback, LateralPlan, PreviousPlan
from ltv_mpc.control.fencing import Fencing
from ltv_mpc.control.linearisation import describe_non_finite
from ltv_mpc.control.nominal import Cycle
from ltv_mpc.control.ocp.extension import Limit, Term
from ltv_mpc.control.ocp.problem import is_finite
from ltv_mpc.control.prediction import Start, currents_at_depths
from ltv_mpc.control.problem_data import Constants
from ltv_mpc.control.solvers import Solver, SolverFactory
from ltv_mpc.messages import Array, Estimate, Pair, PlanOrigin, Solve, SolveStatus
from ltv_mpc.node import Stopwatch
from ltv_mpc.vehicle.parameters import Vehicle

MAX_PRIMAL_RESIDUAL = 1.0
"""Largest primal residual with which an early-terminated solution is used; scaled, so that 1 is one metre or the whole
thrust of a thruster."""

MAX_WHY_CHARS = 200
"""Longest text of an exception in a plan."""

REST_M, RESTING_MPS, RESTLESS = 0.07, 0.01, 1.5
"""Distance from a point within which a vehicle rests in still water (m): closer, an error of its arm would make it turn
for ever, or drive to and fro. Sinking speed up to which it rests (m/s), and how soon a current that gives the heading
ends that: the square of its speed, over ``heading_free_mps``, times this.
"""


class LateralPlanner:
    """Lateral plans of one vehicle: the QP's solution, or the first fallback level that gives a plan."""

    def __init__(
        self,
        vehicle: Vehicle,
        config: ResolvedConfig,
        constants: Constants,
        make_solver: SolverFactory,
        stopwatch: Stopwatch,
        terms: Sequence[Term | Limit] = (),
    ) -> None:
        """Make the solver and the arrays of a cycle.

        Parameters
        ----------
        vehicle, config : as ``make_solver`` takes them.
        constants : of the controller; its coefficients may change.
        make_solver : called now, and again after a solve that failed.
        stopwatch : is called with a stage's name when that stage of a cycle ends.
        terms : of a user, beside those of ``ocp/``.
        """
        self.previous = PreviousPlan(config.knots_ns)
        self.fencing = Fencing(vehicle, config.knots_ns, config.limits.max_cross_track_m)
        """Fence, obstacles and corridor in force."""
        self._cycle = Cycle(constants, self.fencing.scene, terms)
        self._fallback = Fallback(vehicle, self._cycle, self.previous, config.period_ns)
        self._vehicle, self._config_for = vehicle, functools.cache(functools.partial(_config_for, config))
        self._config = self._config_for(path=False, heading=False)
        self._make_solver: Callable[[], Solver] = lambda: make_solver(self._weakened_vehicle(), self._config)
        self._solver: Solver | None = self._new_solver()
        self._stopwatch = stopwatch

    @property
    def target(self) -> Array:
        """Target at the knots (``ocp/terms.py``)."""
        return self._cycle.target

    def set_current(self, estimate: Estimate, depth_m: Array) -> None:
        """Set the current along the horizon.

        Parameters
        ----------
        estimate : its current profile is used; no current if it has none.
        depth_m : (N+1,) predicted depths at the knots (m).
        """
        if self._cycle.set_fence_rows(self.fencing.rows):
            self.discard_solver()
        self._cycle.lin.C[:] = currents_at_depths(estimate.current, depth_m)

    def bend_target(self, start: Start) -> None:
        """Lead the targets round the zones, where the line through them is blocked, and bring far ones nearer.

        Parameters
        ----------
        start : the vehicle at the plan's start. Target and current are set before.
        """
        low, high = self._cycle.constants.low_state, self._cycle.constants.high_state
        limited = bool(np.isfinite(low).any() or np.isfinite(high).any())
        self.fencing.bend(start.lateral[:2], self._cycle.lin.C[0], self.target, limited=limited)

    def relax_target(self, start: Start, radius_m: float) -> None:
        """Move the target of each knot to the point of a disc about it that is nearest to the vehicle.

        Parameters
        ----------
        start : the vehicle at the plan's start.
        radius_m : radius of the disc (m). Where the heading is free and the depth is kept, it is ``REST_M`` at least in
            still water, and less in a current.
        """
        if abs(start.sinking_mps) < RESTING_MPS and self._config.weights.heading_per_rad2 == 0.0:
            current_mps = math.hypot(start.current_north_mps, start.current_east_mps)
            radius_m = max(radius_m, REST_M / (1.0 + RESTLESS * (current_mps / heading_free_mps(self._vehicle)) ** 2))
        bring_within(start.lateral[:2], radius_m, self.target)

    def ramp(self, start: Start, why: str, goal: Array | None = None) -> LateralPlan:
        """Ramp the lateral thrusters to a goal at their slew limits.

        Parameters
        ----------
        start, why, goal : as ``Fallback.ramp`` takes them; the current is the one that was set.
        """
        delivered = None if goal is None else goal[:, :2] * self.previous.shares
        return self._as_commands(self._fallback.ramp(start, why, delivered))

    def set_shares(self, shares: Pair) -> None:
        """Plan with thrusters that deliver a share of their commands; the solver is rebuilt if the shares change.

        Parameters
        ----------
        shares : of port and starboard, above 0.
        """
        if shares == self.previous.shares:
            return
        self.previous.shares = shares
        self._repack()

    def set_reference(self, *, path: bool, heading: bool) -> None:
        """Plan with the limits and weights of one kind of reference; the solver is rebuilt if they change.

        Parameters
        ----------
        path : True on a path, where the bow may have to go first.
        heading : True if the reference has a heading, which costs.
        """
        before, self._config = self._config, self._config_for(path=path, heading=heading)
        if self._config is not before and self._config != before:
            self._repack()

    def _repack(self) -> None:
        config, learned = self._config, self._cycle.constants.p
        of = Constants.of(self._weakened_vehicle(), config.weights, config.knots, config.limits.state_bounds)
        self._cycle.constants = of._replace(p=learned)
        self.discard_solver()

    def stop(self, start: Start, why: str) -> LateralPlan:
        """Stop the vehicle through the water.

        Parameters
        ----------
        start, why : as ``Fallback.stop`` takes them; the current is the one that was set.
        """
        return self._as_commands(self._fallback.stop(start, why))

    def plan(self, start: Start) -> LateralPlan:
        """Return the QP's plan, or that of the first fallback level that gives one.

        Parameters
        ----------
        start : the vehicle at the plan's start. Target and current are set before.
        """
        try:
            plan: LateralPlan | Solve = self._solve(start)
        except Exception as error:  # a solver should report a status, but those of others may raise
            plan = Solve(status=SolveStatus.FAILED, why=f"{type(error).__name__}: {error}"[:MAX_WHY_CHARS])
        unbraked = self._fall_back(start, plan) if isinstance(plan, Solve) else plan
        self.previous.unbraked = self._as_commands(unbraked).U
        return self._as_commands(self._brake_before_zones(start, unbraked))

    def _brake_before_zones(self, start: Start, plan: LateralPlan) -> LateralPlan:
        """Return a plan with a braking tail, if the vehicle would enter a zone when no other plan follows it."""
        if plan.origin is PlanOrigin.ZERO or not self.fencing.is_active:
            return plan
        enters_s = self.fencing.enters_s(self._fallback.coasting(start, plan).X)
        if math.isinf(enters_s):
            return plan
        braking = self._fallback.with_braking_tail(start, plan)
        return braking if self.fencing.enters_s(braking.X) > enters_s else plan

    def discard_solver(self) -> None:
        """Make a new solver before the next solve: the workspace of this one may hold numbers that are not finite."""
        self._solver = None

    def _solve(self, start: Start) -> LateralPlan | Solve:
        """Solve ``sqp_iterations`` QPs, each along the trajectory of the one before.

        Returns the plan, or the report of the solve that gave no usable one.
        """
        cycle = self._cycle
        cycle.scene = self.fencing.scene
        shift = self._linearise(start)
        X, U = self._fallback.empty()
        for left in reversed(range(self._config.sqp_iterations)):
            self._stopwatch("linearise")
            commands, solve = self._solve_qp(shift, last=left == 0)
            if solve.status is not SolveStatus.SOLVED:
                if not is_usable(commands, solve):
                    return solve
                # The line search brings it into box and slew, and takes it only as far as the cost does not rise.
            elif not math.isfinite(np.vdot(commands, commands)):
                return Solve(status=SolveStatus.NON_FINITE, why="the solver's commands are not finite")
            step = nominal.line_search(cycle, commands, X, U)
            # A step above zero has a finite cost, so its states and commands are finite.
            if step == 0.0 and not (np.isfinite(X).all() and np.isfinite(U).all()):
                return Solve(status=SolveStatus.NON_FINITE, why="the predicted motion is not finite")
            shift = 0.0
            if left > 0:
                cycle.lin.X[...], cycle.lin.U[...] = X, U
                cycle.linearise()
        return LateralPlan(X, U, PlanOrigin.SOLVED, solve, "")

    def _solve_qp(self, shift: float, *, last: bool) -> tuple[Array, Solve]:
        """Return the commands of the QP and the solver's report."""
        cycle = self._cycle
        cycle.fill()
        if self._solver is None:
            self._solver, shift = self._new_solver(), math.nan
        self._stopwatch("build")
        z, solve = self._solver.solve(cycle.problem, shift, last=last)
        self._stopwatch("solve")
        if solve.status is SolveStatus.NON_FINITE and not is_finite(cycle.problem):
            solve = msgspec.structs.replace(solve, why=describe_non_finite(cycle.lin, self.target))
        return cycle.commands(z), solve

    def _new_solver(self) -> Solver:
        """Return a solver that is set up, which takes as long as several cycles."""
        solver = self._make_solver()
        solver.set_up(self._cycle.full_problem())
        return solver

    def _linearise(self, start: Start) -> float:
        """Linearise along the previous plan on the new knots, or along a steering guess if that costs less.

        Returns by how many first stages the previous plan began earlier, NaN for a steering guess.
        """
        stages, commands = self.previous.lateral_commands(start.t_ns)
        report = None if self.previous.plan is None else self.previous.plan.fence
        was_clear = report is not None and report.exceeded == 0
        kind = nominal.choose_nominal(self._cycle, start.lateral, commands, stages, was_clear=was_clear)
        return stages if kind == nominal.PREVIOUS_PLAN else math.nan

    def _fall_back(self, start: Start, solve: Solve) -> LateralPlan:
        """Return the plan of the first fallback level that gives one."""
        self.discard_solver()
        np.nan_to_num(self._cycle.lin.C, copy=False, nan=0.0, posinf=0.0, neginf=0.0)
        return self._fallback.plan(start, solve)

    def _as_commands(self, plan: LateralPlan) -> LateralPlan:
        """Return a plan of delivered thrusts with the commands that lead to them."""
        if self.previous.shares == (1.0, 1.0):
            return plan
        port, starboard, _ = self._vehicle.thrusters
        # The quotient may exceed the box by rounding.
        return plan._replace(
            U=np.clip(plan.U / self.previous.shares, (port.min_N, starboard.min_N), (port.max_N, starboard.max_N))
        )

    def _weakened_vehicle(self) -> Vehicle:
        """Return the vehicle whose lateral thrusters have the box and slew limit of the thrust that they deliver."""
        port, starboard = (
            msgspec.structs.replace(
                of, min_N=of.min_N * share, max_N=of.max_N * share, slew_N_per_s=of.slew_N_per_s * share
            )
            for of, share in zip(self._vehicle.thrusters[:2], self.previous.shares, strict=True)
        )
        thruster = msgspec.structs.replace(self._vehicle.thruster, port=port, starboard=starboard)
        return msgspec.structs.replace(self._vehicle, thruster=thruster)


def _config_for(settings: ResolvedConfig, *, path: bool, heading: bool) -> ResolvedConfig:
    """Return the settings for a reference that is a path or not, and has a heading or not."""
    return msgspec.structs.replace(
        settings, limits=settings.limits.on(path=path), weights=settings.weights.at_heading(heading)
    )


def bring_within(position: Array, radius_m: float, target: Array) -> None:
    """Move the target of each knot to the point of a disc about it that is nearest to the vehicle.

    Within the disc the vehicle stays where it is. The nearest point to each knot of the previous plan would let it
    drift on with what that plan does: a slow turn would take minutes to end.

    Parameters
    ----------
    position : (2,) of the vehicle at the first knot (m).
    radius_m : radius of the disc (m).
    target : (N+1, 3) as in ``ocp/terms.py``; its positions are overwritten.
    """
    off = position - target[:-1, :2]
    share = np.minimum(radius_m / np.maximum(np.hypot(off[:, 0], off[:, 1]), 1e-9), 1.0)
    target[:-1, :2] += share[:, None] * off


def is_usable(commands: Array, solve: Solve) -> bool:
    """Return True if an early-terminated solution is finite and its primal residual is at most MAX_PRIMAL_RESIDUAL.

    Parameters
    ----------
    commands : (N+1, 2) lateral commands at the knots (N).
    solve : the solver's report.
    """
    return (
        solve.status is SolveStatus.ITERATION_LIMIT
        and solve.primal_residual <= MAX_PRIMAL_RESIDUAL
        and bool(np.isfinite(commands).all())
    )
