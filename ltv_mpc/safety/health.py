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

Age and monitor of one input: its newest stamp, the arrival of that message, the spacing of the stamps, its source.

Whatever depends on how old an input is has one: the monitor of an input, the choice of a source, the gates of estimates
and plans, and the mission policy. Times are those of the receiver, whose clock follows the monotonic clock of its host.
A jump of the wall clock has no effect.

A monitor checks order and source of the messages, and publishes:

alive    a message was received recently
valid    the stamp of the newest message is close to the receiver's time
rate     at most half of the recent messages are missing, by the median spacing of their stamps
"""

from __future__ import annotations

from collections import deque
from typing import Annotated, Generic, NamedTuple, TypeVar

import msgspec
from msgspec import Meta

from ltv_mpc.messages import Health, InputReport, Times
from ltv_mpc.node import ReceivedMessage

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


def plan_health(*, silent_ns: int | None, period_ns: int, left_ns: int) -> Health:
    """Return the health of the actuators by the plans they accept.

    Parameters
    ----------
    silent_ns : time since the last accepted plan (ns); None before the first.
    period_ns : period of the plans (ns); 0 if unknown.
    left_ns : time to the end of the newest plan, as ``plan_end_ns`` gives it (ns); negative after it.
    """
    if silent_ns is None:
        return Health.DEGRADED
    if left_ns < 0:
        return Health.FAILSAFE
    return Health.NOMINAL if silent_ns <= plan_timeout_ns(period_ns) else Health.DEGRADED


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


SPACINGS = 9
"""Number of spacings in the median, so that a lost message or a burst does not change the period."""

CONTESTED_NS = 1_500_000_000
"""Time for which a second source is reported after both have published."""

T = TypeVar("T")


class InputAge:
    """Newest message of an input by its stamp and its arrival, and the period of the input."""

    def __init__(self) -> None:
        self.stamp_ns: int | None = None
        """Newest stamp (ns); None before the first."""
        self.arrived_ns = 0
        """Arrival of that message (ns)."""
        self._spacings: deque[int] = deque(maxlen=SPACINGS)
        self._median_ns: int | None = 0  # None: not computed since the last stamp

    def add(self, stamp_ns: int, arrived_ns: int | None = None) -> None:
        """Add a message. A repeated stamp changes the arrival alone.

        Parameters
        ----------
        stamp_ns : stamp (ns).
        arrived_ns : arrival (ns); None: the stamp is that of the arrival.
        """
        if self.stamp_ns not in (None, stamp_ns):
            self._spacings.append(max(stamp_ns - self.stamp_ns, 0))
            self._median_ns = None
        self.stamp_ns, self.arrived_ns = stamp_ns, stamp_ns if arrived_ns is None else arrived_ns

    @property
    def median_ns(self) -> int:
        """Median spacing (ns); 0 before the second stamp."""
        if self._median_ns is None:
            self._median_ns = sorted(self._spacings)[len(self._spacings) // 2]
        return self._median_ns

    @property
    def mean_ns(self) -> float:
        """Mean spacing (ns); 0 before the second stamp."""
        return sum(self._spacings) / len(self._spacings) if self._spacings else 0.0

    def silent_ns(self, t_ns: int) -> int | None:
        """Return the time (ns) since the newest message arrived; None before the first.

        Parameters
        ----------
        t_ns : current time (ns).
        """
        return None if self.stamp_ns is None else t_ns - self.arrived_ns


class Contest(Generic[T]):
    """Second source of an input, which is reported while both publish."""

    def __init__(self) -> None:
        self._second: T | None = None
        self._unanswered = False  # nothing was accepted since
        self._at_ns: int | None = None  # last time at which both published

    def reject(self, second: T) -> None:
        """Note a message of a second source.

        Parameters
        ----------
        second : what identifies the source.
        """
        self._second, self._unanswered = second, True

    def accept(self, t_ns: int) -> None:
        """Note a message of the source in use.

        Parameters
        ----------
        t_ns : its arrival (ns).
        """
        if self._unanswered:
            self._unanswered, self._at_ns = False, t_ns

    def second(self, t_ns: int) -> T | None:
        """Return the second source if it publishes beside the one in use.

        Parameters
        ----------
        t_ns : current time (ns).
        """
        return self._second if self._at_ns is not None and t_ns - self._at_ns <= CONTESTED_NS else None


MAX_MEAN_OVER_MEDIAN = 2.0
"""Ratio of mean to median spacing above which ``rate`` is false: more than half of the messages are missing."""

CLOCK_SET_BACK_NS = 10_000_000_000
"""Step backwards between two stamps from which the sender's clock counts as set back."""

