"""Mode of a control cycle: what the thrusters do, and why.

    mode         condition                               lateral thrusters            vertical thruster
    OVERRIDE     disarmed, stopped or steered by hand    ramp to the override         ramp to the override
    FAILSAFE     health is "failsafe"                    ramp to zero                 ramp to the failsafe thrust
    HOLD         health is "hold"                        stop through the water (*)   hold the depth (**)
    WAIT         the reference has not started           ramp to zero                 keep the command in force
    DEPTH_ONLY   [controller] lateral = false            ramp to zero                 depth law
    FOLLOW       none of these                           QP or fallback level         depth law

(*) ramp to zero before the reference has started and with [controller] lateral = false.
(**) the predicted depth at which the hold began, if estimate and reference have a depth; else the command in force is
kept.

The first condition that is met decides. The health is the worst of that of the estimates and that of the caller's
inputs (``safety/health.py``); the failsafe thrust is the vehicle's ``failsafe_vertical_N``. FOLLOW, DEPTH_ONLY and HOLD
use the prediction from the newest estimate, however old it is; in FAILSAFE the vehicle is taken to be where it was.
"""

from __future__ import annotations

import enum
from typing import NamedTuple

import msgspec

from ltv_mpc.messages import Estimate, Health
from ltv_mpc.references.follower import Follower
from ltv_mpc.safety.command_arbiter import ThrustOverride
from ltv_mpc.safety.health import HealthState, worst

NOT_STARTED = "the reference has not started yet"
LATERAL_OFF = "lateral control is off"
NO_DEPTH = "the reference has a depth but the estimates have none: give depth_m, or a reference without depth"

MAX_START_AGE_NS = 1_500_000_000
"""Age of a late estimate up to which a reference starts at it: "here" is not where the vehicle was long ago."""


class Mode(enum.Enum):
    """Mode of one control cycle; the conditions are in the table at the head of this file."""

    OVERRIDE = enum.auto()
    FAILSAFE = enum.auto()
    HOLD = enum.auto()
    WAIT = enum.auto()
    DEPTH_ONLY = enum.auto()
    FOLLOW = enum.auto()


class Decision(NamedTuple):
    """Mode of a cycle with its reason and its inputs."""

    mode: Mode
    why: str  # in FOLLOW empty, or NO_DEPTH
    estimate: Estimate  # to predict from; stamped now if it is too old for that
    estimate_t_ns: int  # its own stamp
    health: HealthState
    override: ThrustOverride | None
    stops: bool = False  # the lateral thrusters stop the vehicle through the water

    @property
    def follows(self) -> bool:
        """True if the cycle follows the reference, at least in depth."""
        return self.mode is Mode.FOLLOW or self.mode is Mode.DEPTH_ONLY

    def without_depth(self) -> Decision:
        """Return the decision for a reference with a depth: degraded if the estimate has none."""
        if self.estimate.depth_m is not None or not self.follows:
            return self
        return self._replace(
            why=self.why or NO_DEPTH, health=worst(self.health, HealthState(Health.DEGRADED, NO_DEPTH))
        )


def decide(
    estimate: Estimate | None,
    now_ns: int,
    *,
    override: ThrustOverride | None,
    health: HealthState,
    late: bool,
    follower: Follower,
    lateral: bool,
) -> Decision:
    """Decide the mode of one cycle.

    Parameters
    ----------
    estimate : newest plausible one; None if there is none, then ``health`` is "failsafe".
    now_ns : start of the cycle, vehicle time (ns).
    override : thrusts commanded by a source other than the controller, if any.
    health : the worst of all inputs.
    late : True if the estimate is older than those of a nominal publisher.
    follower : begins its reference here if the mode allows it.
    lateral : False if the lateral thrusters stay at zero.

    Returns
    -------
    The mode, its reason and the estimate to predict from.
    """
    stamp_ns = now_ns if estimate is None else estimate.t_ns
    if estimate is None or health.health is Health.FAILSAFE:
        estimate = msgspec.structs.replace(estimate or Estimate.at_rest(), t_ns=now_ns)
    stops = False
    if override is not None:
        mode, why = Mode.OVERRIDE, override.why
    elif health.health is Health.FAILSAFE:
        mode, why = Mode.FAILSAFE, health.why
    elif health.health is Health.HOLD:
        mode, why, stops = Mode.HOLD, health.why, lateral and follower.target_m is not None
    elif follower.target_m is None and (
        (late and now_ns - stamp_ns > MAX_START_AGE_NS) or not follower.begin(estimate)
    ):
        mode, why = Mode.WAIT, NOT_STARTED
    elif not lateral:
        mode, why = Mode.DEPTH_ONLY, LATERAL_OFF
    else:
        mode, why = Mode.FOLLOW, ""
    return Decision(mode, why, estimate, stamp_ns, health, override, stops)
