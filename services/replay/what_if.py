"""What a node would have answered to the recorded inputs with other settings.

The inputs stay as they were recorded: each plan is another, but the estimates that follow are still those of the
vehicle that moved by the recorded ones. Where it would have been, only a run tells.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np

from ltv_mpc.control.node import ControllerNode
from ltv_mpc.frames import wrap_angle
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.messages import Array, Estimate, Message, Plan
from services.bus import wire
from services.recording.reader import StoredMessage
from services.replay.epoch import Record
from services.replay.frames import Header
from services.replay.verdict import Deviation, Gap, Shares

MAX_WAITING = 1000
"""Signals of one side that wait for the other's of the same time."""


class _Kind(NamedTuple):
    """How two signals of one node are compared."""

    signal: type[Message]
    columns: tuple[tuple[str, str], ...]  # what is compared, and its unit
    time: Callable[[Any], int]  # by which two belong together
    deviations: Callable[[Any, Any], Array]  # recorded, replayed -> (K, columns)
    origin: Callable[[Any], str] = lambda _: ""


def _thrusts(recorded: Plan, replayed: Plan) -> Array:
    """At the recorded plan's knots, as far as the replayed one reaches; (K, 3)."""
    t, knots = recorded.t_ns - recorded.t_ns[0], replayed.t_ns - recorded.t_ns[0]
    both = (t >= knots[0]) & (t <= knots[-1])
    thrust = np.column_stack([np.interp(t[both], knots, column) for column in replayed.thrust_N.T])
    deviations: Array = thrust - recorded.thrust_N[both]
    return deviations


def _motion(recorded: Estimate, replayed: Estimate) -> Array:
    """(1, 6) in the order of the columns; a depth that either leaves out counts as 0."""
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


_KINDS: Mapping[str, _Kind] = {
    ControllerNode.name: _Kind(
        Plan,
        (("port thrust", "N"), ("starboard thrust", "N"), ("vertical thrust", "N")),
        lambda plan: plan.cycle_t_ns,
        _thrusts,
        lambda plan: plan.origin.value,
    ),
    Estimator.name: _Kind(
        Estimate,
        (
            ("north", "m"),
            ("east", "m"),
            ("depth", "m"),
            ("velocity north", "m/s"),
            ("velocity east", "m/s"),
            ("heading", "rad"),
        ),
        lambda estimate: estimate.t_ns,
        _motion,
    ),
}


class WhatIf:
    """Over all epochs of one node."""

    def __init__(self, node: str) -> None:
        self.pairs = 0
        self.steps = 0
        self.recorded: Counter[str] = Counter()  # by origin
        self.replayed: Counter[str] = Counter()
        self._kind = kind = _KINDS[node]
        self._waiting: dict[bool, dict[tuple[int, int], Message]] = {False: {}, True: {}}  # by "replayed"
        self._squares, self._max_abs, self._final = (np.zeros(len(kind.columns)) for _ in range(3))
        self._rows = 0

    @property
    def kind(self) -> type[Message]:
        """Which of the node's outputs are compared."""
        return self._kind.signal

    @property
    def deviations(self) -> tuple[Deviation, ...]:
        """One for each column; none where there is no pair."""
        if not self._rows:
            return ()
        values = np.column_stack([np.sqrt(self._squares / self._rows), self._max_abs, self._final]).tolist()
        return tuple(
            Deviation(of=of, unit=unit, rms=rms, max_abs=max_abs, final=final)
            for (of, unit), (rms, max_abs, final) in zip(self._kind.columns, values, strict=True)
        )

    @property
    def shares(self) -> tuple[Shares, ...]:
        """By origin; none where a signal has none."""
        total, again = self.recorded.total(), self.replayed.total()
        return tuple(
            Shares(origin=name, recorded=self.recorded[name] / total, replayed=self.replayed[name] / again)
            for name in sorted(self.recorded | self.replayed)
            if name and total and again
        )

    def epoch_outcome(self, epoch: int) -> WhatIfEpoch:
        """What takes the outputs of one epoch."""
        return WhatIfEpoch(self, epoch)

    def add(self, epoch: int, signal: Message, *, replayed: bool) -> None:
        """One of either side, in any order; of a time that has been, or of another kind, it is left out."""
        kind = self._kind
        if not isinstance(signal, kind.signal):
            return
        (self.replayed if replayed else self.recorded)[kind.origin(signal)] += 1
        name = epoch, kind.time(signal)
        other = self._waiting[not replayed].pop(name, None)
        if other is not None:
            self._pair(kind.deviations(other, signal) if replayed else kind.deviations(signal, other))
            return
        mine = self._waiting[replayed]
        mine[name] = signal
        if len(mine) > MAX_WAITING:
            del mine[next(iter(mine))]

    def _pair(self, rows: Array) -> None:
        if not len(rows):
            return
        self.pairs += 1
        self._rows += len(rows)
        self._squares += (rows**2).sum(axis=0)
        self._max_abs = np.maximum(self._max_abs, np.abs(rows).max(axis=0))
        self._final = rows[0]


class WhatIfEpoch:
    """The outcome of one epoch, on its way into the whole."""

    def __init__(self, whole: WhatIf, epoch: int) -> None:
        self._whole = whole
        self._epoch = epoch

    @property
    def behind(self) -> bool:
        """Not asked: what has no counterpart is left out."""
        return False

    def add_replayed(self, record: Record, signals: Sequence[Message]) -> None:  # noqa: ARG002
        """A step made these."""
        self._whole.steps += 1
        for signal in signals:
            self._whole.add(self._epoch, signal, replayed=True)

    def step_failed(self, record: Record, error: Exception) -> None:
        """Other settings must not break a node."""
        raise RuntimeError(f"step {record.step} at {record.t_ns / 1e9:.3f} s") from error

    def add_recorded(self, stored: StoredMessage, header: Header) -> None:  # noqa: ARG002
        """The file holds this output of the epoch."""
        if stored.kind is not self._whole.kind:
            return
        with contextlib.suppress(wire.WireError):  # rubbish on its key
            signal = wire.from_validated_map(stored.kind, msgspec.json.decode(stored.data))
            self._whole.add(self._epoch, signal, replayed=False)

    def stop(self) -> None:
        """No step will make anything any more."""

    def close(self, gap: Gap | None) -> None:
        """Nothing more comes."""
