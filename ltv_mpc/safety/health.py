"""Health with its reason: thresholds on the age of estimates, actuator reports and plans, in vehicle time.

Controller, by the age of the newest accepted estimate, the period T of the estimates, and the growth of the standard
deviation of the position predicted from that estimate (``control/prediction.py``):

    degraded   age > max(3 T, degraded_s)       control continues from the prediction: origin "solved"
    hold       age > max(4 T, hold_s), or       stop through the water, hold the depth: origin "stop"
               growth > hold_growth_m
    failsafe   age > max(6 T, failsafe_s)       lateral thrusts to zero, vertical thrust to the vehicle's
                                                ``failsafe_vertical_N``: origin "zero"

Defaults: 0.5 s, 10 s, 0.5 m, 20 s. Before the first estimate the controller is degraded and publishes no plan; while it
has received implausible ones only, it is in failsafe.

The controller is also degraded while the actuators, having reported before, are silent for max(3 T, 0.5 s) with T
their own period. The multiples of T make a slow publisher nominal: one that sends every 5 s is degraded after two
missing messages, held after three, failsafe after five.

And it is degraded while the actuators report commands that contradict its plans (``actuator_check.py``), and while the
vehicle stays away from its target (``references/follower.py``).

Actuators, by the time since the last accepted plan and the period T of the plans:

    degraded   no plan for max(2.5 T, 0.5 s), or none yet                       the last plan is followed
    failsafe   the last plan is at its last knot, or began more than            thrusts ramp to rest
               max(2.5 T, plan_timeout_s) ago; the setting is the vehicle's

A pause of the clock freezes every age. A negative age comes from a stamp in the future. Nothing can be predicted back
from there, so an estimate that is ahead by more than ``MAX_STAMP_AHEAD_NS`` means failsafe.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import msgspec
from msgspec import Meta

from ltv_mpc.messages import Health, Times

DEGRADED_PERIODS, HOLD_PERIODS, FAILSAFE_PERIODS = 3, 4, 6

REPLACEMENTS_MISSING = 2.5
"""Silence in plan periods at which a commander counts as lost: its second replacement is half a period overdue."""

MIN_PLAN_TIMEOUT_NS = 500_000_000
"""Shortest silence that counts as a loss of the commander; a shorter one can be a delay of the link."""

MAX_STAMP_AHEAD_NS = 1_000_000_000
"""Largest lead of a stamp over its arrival. A stamp farther ahead comes from a clock that jumped; if accepted, it would
make every correct message look old until its time has come. The offset to another host's clock is known to 0.5 s while
its first messages arrive through delays that jump.
"""

WORST_FIRST = (Health.FAILSAFE, Health.HOLD, Health.DEGRADED, Health.NOMINAL)


class HealthState(NamedTuple):
    """Health of one input, or of all, with its reason.

    The reason contains no figure that changes with time, so that a change of the state is an event.
    """

    health: Health
    why: str = ""  # empty if nominal


NOMINAL = HealthState(Health.NOMINAL)

PREDICTED = "no new estimates: control continues from the prediction"
PREDICTED_TOO_LONG = "no new estimates: predicted for longer than hold_s"
PREDICTED_TOO_FAR = "no new estimates: the predicted position is uncertain by more than hold_growth_m"
OLD_ESTIMATES = "no new estimates: the newest is older than failsafe_s"
AHEAD = "the estimates are stamped in the future"
NO_ESTIMATE = "no estimate yet"
SILENT_ACTUATORS = "the actuators do not report"


class Ages(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """[controller.ages]: ages of the newest estimate, in vehicle seconds, from which the health is worse.

    They grow for a slow publisher. ``hold_growth_m`` begins the hold earlier: it is the largest growth of the standard
    deviation of the predicted position.
    """

    degraded_s: Annotated[float, Meta(gt=0, le=60)] = 0.5
    hold_s: Annotated[float, Meta(gt=0, le=60)] = 10.0
    hold_growth_m: Annotated[float, Meta(gt=0, le=1000)] = 0.5
    failsafe_s: Annotated[float, Meta(gt=0, le=60)] = 20.0

    def __post_init__(self) -> None:
        """Reject thresholds that are not in order."""
        if self.hold_s < self.degraded_s:
            raise ValueError(f"hold_s = {self.hold_s:g}: must be >= degraded_s = {self.degraded_s:g}")
        if self.failsafe_s < self.hold_s:
            raise ValueError(f"failsafe_s = {self.failsafe_s:g}: must be >= hold_s = {self.hold_s:g}")


DEFAULT_AGES = Ages()


def timeout_ns(periods: float, period_ns: int, min_s: float) -> int:
    """Return the age (ns) at which an input times out: ``periods`` of its own, at least a fixed time.

    Parameters
    ----------
    periods : number of periods.
    period_ns : period of the input (ns); 0 if unknown.
    min_s : smallest timeout (s).
    """
    return max(round(periods * period_ns), round(min_s * 1e9))


def health(*, age_ns: int | None, period_ns: int, ages: Ages = DEFAULT_AGES) -> HealthState:
    """Return the health of the controller by the age of its estimates.

    Parameters
    ----------
    age_ns : age of the newest accepted estimate (ns); None before the first.
    period_ns : period of the estimates (ns); 0 if unknown.
    ages : thresholds.
    """
    if age_ns is None:
        return HealthState(Health.DEGRADED, NO_ESTIMATE)
    if abs(age_ns) <= timeout_ns(DEGRADED_PERIODS, period_ns, ages.degraded_s):
        return NOMINAL
    if age_ns < 0:
        return HealthState(Health.DEGRADED if -age_ns <= MAX_STAMP_AHEAD_NS else Health.FAILSAFE, AHEAD)
    if age_ns <= timeout_ns(HOLD_PERIODS, period_ns, ages.hold_s):
        return HealthState(Health.DEGRADED, PREDICTED)
    if age_ns <= timeout_ns(FAILSAFE_PERIODS, period_ns, ages.failsafe_s):
        return HealthState(Health.HOLD, PREDICTED_TOO_LONG)
    return HealthState(Health.FAILSAFE, OLD_ESTIMATES)


def report_health(*, silent_ns: int | None, period_ns: int, ages: Ages = DEFAULT_AGES) -> HealthState:
    """Return the health of the controller by the reports of the actuators.

    Parameters
    ----------
    silent_ns : time since the last report (ns); None if there was none, which is allowed.
    period_ns : period of the reports (ns); 0 if unknown.
    ages : thresholds.
    """
    if silent_ns is None or silent_ns <= timeout_ns(DEGRADED_PERIODS, period_ns, ages.degraded_s):
        return NOMINAL
    return HealthState(Health.DEGRADED, SILENT_ACTUATORS)


def plan_timeout_ns(period_ns: int) -> int:
    """Return the time (ns) after its last plan for which a commander counts as present."""
    return max(round(REPLACEMENTS_MISSING * period_ns), MIN_PLAN_TIMEOUT_NS)


def plan_end_ns(knots_ns: Times, period_ns: int, timeout_s: float) -> int:
    """Return the time (ns) until which the actuators follow a plan if no other one follows.

    Parameters
    ----------
    knots_ns : (N+1,) knots of the plan (ns).
    period_ns : period of the plans (ns); 0 if unknown.
    timeout_s : ``plan_timeout_s`` of the vehicle (s).
    """
    return min(int(knots_ns[-1]), int(knots_ns[0]) + timeout_ns(REPLACEMENTS_MISSING, period_ns, timeout_s))


def worst(*states: HealthState) -> HealthState:
    """Return the first of the worst states."""
    return min(states, key=lambda state: WORST_FIRST.index(state.health))
