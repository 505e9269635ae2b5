"""Vehicle time in one process: the clock that it follows or keeps, and the schedule of its steps.

clock master     the plant's process: announces the time and follows its own announcements
follower         all other processes of a run: follow the announced clock (``clock.py``)
synchronised     a controller without an announced clock: takes the time from its inputs' stamps (``clock_sync.py``)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from ltv_mpc.messages import Clock, ClockStep, Message, RunEvent
from ltv_mpc.node import Cycle, Grid, Node, OnMessage, Schedule
from services.runtime.clock import VehicleClock, monotonic_us
from services.runtime.clock_master import ClockMaster, ClockMasterSettings
from services.runtime.clock_sync import STAMPED_INPUTS, ClockSync

INPUT_LATENCY_US = 6_000
"""Cycles start this long after the multiples of their period. Measurements of an instant arrive within it: a cycle that
started at the instant itself would just miss them and plan on an estimate that is a whole period old."""


class ClockOptions(NamedTuple):
    """Choice of the clock that a process follows."""

    master: ClockMasterSettings | None = None
    """Settings of the process that keeps the time; None for a follower."""
    sync_to_inputs: bool = False
    """Take the time from the inputs' stamps if no clock is announced."""
    input_delay_ns: int = 0
    """Smallest transport delay of the inputs, for the one-way mode of the synchronisation."""
    speed: float | None = None
    """Clock speed that this process expects; another one is an error. None: any."""


class StepSchedule:
    """Vehicle time at which a node's next step is due, ``next_ns``. It is None before the clock is known.

    Grid        every multiple of the period, none is skipped: t = k x period
    Cycle       the last start plus the period, or the end of the last step if that is later
    OnMessage   no schedule: messages cause the steps

    Grid and Cycle begin at the first multiple of the period that is not before the start, as in lock step.
    """

    def __init__(self, schedule: Schedule, *, end_ns: int | None = None) -> None:
        self._period_ns = 0 if isinstance(schedule, OnMessage) else schedule.period_ns
        self._may_shift = isinstance(schedule, Cycle)
        self._end_ns = end_ns
        self.on_grid = isinstance(schedule, Grid)
        self.next_ns: int | None = None

    def start(self, now_ns: int, *, phase_ns: int = 0) -> None:
        """Start at the first clock reading. Cycles start ``phase_ns`` after the multiples of their period."""
        if self._period_ns and self.next_ns is None:
            self.next_ns = -(-now_ns // self._period_ns) * self._period_ns
            if self._may_shift:
                self.next_ns += min(phase_ns, self._period_ns // 2)

    def advance(self, ended_ns: int) -> None:
        """Schedule the next step after one that ended at ``ended_ns``."""
        if self.next_ns is None:
            return
        self.next_ns += self._period_ns
        if self._may_shift:
            self.next_ns = max(self.next_ns, ended_ns)

    @property
    def finished(self) -> bool:
        """True once the last step is done."""
        return self._end_ns is not None and self.next_ns is not None and self.next_ns > self._end_ns


class ProcessTime:
    """Vehicle time and the step schedule of one process."""

    def __init__(
        self, node: Node, options: ClockOptions, *, epoch: int, publish: Callable[[Clock | RunEvent], object]
    ) -> None:
        """``epoch``: of the messages of this process. ``publish``: for a clock master, from its connection on."""
        self.epoch = epoch
        self.clock = VehicleClock(speed=options.speed)
        self.master: ClockMaster | None = None
        if options.master is not None:
            self.master = ClockMaster(
                options.master, self.clock, node=node.name, epoch=epoch, now_us=monotonic_us(), publish=publish
            )
        self.sync = ClockSync(self.clock, epoch=epoch, input_delay_ns=options.input_delay_ns)
        self.syncs = options.sync_to_inputs
        """True if the time is taken from the inputs' stamps while no clock is announced."""
        self.schedule = StepSchedule(node.schedule, end_ns=options.master.end_ns if options.master else None)

    def now_ns(self, now_us: int) -> int:
        """Return the vehicle time at a monotonic time; 0 while it is not known."""
        reading = self.clock.read(now_us)
        return 0 if reading is None else reading

    @property
    def speed(self) -> float:
        """Speed of the vehicle clock; 1 while it is not known."""
        newest = self.clock.newest
        return 1.0 if newest is None else newest.num / newest.den

    def received_ns(self, message: Message, received_us: int) -> int:
        """Return the vehicle time of a message's arrival; its own stamp while the vehicle time is not known."""
        if isinstance(message, STAMPED_INPUTS) and self.clock.read(received_us) is None:
            return message.t_ns
        return self.now_ns(received_us)

    @property
    def next_step_us(self) -> int | None:
        """Monotonic time at which the next scheduled step is due; None while it is not known."""
        next_ns = self.schedule.next_ns
        return None if next_ns is None else self.clock.due_us(next_ns)

    def start_schedule(self) -> None:
        """Schedule the first step, if the time is known and the schedule has not started."""
        newest = self.clock.newest
        if newest is not None:
            reading = self.clock.read(monotonic_us())
            phase_ns = INPUT_LATENCY_US * 1000 * newest.num // newest.den
            self.schedule.start(newest.vehicle_ns if reading is None else reading, phase_ns=phase_ns)

    def take(self, message: Message, epoch: int, received_us: int) -> str:
        """Follow a clock, or the stamps of the inputs. Return why a message does not fit the time; empty if it fits.

        ``epoch``: of its publisher. Raises ``ClockError`` if the clock cannot be followed.
        """
        if not (self.syncs or isinstance(message, Clock)):
            return ""
        known = self.clock.newest is not None
        reason = self.sync.take(message, epoch, received_us)
        if not known:
            self.start_schedule()
        return reason


def step_text(step: ClockStep) -> str:
    """Return a clock step as an event."""
    text = f"the clock of the publisher of `{step.input}` was set by {step.step_ns / 1e9:+.3f} s"
    return text if step.certain else f"{text}, or its link is congested: degraded for 10 s"
