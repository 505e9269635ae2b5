"""Mission policy: when the mission ends before its reference does, and what the vehicle does then.

    cause                                                            action
    operator   no sign of an operator for ``operator_timeout_s``     ``on_operator_loss``
    time       armed first more than ``time_limit_s`` ago            ``on_time_limit``
    battery    below a threshold in all messages of 5 s              surface
    leak       a detector reports water in the hull                  surface
    silence    no message of a configured input for 5 s              go on

    go on      the reference is followed, and the health is degraded
    hold       the present position is held, the reference waits
    surface    the failsafe of the vehicle: lateral thrusts at zero, vertical thrust ``failsafe_vertical_N``

An action other than "go on" is latched while the vehicle is armed: it stays when its cause is gone, and only a stronger
one replaces it. The command ``clear`` ends it if its cause is gone; ``disarm`` and ``stop`` end it in any case. A cause
that a forced ``arm`` skipped only degrades the health until it was gone once, also after a restart of the controller.

The operator's timeout begins at the first command, message of a pilot or ``heartbeat``. Mission time begins at the
first ``arm`` and again at each ``follow``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Annotated, NamedTuple, TypeAlias

import msgspec
from msgspec import Meta

from ltv_mpc.messages import Battery, Health, Leak, MissionAction, MissionState
from ltv_mpc.safety.health import HealthState
from ltv_mpc.safety.input_age import InputAge

GO_ON, HOLD, SURFACE = MissionAction.GO_ON, MissionAction.HOLD, MissionAction.SURFACE
WEAKEST_FIRST = (GO_ON, HOLD, SURFACE)

BATTERY_LOW_NS = 5_000_000_000
"""Time for which all messages are below a threshold before the battery counts as low: thrust lowers the voltage."""

SILENT_NS, SILENT_PERIODS = 5_000_000_000, 3
"""Silence after which an input is missing: this time, or a number of its own periods if that is longer."""

Timeout: TypeAlias = Annotated[float, Meta(ge=1, le=1e6)] | None


class MissionSettings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Ends of a mission, [controller.mission], and bounds of the pre-arm checks; not set: not monitored."""

    operator_timeout_s: Timeout = None  # longest silence of an operator after the first sign of one
    on_operator_loss: MissionAction = GO_ON
    time_limit_s: Timeout = None  # from the first `arm` or the last `follow`
    on_time_limit: MissionAction = GO_ON
    battery_min_V: Annotated[float, Meta(gt=0, le=10_000)] | None = None  # surface below it
    battery_min_share: Annotated[float, Meta(gt=0, le=1)] | None = None  # of the energy: surface below it
    leak: bool = False  # true: the vehicle publishes `leak`; surface at a leak
    max_start_m: Annotated[float, Meta(gt=0, le=1e6)] = 2000.0  # pre-arm: distance to the start of the reference
    max_position_sd_m: Annotated[float, Meta(gt=0, le=1e6)] = 50.0  # pre-arm: of the estimate, if it has a covariance

    @property
    def uses_battery(self) -> bool:
        """True if a threshold of the battery is set."""
        return self.battery_min_V is not None or self.battery_min_share is not None


class Cause(NamedTuple):
    """Present cause of an action."""

    name: str
    action: MissionAction
    why: str


