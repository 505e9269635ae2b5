"""Model predictive controller: one cycle, from the newest estimate to a plan.

    estimate --predict--> state at the plan's start --linearise--> LTV model along the previous plan --build--> QP
             --solve--> commands at the knots --line search--> plan

A cycle whose QP gives no commands takes the next fallback level in the same cycle; the plan names it with its reason:

    solved     the QP's plan
    shifted    the rest of the plan solved last, then zero lateral thrust
    zero       lateral thrusts ramp to zero: there is no plan left to shift, or the mode drives no lateral thruster

Modes: ``mode.py``. Fallback levels: ``fallback.py``. Source: Medagoda & Williams 2012, Fig 5 (dead time) and section V
(horizon). Beyond it: analytic sensitivities, thruster lag and slew in the model, one convex QP at a time.
"""

from __future__ import annotations

import contextlib
import math

import numpy as np

from ltv_mpc.control.config import STAGE_NS, ControllerConfig
from ltv_mpc.control.delay import Delay
from ltv_mpc.control.disturbance import CurrentBias
from ltv_mpc.control.fallback import NOT_RUN, LateralPlan, ramp_to_rest
from ltv_mpc.control.lateral import MAX_WHY_CHARS, LateralPlanner
from ltv_mpc.control.mode import Decision, EstimateSelector, Mode, decide
from ltv_mpc.control.prediction import Prediction, Start, current_at_depth, profile_of
from ltv_mpc.control.problem_data import pack_constants
from ltv_mpc.control.scaling import resolve_weights
from ltv_mpc.control.sent_commands import SentCommands
from ltv_mpc.control.solvers import SolverFactory, make
from ltv_mpc.control.vertical import VerticalLaw, VerticalPlan
from ltv_mpc.messages import (
    Applied,
    Authority,
    ControllerState,
    CycleTiming,
    Estimate,
    Health,
    Plan,
    PlanOrigin,
    Times,
)
from ltv_mpc.node import Stopwatch, no_stopwatch
from ltv_mpc.references import Reference
from ltv_mpc.references.follower import NO_PROGRESS, Follower, FollowerState
from ltv_mpc.safety.command_arbiter import ThrustOverride
from ltv_mpc.safety.estimate_gate import EstimateGate
from ltv_mpc.vehicle.parameters import Vehicle

STAGE_S = STAGE_NS * 1e-9


