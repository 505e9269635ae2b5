"""Who commands the thrusters: a state machine that nothing but an operator's commands moves.

                 arm                    manual
    disarmed  -------->  controller  ----------->  manual         stop:    from everywhere to stopped
        ^                  ^  |  ^                  |  |          disarm:  from controller and manual to disarmed
        |                  |  |  +----- release ----+  |
        +----- disarm -----|--+------------------------+
                           |
    stopped  ----- arm ----+

In disarmed and stopped no thruster is driven, the vertical one included. Out of both leads ``arm`` alone: whoever wants
to steer by hand takes the thrusters from the controller. A command that asks for what is so already is accepted, except
where it would be mistaken for more than it does. Every change of hands is met at the slew limit, from the command in
force, since every plan begins there.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ltv_mpc.messages import Action, Array, Authority, Times, Triple
from ltv_mpc.vehicle.parameters import Vehicle

MANUAL_TIMEOUT_NS = 1_000_000_000
"""So long after its arrival a pilot's message counts."""

DISARMED, CONTROLLER, MANUAL, STOPPED = Authority.DISARMED, Authority.CONTROLLER, Authority.MANUAL, Authority.STOPPED

NEXT: Mapping[Action, Mapping[Authority, Authority]] = {
    Action.ARM: {DISARMED: CONTROLLER, STOPPED: CONTROLLER, CONTROLLER: CONTROLLER},
    Action.DISARM: {DISARMED: DISARMED, CONTROLLER: DISARMED, MANUAL: DISARMED},
    Action.STOP: dict.fromkeys(Authority, STOPPED),
    Action.MANUAL: {CONTROLLER: MANUAL, MANUAL: MANUAL},
    Action.RELEASE: {MANUAL: CONTROLLER},
    Action.FOLLOW: {state: state for state in Authority},
    Action.HOLD: {state: state for state in Authority},
}
"""Where an action leads; an action without a row for a state is refused there."""

REFUSED: Mapping[Action, str] = {
    Action.ARM: "a pilot has the thrusters: release hands them to the controller",
    Action.DISARM: "stopped: the thrusters stay at zero until arm",
    Action.MANUAL: "not armed: arm first",
    Action.RELEASE: "no pilot has the thrusters",
}
"""What is said then."""


class CommandResult(NamedTuple):
    """What became of an action; ``why`` is empty where it was accepted."""

    authority: Authority
    why: str = ""


def next_authority(authority: Authority, action: Action) -> CommandResult:
    """The state after ``action`` was asked for in ``authority``: the same one where it is refused."""
    after = NEXT[action].get(authority)
    return CommandResult(authority, REFUSED[action]) if after is None else CommandResult(after)


class ThrustOverride(NamedTuple):
    """Thrusts of someone else than the controller."""

    authority: Authority
    thrust_N: Triple
    until_ns: int | None  # from then on zero; None: they are zero anyway
    why: str

    def targets(self, knots: Times) -> Array:
        """What each thruster shall come to at each knot (N+1, 3)."""
        lasts = np.zeros(len(knots)) if self.until_ns is None else np.where(knots <= self.until_ns, 1.0, 0.0)
        goal: Array = lasts[:, None] * np.array(self.thrust_N)
        return goal


class CommandArbiter:
    """The state, and the pilot's newest word."""

    def __init__(self, vehicle: Vehicle, authority: Authority = DISARMED) -> None:
        """The thrusters' boxes bound what a pilot may ask for."""
        self.authority = authority
        self.manual_rejected = 0
        """Messages that asked for a thrust outside the box: not acted on."""
        self._box = [(t.min_N, t.max_N) for t in vehicle.thrusters]
        self._wanted: tuple[Triple, int] | None = None  # thrusts, and when they were heard

    def request(self, action: Action) -> CommandResult:
        """Go where ``action`` leads."""
        before = self.authority
        said = next_authority(before, action)
        self.authority = said.authority
        if said.authority is not before:
            self._wanted = None  # a hand on the stick before it had the thrusters counts for nothing
        return said

    def receive_manual(self, thrust_N: Triple, received_ns: int) -> None:
        """A pilot's message, heard at ``received_ns``. Outside the box it is not acted on."""
        if all(low <= thrust <= high for thrust, (low, high) in zip(thrust_N, self._box, strict=True)):
            self._wanted = thrust_N, received_ns
        else:
            self.manual_rejected += 1

    def override(self, t_ns: int) -> ThrustOverride | None:
        """What the thrusters shall do at ``t_ns`` and after; None where that is the controller's affair."""
        if self.authority is CONTROLLER:
            return None
        if self.authority is not MANUAL:
            return ThrustOverride(self.authority, (0.0, 0.0, 0.0), None, self.authority.value)
        if self._wanted is None or t_ns - self._wanted[1] > MANUAL_TIMEOUT_NS:
            return ThrustOverride(MANUAL, (0.0, 0.0, 0.0), None, "manual, and no word of the pilot for a second")
        thrust, received_ns = self._wanted
        return ThrustOverride(MANUAL, thrust, received_ns + MANUAL_TIMEOUT_NS, "manual")