class MissionPolicy:
    """Causes that end a mission, and the action in force."""

    def __init__(self, settings: MissionSettings) -> None:
        """Begin without an action; no message has arrived."""
        self.state = MissionState()
        """Start of the mission and the action in force; the saved state of the policy."""
        self._settings = settings
        self._battery, self._leak = InputAge(), InputAge()  # arrivals
        self._newest_battery: Battery | None = None
        self._charged_ns: int | None = None  # arrival of the last message above the thresholds
        self._leaking = False

    def hear_operator(self, t_ns: int) -> None:
        """Note a sign of life of an operator.

        Parameters
        ----------
        t_ns : time of arrival (ns).
        """
        self.state = msgspec.structs.replace(self.state, operator_t_ns=t_ns)

    def operator_is_silent(self, t_ns: int, after_ns: int) -> bool:
        """Return True if there was no sign of an operator for ``after_ns``, or never one.

        Parameters
        ----------
        t_ns, after_ns : now, and the silence that counts (ns).
        """
        newest_ns = self.state.operator_t_ns
        return newest_ns is None or t_ns - newest_ns > after_ns

    def receive(self, message: Battery | Leak, received_ns: int) -> None:
        """Note the state of battery or leak detectors.

        Parameters
        ----------
        message : accepted message.
        received_ns : time of arrival (ns).
        """
        if isinstance(message, Leak):
            self._leak.add(received_ns)
            self._leaking = message.detected
            return
        if not self._below(message):
            self._charged_ns = received_ns
        self._battery.add(received_ns)
        self._newest_battery = message

    def arm(self, t_ns: int) -> None:
        """End the action in force, and start the mission time if it does not run.

        The present causes have no effect until they are gone once.

        Parameters
        ----------
        t_ns : time of the arming (ns).
        """
        self.disarm()
        self._skip(tuple(cause.name for cause in self.causes(t_ns)))
        if self.state.start_t_ns is None:
            self.state = msgspec.structs.replace(self.state, start_t_ns=t_ns)

    def disarm(self) -> None:
        """End the action in force."""
        self._skip(())
        self._set(GO_ON, "")

    def restart(self, t_ns: int) -> None:
        """Start the mission time again, if it runs.

        Parameters
        ----------
        t_ns : now (ns).
        """
        if self.state.start_t_ns is not None:
            self.state = msgspec.structs.replace(self.state, start_t_ns=t_ns)

    def update(self, t_ns: int, *, armed: bool) -> MissionAction:
        """Latch the strongest action whose cause is present, and return the action in force.

        Parameters
        ----------
        t_ns : now (ns).
        armed : False: no action is latched.
        """
        causes = list(self.causes(t_ns))
        present = {cause.name for cause in causes} | self._unknown_causes()
        self._skip(tuple(name for name in self.state.skipped if name in present))
        for cause in self._effective(causes) if armed else ():
            if WEAKEST_FIRST.index(cause.action) > WEAKEST_FIRST.index(self.state.action):
                self._set(cause.action, cause.why)
        return self.state.action

    def clear(self, t_ns: int) -> str:
        """End the action in force; return the reason if its cause is still present.

        Parameters
        ----------
        t_ns : now (ns).
        """
        present = [cause.why for cause in self._effective(self.causes(t_ns)) if cause.action is not GO_ON]
        if self.state.action is not GO_ON and not present:
            self._set(GO_ON, "")
        return "; ".join(present)

    def health(self, t_ns: int) -> HealthState:
        """Return the health by the action in force and by the present causes.

        Parameters
        ----------
        t_ns : now (ns).
        """
        action, why = self.state.action, self.state.why
        if action is not GO_ON:
            return HealthState(Health.FAILSAFE if action is SURFACE else Health.DEGRADED, f"{action.value}: {why}")
        reasons = [cause.why for cause in self.causes(t_ns)]
        return HealthState(Health.DEGRADED if reasons else Health.NOMINAL, "; ".join(reasons))

    def _set(self, action: MissionAction, why: str) -> None:
        self.state = msgspec.structs.replace(self.state, action=action, why=why)

    def _effective(self, causes: Iterable[Cause]) -> list[Cause]:
        return [cause for cause in causes if cause.name not in self.state.skipped]

    def _skip(self, names: tuple[str, ...]) -> None:
        self.state = msgspec.structs.replace(self.state, skipped=names)

    def _unknown_causes(self) -> set[str]:
        """Return the causes of which nothing is known yet: since the start no message of their input has arrived."""
        arrivals = {"battery": self._battery, "leak": self._leak}
        return {name for name, input_ in arrivals.items() if input_.stamp_ns is None}

    def causes(self, t_ns: int) -> Iterator[Cause]:
        """Yield the present causes.

        Parameters
        ----------
        t_ns : now (ns).
        """
        settings, start_ns = self._settings, self.state.start_t_ns
        limit_s = settings.operator_timeout_s
        known = self.state.operator_t_ns is not None
        if limit_s is not None and known and self.operator_is_silent(t_ns, round(limit_s * 1e9)):
            yield Cause("operator", settings.on_operator_loss, f"no sign of the operator for {limit_s:g} s")
        limit_s = settings.time_limit_s
        if limit_s is not None and start_ns is not None and t_ns - start_ns > limit_s * 1e9:
            yield Cause("mission time", settings.on_time_limit, f"the mission time of {limit_s:g} s is over")
        if settings.uses_battery:
            yield from self._battery_causes(t_ns)
        if settings.leak:
            if self._leaking:
                yield Cause("leak", SURFACE, "leak detected")
            if silence := _silence(self._leak, t_ns):
                yield Cause("leak input", GO_ON, f"leak: {silence}")

    def _battery_causes(self, t_ns: int) -> Iterator[Cause]:
        battery, received_ns, charged_ns = self._newest_battery, self._battery.stamp_ns, self._charged_ns
        if battery is not None and received_ns is not None and (below := self._below(battery)):
            low = charged_ns is None or received_ns - charged_ns >= BATTERY_LOW_NS
            if low:
                yield Cause("battery", SURFACE, f"battery {below}")
        if silence := _silence(self._battery, t_ns):
            yield Cause("battery input", GO_ON, f"battery: {silence}")
        elif battery is not None and battery.remaining is None and self._settings.battery_min_share is not None:
            yield Cause("battery input", GO_ON, "battery: no `remaining` in its messages")

    def _below(self, battery: Battery) -> str:
        """Return which threshold the battery is below; an empty text if none."""
        voltage, share = self._settings.battery_min_V, self._settings.battery_min_share
        if voltage is not None and battery.voltage_V < voltage:
            return f"below {voltage:g} V"
        if share is not None and battery.remaining is not None and battery.remaining < share:
            return f"below {100 * share:g} % of its energy"
        return ""


def _silence(arrivals: InputAge, t_ns: int) -> str:
    """Return a text if an input is silent, else an empty one."""
    if arrivals.stamp_ns is None:
        return "no message yet"
    limit_ns = max(SILENT_NS, SILENT_PERIODS * arrivals.median_ns)
    return "" if t_ns - arrivals.stamp_ns <= limit_ns else "no message any more"
