"""Instruments that fail as PX4's failure injection has it: off, stuck, garbage, wrong, slow, delayed, intermittent.

A failing instrument is a node around the sensors' node: what it does not say is not numbered, what it says wrong is
numbered and stamped like anything else. The node inside, and all that reads it, know nothing.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ltv_mpc.messages import Message
from ltv_mpc.node import Due, Node, Schedule
from sim.faults.interval import Interval
from sim.faults.readings import Reading, changed, restamped


class Failure(enum.StrEnum):
    """PX4's seven."""

    OFF = "off"  # says nothing
    STUCK = "stuck"  # what it said last, with the stamps of now
    GARBAGE = "garbage"  # anything
    WRONG = "wrong"  # biased
    SLOW = "slow"  # one message of several
    DELAYED = "delayed"  # arrives late, stamped right
    INTERMITTENT = "intermittent"  # comes and goes


class SensorFault(NamedTuple):
    """One failure of one instrument. ``size`` is, by failure:

    garbage, wrong: share of the range or bias in ``READINGS``; slow: messages of which one is said; delayed: seconds;
    intermittent: mean seconds of a silence, and of what lies between two. Off and stuck have none.
    """

    kind: type[Message]
    failure: Failure
    interval: Interval
    size: float
    seed: int


class FaultySensors:
    """The sensors' node, with instruments that break."""

    def __init__(self, sensors: Node, broken: Sequence[SensorFault]) -> None:
        self._sensors = sensors
        self._failures = [_Failing(one) for one in broken]

    @property
    def name(self) -> str:
        """As the node inside: the rest see no difference."""
        return self._sensors.name

    @property
    def schedule(self) -> Schedule:
        """As the node inside."""
        return self._sensors.schedule

    @property
    def reads(self) -> tuple[type[Message], ...]:
        """As the node inside."""
        return self._sensors.reads

    @property
    def writes(self) -> tuple[type[Message], ...]:
        """As the node inside."""
        return self._sensors.writes

    def steps(self, due: Sequence[Due]) -> list[list[Message]]:
        """What the instruments say, and what the broken ones make of it."""
        outputs = self._sensors.steps(due)
        for failing in self._failures:
            outputs = [failing.through(t_ns, signals) for (t_ns, _), signals in zip(due, outputs, strict=True)]
        return outputs


class _Failing:
    def __init__(self, broken: SensorFault) -> None:
        self._broken = broken
        self._rng = np.random.default_rng(broken.seed)
        self._count = 0
        self._last: Message | None = None
        self._late: list[tuple[int, Message]] = []
        self._silent = True
        self._until_ns = broken.interval.start_ns

    def through(self, t_ns: int, signals: Sequence[Message]) -> list[Message]:
        """Those of its instrument changed, late, or gone; all others as they were."""
        here = [signal for due_ns, signal in self._late if due_ns <= t_ns]
        self._late = [(due_ns, signal) for due_ns, signal in self._late if due_ns > t_ns]
        for signal in signals:
            if type(signal) is not self._broken.kind:
                here.append(signal)
            elif self._broken.interval.contains(t_ns):
                here += self._said(t_ns, signal)
            else:
                self._last = signal
                here.append(signal)
        return here

    def _said(self, t_ns: int, signal: Message) -> list[Message]:
        size, rng = self._broken.size, self._rng
        self._count += 1
        match self._broken.failure:
            case Failure.OFF:
                return []
            case Failure.STUCK:
                self._last = self._last or signal
                return [restamped(self._last, signal)]
            case Failure.GARBAGE:
                return [changed(signal, lambda r, x: size * r.raves * rng.uniform(-1.0, 1.0, x.shape))]
            case Failure.WRONG:
                return [changed(signal, self._biased)]
            case Failure.SLOW:
                return [signal] if self._count % max(2, round(size)) == 0 else []
            case Failure.DELAYED:
                self._late.append((t_ns + round(size * 1e9), signal))
                return []
            case Failure.INTERMITTENT:
                while t_ns >= self._until_ns:
                    self._silent = not self._silent if self._until_ns > self._broken.interval.start_ns else True
                    self._until_ns += 1 + round(rng.exponential(size) * 1e9)
                return [] if self._silent else [signal]

    def _biased(self, reading: Reading, value: Any) -> Any:
        return value + self._broken.size * reading.bias
