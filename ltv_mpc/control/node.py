"""The controller as a node: a cycle every 0.3 s on the newest estimate, by whoever is in charge.

It writes down who is in charge and how far the reference is, at each change and each 5 s: with that and the plan in
force another one continues where this one ended.
"""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from ltv_mpc import config as settings
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.controller import Controller
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import (
    Acknowledgement,
    Action,
    Applied,
    Authority,
    Command,
    ControllerState,
    CycleTiming,
    Estimate,
    Health,
    InputReport,
    Manual,
    Message,
    ModelCheck,
    Plan,
)
from ltv_mpc.node import Cycle, Due, Inbox, ReceivedMessage, Stopwatch, no_stopwatch
from ltv_mpc.references import Hold, Reference, Timed
from ltv_mpc.safety.command_arbiter import CommandArbiter, CommandResult
from ltv_mpc.safety.health import report_health, worst
from ltv_mpc.safety.input_monitor import InputMonitor
from ltv_mpc.safety.model_monitor import ModelMonitor
from ltv_mpc.vehicle.parameters import Vehicle

MAX_HOLD_DEPTH_M = 11_000.0
"""As a reference's ``depth_m``."""

SAVE_PERIOD_NS = 5_000_000_000
"""Longest time between two saved states."""

LONGEST_WRITTEN = 65_536
"""Characters of a reference in a saved state, as at the door; a longer one is the file that a new process reads too."""


