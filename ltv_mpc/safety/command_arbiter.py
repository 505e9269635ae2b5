"""Arbitration of the thrusters: a state machine that only the commands of an operator move.

                 arm                    manual
    disarmed  -------->  controller  ----------->  manual         stop:    from every state to stopped
        ^                  ^  |  ^                  |  |          disarm:  from controller and manual to disarmed
        |                  |  |  +----- release ----+  |
        +----- disarm -----|--+------------------------+
                           |
    stopped  ----- arm ----+

In disarmed and stopped no thruster is driven, including the vertical one. Only ``arm`` leads out of both, so a pilot
takes the thrusters only from the controller. A command that changes nothing is accepted, except ``disarm`` while
stopped, which would seem to lift the stop. Every change of authority respects the slew limit, because each plan starts
at the command in force.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ltv_mpc.messages import Action, Array, Authority, Times, Triple
from ltv_mpc.vehicle.parameters import Vehicle

MANUAL_TIMEOUT_NS = 1_000_000_000
"""Time after its arrival for which a message of the pilot is valid."""

DISARMED, CONTROLLER, MANUAL, STOPPED = Authority.DISARMED, Authority.CONTROLLER, Authority.MANUAL, Authority.STOPPED

NEXT: Mapping[Action, Mapping[Authority, Authority]] = {
    Action.ARM: {DISARMED: CONTROLLER, STOPPED: CONTROLLER, CONTROLLER: CONTROLLER},
    Action.DISARM: {DISARMED: DISARMED, CONTROLLER: DISARMED, MANUAL: DISARMED},
    Action.STOP: dict.fromkeys(Authority, STOPPED),
    Action.MANUAL: {CONTROLLER: MANUAL, MANUAL: MANUAL},
    Action.RELEASE: {MANUAL: CONTROLLER},
} | {
    action: {state: state for state in Authority}
    for action in (Action.FOLLOW, Action.HOLD, Action.SOURCE, Action.FENCE, Action.CLEAR)
}
"""Next state by action and present state. An action is rejected in a state for which it has no entry."""

REJECTED: Mapping[Action, str] = {
    Action.ARM: "a pilot commands the thrusters: send `release` to return them to the controller",
    Action.DISARM: "stopped: the thrusters stay at zero until `arm` is sent",
    Action.MANUAL: "the controller is disarmed: send `arm` first",
    Action.RELEASE: "no pilot commands the thrusters: nothing to release",
}
"""Reason of a rejection, by action."""


class CommandResult(NamedTuple):
    """Authority after a command, and the reason if it was rejected; ``why`` is empty if it was accepted."""

    authority: Authority
    why: str = ""


class ThrustOverride(NamedTuple):
    """Thrusts that replace those of the controller."""

    authority: Authority  # their source
    thrust_N: Triple  # port, starboard, vertical (N)
    until_ns: int | None  # zero thrust after this vehicle time (ns); None: the thrusts are zero in any case
    why: str  # reason in the plan

    def targets(self, knots: Times) -> Array:
        """Return the target thrust (N+1, 3) of each thruster at the knots (N+1,).

        Parameters
        ----------
        knots : (N+1,) times (ns).
        """
        valid = np.zeros(len(knots)) if self.until_ns is None else np.where(knots <= self.until_ns, 1.0, 0.0)
        targets: Array = valid[:, None] * np.array(self.thrust_N, dtype=np.float64)
        return targets


class CommandArbiter:
    """Present authority, and the newest message of the pilot."""

    def __init__(self, vehicle: Vehicle, authority: Authority = DISARMED) -> None:
        self.authority = authority
        self.manual_rejected = 0
        """Number of messages of the pilot that requested a thrust outside the box."""
        self._box = [(t.min_N, t.max_N) for t in vehicle.thrusters]
        self._manual: tuple[Triple, int] | None = None  # requested thrusts, and when they arrived

    @property
    def armed(self) -> bool:
        """True if the controller or a pilot commands the thrusters."""
        return self.authority is CONTROLLER or self.authority is MANUAL

    def request(self, action: Action) -> CommandResult:
        """Carry out a command of the operator, if the present state allows it.

        Parameters
        ----------
        action : requested action.
        """
        after = NEXT[action].get(self.authority)
        if after is None:
            return CommandResult(self.authority, REJECTED[action])
        if after is not self.authority:
            self.authority, self._manual = after, None  # what a pilot asked for before he had them has no effect
        return CommandResult(after)

    def receive_manual(self, thrust_N: Triple, received_ns: int) -> None:
        """Store the thrusts that a pilot requests, unless one of them is outside the box.

        Parameters
        ----------
        thrust_N : port, starboard, vertical (N).
        received_ns : time of arrival (ns).
        """
        if all(low <= thrust <= high for thrust, (low, high) in zip(thrust_N, self._box, strict=True)):
            self._manual = thrust_N, received_ns
        else:
            self.manual_rejected += 1

    def override(self, t_ns: int) -> ThrustOverride | None:
        """Return the thrusts from ``t_ns`` on, or None if the controller has the authority.

        Parameters
        ----------
        t_ns : current time (ns).
        """
        if self.authority is CONTROLLER:
            return None
        if self.authority is not MANUAL:
            return ThrustOverride(self.authority, (0.0, 0.0, 0.0), None, self.authority.value)
        if self._manual is None or t_ns - self._manual[1] > MANUAL_TIMEOUT_NS:
            return ThrustOverride(
                MANUAL, (0.0, 0.0, 0.0), None, "manual, but no message of the pilot for 1 s: thrusts ramp to zero"
            )
        thrust, received_ns = self._manual
        return ThrustOverride(MANUAL, thrust, received_ns + MANUAL_TIMEOUT_NS, "manual")
