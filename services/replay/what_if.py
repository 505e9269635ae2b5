"""Replay of a node with other settings (what-if replay), on the recorded inputs.

The inputs are the recorded ones: plans differ, but the estimates that follow are still those of the vehicle that
followed the recorded plans. Only a new run shows where the vehicle would have been.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ltv_mpc.bounded import remember
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.frames import wrap_angle
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.messages import Array, Estimate, Message, Plan, RecordedStep
from services.bus.wire import Header, WireError
from services.recording.reader import StoredMessage
from services.replay.verdict import Deviation, Gap, Shares

MAX_WAITING = 1000
"""Messages of one side that wait for the other side's message of the same time."""


class _Kind(NamedTuple):
    """Comparison of two messages of one node."""

    message_type: type[Message]
    time: str  # field with the time that identifies a pair
    units: Mapping[str, str]  # by column: a quantity
    deviations: Callable[[Any, Any], Array]  # recorded, replayed -> (K, columns)


def _thrusts(recorded: Plan, replayed: Plan) -> Array:
    """Return the thrust deviations (K, 3) at the recorded plan's knots that the replayed plan covers."""
    t, knots = recorded.t_ns - recorded.t_ns[0], replayed.t_ns - recorded.t_ns[0]
    both = (t >= knots[0]) & (t <= knots[-1])
    thrust = np.column_stack([np.interp(t[both], knots, column) for column in replayed.thrust_N.T])
    deviations: Array = thrust - recorded.thrust_N[both]
    return deviations


def _motion(recorded: Estimate, replayed: Estimate) -> Array:
    """Return the deviations (1, 6) in the order of the columns; 0 for a depth that one of them does not have."""
    was, is_ = recorded, replayed
    down = 0.0 if was.depth_m is None or is_.depth_m is None else is_.depth_m - was.depth_m
    row = (
        is_.north_m - was.north_m,
        is_.east_m - was.east_m,
        down,
        is_.velocity_north_mps - was.velocity_north_mps,
        is_.velocity_east_mps - was.velocity_east_mps,
        wrap_angle(is_.heading_rad - was.heading_rad),
    )
    return np.array([row])


_THRUSTS = {"port thrust": "N", "starboard thrust": "N", "vertical thrust": "N"}
_POSITION = {"north": "m", "east": "m", "depth": "m"}
_VELOCITY_AND_HEADING = {"velocity north": "m/s", "velocity east": "m/s", "heading": "rad"}
_KINDS: Mapping[str, _Kind] = {
    ControllerNode.name: _Kind(Plan, "cycle_t_ns", _THRUSTS, _thrusts),
    Estimator.name: _Kind(Estimate, "t_ns", _POSITION | _VELOCITY_AND_HEADING, _motion),
}


class WhatIf:
    """Comparison of one node's outputs with the recorded ones, over all epochs."""

    behind = False  # as ``Comparison.behind``: no step is missed here

    def __init__(self, node: str) -> None:
        self.pairs = 0
        self.steps = 0
        self.recorded: Counter[str] = Counter()  # by origin
        self.replayed: Counter[str] = Counter()
        self._kind = kind = _KINDS[node]
        self._waiting: dict[bool, dict[int, Message]] = {False: {}, True: {}}  # by "replayed"
        self._squares, self._max_abs, self._final = (np.zeros(len(kind.units)) for _ in range(3))
        self._rows = 0

    @property
    def deviations(self) -> tuple[Deviation, ...]:
        """Deviations, one for each column; none if there is no pair."""
        if not self._rows:
            return ()
        values = np.column_stack([np.sqrt(self._squares / self._rows), self._max_abs, self._final]).tolist()
        return tuple(
            Deviation(of=of, unit=unit, rms=rms, max_abs=max_abs, final=final)
            for (of, unit), (rms, max_abs, final) in zip(self._kind.units.items(), values, strict=True)
        )

    @property
    def shares(self) -> tuple[Shares, ...]:
        """Shares by origin; none if the messages have no origin."""
        total, again = self.recorded.total(), self.replayed.total()
        return tuple(
            Shares(origin=name, recorded=self.recorded[name] / total, replayed=self.replayed[name] / again)
            for name in sorted(self.recorded | self.replayed)
            if name and total and again
        )

    def add_replayed(self, number: int, step: RecordedStep, messages: Sequence[Message]) -> None:  # noqa: ARG002
        """Add the outputs of a replayed step."""
        self.steps += 1
        for message in messages:
            self._add(message, replayed=True)

    def step_failed(self, number: int, step: RecordedStep, error: Exception) -> None:
        """Raise: other settings must not break a node."""
        raise RuntimeError(f"step {number} at {step.t_ns / 1e9:.3f} s") from error

    def add_recorded(self, stored: StoredMessage, header: Header) -> None:  # noqa: ARG002
        """Add a recorded output."""
        if stored.kind is self._kind.message_type:
            with contextlib.suppress(WireError):  # an invalid message on this key
                self._add(stored.message(), replayed=False)

    def stop(self) -> None:
        """Note a gap: the recorded outputs behind it find no pair."""

    def close(self, gap: Gap | None) -> None:
        """Note the end of an epoch."""

    def _add(self, message: Message, *, replayed: bool) -> None:
        """Add a message of one side, in any order. Messages of another type, or of a paired time, are skipped."""
        kind = self._kind
        if not isinstance(message, kind.message_type):
            return
        origin = message.origin.value if isinstance(message, Plan) else ""
        (self.replayed if replayed else self.recorded)[origin] += 1
        t_ns = getattr(message, kind.time)
        other = self._waiting[not replayed].pop(t_ns, None)
        if other is not None:
            self._pair(kind.deviations(other, message) if replayed else kind.deviations(message, other))
            return
        remember(self._waiting[replayed], t_ns, message, MAX_WAITING)

    def _pair(self, rows: Array) -> None:
        if not len(rows):
            return
        self.pairs += 1
        self._rows += len(rows)
        self._squares += (rows**2).sum(axis=0)
        self._max_abs = np.maximum(self._max_abs, np.abs(rows).max(axis=0))
        self._final = rows[0]