SECOND_SOURCE = "second source"
"""Begin of the reason for which message validation rejects a frame of a second source."""


class InputMonitor:
    """Order and timeliness of one input.

    A source is identified by its epoch, which each start of a process draws at random.
    """

    def __init__(self) -> None:
        self.rejected = 0
        """Number of messages rejected: out of order, or stamped too far ahead of their arrival."""
        self.age = InputAge()
        """Age of the newest message."""
        self.contest: Contest[str] = Contest()
        """Second source, by the reason of its rejection."""
        self._epoch: int | None = None
        self._sequence = -1

    def reject(self, why: str) -> None:
        """Note a message that validation has rejected before it came here; only those of a second source count.

        Parameters
        ----------
        why : reason of the rejection.
        """
        if why.startswith(SECOND_SOURCE):
            self.contest.reject(why)

    def accepts(self, received: ReceivedMessage, stamp_ns: int) -> bool:
        """Return True if an entry of an inbox is accepted as the newest one: ``receive``.

        Parameters
        ----------
        received : its header and its arrival count.
        stamp_ns : time of validity of its message (ns).
        """
        at_ns = received.received_t_ns
        return self.receive(epoch=received.epoch, sequence=received.sequence, stamp_ns=stamp_ns, received_ns=at_ns)

    def receive(self, *, epoch: int, sequence: int, stamp_ns: int, received_ns: int) -> bool:
        """Return True if a message is accepted as the newest one.

        It must be later than the last one of its source, or of another source; not stamped before the newest message,
        unless by more than ``CLOCK_SET_BACK_NS``; and not stamped more than ``MAX_STAMP_AHEAD_NS`` after its arrival.

        Parameters
        ----------
        epoch, sequence : header of the message.
        stamp_ns : time of validity of the message (ns).
        received_ns : time of its arrival (ns).
        """
        if stamp_ns > received_ns + MAX_STAMP_AHEAD_NS:
            self.rejected += 1
            return False
        same = epoch == self._epoch
        older_ns = 0 if self.age.stamp_ns is None else self.age.stamp_ns - stamp_ns
        set_back = older_ns > CLOCK_SET_BACK_NS
        if (same and sequence <= self._sequence) or (older_ns > 0 and not set_back):
            self.rejected += 1
            return False
        if set_back:
            self.age = InputAge()
        self.age.add(stamp_ns, received_ns)
        self._epoch, self._sequence = epoch, sequence
        self.contest.accept(received_ns)
        return True

    def restart(self) -> None:
        """Begin with another source: its order and its period are its own. The count of rejected messages stays."""
        self.age, self._epoch, self._sequence = InputAge(), None, -1

    def report(self, name: str, t_ns: int, ages: Ages = DEFAULT_AGES, *, implausible: int = 0) -> InputReport:
        """Return the state of the input.

        Parameters
        ----------
        name : key of the input.
        t_ns : current time (ns).
        ages : thresholds; ``degraded_s`` is the shortest timeout.
        implausible : messages that were rejected later.
        """
        age, period_ns, silent_ns = self.age, self.age.median_ns, self.age.silent_ns(t_ns)
        timeout = timeout_ns(DEGRADED_PERIODS, period_ns, ages.degraded_s)
        age_ns = None if age.stamp_ns is None else t_ns - age.stamp_ns
        return InputReport(
            input=name,
            alive=silent_ns is not None and silent_ns <= timeout,
            valid=age_ns is not None and abs(age_ns) <= timeout,
            rate=age_ns is not None and age.mean_ns <= MAX_MEAN_OVER_MEDIAN * period_ns,
            age_ns=age_ns,
            period_ns=period_ns,
            rejected=self.rejected + implausible,
        )
