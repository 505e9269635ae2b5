"""What a node is: a pure step. It never asks what time it is, draws no unseeded number, and keeps no thread.

Three callers exist: ``sim/lockstep.py`` (one process, simulated clock), ``sim/stretches.py`` (the same, faster, for
whoever only listens) and ``services/process/runner.py`` (Zenoh, wall clock). Given the same state and the same
(t_ns, inbox) a step returns the same signals, bit for bit; so a recording replays through the nodes without tolerances.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Protocol, TypeAlias, runtime_checkable

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


class Arrival(msgspec.Struct, frozen=True, eq=False, gc=False):
    """One entry of an inbox: a signal that passed validation, its source's epoch and sequence, and its arrival."""

    signal: Message
    epoch: int
    sequence: int
    received_t_ns: int


Inbox: TypeAlias = Sequence[Arrival]


class Node(Protocol):
    """A component. ``reads`` are the types its inbox may hold, ``writes`` those its step may return."""

    @property
    def name(self) -> str: ...
    @property
    def schedule(self) -> Schedule: ...
    @property
    def reads(self) -> tuple[type[Message], ...]: ...
    @property
    def writes(self) -> tuple[type[Message], ...]: ...

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:
        """One step: consumes the inbox in its order, returns what is to be published, in order."""
        ...


Due: TypeAlias = tuple[int, Inbox]
"""What a step is given: its time and its inbox."""


@runtime_checkable
class InBulk(Protocol):
    """A node that can do many steps at once, faster."""

    def steps(self, due: Sequence[Due]) -> list[list[Message]]:
        """What ``step`` returns for each in turn, bit for bit; and it leaves the node as they do."""
        ...


def one_by_one(node: Node, due: Sequence[Due]) -> list[list[Message]]:
    """What ``steps`` are made of."""
    return [node.step(t_ns, inbox) for t_ns, inbox in due]


def steps_of(node: Node) -> Callable[[Sequence[Due]], list[list[Message]]]:
    """The node's own ``steps``, or its ``step`` for each in turn."""
    return node.steps if isinstance(node, InBulk) else partial(one_by_one, node)


Stopwatch: TypeAlias = Callable[[str], None]
"""Called with a stage's name when that stage ends. The runner measures; lock step and replay pass ``no_stopwatch``."""


def no_stopwatch(stage: str) -> None:
    """Measure nothing."""


Progress: TypeAlias = Callable[[], None]
"""Called now and then within a step that may take long, so that whoever watches does not take it for a hang."""


def no_progress() -> None:
    """Tell nobody."""
