"""Model predictive controller: one cycle, from the newest estimate to a plan.

A cycle selects the mode (``mode.py``), predicts the state at the plan's start (``prediction.py``), plans the vertical
thruster (``vertical.py``) and then the lateral ones along the predicted depths (``lateral.py``).

If the QP gives no usable commands, the same cycle takes the next fallback level (``fallback.py``). The plan's
``origin`` says where its lateral thrusts come from, and ``why`` gives the reason if it is not the QP:

    solved     the QP
    shifted    the rest of the plan that was solved last, then zero lateral thrust
    stop       the vehicle is stopped through the water: no estimates, in the mode HOLD
    zero       a ramp to zero: no plan is left to shift, the mode commands no lateral thrust, or the cycle raised
    manual     a ramp to the lateral thrusts of an override

Source: Medagoda & Williams 2012, Fig 5 (compensation of the delay), section V (horizon). This controller adds analytic
sensitivities, thruster lag and slew in the model, and it solves one convex QP at a time.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence

import msgspec
import numpy as np

from ltv_mpc.bathymetry import Bathymetry
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.delay import Delay
from ltv_mpc.control.disturbance import DisturbanceObserver
from ltv_mpc.control.fallback import NOT_RUN, LateralPlan, ramp_to_rest
from ltv_mpc.control.lateral import MAX_WHY_CHARS, LateralPlanner
from ltv_mpc.control.mode import Decision, Mode, decide
from ltv_mpc.control.ocp.extension import Limit, Term
from ltv_mpc.control.prediction import Prediction, Start, growth_m
from ltv_mpc.control.problem_data import Constants
from ltv_mpc.control.resolution import settled
from ltv_mpc.control.solvers import SolverFactory, make
from ltv_mpc.control.vertical import VerticalLaw, VerticalPlan
from ltv_mpc.conversion import exact
from ltv_mpc.geofence.fence import Fence, compare_origins
from ltv_mpc.messages import (
    Applied,
    Array,
    Authority,
    ControllerState,
    CycleTiming,
    Estimate,
    FenceInForce,
    Health,
    Obstacles,
    Pair,
    Plan,
    PlanOrigin,
    SolveStatus,
    Times,
)
from ltv_mpc.node import Stopwatch, no_stopwatch
from ltv_mpc.references import Hold, Reference
from ltv_mpc.references.follower import NO_PROGRESS, Follower, FollowerState
from ltv_mpc.safety.actuator_check import ActuatorCheck
from ltv_mpc.safety.command_arbiter import ThrustOverride
from ltv_mpc.safety.estimate_gate import EstimateGate
from ltv_mpc.safety.health import NOMINAL, HealthState, plan_end_ns, worst
from ltv_mpc.safety.motion_fit import MotionFit
from ltv_mpc.safety.vehicle_file_check import VehicleFileCheck
from ltv_mpc.vehicle.parameters import Vehicle

STAYS_AWAY = "the vehicle does not get nearer to its target"
UNSOLVED = HealthState(Health.DEGRADED, "no plan can be solved, so the lateral thrusts rest")
PREVENTED = "the current, the thrusters or the vehicle file prevent it"

SAVE_PERIOD_NS = 5_000_000_000
"""Longest time between two published states."""


class Controller:
    """Model predictive controller of one vehicle along one reference."""

    def __init__(
        self,
        vehicle: Vehicle,
        reference: Reference,
        config: ControllerConfig | None = None,
        *,
        terms: Sequence[Term | Limit] = (),
        make_solver: SolverFactory = make,
        stopwatch: Stopwatch = no_stopwatch,
    ) -> None:
        """Set up a controller that has no estimate yet.

        Parameters
        ----------
        vehicle : nominal model.
        reference : what to follow, from the first estimate after its start.
        config : settings of the controller; ``ControllerConfig()`` if None. Without a horizon: the vehicle's own.
        terms : cost terms and limits of your own (docs/add-limit.md, docs/add-cost-term.md).
        make_solver : factory of the QP solver; by default it makes the solver that the settings name.
        stopwatch : is called with a stage's name when that stage of a cycle ends.

        Raises
        ------
        ConfigError : the settings name an unknown solver, or one that does not support their motion limits; or a number
            of vehicle, reference or settings is not one (``conversion.py``).
        """
        vehicle = exact(vehicle)
        self.config = config = settled(exact(config or ControllerConfig()), vehicle)
        self.vehicle = vehicle
        weights = config.weights.at_heading(False)
        self.prediction = Prediction(vehicle, config.period_ns)
        """Prediction from an estimate, with the commands in force."""
        constants = Constants.of(vehicle, weights, config.knots, config.limits.state_bounds)
        constants = constants._replace(p=self.prediction.coefficients)  # one array, with what the observer learns
        self.estimate_gate = EstimateGate(vehicle, config.ages)
        """Plausibility check of the estimates, with the count of rejected ones."""
        self.vehicle_file_check = VehicleFileCheck(MotionFit(vehicle))
        """Check of the vehicle file against what the motion shows."""
        self.actuator_check = ActuatorCheck(vehicle, config.period_ns)
        """Check of the actuators' reports against the plans: whether the motion comes from them."""
        self.observer = DisturbanceObserver(config.disturbance, vehicle)
        """What the motion has shown of current, estimated point and vehicle."""
        self._vertical = VerticalLaw(vehicle, constants, config.limits)
        first_ns, least_ns = round(config.first_delay_s * 1e9), round(config.min_delay_s * 1e9)
        plan_ns = plan_end_ns(config.knots_ns, config.period_ns, vehicle.plan_timeout_s)
        self._delay = Delay(first_ns, config.delay_quantile, least_ns, plan_ns)
        self._lateral = LateralPlanner(vehicle, config, constants, make_solver, stopwatch, terms)
        self._stopwatch = stopwatch
        self._followers = [self._follower(reference)]  # of the reference, and of the hold while it is paused

    @property
    def follower(self) -> Follower:
        """Follower of the reference: its target and the progress along it."""
        return self._followers[-1]

    def follow(self, reference: Reference) -> None:
        """Follow another reference from the next cycle on, or from ``resume`` on while the controller is paused.

        The integral of the depth law begins at zero.

        Parameters
        ----------
        reference : begins at the first estimate after its start.

        Raises
        ------
        ConfigError : its origin is not that of the fence.
        """
        compare_origins(self.fence, reference)
        self._followers[0] = self._follower(reference)
        self._vertical.restart()

    def pause(self, estimate: Estimate | None) -> None:
        """Hold the position of the next cycle until ``resume``; the reference waits.

        Parameters
        ----------
        estimate : its depth is held.
        """
        if len(self._followers) == 1:
            self._followers.append(self._follower(Hold.at_depth_of(estimate)))

    def resume(self) -> None:
        """Follow the reference again, if it waits."""
        del self._followers[1:]

    @property
    def reference_has_begun(self) -> bool:
        """True if the reference is in force, or was before ``pause``."""
        return self._followers[0].target_m is not None

    @property
    def arrived(self) -> bool:
        """True once the vehicle was at the end of the reference, until another reference, or the same one, begins."""
        return self._followers[0].arrived

    @property
    def fence(self) -> Fence | None:
        """Fence in force."""
        return self._lateral.fencing.fence

    def set_fence(self, fence: Fence | None) -> None:
        """Keep another fence from the next cycle on. If it is rejected, the one in force stays.

        Parameters
        ----------
        fence : keep-in and keep-out zones; None: no fence.

        Raises
        ------
        ConfigError : the vehicle's file has no [hull], or the fence's origin is not that of the reference.
        """
        fence = None if fence is None else exact(fence)
        compare_origins(fence, self._followers[0].reference)
        self._lateral.fencing.set_fence(fence)
        self._restrict_paths()

    @property
    def bathymetry(self) -> Bathymetry | None:
        """Soundings of the bottom, if there are any."""
        return self._vertical.depth_limits.bathymetry

    def set_bathymetry(self, bathymetry: Bathymetry) -> None:
        """Keep the least altitude above the bottom of a bathymetry, too, from the next cycle on.

        Parameters
        ----------
        bathymetry : soundings of the bottom.

        Raises
        ------
        ConfigError : the settings have no ``limits.min_altitude_m``.
        """
        self._vertical.depth_limits.set_bathymetry(bathymetry)

    def add_obstacles(self, obstacles: Obstacles) -> None:
        """Avoid obstacles from the next cycle on, until their reports are too old.

        Parameters
        ----------
        obstacles : reports of some or all obstacles.

        Raises
        ------
        ConfigError : the vehicle's file has no [hull], or a value is out of its bounds.
        """
        self._lateral.fencing.add_obstacles(exact(obstacles))

    def fence_in_force(self, t_ns: int) -> FenceInForce:
        """Return the fence that is kept, and the obstacles that are known.

        Parameters
        ----------
        t_ns : time of the message, vehicle time (ns).
        """
        return self._lateral.fencing.in_force(t_ns)

    def add_report(self, applied: Applied, t_ns: int | None = None) -> None:
        """Add a report of the actuators: it corrects the expected delay, the commands in force and the thrusts.

        While its commands contradict the plans, nothing is learned from the motion; after 1 s the health is degraded.

        Parameters
        ----------
        applied : the plan that they received last, their commands and their delivered thrusts. One with a number that
            is none, or that no thruster delivers, is not used; the health says so.
        t_ns : now, vehicle time (ns): a report of later is one of now. None: not known.
        """
        report = self.actuator_check.usable(applied)
        if report is None:
            return
        if t_ns is not None and report.t_ns > t_ns:
            report = msgspec.structs.replace(report, t_ns=t_ns)
        self._delay.add_receipt(report)
        self.prediction.add_report(report)
        disagreed = self.actuator_check.disagrees
        self.actuator_check.add(report)
        if self.actuator_check.disagrees and not disagreed:
            self.observer.take_back(self.actuator_check.agreed_ns or report.t_ns)
        self.vehicle_file_check.fit.add_thrust(report.t_ns, report.thrust_N)
        self.prediction.sent.correct(report.t_ns, report.command_N)

    def add_timing(self, timing: CycleTiming) -> None:
        """Add the computing time of the last cycle: without receipts of plans the expected delay follows from it.

        Parameters
        ----------
        timing : ``compute_ns`` is used; it does not include the transport of the plan.
        """
        self._delay.add_timing(timing)

    def restart_estimates(self) -> None:
        """Begin with another source of estimates: gate, period, checks and current bias are those of one source."""
        self.estimate_gate.restart()
        self.vehicle_file_check = VehicleFileCheck(MotionFit(self.vehicle))
        self._restart_observer()

    def predict(self, estimate: Estimate, t_ns: int) -> Array:
        """Return the predicted lateral state (6,) at ``t_ns``: n, e, u, v, psi, r.

        Parameters
        ----------
        estimate : where the prediction begins.
        t_ns : time of the state, vehicle time (ns).
        """
        return self.prediction.state_at(exact(estimate), int(t_ns)).lateral[:6]

    def set_thrust_shares(self, shares: Pair, *, in_doubt: bool = False) -> None:
        """Plan from the next cycle on with lateral thrusters that deliver a share of what they report.

        Parameters
        ----------
        shares : of port and starboard, above 0; 1 if sound.
        in_doubt : the thrusters may deliver less than that, so the bias of the current does not learn from the motion.
        """
        self.observer.thrust_in_doubt = in_doubt
        self._lateral.set_shares(shares)
        self.prediction.set_shares(shares)

    def health(self, t_ns: int) -> HealthState:
        """Return the health by estimates (age, uncertainty of the last prediction), actuators, vehicle file and target.

        Parameters
        ----------
        t_ns : now, vehicle time (ns).
        """
        own = self.estimate_gate.health(t_ns)
        rates = self.estimate_gate.filter.health
        return worst(own, self.actuator_check.health, self._target_health, self.vehicle_file_check.health, rates)

    @property
    def _target_health(self) -> HealthState:
        if not self.follower.stays_away:
            return NOMINAL
        return HealthState(Health.DEGRADED, f"{STAYS_AWAY}: {self.vehicle_file_check.health.why or PREVENTED}")

    def plan(
        self,
        estimate: Estimate,
        *,
        t_ns: int | None = None,
        applied: Applied | None = None,
        override: ThrustOverride | None = None,
        health: HealthState = NOMINAL,
    ) -> Plan:
        """Return the plan of one control cycle. It does not raise.

        If a part of the cycle raises, the lateral thrusts ramp to zero and the plan gives the exception as its reason.

        Parameters
        ----------
        estimate : the newest estimate, of the vehicle's origin (``Vehicle.reference_point.to_origin``).
        t_ns : start of the cycle, vehicle time (ns); the estimate's own time if None.
        applied : the actuators' report, not of later than now. Without reports the controller assumes that its plans
            are followed.
        override : thrusts commanded by a source other than the controller.
        health : of the inputs that the caller monitors, with its reason; the plan reports the worse of it and the
            estimate's.

        Returns
        -------
        The plan; its ``origin`` names where the thrusts come from, and ``why`` gives the reason if it is not solved.
        """
        now_ns = 0 if self.estimate_gate.accepted is None else self.estimate_gate.accepted.t_ns  # if none is given
        try:
            now_ns = int(estimate.t_ns if t_ns is None else t_ns)
            if applied is not None:
                self.add_report(applied, now_ns)
            return self._cycle(self.estimate_gate.usable(estimate), now_ns, override, health)
        except Exception as error:  # of any kind: the thrusters must have a command in every cycle
            why = f"{type(error).__name__}: {error}"[:MAX_WHY_CHARS]
            return self._emergency_plan(now_ns, override, health, why)

    def _cycle(self, newest: Estimate, now_ns: int, override: ThrustOverride | None, health: HealthState) -> Plan:
        """Return the plan of one cycle. May raise; ``plan`` catches it."""
        decision = self._decide(newest, now_ns, override, health)
        delay_ns = self._delay.expected_ns
        start = self.prediction.state_at(decision.estimate, now_ns + delay_ns)
        self.vehicle_file_check.fit.add_thrust(start.t_ns, start.thrust_N, reported=False)
        knots = start.t_ns + self._lateral.previous.knots_ns
        if self._lateral.fencing.predict_obstacles(start.t_ns):
            self._restrict_paths()
        if decision.follows:
            current = start.current_north_mps, start.current_east_mps
            self.follower.advance(knots, start.lateral, current, self._lateral.target)
            if self.estimate_gate.health(now_ns) is NOMINAL:
                self.follower.arrive(decision.estimate, self.config.position_tolerance_m)
            if decision.mode is Mode.FOLLOW and self._lateral.fencing.way == "straight":
                self.follower.watch(decision.estimate, self.config.position_tolerance_m)
        self._lateral.fencing.set_path(self.follower.path_beside(knots) if decision.follows else None)
        error_mps2, apart_m = self.observer.model_error_mps2, self.estimate_gate.growth_m + self.observer.waves_m
        self._lateral.fencing.update(start, decision.estimate, apart_m, error_mps2)
        follower = self.follower if decision.follows else None
        self._vertical.depth_limits.look_ahead(start, self._lateral.previous.plan, follower)
        vertical = self._plan_vertical(decision, start, knots)
        self._lateral.set_current(decision.estimate, vertical.depth_m)
        self._stopwatch("predict")
        lateral = self._plan_lateral(decision, start, knots)
        if lateral.solve.status is SolveStatus.NON_FINITE:
            self.observer.forget_vehicle()  # slips of the installation teach a model whose motion has no end
        plan = self._assemble(decision, now_ns, delay_ns, start, knots, vertical, lateral)
        self._record(plan)
        if not self.actuator_check.learns:
            vertical = vertical._replace(integral_rate_N_per_s=0.0)
        self._vertical.advance_integral(vertical, start.t_ns)
        # Stage "read": reading the QP's solution out into a plan. The step loop uses the same recorded name for reading
        # its inbox, and the stage timer adds both.
        self._stopwatch("read")
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
        reference = self._followers[0]
        follower = reference.save()
        plan_delays_ns, cycle_times_ns = self._delay.save()
        return ControllerState(
            t_ns=t_ns,
            reference_start=follower.reference_start,
            schedule_t_ns=follower.t_ns,
            schedule_s=follower.tau_s,
            schedule_rate=follower.rate,
            progress=reference.progress.share,
            arrived=reference.arrived,
            depth_integral_N=self._vertical.integral_N,
            disturbance=self.observer.save(),
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
        state, expected_ns = exact(state), 0
        if state.plan is not None:
            expected_ns = state.plan.expected_delay_ns
            self.prediction.sent.add(state.plan, before_N=state.plan.initial_thrust_N)
            self.actuator_check.sent(state.plan)
            self._lateral.previous.restore(state.plan)
        self._delay.restore(expected_ns, state.plan_delays_ns, state.cycle_times_ns)
        self._vertical.integral_N = state.depth_integral_N
        self.observer.restore(state.disturbance, t_ns - state.t_ns)
        followed = FollowerState(state.reference_start, state.schedule_t_ns, state.schedule_s, state.schedule_rate)
        moved_until_ns = _end_of_motion_ns(state, self.config.period_ns, self.vehicle.plan_timeout_s)
        self._followers[0].restore(followed, t_ns, moved_until_ns=moved_until_ns)
        self._followers[0].arrived = state.arrived or (state.plan is not None and state.plan.arrived)

    def _follower(self, reference: Reference) -> Follower:
        """Return a follower whose target skips what lies in zones, and is no faster than the vehicle may be."""
        follower = Follower(exact(reference), self.vehicle, self.config.limits.path_speed_mps)
        follower.restrict(self._lateral.fencing.allowed_path)
        return follower

    def _restrict_paths(self) -> None:
        """Move the targets along the part of their paths that is allowed now."""
        for follower in self._followers:
            follower.restrict(self._lateral.fencing.allowed_path)

    def _restart_observer(self, mean: Array | None = None) -> None:
        """Forget what other rates or stamps have taught."""
        self.observer = DisturbanceObserver(self.config.disturbance, self.vehicle, mean)

    # --- parts of a cycle ---

    def _decide(self, newest: Estimate, now_ns: int, override: ThrustOverride | None, health: HealthState) -> Decision:
        """Decide the mode, and begin the reference if the mode allows it.

        The decision uses the newest plausible estimate, corrected by the disturbance observer.
        """
        failed, check = self.estimate_gate.filter.failed, self.actuator_check
        estimate = self.estimate_gate.select(newest)
        if self.estimate_gate.filter.failed != failed:
            self._restart_observer()
        given = self.estimate_gate.accepted
        check.overridden = override is not None
        if estimate is not None and given is not None:
            self._vertical.depth_limits.update(estimate)
            if check.learns:
                self.vehicle_file_check.add(given)
            late_s = self.vehicle_file_check.late_s
            if late_s:
                estimate = msgspec.structs.replace(estimate, t_ns=estimate.t_ns - round(late_s * 1e9))
            estimate = self.observer.correct(estimate, self.prediction, learns=check.learns)
            self.prediction.coefficients[:] = self.observer.coefficients
            other = self.observer.in_waves or self.estimate_gate.filter.health is not NOMINAL
            self.vehicle_file_check.update(given.t_ns, bounded=self.observer.is_bounded, other_cause=other)
            if bool(self.vehicle_file_check.late_s) is not bool(late_s):
                self._restart_observer(self.vehicle_file_check.fit.of_observer)
        own = self.estimate_gate.health(now_ns)
        if estimate is not None and own.health is Health.DEGRADED:
            bias = self.observer.covariance_of_mean((now_ns - estimate.t_ns) * 1e-9)
            growth = growth_m(self.prediction, estimate, now_ns, bias)
            self.estimate_gate.limit_growth(growth)
            own = self.estimate_gate.health(now_ns)
        decision = decide(
            estimate,
            now_ns,
            override=override,
            health=worst(own, health, self.health(now_ns)),
            late=own is not NOMINAL,
            follower=self.follower,
            lateral=self.config.lateral,
        )
        return decision.without_depth() if self.vehicle.can_dive and self.follower.depth_m is not None else decision

    def _plan_vertical(self, decision: Decision, start: Start, knots: Times) -> VerticalPlan:
        """Return the vertical thruster's plan in this mode: the depth law's, a ramp, or the commands in force."""
        law, depth_m = self._vertical, decision.estimate.depth_m
        if decision.mode is not Mode.HOLD:
            law.held_m = None
        if decision.override is not None:
            return law.ramp_to(start, knots, decision.override.targets(knots)[:, 2])
        if decision.mode is Mode.FAILSAFE:
            return law.ramp_to(start, knots, np.full(len(knots), self.vehicle.failsafe_vertical_N))
        if depth_m is not None:
            if decision.mode is Mode.HOLD and self.follower.depth_m is not None:
                return law.hold(start, decision.estimate, knots)
            depth_reference = self.follower.depths(knots) if decision.follows else None
            if depth_reference is not None:
                return law.track(start, decision.estimate, *depth_reference)
        return law.keep(start, self.prediction.sent.at(knots)[:, 2])

    def _plan_lateral(self, decision: Decision, start: Start, knots: Times) -> LateralPlan:
        """Return the lateral thrusters' plan in this mode.

        In FOLLOW it is the QP's plan or that of a fallback level, in HOLD one that stops the vehicle, and in the other
        modes a ramp to the override or to zero. The vehicle stops, too, between zones whose grown margins meet.
        """
        meeting = self._lateral.fencing.meeting_margins
        if decision.mode is Mode.FOLLOW and meeting:
            return self._lateral.stop(start, f"margins meet while estimates are late: {', '.join(meeting)}")
        if decision.mode is Mode.FOLLOW:
            self._lateral.set_reference(path=self.follower.is_path, heading=self.follower.heading_rad is not None)
            if not self.follower.is_path:
                self._lateral.relax_target(start, self.config.position_tolerance_m)
            self._lateral.bend_target(start)
            return self._lateral.plan(start)
        if decision.stops:
            return self._lateral.stop(start, decision.why)
        goal = None if decision.override is None else decision.override.targets(knots)
        return self._lateral.ramp(start, decision.why, goal)

    def _assemble(
        self,
        decision: Decision,
        now_ns: int,
        delay_ns: int,
        start: Start,
        knots: Times,
        vertical: VerticalPlan,
        lateral: LateralPlan,
    ) -> Plan:
        """Join the vertical and the lateral plan. Raises ArithmeticError if a vertical thrust is not finite."""
        thrust = np.empty((len(knots), 3))
        thrust[:, :2], thrust[:, 2] = lateral.U, vertical.thrust_N
        # The sum of squares is finite only if every thrust is. The lateral thrusts of the QP and of a shifted plan are
        # checked in lateral.py and fallback.py.
        if not math.isfinite(np.vdot(vertical.thrust_N, vertical.thrust_N)):
            raise ArithmeticError("a thrust is not finite")
        follower, follows = self.follower, decision.follows
        depth_m = follower.depth_m if follows else None
        progress = follower.progress if follows else NO_PROGRESS
        rests = follows and lateral.origin is PlanOrigin.ZERO
        health = worst(decision.health, UNSOLVED if rests else NOMINAL)
        return Plan(
            cycle_t_ns=now_ns,
            t_ns=knots,
            thrust_N=thrust,
            states=lateral.X[:, :6].copy(),
            origin=lateral.origin,
            solve=lateral.solve,
            why=lateral.why or decision.why,
            authority=_authority(decision.override),
            health=health.health,
            health_why=health.why,
            estimate_t_ns=decision.estimate_t_ns,
            expected_delay_ns=delay_ns,
            reference_m=follower.target_m if follows else None,
            reference_depth_m=depth_m,
            reference_heading_rad=follower.heading_rad if follows else None,
            depth_limit_m=None if depth_m is None else self._vertical.depth_limits.limit_before(depth_m),
            progress=progress.share,
            cross_track_m=progress.cross_track_m,
            remaining_m=progress.remaining_m,
            arrived=self.arrived,
            delivered_N=start.thrust_N,
            fence=self._lateral.fencing.report(
                lateral.X[:, :6], follower.skipped_m, drifts=lateral.origin is not PlanOrigin.SOLVED
            ),
        )

    def _record(self, plan: Plan) -> None:
        """Record the plan as sent: its commands are in force from its first knot on."""
        self.prediction.sent.add(plan)
        self.actuator_check.sent(plan)
        self._lateral.previous.record(plan)

    def _emergency_plan(self, now_ns: int, override: ThrustOverride | None, health: HealthState, why: str) -> Plan:
        """Return the plan of a cycle that raised, computed without the parts that may have raised.

        The lateral thrusts ramp to zero and the vertical one to the failsafe thrust (to zero under an override). The
        ramps begin at the commands in force, or at zero if these are not available.
        """
        self._lateral.discard_solver()
        self._lateral.previous.plan = None
        delay_ns = self._delay.expected_ns
        knots = now_ns + delay_ns + self._lateral.previous.knots_ns
        command = np.zeros(3)
        with contextlib.suppress(Exception):
            command = self.prediction.sent.at(knots[:1])[0]
        states, fence = np.zeros((len(knots), 6)), None
        estimate = self.estimate_gate.accepted
        if estimate is not None:
            drift_s = (knots - estimate.t_ns) * 1e-9
            states[:, 0] = estimate.north_m + drift_s * estimate.velocity_north_mps
            states[:, 1] = estimate.east_m + drift_s * estimate.velocity_east_mps
            states[:, 4] = estimate.heading_rad
            with contextlib.suppress(Exception):
                fence = self._lateral.fencing.report(states, 0.0, drifts=True)
        vertical_N = 0.0 if override is not None else self.vehicle.failsafe_vertical_N
        health = worst(self.health(now_ns), health, UNSOLVED)
        plan = Plan(
            cycle_t_ns=now_ns,
            t_ns=knots,
            thrust_N=ramp_to_rest(self.vehicle, command, knots, vertical_N),
            states=states,
            origin=PlanOrigin.ZERO,
            solve=NOT_RUN,
            why=why,
            authority=_authority(override),
            health=health.health,
            health_why=health.why,
            estimate_t_ns=now_ns if estimate is None else estimate.t_ns,
            expected_delay_ns=delay_ns,
            fence=fence,
        )
        with contextlib.suppress(Exception):
            self._record(plan)
        return plan


def _authority(override: ThrustOverride | None) -> Authority:
    return Authority.CONTROLLER if override is None else override.authority


def _end_of_motion_ns(state: ControllerState, period_ns: int, timeout_s: float) -> int:
    """Return until when (ns) the vehicle has followed the reference at most: to the end of the last plan.

    The plan in the state may be older than that one, by the period of the states. ``period_ns`` is that of the plans,
    ``timeout_s`` the vehicle's ``plan_timeout_s``.
    """
    plan = state.plan
    if plan is None or plan.authority is not Authority.CONTROLLER:
        return state.schedule_t_ns
    return plan_end_ns(plan.t_ns, period_ns, timeout_s) + SAVE_PERIOD_NS
