"""What a node is: pure steps. It never asks what time it is, draws no unseeded number, and keeps no thread.

A node is given the steps that are due. ``sim/scheduler.py`` (one process, simulated clock) gives it as many at once as
are known; ``services/runtime/runner.py`` (Zenoh, wall clock) and a replay give it one at a time. Given the same state
and the same (t_ns, inbox) a step returns the same messages, bit for bit, alone or with others; so a recording replays
through the nodes without tolerances.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeAlias

import msgspec

from ltv_mpc.messages import Message


class Grid(msgspec.Struct, frozen=True):
    """Steps at t_ns = k x period exactly; none is skipped."""

    period_ns: int


class Cycle(msgspec.Struct, frozen=True):
    """A step starts at its period, or when the last one ends, if that is later; t_ns is the clock's reading."""

    period_ns: int


class OnMessage(msgspec.Struct, frozen=True):
    """A step for each message of these types, in order of arrival; t_ns is the message's validity time."""

    types: tuple[type[Message], ...]


Schedule: TypeAlias = Grid | Cycle | OnMessage


class ReceivedMessage(msgspec.Struct, frozen=True, eq=False, gc=False):
    """One entry of an inbox: a signal that passed validation, its source's epoch and sequence, and its arrival."""

    message: Message
    epoch: int
    sequence: int
    received_t_ns: int


Inbox: TypeAlias = Sequence[ReceivedMessage]

Due: TypeAlias = tuple[int, Inbox]
"""What a step is given: its time and its inbox."""


class Node(Protocol):
    """A component. ``reads`` are the types its inbox may hold, ``writes`` those its steps may return."""

    @property
    def name(self) -> str: ...
    @property
    def schedule(self) -> Schedule: ...
    @property
    def reads(self) -> tuple[type[Message], ...]: ...
    @property
    def writes(self) -> tuple[type[Message], ...]: ...

    def steps(self, due: Sequence[Due]) -> list[list[Message]]:
        """Do these steps in turn. Each consumes its inbox in its order, and returns what to publish, in order.

        Steps given together return what they return one at a time, bit for bit, and leave the node in the same state.
        """
        ...


Stopwatch: TypeAlias = Callable[[str], None]
"""Called with a stage's name when that stage ends. The runner measures; lock step and replay pass ``no_stopwatch``."""


def no_stopwatch(stage: str) -> None:
    """Measure nothing."""


Progress: TypeAlias = Callable[[], None]
"""Called now and then within a step that may take long, so that whoever watches does not take it for a hang."""


def no_progress() -> None:
    """Tell nobody."""
