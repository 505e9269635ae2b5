"""Replay of nodes in one pass over a recording: each message goes to the nodes that it concerns.

These are the nodes that read it, wrote it, or whose step it records.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from functools import partial
from itertools import chain

from ltv_mpc.messages import NodeStatus, StepRecord
from ltv_mpc.node import Node
from services.bus.topics import STATES, key_of, table_key
from services.bus.wire import Header, WireError
from services.recording.reader import Recording, StoredMessage
from services.replay.comparison import Comparison
from services.replay.epoch import REACH, Epoch, Frames
from services.replay.what_if import WhatIf

SWEEP = 10_000
"""Messages between two removals of those that are too old to be needed."""


class NodeReplay:
    """Replay of one node: its epochs by number, in the order of their start."""

    def __init__(
        self, name: str, make: Callable[[int | None], Node], outcome: Callable[[int], Comparison | WhatIf]
    ) -> None:
        """``make`` builds the node of an epoch, None: of any; ``outcome`` builds the consumer of its outputs."""
        node = make(None)
        self.name = name
        self.epochs: dict[int, Epoch] = {}
        self.record_key, self.status_key = key_of(StepRecord, name), key_of(NodeStatus, name)
        restored = (STATES[name],) if name in STATES else ()  # the state that a new process begins from
        self.reads = frozenset(key_of(kind, name) for kind in (*node.reads, *restored))
        self.writes = frozenset(key_of(kind, name) for kind in node.writes)
        self._make = make
        self._outcome = outcome
        self._frames = Frames()
        self._open: list[Epoch] = []

    @property
    def keys(self) -> frozenset[str]:
        """Keys that the replay needs."""
        return self.reads | self.writes | {self.record_key, self.status_key}

    def take(self, stored: StoredMessage, header: Header, at: int) -> None:
        """Take a message of the file; ``at`` is its position. An invalid one is skipped: no node has acted on it."""
        if stored.key in (self.record_key, self.status_key):
            with contextlib.suppress(WireError):
                match stored.message():
                    case StepRecord() as record:
                        self._epoch(header.epoch).take(record, at)
                    case NodeStatus(steps=steps) if steps:
                        epoch = self._epoch(header.epoch)
                        epoch.steps_run = max(epoch.steps_run, steps)
            return
        if table_key(stored.key) in self.reads:
            self._frames.add(stored, header, at)
            for epoch in self._open:
                if epoch.waits:
                    epoch.advance(at)
        if stored.key in self.writes and header.epoch in self.epochs:
            self.epochs[header.epoch].outcome.add_recorded(stored, header)

    def sweep(self, at: int) -> None:
        """Discard messages that are no longer needed, and close epochs that a newer one has followed."""
        self._frames.discard_before(at - REACH)
        for epoch in self._open[:-1]:
            if epoch.last_at < at - REACH:
                epoch.close()
                self._open.remove(epoch)

    def close(self) -> None:
        """Close all epochs at the end of the file."""
        for epoch in self._open:
            epoch.close()
        self._open.clear()

    def _epoch(self, number: int) -> Epoch:
        epoch = self.epochs.get(number)
        if epoch is None:
            made = Epoch(number, partial(self._make, number), self._frames, self._outcome(number))
            epoch = self.epochs[number] = made
            self._open.append(epoch)
        return epoch


def feed(
    recordings: Sequence[Recording],
    nodes: Sequence[NodeReplay],
    *,
    progress: Callable[[int], None] = lambda _: None,
) -> None:
    """Read the recordings, a run's segments in their order, once. ``progress`` receives the vehicle time."""
    readers: dict[str, list[NodeReplay]] = {}
    for node in nodes:
        for key in node.keys:
            readers.setdefault(key, []).append(node)
    t_ns = None

    def wanted(key: str) -> bool:
        return table_key(key) in readers  # also of the sources that publish beside those of the table

    stream = chain.from_iterable(recording.stored(wanted) for recording in recordings)
    for at, stored in enumerate(stream, 1):
        if t_ns is None:
            progress(stored.t_ns)
        t_ns = stored.t_ns
        with contextlib.suppress(WireError):
            header = stored.header()
            for node in readers.get(table_key(stored.key), ()):
                node.take(stored, header, at)
        if at % SWEEP == 0:
            progress(t_ns)
            for node in nodes:
                node.sweep(at)
    for node in nodes:
        node.close()
    if t_ns is not None:
        progress(t_ns)