class ControllerNode:
    """Reads the newest ``Estimate`` and ``Manual``, each ``Applied``, ``Command`` and ``CycleTiming``.

    Writes one ``Plan`` a cycle, disarmed too: that one ramps the thrusts to zero; an ``Acknowledgement`` for each
    command; a ``ControllerState`` and a ``ModelCheck`` now and then. A node that takes another's place is given the
    newest ``ControllerState`` as its first message.
    """

    name = "controller"
    reads: tuple[type[Message], ...] = (Estimate, Applied, CycleTiming, Command, Manual)
    writes: tuple[type[Message], ...] = (Plan, Acknowledgement, ControllerState, ModelCheck)

    def __init__(
        self,
        vehicle: Vehicle,
        reference: Reference,
        config: ControllerConfig,
        *,
        stopwatch: Stopwatch = no_stopwatch,
    ) -> None:
        """Disarmed."""
        self.schedule = Cycle(config.period_ns)
        self.controller = Controller(vehicle, reference, config, stopwatch=stopwatch)
        self.arbiter = CommandArbiter(vehicle)
        self._reference = reference
        self._written = _written(reference)
        self._estimate: Estimate | None = None
        self.estimates, self.reports = InputMonitor(), InputMonitor()
        """The inputs whose ages count."""
        self._monitor = ModelMonitor(vehicle, config.disturbance.noise_mps)
        self._cycled_ns = 0  # the last cycle's time
        self._saved: ControllerState | None = None

    def steps(self, due: Sequence[Due]) -> list[list[Message]]:
        """One cycle at each time; no plan until the first estimate."""
        return [self._step(t_ns, inbox) for t_ns, inbox in due]

    def _step(self, t_ns: int, inbox: Inbox) -> list[Message]:
        self._cycled_ns = t_ns
        said: list[Message] = []
        for arrival in inbox:
            match arrival.message:
                case Command() as command:
                    said.append(self._answered(command, t_ns))
                case Manual() as manual:
                    self.arbiter.receive_manual(manual.thrust_N, arrival.received_t_ns)
                case ControllerState() as state:
                    self._restore(state, t_ns)
                case _:
                    self.receive(arrival)
        # The plan first: who has the answer can rely on its being in force.
        plans = [] if self._estimate is None else [self.cycle(self._estimate, t_ns)]
        words = (self._due_state(t_ns), self._checked_model())
        return [*plans, *said, *(word for word in words if word is not None)]

    def receive(self, arrival: ReceivedMessage) -> None:
        """One message of how the vehicle moves or what a cycle took."""
        match arrival.message:
            case Estimate() as estimate:
                if self._news(self.estimates, arrival, estimate.t_ns):
                    self._estimate = estimate
            case Applied() as applied:
                if self._news(self.reports, arrival, applied.t_ns):
                    self.controller.report(applied)
                    self._monitor.report(applied)
            case CycleTiming() as timing:
                self.controller.timing(timing)
            case _:
                pass

    def cycle(self, estimate: Estimate, t_ns: int) -> Plan:
        """What a cycle does with the newest estimate."""
        return self.controller.plan(
            estimate, t_ns=t_ns, override=self.arbiter.override(t_ns), health=self._health_of_reports(t_ns)
        )

    def health(self, t_ns: int) -> Health:
        """How well the inputs keep up at ``t_ns``."""
        return worst(self.controller.health(t_ns), self._health_of_reports(t_ns))

    def inputs(self) -> tuple[InputReport, ...]:
        """Of each input whose age counts, at the last cycle."""
        rejected = {"estimate": self.controller.estimate_gate.rejected.total(), "applied": 0}
        ages = self.controller.config.ages
        return tuple(
            InputReport(
                input=name, rejected=rejected[name] + of.rejected, **of.state_at(self._cycled_ns, ages)._asdict()
            )
            for name, of in (("estimate", self.estimates), ("applied", self.reports))
        )

    def _health_of_reports(self, t_ns: int) -> Health:
        reports, ages = self.reports, self.controller.config.ages
        silent_ns = reports.silent_ns(t_ns)
        if silent_ns is None or silent_ns <= ages.degraded_s * 1e9:
            return Health.NOMINAL  # whatever their period
        return report_health(silent_ns=silent_ns, period_ns=reports.period.median_ns, ages=ages)

    @staticmethod
    def _news(of: InputMonitor, arrival: ReceivedMessage, stamp_ns: int) -> bool:
        return of.receive(
            epoch=arrival.epoch, sequence=arrival.sequence, stamp_ns=stamp_ns, received_ns=arrival.received_t_ns
        )

    def _checked_model(self) -> ModelCheck | None:
        believed = self.controller.estimate_gate.accepted
        return None if believed is None else self._monitor.update(believed)

    # --- saved and restored ---

    def _restore(self, state: ControllerState, t_ns: int) -> None:
        """Continue where another node ended: armed if it was, along the same reference, from the plan in force."""
        self.arbiter.authority = state.authority
        if state.reference_toml and state.reference_toml != self._written:
            self._follow(state.reference_toml)
        if state.model_products is not None:
            self._monitor.restore(state.model_products)
        self.controller.restore(state, t_ns)
        if self._estimate is None:
            self._estimate = state.estimate

    def _due_state(self, t_ns: int) -> ControllerState | None:
        """Return the state to publish now: at each change of who is in charge or of what is followed, and each 5 s."""
        before = self._saved
        if before is not None and (
            0 <= t_ns - before.t_ns < SAVE_PERIOD_NS
            and before.authority is self.arbiter.authority
            and before.reference_toml is self._written
            and (before.reference_start is None) == (self.controller.follower.target_m is None)
        ):
            return None
        self._saved = msgspec.structs.replace(
            self.controller.save(t_ns),
            authority=self.arbiter.authority,
            reference_toml=self._written,
            model_products=self._monitor.products,
            estimate=self._estimate,
        )
        return self._saved

    # --- what is asked ---

    def _answered(self, command: Command, t_ns: int) -> Acknowledgement:
        said = self._done(command)
        return Acknowledgement(
            t_ns=t_ns,
            command_id=command.command_id,
            accepted=not said.why,
            authority=said.authority,
            why=said.why,
        )

    def _done(self, command: Command) -> CommandResult:
        before = self.arbiter.authority
        if command.action is Action.FOLLOW:
            return self._follow(command.reference_toml)
        if command.action is Action.HOLD:
            return self._hold()
        said = self.arbiter.request(command.action)
        if command.action is Action.ARM and before is not Authority.CONTROLLER and not said.why:
            self.controller.follow(self._reference)  # "here" is where it is now, not where it was put into the water
        return said

    def _follow(self, toml: str) -> CommandResult:
        try:
            reference: Reference = settings.parse(settings.loads(toml), Reference, source="reference")  # type: ignore[arg-type]
        except ConfigError as error:
            return CommandResult(self.arbiter.authority, str(error))
        except (ValueError, RecursionError) as error:
            return CommandResult(self.arbiter.authority, f"reference: is not valid TOML: {error}")
        if isinstance(reference, Timed) and reference.file:
            return CommandResult(
                self.arbiter.authority, "reference: file: a message cannot name a file: give rows instead"
            )
        self._take(reference, toml)
        return self.arbiter.request(Action.FOLLOW)

    def _hold(self) -> CommandResult:
        estimate = self._estimate
        if estimate is None:
            return CommandResult(
                self.arbiter.authority,
                "no estimate received yet, so the current position is unknown: retry after the first estimate",
            )
        depth_m = None if estimate.depth_m is None else min(max(estimate.depth_m, 0.0), MAX_HOLD_DEPTH_M)
        hold = Hold(depth_m=depth_m)
        self._take(hold, _written(hold))
        return self.arbiter.request(Action.HOLD)

    def _take(self, reference: Reference, written: str) -> None:
        self._reference, self._written = reference, written
        self.controller.follow(reference)


def _written(reference: Reference) -> str:
    """As a reference file holds it; empty where that is too long to travel."""
    text = settings.to_toml(reference)
    return text if len(text) <= LONGEST_WRITTEN else ""
