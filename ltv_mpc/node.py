"""Node interface: pure steps, without clock, unseeded random numbers or threads.

The callers are ``sim/scheduler.py`` (one process, simulated clock), ``services/runtime/runner.py`` (Zenoh, wall
clock) and a replay. For the same state and (t_ns, inbox) a step returns the same messages, bit for bit, so a recording
replays through the nodes without tolerances.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeAlias

import msgspec

from ltv_mpc.messages import Message

DEFAULT_SOURCE = "default"
"""Name of the source on a plain key."""


class Grid(msgspec.Struct, frozen=True):
    """Schedule of steps at exactly t_ns = k x period; none is skipped."""

    period_ns: int


class Cycle(msgspec.Struct, frozen=True):
    """Schedule of steps that start one period apart, or at the end of the last step if that is later.

    ``t_ns`` is the reading of the clock.
    """

    period_ns: int


class OnMessage(msgspec.Struct, frozen=True):
    """Schedule of one step for each message of these types, in order of arrival.

    ``t_ns`` is the time of validity of the message.
    """

    types: tuple[type[Message], ...]


Schedule: TypeAlias = Grid | Cycle | OnMessage


class ReceivedMessage(msgspec.Struct, frozen=True, eq=False, gc=False):
    """Entry of an inbox: a validated message, epoch and sequence of its header, its time of arrival, and its source.

    ``source`` is the name of the source, if several may publish on keys of their own.
    """

    message: Message
    epoch: int
    sequence: int
    received_t_ns: int
    source: str = DEFAULT_SOURCE


Inbox: TypeAlias = Sequence[ReceivedMessage]


class Node(Protocol):
    """Component with pure steps. ``reads`` are the types in its inbox, ``writes`` the types that its steps return."""

    @property
    def name(self) -> str:
        """Name of the node."""
        ...

    @property
    def schedule(self) -> Schedule:
        """Times of its steps."""
        ...

    @property
    def reads(self) -> tuple[type[Message], ...]:
        """Types of the messages in its inbox."""
        ...

    @property
    def writes(self) -> tuple[type[Message], ...]:
        """Types of the messages that its steps return."""
        ...

    def step(self, t_ns: int, inbox: Inbox) -> Sequence[Message]:
        """Take one step, and return the messages to publish, in order.

        Parameters
        ----------
        t_ns : time of the step (ns).
        inbox : messages since the last step, in order.
        """
        ...


Stopwatch: TypeAlias = Callable[[str], None]
"""Callback with the name of a stage at its end. The runner measures; lock step and replay pass ``no_stopwatch``."""


def no_stopwatch(stage: str) -> None:
    """Measure nothing."""


Progress: TypeAlias = Callable[[], None]
"""Callback during a step that may take long, so that its supervisor does not treat it as hung."""


def no_progress() -> None:
    """Report no progress."""
