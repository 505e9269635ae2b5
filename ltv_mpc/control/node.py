"""Controller node: one control cycle per period on the newest estimate, under the current authority.

It publishes its state at each change of authority, reference, fence or forced source, and every ``SAVE_PERIOD_NS``.
From that state and the plan in force another controller node can continue.

Its health counts what the actuators report of its plans: rejections, and that none arrives.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import msgspec

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.controller import SAVE_PERIOD_NS, Controller
from ltv_mpc.control.estimate_sources import EstimateSources
from ltv_mpc.control.ocp.extension import Limit, Term
from ltv_mpc.control.operator_commands import OperatorCommands
from ltv_mpc.control.pre_arm import Failure, failures
from ltv_mpc.control.solvers import SolverFactory, make
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.messages import (
    Acknowledgement,
    Action,
    Applied,
    Authority,
    Battery,
    ClockStep,
    Command,
    ControllerState,
    CycleTiming,
    Estimate,
    FenceInForce,
    Health,
    Heartbeat,
    InputReport,
    Leak,
    Manual,
    Message,
    MissionAction,
    ModelCheck,
    Obstacles,
    Plan,
)
from ltv_mpc.node import Cycle, Inbox, ReceivedMessage, Stopwatch, no_stopwatch
from ltv_mpc.references import Reference
from ltv_mpc.safety.command_arbiter import MANUAL_TIMEOUT_NS, CommandArbiter
from ltv_mpc.safety.health import NOMINAL, HealthState, plan_timeout_ns, report_health, worst
from ltv_mpc.safety.input_age import InputMonitor
from ltv_mpc.safety.mission_policy import MissionPolicy
from ltv_mpc.safety.model_monitor import ModelMonitor
from ltv_mpc.safety.source_selector import Source
from ltv_mpc.vehicle.parameters import Vehicle

CLOCK_DOUBT_NS = 10_000_000_000
"""Time for which the health is degraded after a clock step that may also be a congested link."""

ACTUATORS = "applied"
"""Input of the actuators' reports."""

UNCERTAIN_CLOCK = "a publisher's clock was set back, or its link is congested"


