"""A process's word about itself: twice a second from its own step loop, so that it is a heartbeat, and a last one."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol

from ltv_mpc.messages import ClockState, Message, NodeStatus
from services.bus.mailbox import Mailbox
from services.bus.outbox import Outbox
from services.bus.topics import BY_TYPE, OPERATOR
from services.runtime.clock import VehicleClock
from services.runtime.stopping import Say

PERIOD_US = 500_000
EARLY_PERIOD_US = 100_000  # before the start: who waits for this word should not wait long
SILENCE_US = 2_000_000  # without a word of the clock
HURRIED_PERIOD_US = 50_000  # of who cannot keep up: the time-keeper is to know before much has piled up
LONGEST_WAY_US = 10_000_000  # one that seems to have been longer on its way was stamped by another machine's clock

MAX_BACKLOG_US = 20_000
"""So long each message may wait at a process: estimates come through two of them before a plan is made of them."""


class Counts(Protocol):
    """What became of the messages that came."""

    @property
    def received(self) -> int: ...
    @property
    def dropped(self) -> int: ...
    @property
    def rejected(self) -> int: ...


class NodeStatusReporter:
    """Counts a process's steps, knows what it waits for, and publishes both."""

    def __init__(
        self,
        node: str,
        *,
        outbox: Outbox,
        counts: Counts,
        mailbox: Mailbox,
        clock: VehicleClock,
        reads: Iterable[type[Message]],
        say: Say,
        foreign: bool = False,
        missing: Callable[[], str] | None = None,
    ) -> None:
        """``foreign``: without a clock it goes by the stamps of its inputs.

        ``missing``: the node's own word for what it needs and has not; without one, whatever it never heard of.
        """
        self._node = node
        self._no_time = "an estimate, or a clock" if foreign else "the clock of `ltv-mpc plant`"
        self._outbox = outbox
        self._counts = counts
        self._mailbox = mailbox
        self._clock = clock
        self._say = say
        self._said = ""
        self._missing = missing
        self._never_heard = dict.fromkeys(kind for kind in reads if BY_TYPE[kind].written_by != OPERATOR)
        self._clock_heard_us: int | None = None
        self._said_us = 0
        self._busy_us, self._busy_steps = 0, 0
        self.steps = 0
        self._least_wait_us: int | None = None
        self.due_us = 0

    def on_input(self, kind: type[Message]) -> None:
        """A signal of this kind was let in."""
        self._never_heard.pop(kind, None)

    def on_delivery(self, sent_us: int, arrived_us: int, now_us: int) -> None:
        """The message taken last was sent, came and was taken then.

        Faster than real time a router that cannot keep up counts as well. In real time the way is what it is: a long
        link's delay is to be measured and compensated, not to be waited for.
        """
        newest = self._clock.newest
        fast = newest is not None and newest.num > newest.den
        stamped = fast and 0 < sent_us <= arrived_us < sent_us + LONGEST_WAY_US
        since_us = sent_us if stamped else arrived_us
        wait_us = max(0, now_us - since_us)
        self._least_wait_us = wait_us if self._least_wait_us is None else min(self._least_wait_us, wait_us)
        if wait_us > MAX_BACKLOG_US:
            self.due_us = min(self.due_us, now_us + HURRIED_PERIOD_US)

    @property
    def min_queue_delay_us(self) -> int:
        """The least wait since the last word: a queue that stands. One that a long step has left drains by itself."""
        return self._least_wait_us or 0

    def on_clock(self, now_us: int) -> None:
        """The time-keeper lives."""
        self._clock_heard_us = now_us

    def on_step(self, took_us: int) -> None:
        """A step is done."""
        self.steps += 1
        self._busy_us += took_us
        self._busy_steps += 1

    def publish(self, now_us: int, *, others: str = "", finished: bool = False) -> None:
        """Say it now. ``others`` names the nodes that the time-keeper waits for."""
        waiting_for = "" if finished else others or self._waiting_for(now_us)
        if waiting_for and waiting_for != self._said:
            self._say(f"waiting for {waiting_for}")
        self._said = waiting_for
        newest = self._clock.newest
        running = newest is not None and newest.state is ClockState.RUNNING
        self._said_us = now_us
        self.due_us = now_us + (PERIOD_US if running else EARLY_PERIOD_US)
        self._outbox.publish(
            NodeStatus(
                node=self._node,
                t_ns=self._clock.read(now_us) or 0,
                ready=True,
                waiting_for=waiting_for,
                steps=self.steps,
                published=self._outbox.published + 1,  # this one included
                received=self._counts.received,
                # Of a key that overflowed the next frame shows the gap, which is counted as well: not the sum.
                dropped=max(self._counts.dropped, self._mailbox.overflowed),
                rejected=self._counts.rejected,
                step_us=self._busy_us / self._busy_steps if self._busy_steps else 0.0,
                min_queue_delay_us=self.min_queue_delay_us,
                finished=finished,
            )
        )
        self._busy_us, self._busy_steps = 0, 0
        self._least_wait_us = None

    def _waiting_for(self, now_us: int) -> str:
        newest = self._clock.newest
        if newest is None:
            return self._no_time
        if newest.state is ClockState.WAITING:
            return "the start"
        if newest.state is ClockState.PAUSED:
            return "the clock, which is paused"
        if self._clock_heard_us is not None and now_us - self._clock_heard_us > SILENCE_US:
            return "the clock, whose messages have stopped"
        if self._missing is not None:
            return self._missing()
        return ", ".join(BY_TYPE[kind].key for kind in self._never_heard)
