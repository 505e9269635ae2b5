"""A process whose inputs come from a side that keeps a clock of its own: by which clock it goes, and what it believes.

Where a ``clock`` is published that one counts. Where none is heard for half a second after the first input, the time is
the other side's, by the stamps of what comes and by its reports of what it received.
"""

from __future__ import annotations

from collections import OrderedDict

from ltv_mpc.messages import Applied, ClockMode, ClockState, Estimate, Message
from services.runtime.clock import Line, VehicleClock
from services.runtime.foreign_clock import ForeignClock, Reading

GRACE_US = 500_000
"""A clock is repeated ten times a second."""

REMEMBERED = 200
"""Plans whose receipt may still be reported: a minute of them."""

OF_ALL = Reading(ClockMode.SHARED, 0, 0)
"""One clock for all: nothing to find out."""

STAMPED = (Estimate, Applied)


class ForeignTime:
    """Sets ``clock`` by what comes and goes, once it is clear that nobody publishes one."""

    def __init__(self, clock: VehicleClock, *, epoch: int, input_delay_ns: int = 0) -> None:
        """``epoch``: under which this process publishes."""
        self._clock = clock
        self._epoch = epoch
        self._theirs = ForeignClock(input_delay_ns=input_delay_ns)
        self._sent_us: OrderedDict[int, int] = OrderedDict()  # by sequence
        self._first_us: int | None = None
        self.in_force = False

    @property
    def times_set(self) -> int:
        """How often the other side has set its clock."""
        return self._theirs.times_set

    def reading(self, now_us: int) -> Reading:
        """By which clock the process goes, and how far off it may be."""
        reading = self._theirs.read(now_us) if self.in_force else None
        return reading or OF_ALL

    def sent(self, sequence: int, m_us: int) -> None:
        """A plan of that number goes out."""
        self._sent_us[sequence] = m_us
        while len(self._sent_us) > REMEMBERED:
            self._sent_us.popitem(last=False)

    def heard(self, signal: Message, m_us: int) -> str:
        """An input came at ``m_us``. Why it must not be believed; empty where it may."""
        if not isinstance(signal, STAMPED) or (self._clock.newest is not None and not self.in_force):
            return ""  # with a clock for all the stamps are by that one, at whatever speed it goes
        if self._first_us is None:
            self._first_us = m_us
        times_set = self.times_set
        if not self._theirs.stamped(signal.t_ns, m_us):
            return "t_ns contradicts the clock that all before it were stamped by"
        if self.in_force and self.times_set > times_set:
            self._clock.start_anew()
        if isinstance(signal, Applied) and signal.plan_epoch == self._epoch and signal.plan_sequence in self._sent_us:
            self._theirs.received(signal.plan_received_t_ns, self._sent_us[signal.plan_sequence])
        self._set(m_us, self._first_us)
        return ""

    def _set(self, m_us: int, first_us: int) -> None:
        reading = self._theirs.read(m_us)
        if m_us - first_us < GRACE_US or reading is None:
            return
        self.in_force = True
        self._clock.go_by(Line(m_us, m_us * 1000 + reading.offset_ns, 1, 1, ClockState.RUNNING))
