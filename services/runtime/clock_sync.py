"""Synchronisation with the clocks of the other side: one clock for each publisher, and a vehicle time without steps.

    vehicle time = m + theta_r - J        r: the actuators; before their third report, the estimates in use

theta is the offset of a publisher's clock (``clock_offset.py``). J is the sum of the steps of clock r, so that vehicle
time runs on if that clock is set. Stamps and vehicle time are converted where messages enter and leave:

    stamp of publisher p in vehicle time    t + theta_r - theta_p - J
    published time by the actuators' clock  t + J

Both shifts are 0 as long as all publishers use one clock and nobody sets it. A publisher has a clock of its own if its
stamps cannot come from clock r.
"""

from __future__ import annotations

from ltv_mpc.bounded import remember
from ltv_mpc.messages import Applied, Clock, ClockMode, ClockState, ClockStep, Estimate, Message
from services.bus.topics import BY_TYPE
from services.runtime.clock import ClockSegment, VehicleClock
from services.runtime.clock_offset import LATE_NS, STEP_DETECTED_AT, ClockOffset, ClockOffsetEstimator

GRACE_US = 500_000
"""Time without a published clock after which the other side's stamps count: a clock is repeated ten times a second."""

SHARED_CLOCK_LATE_NS = 1_000_000_000
"""Largest lateness of a publisher that shares the actuators' clock, unless its own clock has been seen to step."""

SILENT_US = 1_000_000
"""Silence of the actuators after which others that report take over: vehicle time then follows their clock."""

MAX_PENDING_PLANS = 200
"""Plans whose receipt may still be reported, a minute of them."""

MAX_PUBLISHERS = 16
"""Largest number of publishers whose clocks are remembered, as many as the rate limit admits at a time; beyond it the
one that has been silent longest is forgotten.
"""

STAMPED_INPUTS = (Estimate, Applied)
"""Inputs that carry the other side's time."""

SHARED_CLOCK = ClockOffset(ClockMode.SHARED, 0, 0)
"""Offset if one clock is announced for all processes, or while none is followed yet."""

SYNCHRONISED = "vehicle time already follows the estimates: restart this process to use the clock"
STAMP_REJECTED = "t_ns contradicts the clock of all earlier stamps"
RECEIPT_REJECTED = "plan_received_t_ns contradicts the clock of all earlier stamps"
RECEIPT_BEFORE_STEP = "plan_received_t_ns is of a plan that was sent before the clock stepped"


