"""Node status of a process: ready, waiting for which inputs, step count, message counts and backlog.

Each process publishes it twice a second from its own step loop, so that it also shows that the process works, and once
more, with ``finished``, before it ends.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol

from ltv_mpc.messages import Battery, Clock, ClockState, Leak, Message, NodeStatus
from services.bus.mailbox import Mailbox
from services.bus.outbox import Outbox
from services.bus.topics import BY_TYPE, OPERATOR
from services.runtime.clock import VehicleClock
from services.runtime.stopping import Say

PERIOD_US = 500_000
EARLY_PERIOD_US = 100_000  # before the start: the clock master waits for this status
HURRIED_PERIOD_US = 50_000  # of a process that falls behind: the clock master slows the clock before much has piled up
CLOCK_MESSAGE = "a `clock` message, which `ltv-mpc plant` sends in a simulation"
CLOCK_OR_ESTIMATE = "an estimate, or a clock"
"""What a process waits for while it has no time: in a simulation, and beside a vehicle."""

CLOCK_TIMEOUT_US = 2_000_000
"""Silence of the clock after which the process reports that it waits for it."""

MAX_TRANSIT_US = 10_000_000
"""A message with a longer transit time was stamped by the clock of another machine."""

MAX_BACKLOG_US = 20_000
"""Waiting time of a message that does not yet count as falling behind. An estimate waits in two processes before a plan
is made from it."""


OPTIONAL: tuple[type[Message], ...] = (Battery, Leak)
"""Inputs of instruments that a vehicle may lack: no process waits for them."""


class Counts(Protocol):
    """Counts of the messages that a process received."""

    @property
    def received(self) -> int: ...
    @property
    def dropped(self) -> int: ...
    @property
    def rejected(self) -> int: ...


class WaitingFor:
    """Conditions that a process waits for: the clock, the start, and inputs that have not arrived yet."""

    def __init__(
        self,
        clock: VehicleClock,
        inputs: Iterable[type[Message]],
        *,
        from_inputs: bool = False,
        node_waits: Callable[[], str] | None = None,
    ) -> None:
        """``from_inputs``: without an announced clock the time is that of the inputs.

        ``node_waits`` is the node's own account of what it needs. Without it, the process waits for each of ``inputs``
        that has never arrived; those of an operator and the optional ones are not waited for.
        """
        self.clock = clock
        self._clock_source = CLOCK_OR_ESTIMATE if from_inputs else CLOCK_MESSAGE
        self._node_waits = node_waits
        self._missing = dict.fromkeys(
            kind for kind in inputs if BY_TYPE[kind].written_by != OPERATOR and kind not in OPTIONAL
        )
        self._clock_received_us: int | None = None

    def on_input(self, kind: type[Message], now_us: int) -> None:
        """Note an input of this type, or a clock announcement."""
        self._missing.pop(kind, None)
        if kind is Clock:
            self._clock_received_us = now_us

    def text(self, now_us: int) -> str:
        """Return what the process waits for; empty if for nothing."""
        newest = self.clock.newest
        if newest is None:
            return self._clock_source
        if newest.state is ClockState.WAITING:
            return "the start"
        if newest.state is ClockState.PAUSED:
            return "the clock, which is paused"
        if self._clock_received_us is not None and now_us - self._clock_received_us > CLOCK_TIMEOUT_US:
            return "the clock, whose messages have stopped"
        if self._node_waits is not None:
            return self._node_waits()
        return ", ".join(BY_TYPE[kind].key for kind in self._missing)


class NodeStatusReporter:
    """Reporter of a process's status, from the events of its step loop."""

    def __init__(
        self, node: str, *, outbox: Outbox, counts: Counts, mailbox: Mailbox, waiting: WaitingFor, say: Say
    ) -> None:
        self.steps = 0
        self.due_us = 0
        self._node = node
        self._outbox = outbox
        self._counts = counts
        self._mailbox = mailbox
        self.waiting = waiting
        self._say = say
        self._printed = ""  # newest waiting text on stderr
        self._busy_us, self._busy_steps = 0, 0  # since the last status
        self._min_wait_us: int | None = None  # since the last status

    def on_delivery(self, sent_us: int, arrived_us: int, now_us: int) -> None:
        """Note when the newest message was sent, arrived here and was taken from the mailbox.

        If vehicle time runs faster than real time, the transit counts as waiting too, so that a slow router is noticed.
        In real time it does not: the delay of a long link is measured and compensated, not waited for.
        """
        newest = self.waiting.clock.newest
        fast = newest is not None and newest.num > newest.den
        counts_transit = fast and 0 < sent_us <= arrived_us < sent_us + MAX_TRANSIT_US
        wait_us = max(0, now_us - (sent_us if counts_transit else arrived_us))
        self._min_wait_us = wait_us if self._min_wait_us is None else min(self._min_wait_us, wait_us)
        if wait_us > MAX_BACKLOG_US:
            self.due_us = min(self.due_us, now_us + HURRIED_PERIOD_US)

    def on_step(self, took_us: int) -> None:
        """Note a step that took ``took_us`` of wall time."""
        self.steps += 1
        self._busy_us += took_us
        self._busy_steps += 1

    @property
    def min_queue_delay_us(self) -> int:
        """Shortest waiting time of a message since the last status: the backlog that does not drain by itself.

        The longest waiting time would also count the queue that one long step leaves, which drains by itself.
        """
        return self._min_wait_us or 0

    def publish(self, now_us: int, *, others: str = "", finished: bool = False) -> None:
        """Publish the status. ``others`` names the nodes that the clock master waits for."""
        waiting_for = "" if finished else others or self.waiting.text(now_us)
        if waiting_for and waiting_for != self._printed:
            self._say(f"waiting for {waiting_for}")
        self._printed = waiting_for
        clock = self.waiting.clock
        running = clock.newest is not None and clock.newest.state is ClockState.RUNNING
        self.due_us = now_us + (PERIOD_US if running else EARLY_PERIOD_US)
        self._outbox.publish(
            NodeStatus(
                node=self._node,
                t_ns=clock.read(now_us) or 0,
                ready=True,
                waiting_for=waiting_for,
                steps=self.steps,
                published=self._outbox.published + 1,  # this one included
                received=self._counts.received,
                # Not the sum: after an overflow the next frame of that key shows the gap, which ``dropped`` counts.
                dropped=max(self._counts.dropped, self._mailbox.overflowed),
                rejected=self._counts.rejected,
                step_us=self._busy_us / self._busy_steps if self._busy_steps else 0.0,
                min_queue_delay_us=self.min_queue_delay_us,
                finished=finished,
            )
        )
        self._busy_us, self._busy_steps = 0, 0
        self._min_wait_us = None
