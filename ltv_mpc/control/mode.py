"""Mode of a control cycle: what the thrusters do, and why.

    mode         condition                                             lateral thrusters     vertical thruster
    OVERRIDE     disarmed, stopped or steered by hand                  ramp to the override  ramp to the override
    FAILSAFE     no plausible estimate, or its age is over the limit   ramp to zero          ramp to the failsafe thrust
    HOLD         health is "hold": the estimate or an input is old     ramp to zero          hold the depth (*)
    WAIT         the reference has not started                         ramp to zero          keep the command in force
    DEPTH_ONLY   [controller] lateral = false                          ramp to zero          depth law
    FOLLOW       none of these                                         QP or fallback level  depth law

(*) the estimated depth, if estimate and reference have a depth; else the command in force is kept.

The first condition that is met decides. Ages and health are in ``safety/health.py``; the failsafe thrust is the
vehicle's ``failsafe_vertical_N``.
"""

from __future__ import annotations

import enum
from typing import NamedTuple

import msgspec

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.messages import Estimate, Health
from ltv_mpc.references.follower import Follower
from ltv_mpc.safety.command_arbiter import ThrustOverride
from ltv_mpc.safety.estimate_gate import EstimateGate
from ltv_mpc.safety.health import NOMINAL, HealthState, health, worst
from ltv_mpc.safety.input_monitor import Period
from ltv_mpc.vehicle.parameters import Vehicle

NOT_STARTED = "the reference has not started yet"
LATERAL_OFF = "lateral control is off"


class Mode(enum.Enum):
    """Mode of one control cycle; the conditions are in the table at the head of this file."""

    OVERRIDE = enum.auto()
    FAILSAFE = enum.auto()
    HOLD = enum.auto()
    WAIT = enum.auto()
    DEPTH_ONLY = enum.auto()
    FOLLOW = enum.auto()


class Selection(NamedTuple):
    """Estimate that a cycle plans on."""

    estimate: Estimate
    health: HealthState  # by the age of the estimate alone
    why: str  # reason why no estimate is plausible; empty if ``estimate`` is one


class Decision(NamedTuple):
    """Mode of a cycle with its reason and its inputs."""

    mode: Mode
    why: str  # empty in FOLLOW
    estimate: Estimate
    health: HealthState  # the worst of the estimate's and the caller's inputs
    override: ThrustOverride | None

    @property
    def follows(self) -> bool:
        """True if the cycle follows the reference, at least in depth."""
        return self.mode is Mode.FOLLOW or self.mode is Mode.DEPTH_ONLY


class EstimateSelector:
    """Selection of the newest plausible estimate, and the health that follows from its age."""

    def __init__(self, vehicle: Vehicle, config: ControllerConfig) -> None:
        """Start without an estimate.

        Parameters
        ----------
        vehicle : bounds of its motion decide what is plausible.
        config : the ages at which health degrades are used.
        """
        self.gate = EstimateGate(vehicle)
        """Plausibility check, with the count of rejected estimates."""
        self._ages = config.ages
        self._fresh_ns = round(config.ages.degraded_s * 1e9)
        self._period = Period()  # of the plausible estimates

    def select(self, newest: Estimate, now_ns: int) -> Selection:
        """Return the newest plausible estimate.

        Parameters
        ----------
        newest : estimate that was received last.
        now_ns : start of the cycle, vehicle time (ns).

        Returns
        -------
        The estimate and its health. Before the first plausible one: an estimate at rest at the origin, with the reason.
        """
        before = self.gate.accepted
        reason = self.gate.check(newest)
        estimate = self.gate.accepted
        if estimate is None:
            at_rest = msgspec.structs.replace(Estimate.at_rest(), t_ns=now_ns)
            why = f"no valid estimate: {reason}"
            return Selection(at_rest, HealthState(Health.FAILSAFE, why), why)
        if estimate is not before:
            self._period.add(estimate.t_ns)
        return Selection(estimate, self.health(now_ns), "")

    def health(self, t_ns: int) -> HealthState:
        """Return the health by the age of the newest plausible estimate.

        Parameters
        ----------
        t_ns : now, vehicle time (ns).
        """
        estimate = self.gate.accepted
        age_ns = None if estimate is None else t_ns - estimate.t_ns
        if age_ns is not None and -self._fresh_ns <= age_ns <= self._fresh_ns:
            return NOMINAL  # for any period of the estimates
        return health(age_ns=age_ns, period_ns=self._period.median_ns, ages=self._ages)


def decide(
    selection: Selection,
    now_ns: int,
    *,
    override: ThrustOverride | None,
    health: HealthState,
    follower: Follower,
    lateral: bool,
) -> Decision:
    """Decide the mode of one cycle.

    Parameters
    ----------
    selection : estimate that the cycle plans on.
    now_ns : start of the cycle, vehicle time (ns).
    override : thrusts commanded by a source other than the controller, if any.
    health : of the inputs that the caller watches.
    follower : begins its reference here if the mode allows it.
    lateral : False if the lateral thrusters stay at zero.

    Returns
    -------
    The mode, its reason, the estimate and the worst health. An estimate that is too old to predict from is stamped
    ``now_ns``.
    """
    estimate, own, why = selection
    if own is not NOMINAL:
        health = worst(own, health)
    age = ""
    if not why and (own.health is Health.FAILSAFE or health.health is Health.HOLD):
        age = f"the newest estimate is {(now_ns - estimate.t_ns) * 1e-9:.1f} s old"
        if own.health is Health.FAILSAFE:
            estimate = msgspec.structs.replace(estimate, t_ns=now_ns)
    if override is not None:
        return Decision(Mode.OVERRIDE, override.why, estimate, health, override)
    if own.health is Health.FAILSAFE:
        return Decision(Mode.FAILSAFE, why or age, estimate, health, None)
    if health.health is Health.HOLD:
        has_begun = follower.target_m is not None
        mode, why = Mode.HOLD, (age if lateral else LATERAL_OFF) if has_begun else NOT_STARTED
    elif not follower.begin(estimate):
        mode, why = Mode.WAIT, NOT_STARTED
    elif not lateral:
        mode, why = Mode.DEPTH_ONLY, LATERAL_OFF
    else:
        mode = Mode.FOLLOW
    return Decision(mode, why, estimate, health, None)
