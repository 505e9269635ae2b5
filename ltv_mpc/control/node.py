"""The controller as a node: a cycle every 0.3 s on the newest estimate, by whoever is in charge."""

from __future__ import annotations

import tomllib

import msgspec

from ltv_mpc import config as settings
from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.controller import OLDEST_ESTIMATE_NS, Controller
from ltv_mpc.errors import ConfigError
from ltv_mpc.node import Cycle, Inbox, Stopwatch, no_stopwatch
from ltv_mpc.references import Hold, Reference, Timed
from ltv_mpc.safety.authority import Answer, Helm
from ltv_mpc.safety.health import Period, health
from ltv_mpc.signals import (
    Acknowledged,
    Action,
    Applied,
    Authority,
    Command,
    CycleTiming,
    Estimate,
    Health,
    Manual,
    Plan,
    Signal,
)
from ltv_mpc.vehicle.parameters import Vehicle

DEEPEST_HOLD_M = 11_000.0
"""As a reference's ``depth_m``."""


class ControllerNode:
    """Reads the newest ``Estimate`` and ``Manual``, each ``Applied``, ``Command`` and ``CycleTiming``.

    Writes an ``Acknowledged`` for each command and one ``Plan`` a cycle, disarmed too: that one lets the thrusters go.
    """

    name = "controller"
    reads: tuple[type[Signal], ...] = (Estimate, Applied, CycleTiming, Command, Manual)
    writes: tuple[type[Signal], ...] = (Plan, Acknowledged)

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
        self.helm = Helm(vehicle)
        self._reference = reference
        self._estimate: Estimate | None = None
        self._period = Period()

    def step(self, t_ns: int, inbox: Inbox) -> list[Signal]:
        """One cycle at ``t_ns``; no plan until the first estimate."""
        answers: list[Signal] = []
        for arrival in inbox:
            match arrival.signal:
                case Command() as command:
                    answers.append(self._answered(command, t_ns))
                case Manual() as manual:
                    self.helm.steer(manual.thrust_N, arrival.received_t_ns)
                case signal:
                    self.hear(signal)
        # The plan first: who has the answer can rely on its being in force.
        if self._estimate is None:
            return answers
        return [msgspec.structs.replace(self.cycle(self._estimate, t_ns), health=self.health(t_ns)), *answers]

    def hear(self, signal: Signal) -> None:
        """One message of how the vehicle moves or what a cycle took."""
        match signal:
            case Estimate() as estimate if self._is_news(estimate):
                self._estimate = estimate
                self._period.stamped(estimate.t_ns)
            case Applied() as applied:
                self.controller.report(applied)
            case CycleTiming() as timing:
                self.controller.timing(timing)
            case _:
                pass

    def cycle(self, estimate: Estimate, t_ns: int) -> Plan:
        """What a cycle does with the newest estimate."""
        return self.controller.plan(estimate, t_ns=t_ns, override=self.helm.override(t_ns))

    def health(self, t_ns: int) -> Health:
        """How well the estimates keep up at ``t_ns``."""
        age_ns = None if self._estimate is None else t_ns - self._estimate.t_ns
        return health(age_ns=age_ns, period_ns=self._period.median_ns)

    def _is_news(self, estimate: Estimate) -> bool:
        """Whether it is newer, or so much older that its clock must have been set back."""
        if self._estimate is None:
            return True
        newer_ns = estimate.t_ns - self._estimate.t_ns
        return newer_ns > 0 or newer_ns < -OLDEST_ESTIMATE_NS

    def _answered(self, command: Command, t_ns: int) -> Acknowledged:
        said = self._done(command)
        return Acknowledged(
            t_ns=t_ns,
            command_id=command.command_id,
            accepted=not said.why,
            authority=said.authority,
            why=said.why,
        )

    def _done(self, command: Command) -> Answer:
        before = self.helm.authority
        if command.action is Action.FOLLOW:
            return self._follow(command.reference_toml)
        if command.action is Action.HOLD:
            return self._hold()
        said = self.helm.ask(command.action)
        if command.action is Action.ARM and before is not Authority.CONTROLLER and not said.why:
            self.controller.follow(self._reference)  # "here" is where it is now, not where it was put into the water
        return said

    def _follow(self, toml: str) -> Answer:
        try:
            reference: Reference = settings.parse(tomllib.loads(toml), Reference, source="reference")  # type: ignore[arg-type]
        except ConfigError as error:
            return Answer(self.helm.authority, str(error))
        except (ValueError, RecursionError) as error:
            return Answer(self.helm.authority, f"reference: no valid TOML: {error}")
        if isinstance(reference, Timed) and reference.file:
            return Answer(self.helm.authority, "reference: file: no file is read for a message: give rows")
        self._take(reference)
        return self.helm.ask(Action.FOLLOW)

    def _hold(self) -> Answer:
        estimate = self._estimate
        if estimate is None:
            return Answer(self.helm.authority, "no estimate yet: nobody knows where here is")
        depth_m = None if estimate.depth_m is None else min(max(estimate.depth_m, 0.0), DEEPEST_HOLD_M)
        self._take(Hold(depth_m=depth_m))
        return self.helm.ask(Action.HOLD)

    def _take(self, reference: Reference) -> None:
        self._reference = reference
        self.controller.follow(reference)
