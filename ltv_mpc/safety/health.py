"""How well the inputs keep up: pure functions of ages, all in the vehicle's time.

Of the controller, by the age of the newest estimate that it believes and the period T at which estimates come:

    degraded   age > max(3 T, 0.5 s), or there is none yet     what is done stays the same, and is said
    hold       age > max(4 T, 1.5 s)                           lateral thrusts to zero, the depth kept: origin "zero"
    failsafe   age > max(6 T, 3.0 s)                           lateral thrusts to zero, the vertical one to the
                                                               vehicle's ``failsafe_vertical_N``: origin "zero"

and degraded as well while the actuators, having reported before, are silent for max(3 T, 0.5 s) of their own period.
The multiples of T let a slow publisher be nominal: one that comes each second is degraded after two that are missing,
held after three, given up after five. They take over from the seconds at 6, 2.7 and 2 Hz.

Of the actuators, by the time since the newest plan was accepted and the period at which plans come:

    degraded   two planned replacements are missing (2.5 T), or there is no plan yet     the plan is followed to its end
    failsafe   the plan is at its end                                                    thrusts ramp to rest

A pause of the clock freezes every age. An age below zero is a stamp from the future, and as wrong as one of the past.
"""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from ltv_mpc.messages import Health

DEGRADED_PERIODS, HOLD_PERIODS, FAILSAFE_PERIODS = 3, 4, 6

REPLACEMENTS_MISSING = 2.5
"""Plan periods without a plan: the second replacement was due half a period ago."""

MIN_PLAN_TIMEOUT_NS = 500_000_000
"""A shorter silence of the plans is the way's, not the commander's."""

WORST_FIRST = (Health.FAILSAFE, Health.HOLD, Health.DEGRADED, Health.NOMINAL)


class Ages(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """[controller.ages]: how old the newest estimate may be, in vehicle seconds; a slow publisher is given more."""

    degraded_s: Annotated[float, Meta(gt=0, le=60)] = 0.5
    hold_s: Annotated[float, Meta(gt=0, le=60)] = 1.5
    failsafe_s: Annotated[float, Meta(gt=0, le=60)] = 3.0

    def problem(self) -> tuple[str, str] | None:
        """Field and bound where the thresholds contradict each other."""
        if self.hold_s < self.degraded_s:
            return "hold_s", f"must be >= degraded_s = {self.degraded_s:g}"
        if self.failsafe_s < self.hold_s:
            return "failsafe_s", f"must be >= hold_s = {self.hold_s:g}"
        return None


DEFAULT_AGES = Ages()


def timeout_ns(periods: float, period_ns: int, least_s: float) -> int:
    """So old an input may become: so many of its periods (0: not known), and not less than ``least_s``."""
    return max(round(periods * period_ns), round(least_s * 1e9))


def health(*, age_ns: int | None, period_ns: int, ages: Ages = DEFAULT_AGES) -> Health:
    """Of the controller, by the age of the newest estimate (None: there is none) and the period of estimates (0: not
    known).
    """
    if age_ns is None:
        return Health.DEGRADED
    age = abs(age_ns)
    if age <= timeout_ns(DEGRADED_PERIODS, period_ns, ages.degraded_s):
        return Health.NOMINAL
    if age <= timeout_ns(HOLD_PERIODS, period_ns, ages.hold_s):
        return Health.DEGRADED
    return Health.HOLD if age <= timeout_ns(FAILSAFE_PERIODS, period_ns, ages.failsafe_s) else Health.FAILSAFE


def report_health(*, silent_ns: int | None, period_ns: int, ages: Ages = DEFAULT_AGES) -> Health:
    """Of the controller, by how long the actuators have been silent (None: they never said anything, as they may)."""
    if silent_ns is None or silent_ns <= timeout_ns(DEGRADED_PERIODS, period_ns, ages.degraded_s):
        return Health.NOMINAL
    return Health.DEGRADED


def plan_health(*, silent_ns: int | None, period_ns: int, left_ns: int) -> Health:
    """Of the actuators, by the time since a plan was accepted last (None: never), the period of plans (0: not known),
    and how long the newest still lasts.
    """
    if silent_ns is None:
        return Health.DEGRADED
    if left_ns < 0:
        return Health.FAILSAFE
    return Health.NOMINAL if silent_ns <= plan_timeout_ns(period_ns) else Health.DEGRADED


def plan_timeout_ns(period_ns: int) -> int:
    """So long after its last plan a commander counts as there."""
    return max(round(REPLACEMENTS_MISSING * period_ns), MIN_PLAN_TIMEOUT_NS)


def worst(*of: Health) -> Health:
    """The worst of them."""
    return next(health for health in WORST_FIRST if health in of)