class ClockSync:
    """Choice of the clock that a process follows, when its inputs may come from sides with clocks of their own.

    If a ``clock`` message is published, the process follows it. If none has arrived within ``GRACE_US`` of the first
    input, the process sets its own vehicle clock from the stamps of its inputs and from the actuators' reports of the
    plans that they received. A publisher is identified by its epoch.
    """

    def __init__(self, clock: VehicleClock, *, epoch: int, input_delay_ns: int = 0) -> None:
        """``epoch``: the epoch under which this process publishes its plans."""
        self._clock = clock
        self._epoch, self._input_delay_ns = epoch, input_delay_ns
        # By epoch, the one received last at the end.
        self._publishers: dict[int, ClockOffsetEstimator] = {}
        self._reference: int | None = None  # publisher whose clock the vehicle time and the plans follow
        self._actuators_report = False
        self._source: int | None = None  # publisher of the estimates in use
        self._sent_us: dict[int, int] = {}  # by sequence
        self._first_us: int | None = None
        self._steps: list[ClockStep] = []
        self._plans_from_us = -1  # plans that were sent before carry the times of another clock
        self.active = False
        self.published_shift_ns = 0
        """J: published time minus vehicle time."""

    def offset(self, now_us: int) -> ClockOffset:
        """Return mode, offset and error bound of the clock that the process follows."""
        if not self.active or self._reference is None:
            return SHARED_CLOCK
        return self._publishers[self._reference].read(now_us)

    def shift_ns(self, epoch: int, m_us: int) -> int:
        """Return vehicle time minus the time of the publisher ``epoch``; 0 while either is unknown.

        A publisher of neither estimates nor reports, as one of obstacles, has the clock of the estimates in use.
        """
        if epoch not in self._publishers and self._source is not None:
            epoch = self._source
        if self._reference is None or epoch not in self._publishers:
            return 0
        return self._theta_ns(self._reference, m_us) - self._theta_ns(epoch, m_us) - self.published_shift_ns

    def on_plan_sent(self, sequence: int, m_us: int) -> None:
        """Note that the plan of this sequence number is sent at ``m_us``."""
        remember(self._sent_us, sequence, m_us, MAX_PENDING_PLANS)

    def follow_source(self, epoch: int, m_us: int) -> None:
        """Follow the publisher ``epoch``, whose estimates are in use from now on, while the actuators do not report."""
        self._source = epoch
        if not self._actuators_report and epoch in self._publishers:
            self._follow(Estimate, epoch, m_us)

    def take_steps(self) -> list[ClockStep]:
        """Return the clock steps that were recognised since the last call."""
        steps, self._steps = self._steps, []
        return steps

    def take(self, message: Message, epoch: int, m_us: int) -> str:
        """Follow an announced clock, or add an input that arrived at ``m_us``. Return why it is rejected; empty if not.

        Raises ``ClockError`` if the announced clock cannot be followed.
        """
        if not isinstance(message, Clock):
            return self.check_stamp(message, epoch, m_us)
        if self.active:
            return SYNCHRONISED
        self._clock.follow(message)
        return ""

    def check_stamp(self, message: Message, epoch: int, m_us: int) -> str:
        """Add an input of the publisher ``epoch`` that arrived at ``m_us``. Return why it is rejected; empty if not."""
        if not isinstance(message, STAMPED_INPUTS) or (self._clock.newest is not None and not self.active):
            return ""  # an announced clock stamps all messages, and may run at another speed
        if self._first_us is None:
            self._first_us = m_us
        publisher = self._publisher(epoch)
        steps, before_ns = publisher.clock_steps, self._theta_ns(epoch, m_us)
        if not publisher.add_stamp(message.t_ns, m_us):
            return STAMP_REJECTED
        sent_us, reason = self._plan_sent_us(message), ""
        if isinstance(message, Applied) and sent_us is not None and sent_us > publisher.stepped_us:
            fits = publisher.add_receipt(message.plan_received_t_ns, sent_us)
            reason = "" if fits else RECEIPT_REJECTED
        if publisher.clock_steps > steps:
            if epoch == self._reference:
                self._keep_vehicle_time(m_us)
            self._report(type(message), epoch, self._theta_ns(epoch, m_us) - before_ns, m_us)
        self._choose_reference(message, epoch, m_us)
        self._set(m_us, self._first_us)
        return RECEIPT_BEFORE_STEP if sent_us is not None and sent_us <= self._plans_from_us else reason

    def _plan_sent_us(self, message: Message) -> int | None:
        """Return when this process sent the plan that the actuators report as their newest; None if it did not."""
        if not isinstance(message, Applied) or message.plan_epoch != self._epoch:
            return None
        return self._sent_us.get(message.plan_sequence)

    def _choose_reference(self, message: Message, epoch: int, m_us: int) -> None:
        """Let vehicle time follow the actuators' clock from their third report on; before it, that of the estimates."""
        old, is_report = self._reference, isinstance(message, Applied)
        if epoch == old or old is None:
            self._reference, self._actuators_report = epoch, self._actuators_report or is_report
        elif (
            is_report
            and self._publishers[epoch].stamps >= STEP_DETECTED_AT
            and not (self._actuators_report and m_us - self._publishers[old].heard_us <= SILENT_US)
        ):
            self._actuators_report = True
            self._follow(Applied, epoch, m_us)

    def _follow(self, kind: type[Message], epoch: int, m_us: int) -> None:
        """Let vehicle time follow the clock of ``epoch``, the publisher of ``kind``, without a step of vehicle time."""
        old = self._reference
        if old is None or epoch == old:
            return
        before_ns, differs = self._theta_ns(old, m_us), self._has_own_clock(epoch, m_us)
        self._reference = epoch
        step_ns = self._theta_ns(epoch, m_us) - before_ns
        if self.active and (differs or abs(step_ns) >= LATE_NS):
            self._keep_vehicle_time(m_us)
            self._report(kind, epoch, step_ns, m_us)

    def _keep_vehicle_time(self, m_us: int) -> None:
        """Set J so that vehicle time runs on although theta_r has changed."""
        vehicle_ns = self._clock.read(m_us) if self.active else None
        self._plans_from_us = m_us
        if vehicle_ns is not None and self._reference is not None:
            self.published_shift_ns = m_us * 1000 + self._theta_ns(self._reference, m_us) - vehicle_ns

    def _report(self, kind: type[Message], epoch: int, step_ns: int, m_us: int) -> None:
        """Report a step. One that lateness alone shows is certain if a two-way exchange confirms the new clock."""
        two_way = self.offset(m_us).mode is ClockMode.TWO_WAY
        confirmed = epoch != self._reference and not self._has_own_clock(epoch, m_us) and two_way
        self._steps.append(
            ClockStep(
                t_ns=self._clock.read(m_us) or 0,
                input=BY_TYPE[kind].key,
                publisher=epoch,
                step_ns=step_ns,
                certain=self._publishers[epoch].certain or confirmed,
            )
        )

    def _publisher(self, epoch: int) -> ClockOffsetEstimator:
        """Return the estimator of a publisher's clock; a new one for a new publisher."""
        publisher = self._publishers.pop(epoch, None) or ClockOffsetEstimator(input_delay_ns=self._input_delay_ns)
        self._publishers[epoch] = publisher
        if len(self._publishers) > MAX_PUBLISHERS:
            del self._publishers[next(old for old in self._publishers if old != self._reference)]
        return publisher

    def _theta_ns(self, epoch: int, m_us: int) -> int:
        """Return the offset of the clock of a publisher, which is clock r unless its stamps cannot come from that."""
        followed = epoch if self._reference is None or self._has_own_clock(epoch, m_us) else self._reference
        return self._publishers[followed].read(m_us).offset_ns

    def _has_own_clock(self, epoch: int, m_us: int) -> bool:
        """Return True if the stamps of a publisher cannot come from the clock that vehicle time follows."""
        if self._reference is None or epoch == self._reference:
            return self._reference is None
        publisher = self._publishers[epoch]
        late_ns = LATE_NS if publisher.clock_steps else SHARED_CLOCK_LATE_NS
        return not publisher.agrees(self._publishers[self._reference], m_us, late_ns)

    def _set(self, m_us: int, first_us: int) -> None:
        """Set the vehicle clock once ``GRACE_US`` have passed since the first input without a published clock."""
        if m_us - first_us < GRACE_US or self._reference is None:
            return
        self.active = True
        offset_ns = self._theta_ns(self._reference, m_us) - self.published_shift_ns
        self._clock.set_segment(ClockSegment(m_us, m_us * 1000 + offset_ns, 1, 1, ClockState.RUNNING))