class Controller:
    """Model predictive controller of one vehicle along one reference."""

    def __init__(
        self,
        vehicle: Vehicle,
        reference: Reference,
        config: ControllerConfig | None = None,
        *,
        make_solver: SolverFactory = make,
        stopwatch: Stopwatch = no_stopwatch,
    ) -> None:
        """Begin before the first estimate.

        Parameters
        ----------
        vehicle : nominal model.
        reference : what to follow, from the first estimate after its start.
        config : settings; the defaults if None.
        make_solver : makes the QP's solver; the one that the settings name by default.
        stopwatch : is called with a stage's name when that stage of a cycle ends.

        Raises
        ------
        ConfigError : the settings name an unknown solver, or one that cannot keep their limits.
        """
        self.config = config = resolve_weights(config or ControllerConfig(), vehicle)
        self.vehicle = vehicle
        self.sent_commands = SentCommands(vehicle)
        """Commands in force, by time."""
        packed = pack_constants(vehicle, config.weights, config.knots, STAGE_S, config.limits.max_abs)
        self._estimates = EstimateSelector(vehicle, config)
        self._bias = None if config.disturbance.sd_mps == 0 else CurrentBias(config.disturbance)
        self._delay = Delay(_first_delay_ns(config), config.delay_quantile, round(config.min_delay_s * 1e9))
        self._prediction = Prediction(vehicle)
        self._vertical = VerticalLaw(vehicle, packed)
        self._lateral = LateralPlanner(
            vehicle,
            config,
            packed,
            knots_ns=np.round(config.knots * STAGE_NS).astype(np.int64),
            make_solver=make_solver,
            stopwatch=stopwatch,
        )
        self._lap = stopwatch
        self.follow(reference)

    @property
    def follower(self) -> Follower:
        """Progress along the reference."""
        return self._follower

    @property
    def estimate_gate(self) -> EstimateGate:
        """Plausibility check of the estimates, with the count of rejected ones."""
        return self._estimates.gate

    def follow(self, reference: Reference) -> None:
        """Follow another reference from the next cycle on.

        Parameters
        ----------
        reference : begins at the first estimate after its start.
        """
        self._follower = Follower(reference, self.vehicle)

    def report(self, applied: Applied) -> None:
        """Take in a report of the actuators: it corrects the expected delay, the commands in force and the thrusts.

        Parameters
        ----------
        applied : the plan that they received last, their commands and their delivered thrusts.
        """
        self._delay.add_receipt(applied)
        self._prediction.add_report(applied)
        self.sent_commands.correct(applied.t_ns, applied.command_N)

    def timing(self, timing: CycleTiming) -> None:
        """Take in the computing time of the last cycle: without receipts of plans the expected delay follows from it.

        Parameters
        ----------
        timing : without the transport of the plan.
        """
        self._delay.add_timing(timing)

    def health(self, t_ns: int) -> Health:
        """Return the health by the age of the newest plausible estimate.

        Parameters
        ----------
        t_ns : now, vehicle time (ns).
        """
        return self._estimates.health(t_ns)

    def plan(
        self,
        estimate: Estimate,
        *,
        t_ns: int | None = None,
        applied: Applied | None = None,
        override: ThrustOverride | None = None,
        health: Health = Health.NOMINAL,
    ) -> Plan:
        """Return the plan of one control cycle. Never raises: a fallback plan names its level and its reason.

        Parameters
        ----------
        estimate : the newest estimate.
        t_ns : start of the cycle, vehicle time (ns); the estimate's own time if None.
        applied : the actuators' report. Without reports the controller assumes that its plans are followed.
        override : thrusts commanded by a source other than the controller.
        health : of inputs that the caller watches; the plan reports the worst.

        Returns
        -------
        The plan: ``origin`` names the fallback level, ``why`` its reason.
        """
        now = estimate.t_ns if t_ns is None else t_ns
        try:
            if applied is not None:
                self.report(applied)
            return self._cycle(estimate, now, override, health)
        except Exception as error:  # of any kind: the thrusters must have a command in every cycle
            return self._emergency_plan(now, override, f"{type(error).__name__}: {error}"[:MAX_WHY_CHARS])

    def _cycle(self, newest: Estimate, now: int, override: ThrustOverride | None, health: Health) -> Plan:
        """Return the plan of a cycle in which nothing raises."""
        decision = self._decide(newest, now, override, health)
        delay_ns = self._delay.expected_ns()
        start = self._prediction.state_at(decision.estimate, now + delay_ns, self.sent_commands)
        knots = start.t_ns + self._lateral.previous.knots_ns
        if decision.follows:
            self._advance_reference(decision.estimate, start, knots)
        vertical = self._plan_vertical(decision, start, knots)
        self._lateral.set_current(decision.estimate, vertical.depth_m)
        self._lap("predict")
        lateral = self._plan_lateral(decision, start, knots)
        plan = self._assemble(decision, now, delay_ns, knots, vertical, lateral)
        self._record(plan)
        self._vertical.advance_integral(vertical, start.t_ns)
        self._lap("read")
        return plan

    def save(self, t_ns: int) -> ControllerState:
        """Return the state that another controller of the same reference continues from; not the solver's warm start.

        Parameters
        ----------
        t_ns : time of the state, vehicle time (ns).

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
            plan=self._lateral.previous.plan,
        )

    def restore(self, state: ControllerState, t_ns: int) -> None:
        """Continue from the state of another controller that followed the same reference.

        Parameters
        ----------
        state : what the other one saved; its plan is the one in force at the actuators.
        t_ns : now, vehicle time (ns).
        """
        first_ns = _first_delay_ns(self.config)
        if state.plan is not None:
            first_ns = max(state.plan.expected_delay_ns, first_ns)
            self.sent_commands.add(state.plan)
            self._lateral.previous.restore(state.plan)
        self._delay.restore(first_ns, state.plan_delays_ns, state.cycle_times_ns)
        self._vertical.integral_N = state.depth_integral_N
        followed = FollowerState(state.reference_start, state.schedule_t_ns, state.schedule_s, state.schedule_rate)
        self._follower.restore(followed, t_ns)

    # --- parts of a cycle ---

    def _decide(self, newest: Estimate, now: int, override: ThrustOverride | None, health: Health) -> Decision:
        """Decide the mode, on the newest plausible estimate with the estimated bias of its current."""
        selection = self._estimates.select(newest, now)
        if self._bias is not None and not selection.why:
            estimate = self._bias.correct(selection.estimate, self._prediction, self.sent_commands)
            selection = selection._replace(estimate=estimate)
        return decide(
            selection,
            now,
            override=override,
            health=health,
            follower=self._follower,
            lateral=self.config.lateral,
        )

    def _advance_reference(self, estimate: Estimate, start: Start, knots: Times) -> None:
        """Advance the reference's target to the plan's first knot."""
        profile = profile_of(estimate)
        current = current_at_depth(profile.depth_m, profile.north_mps, profile.east_mps, start.depth_m)
        self._follower.advance(knots, start.lateral, current)

    def _plan_vertical(self, decision: Decision, start: Start, knots: Times) -> VerticalPlan:
        """Return the vertical thruster's plan in this mode."""
        law, mode, estimate = self._vertical, decision.mode, decision.estimate
        if decision.override is not None:
            return law.ramp_to(start, knots, decision.override.targets(knots)[:, 2])
        if mode is Mode.FAILSAFE:
            return law.ramp_to(start, knots, np.full(len(knots), self.vehicle.failsafe_vertical_N))
        if estimate.depth_m is not None:
            if mode is Mode.HOLD and self._follower.depth_m is not None:
                still = np.zeros(len(knots))
                return law.track(start, still + estimate.depth_m, still)
            wanted = self._follower.depths(knots) if decision.follows else None
            if wanted is not None:
                return law.track(start, *wanted)
        return law.keep(start, self.sent_commands.at(knots)[:, 2])

    def _plan_lateral(self, decision: Decision, start: Start, knots: Times) -> LateralPlan:
        """Return the lateral thrusters' plan in this mode: the QP's, or a ramp to the override or to zero."""
        if decision.mode is Mode.FOLLOW:
            self._follower.fill(knots, self._lateral.target)
            return self._lateral.plan(start)
        goal = None if decision.override is None else decision.override.targets(knots)
        return self._lateral.ramp(start, decision.why, goal)

    def _assemble(
        self,
        decision: Decision,
        now: int,
        delay_ns: int,
        knots: Times,
        vertical: VerticalPlan,
        lateral: LateralPlan,
    ) -> Plan:
        """Return the plan made of its vertical and lateral parts. Raises ArithmeticError if a thrust is not finite."""
        thrust = np.empty((len(knots), 3))
        thrust[:, :2], thrust[:, 2] = lateral.U, vertical.thrust_N
        if not math.isfinite(np.vdot(vertical.thrust_N, vertical.thrust_N)):  # the lateral ones are checked before
            raise ArithmeticError("a thrust is not finite")
        follower, follows = self._follower, decision.follows
        progress = follower.progress if follows else NO_PROGRESS
        return Plan(
            cycle_t_ns=now,
            t_ns=knots,
            thrust_N=thrust,
            states=lateral.X[:, :6].copy(),
            origin=lateral.origin,
            solve=lateral.solve,
            why=lateral.why,
            authority=_authority(decision.override),
            health=decision.health,
            estimate_t_ns=decision.estimate.t_ns,
            expected_delay_ns=delay_ns,
            reference_m=follower.target_m if follows else None,
            reference_depth_m=follower.depth_m if follows else None,
            progress=progress.share,
            cross_track_m=progress.cross_track_m,
            remaining_m=progress.remaining_m,
        )

    def _record(self, plan: Plan) -> None:
        """Record the plan that is sent: its commands are in force from its first knot on."""
        self.sent_commands.add(plan)
        self._lateral.previous.record(plan)

    def _emergency_plan(self, now: int, override: ThrustOverride | None, why: str) -> Plan:
        """Return a plan for a cycle that raised: every thruster ramps to rest from its command in force."""
        self._lateral.distrust_solver()
        self._lateral.previous.clear()
        delay_ns = self._delay.expected_ns()
        knots = now + delay_ns + self._lateral.previous.knots_ns
        command = np.zeros(3)
        with contextlib.suppress(Exception):
            command = self.sent_commands.at(knots[:1])[0]
        states = np.zeros((len(knots), 6))
        estimate = self.estimate_gate.accepted
        if estimate is not None:
            states[:, :2], states[:, 4] = (estimate.north_m, estimate.east_m), estimate.heading_rad
        vertical_N = 0.0 if override is not None else self.vehicle.failsafe_vertical_N
        plan = Plan(
            cycle_t_ns=now,
            t_ns=knots,
            thrust_N=ramp_to_rest(self.vehicle, command, knots, vertical_N),
            states=states,
            origin=PlanOrigin.ZERO,
            solve=NOT_RUN,
            why=why,
            authority=_authority(override),
            health=self.health(now),
            estimate_t_ns=now if estimate is None else estimate.t_ns,
            expected_delay_ns=delay_ns,
        )
        with contextlib.suppress(Exception):
            self._record(plan)
        return plan


def _authority(override: ThrustOverride | None) -> Authority:
    return Authority.CONTROLLER if override is None else override.authority


def _first_delay_ns(config: ControllerConfig) -> int:
    """Return the delay (ns) that is expected before anything was measured."""
    return round(config.first_delay_s * 1e9)