class ControllerNode:
    """Controller of one vehicle as a node.

    It reads the newest ``Estimate`` and ``Manual``, and each ``Applied``, ``Command``, ``CycleTiming``, ``ClockStep``,
    ``Battery``, ``Leak``, ``Obstacles`` and ``Heartbeat``; commands after the other messages of an inbox. It writes one
    ``Plan`` per cycle, also while disarmed: that plan ramps all thrusts to zero. It also writes an ``Acknowledgement``
    for each command, and from time to time a ``ControllerState``, a ``ModelCheck`` and, with a fence or obstacles, a
    ``FenceInForce``. A node that replaces another one receives the newest ``ControllerState`` as its first message.
    """

    name = "controller"
    reads: tuple[type[Message], ...] = (
        Estimate,
        Applied,
        CycleTiming,
        ClockStep,
        Command,
        Manual,
        Heartbeat,
        Battery,
        Leak,
        Obstacles,
    )
    writes: tuple[type[Message], ...] = (Plan, Acknowledgement, ControllerState, ModelCheck, FenceInForce)

    def __init__(
        self,
        vehicle: Vehicle,
        reference: Reference,
        config: ControllerConfig,
        *,
        fence: Fence | None = None,
        terms: Sequence[Term | Limit] = (),
        make_solver: SolverFactory = make,
        stopwatch: Stopwatch = no_stopwatch,
    ) -> None:
        """Begin disarmed.

        Parameters
        ----------
        vehicle, reference, config, terms, make_solver, stopwatch : as ``Controller`` takes them.
        fence : as ``Controller.set_fence`` takes it.
        """
        self.schedule = Cycle(config.period_ns)
        self.controller = Controller(
            vehicle, reference, config, terms=terms, make_solver=make_solver, stopwatch=stopwatch
        )
        self.controller.set_fence(fence)
        self.arbiter = CommandArbiter(vehicle)
        self.sources = EstimateSources(self.controller, config.sources)
        """Sources of the estimates: the active one and the rejected ones."""
        self.reports = InputMonitor()
        """Order and age of the actuators' reports."""
        self._commands = OperatorCommands(self.controller, self.arbiter, self.sources, reference)
        self._model_monitor = ModelMonitor(vehicle)
        self._plan_rejections = PlanRejections(config.period_ns)
        self._applied: Applied | None = None  # the newest
        self._cycle_ns = 0  # time of the last cycle
        self._clock_doubt: ClockStep | None = None  # the last step, if it is not certain
        self._saved: ControllerState | None = None  # state that was published last

    @property
    def mission(self) -> MissionPolicy:
        """Policy that ends the mission."""
        return self._commands.mission

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:
        """Run one cycle; there is no plan before the first estimate.

        Parameters
        ----------
        t_ns : vehicle time of the cycle (ns).
        inbox : messages since the last cycle.
        """
        self._cycle_ns = t_ns
        acknowledged: list[Message] = []
        for received in sorted(inbox, key=_is_by_operator):
            match received.message:
                case Command() as command:
                    self.mission.hear_operator(received.received_t_ns)
                    acknowledged.append(self._commands.acknowledge(command, t_ns, self._pre_arm_failures))
                case Manual() as manual:
                    self.mission.hear_operator(received.received_t_ns)
                    self.arbiter.receive_manual(manual.thrust_N, received.received_t_ns)
                case Heartbeat():
                    self.mission.hear_operator(received.received_t_ns)
                case Battery() | Leak() as monitored:
                    self.mission.receive(monitored, received.received_t_ns)
                case ClockStep() as clock_step:
                    self._clock_doubt = None if clock_step.certain else clock_step
                case ControllerState() as state:
                    self._restore(state, t_ns)
                case _:
                    self.receive(received)
        self._apply_mission_policy(t_ns)
        # The plan and the state come first: a command that is acknowledged is in force, and saved.
        plans = [] if self.sources.newest is None else [self.cycle(self.sources.newest, t_ns)]
        reports: list[Message | None] = [self._due_state(t_ns), self._commands.fence.due(t_ns), self._check_model()]
        states, fences, checks = ([] if report is None else [report] for report in reports)
        return [*plans, *states, *acknowledged, *fences, *checks]

    def receive(self, received: ReceivedMessage) -> None:
        """Take in a message about the vehicle's motion or the time of a cycle.

        Parameters
        ----------
        received : an estimate or a report that is out of order is ignored and counted.
        """
        match received.message:
            case Estimate() as estimate:
                at_origin = self.controller.vehicle.reference_point.to_origin(estimate)
                if self.sources.receive(received, at_origin):
                    self._model_monitor.restart()
            case Applied() as applied:
                if self.reports.accepts(received, applied.t_ns):
                    self._applied = applied
                    self.controller.add_report(applied)
                    self._model_monitor.add_report(applied)
                    self._plan_rejections.add(applied, received.received_t_ns)
            case CycleTiming() as timing:
                self.controller.add_timing(timing)
            case Obstacles() as obstacles:
                self._commands.fence.receive(obstacles)
            case _:
                pass

    def cycle(self, estimate: Estimate, t_ns: int) -> Plan:
        """Return the plan of one cycle.

        Parameters
        ----------
        estimate : the newest estimate.
        t_ns : start of the cycle, vehicle time (ns).
        """
        plan = self.controller.plan(
            estimate, t_ns=t_ns, override=self.arbiter.override(t_ns), health=self._health_of_inputs(t_ns)
        )
        return self.controller.vehicle.reference_point.of_plan(plan)

    def health(self, t_ns: int) -> HealthState:
        """Return the health of all inputs, with its reason.

        Parameters
        ----------
        t_ns : now, vehicle time (ns).
        """
        return worst(self.controller.health(t_ns), self._health_of_inputs(t_ns))

    @property
    def active_source(self) -> Source | None:
        """Source of the estimates in use; None before the first believed estimate."""
        return self.sources.selector.active

    def inputs(self) -> tuple[InputReport, ...]:
        """Return the state of each input whose age decides the health, at the last cycle."""
        t_ns, ages, implausible = self._cycle_ns, self.controller.config.ages, self.controller.estimate_gate.rejected
        estimates = self.sources.monitor.report("estimate", t_ns, ages, implausible=implausible.total())
        return estimates, self.reports.report(ACTUATORS, t_ns, ages)

    def _health_of_inputs(self, t_ns: int) -> HealthState:
        """Return the worst health of the inputs other than the estimate's age."""
        return worst(self.mission.health(t_ns), *self._states(t_ns).values())

    def _states(self, t_ns: int) -> dict[str, HealthState]:
        """Return the health by each input other than estimate's age and mission policy, by name."""
        reports, ages = self.reports.age, self.controller.config.ages
        return {
            "actuators": report_health(silent_ns=reports.silent_ns(t_ns), period_ns=reports.median_ns, ages=ages),
            "plans": self._plan_rejections.health(t_ns),
            "commands": self.controller.actuator_check.health,
            "clock": self._health_of_clock(t_ns),
            "obstacles": self._commands.fence.health,
            "source": self.sources.health(t_ns),
            "vehicle file": self.controller.vehicle_file_check.health,  # stands for minutes, and hides nothing new
            "thrusters": self._model_monitor.weak_thruster.health(self.controller.vehicle),
        }

    def _health_of_clock(self, t_ns: int) -> HealthState:
        """Return the health by doubts about a publisher's clock."""
        if self._clock_doubt is not None and t_ns - self._clock_doubt.t_ns < CLOCK_DOUBT_NS:
            return HealthState(Health.DEGRADED, UNCERTAIN_CLOCK)
        return NOMINAL

    def _pre_arm_failures(self) -> list[Failure]:
        """Return the pre-arm checks that fail now."""
        t_ns = self._cycle_ns
        trial = Controller(self.controller.vehicle, self._commands.reference, self.controller.config)
        trial.set_fence(self.controller.fence)
        return failures(
            trial,
            estimate=self.sources.newest,
            applied=self._applied,
            reports={report.input: report for report in self.inputs()},
            states=self._states(t_ns),
            causes=self.mission.causes(t_ns),
        )

    def _apply_mission_policy(self, t_ns: int) -> None:
        """Hold the position, or let the reference go on; an action takes the thrusters from a silent pilot."""
        action = self.mission.update(t_ns, armed=self.arbiter.armed)
        if action is MissionAction.HOLD:
            self.controller.pause(self.sources.newest)
        else:
            self.controller.resume()
        no_pilot = self.mission.operator_is_silent(t_ns, MANUAL_TIMEOUT_NS)
        if action is not MissionAction.GO_ON and self.arbiter.authority is Authority.MANUAL and no_pilot:
            self.arbiter.request(Action.RELEASE)

    def _check_model(self) -> ModelCheck | None:
        """Compare the motion with the model's; return the report that is due."""
        estimate, monitor, check = self.controller.estimate_gate.accepted, self._model_monitor, None
        if not self.controller.actuator_check.learns:
            monitor.restart()
        elif estimate is not None:
            observer = self.controller.observer
            rates_agree = self.controller.estimate_gate.filter.health is NOMINAL
            if self.controller.vehicle_file_check.stamps_are_late or not rates_agree:
                monitor.dismiss()
            check = monitor.update(estimate, observer.current, observer.coefficients)
        self._set_thrust_shares()
        why = self.controller.vehicle_file_check.why
        if check is None or not why:
            return check
        return msgspec.structs.replace(check, alarm=True, why=f"{why}; {check.why}" if check.why else why)

    def _set_thrust_shares(self) -> None:
        """Plan with the share that a weak thruster delivers."""
        monitor, weak = self._model_monitor, self._model_monitor.weak_thruster
        known = weak.is_weak and not weak.may_be_weaker
        self.controller.set_thrust_shares(weak.shares, in_doubt=monitor.suspects_loss and not known)

    # --- saved state ---

    def _restore(self, state: ControllerState, t_ns: int) -> None:
        """Continue where another node ended: with its authority and its reference, from the plan in force."""
        self.arbiter.authority = state.authority
        other_fence = state.fence_toml != self._commands.fence_toml
        if other_fence:  # its origin need not be that of the saved reference
            self._commands.set_fence("")
        if state.reference_toml and state.reference_toml != self._commands.reference_toml:
            self._commands.follow(state.reference_toml)
        if other_fence:
            self._commands.set_fence(state.fence_toml)
        self._commands.arm_continues = state.arm_continues
        if state.model_products is not None:
            self._model_monitor.restore(state.model_products)
        self._model_monitor.weak_thruster.restore(state.thrust_shares)
        self._set_thrust_shares()
        self.controller.restore(state, t_ns)
        self.mission.state = state.mission
        self.sources.selector.forced = state.source
        if self.sources.newest is None:
            self.sources.newest = state.estimate

    def _due_state(self, t_ns: int) -> ControllerState | None:
        """Return the state if it is due: at each change of what an operator chooses, and every SAVE_PERIOD_NS."""
        before, toml = self._saved, self._commands.reference_toml
        if before is not None and (
            0 <= t_ns - before.t_ns < SAVE_PERIOD_NS
            and before.authority is self.arbiter.authority
            and before.arm_continues is self._commands.arm_continues
            and before.reference_toml is toml
            and before.fence_toml is self._commands.fence_toml
            and before.source == self.sources.selector.forced
            and (before.reference_start is None) != self.controller.reference_has_begun
            and before.mission.action is self.mission.state.action
        ):
            return None
        self._saved = msgspec.structs.replace(
            self.controller.save(t_ns),
            authority=self.arbiter.authority,
            reference_toml=toml,
            fence_toml=self._commands.fence_toml,
            arm_continues=self._commands.arm_continues,
            model_products=self._model_monitor.products,
            thrust_shares=self._model_monitor.weak_thruster.shares,
            estimate=self.sources.newest,
            source=self.sources.selector.forced,
            mission=self.mission.state,
        )
        return self._saved


def _is_by_operator(received: ReceivedMessage) -> bool:
    return isinstance(received.message, Command | Manual)


REJECTED_PLANS = "the actuators reject plans"
NO_PLANS = "no plan arrives at the actuators: the thrusters are at rest"

MIN_REJECTIONS = 2
"""Rejections within the window from which the health is degraded: a link that reorders two plans costs one."""


class PlanRejections:
    """Rejections of plans by the actuators, of this controller or of a second one, and the end of the last plan.

    The health is degraded from the second rejection within ``plan_timeout_ns`` on, until that time has passed without
    another one. It is also degraded while the actuators report that their last plan has ended.
    """

    def __init__(self, plan_period_ns: int) -> None:
        """Begin without a report.

        Parameters
        ----------
        plan_period_ns : period of the plans (ns).
        """
        self._window_ns = plan_timeout_ns(plan_period_ns)
        self._count: int | None = None  # in the newest report
        self._ended = False  # the last plan, by the newest report
        self._seen_ns: deque[int] = deque(maxlen=MIN_REJECTIONS)  # arrival of the reports of the last rejections

    def add(self, applied: Applied, received_ns: int) -> None:
        """Add a report; rejections before the first one, or before a restart of the actuators, do not count.

        Parameters
        ----------
        applied : report, newer than the last.
        received_ns : its arrival, vehicle time (ns).
        """
        count = applied.plans_rejected
        if self._count is not None:
            self._seen_ns.extend([received_ns] * min(count - self._count, MIN_REJECTIONS))
        self._count, self._ended = count, applied.health is Health.FAILSAFE

    def health(self, t_ns: int) -> HealthState:
        """Return the health by the newest report and the last rejections.

        Parameters
        ----------
        t_ns : now, vehicle time (ns).
        """
        if self._ended:
            return HealthState(Health.DEGRADED, NO_PLANS)
        seen = self._seen_ns
        if len(seen) < MIN_REJECTIONS or t_ns - seen[-1] > self._window_ns or seen[-1] - seen[0] > self._window_ns:
            return NOMINAL
        return HealthState(Health.DEGRADED, REJECTED_PLANS)
