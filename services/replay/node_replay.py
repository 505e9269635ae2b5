"""Replay of nodes in one pass over a recording: a new node of each start steps on the inboxes of its recorded steps.

Each message goes to the nodes that read it, wrote it, or whose step it records. A record names a message by its key,
its source's epoch, its sequence number and the CRC-32 of the frame. If the recorder listened on both sides of a bad
link, the file may have a frame twice, or a damaged copy under the same number: the CRC identifies the one that the node
received.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from functools import partial
from typing import TypeAlias

import msgspec

from ltv_mpc.bounded import remember
from ltv_mpc.messages import InboxEntry, NodeStatus, RecordedStep, StepRecord
from ltv_mpc.node import Node, ReceivedMessage
from services.bus.time_shift import shifted
from services.bus.topics import STATES, key_of, source_of, table_key
from services.bus.wire import Header, WireError
from services.recording.reader import Recording, StoredMessage
from services.replay.comparison import Comparison
from services.replay.nodes import NoSettingsError
from services.replay.verdict import Gap
from services.replay.what_if import WhatIf

REACH = 100_000
"""Largest distance in the file, in messages, between a step's record and a message of its inbox. The file has the
messages of several processes in the order in which the recorder received them, and a mailbox holds 50,000."""

MAX_FRAMES = 50_000
"""Frames of a node that wait for the record of their step; beyond that number the oldest is forgotten."""

FIRST_STEP = "the record of its first step, which it published before the recorder was there,"


Frame: TypeAlias = tuple[str, int, int, int]
"""Identity of a frame: its key, epoch, sequence number and CRC."""

Frames: TypeAlias = dict[Frame, StoredMessage]
"""Frames in the order of the file, until they are used or too old."""


def frame_of(entry: InboxEntry) -> Frame:
    """Return the identity of the frame that a node received."""
    return entry.key, entry.epoch, entry.sequence, entry.crc


def received_message(stored: StoredMessage, entry: InboxEntry) -> ReceivedMessage:
    """Return the entry as the node received it. Raises ``WireError`` if this version has no such message."""
    return ReceivedMessage(
        shifted(stored.message(), entry.shift_ns),
        entry.epoch,
        entry.sequence,
        entry.received_t_ns,
        source_of(entry.key),
    )


class Epoch:
    """Epoch of a node, from its first record to its last. No step is replayed after a gap: the state is unknown."""

    def __init__(self, number: int, make: Callable[[], Node], frames: Frames, outcome: Comparison | WhatIf) -> None:
        self.number = number
        self.outcome = outcome
        self.steps_run = 0  # by its records and its status
        self.gap: Gap | None = None
        self._make = make
        self._node: Node | None = None
        self._frames = frames
        self._steps: dict[int, tuple[int, RecordedStep]] = {}  # in waiting, with the position of the record
        self._next = 0

    def take(self, record: StepRecord, at: int) -> None:
        """Add a record of the file. A duplicate counts once."""
        self.steps_run = max(self.steps_run, record.step + len(record.steps))
        if self.gap is None:
            for number, step in enumerate(record.steps, record.step):
                if number >= self._next:
                    self._steps.setdefault(number, (at, step))
            self.advance(at)

    def advance(self, at: int | None) -> None:
        """Replay every step whose inputs are there. ``at``: position in the file; None: the file is read to its end."""
        while self._steps and self.gap is None:
            since, step = self._steps.get(self._next, (None, None))
            if step is None or since is None:
                missing = f"the record of step {self._next}" if self._next else FIRST_STEP
                since, step = next(iter(self._steps.values()))
            else:
                entry = next((entry for entry in step.inbox if frame_of(entry) not in self._frames), None)
                if entry is None:
                    self._step(step)
                    continue
                missing = f"{entry.key} {entry.sequence} (epoch {entry.epoch:012x}, crc {entry.crc:08x})"
            if at is not None and at - since <= REACH:
                return
            self._stop(f"{missing} is not in the file", step.t_ns)

    def close(self) -> None:
        """Finish: the file has been read."""
        self.advance(None)
        if self.gap is None and self.outcome.behind:  # killed before it published a status
            self.steps_run = max(self.steps_run, self._next + 1)
        if self.gap is None and self._next < self.steps_run:
            self._stop("the records of its last steps are not in the file", None)
        if self.gap is not None:
            self.gap = msgspec.structs.replace(self.gap, steps=self.steps_run - self.gap.first_step)
        self.outcome.close(self.gap)
        self._node = None

    def _step(self, step: RecordedStep) -> None:
        number = self._next
        del self._steps[number]
        try:
            arrivals = [received_message(self._frames[frame_of(entry)], entry) for entry in step.inbox]
        except WireError as error:
            self._stop(f"this version does not know the message: {error}", step.t_ns)
            return
        for entry in step.inbox:
            self._frames.pop(frame_of(entry), None)  # a node accepts a frame once
        if self._node is None:
            try:
                self._node = self._make()
            except NoSettingsError as error:
                self._stop(str(error), step.t_ns)
                return
        self._next += 1
        try:
            messages = self._node.step(step.t_ns, arrivals)
        except Exception as error:
            self.outcome.step_failed(number, step, error)
            self._stop(f"the replayed step {number} raised {type(error).__name__}", step.t_ns)
            return
        self.outcome.add_replayed(number, step, [shifted(message, step.shift_ns) for message in messages])

    def _stop(self, why: str, t_ns: int | None) -> None:
        self.gap = Gap(epoch=self.number, first_step=self._next, steps=0, t_ns=t_ns, why=why)  # counted at the end
        self._steps.clear()
        self._node = None
        self.outcome.stop()


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
        self._frames: Frames = {}

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
            remember(self._frames, (stored.key, header.epoch, header.sequence, stored.crc), stored, MAX_FRAMES)
            for epoch in self.epochs.values():
                epoch.advance(at)
        if stored.key in self.writes and header.epoch in self.epochs:
            self.epochs[header.epoch].outcome.add_recorded(stored, header)

    def close(self) -> None:
        """Close all epochs at the end of the file."""
        for epoch in self.epochs.values():
            epoch.close()

    def _epoch(self, number: int) -> Epoch:
        if number not in self.epochs:
            self.epochs[number] = Epoch(number, partial(self._make, number), self._frames, self._outcome(number))
        return self.epochs[number]


def feed(recording: Recording, nodes: Sequence[NodeReplay], is_done: Callable[[], bool] = lambda: False) -> float:
    """Read the recording once, until ``is_done``. Return the time from its first to its last message (s of vehicle)."""
    readers: dict[str, list[NodeReplay]] = {}
    for node in nodes:
        for key in node.keys:
            readers.setdefault(key, []).append(node)

    def wanted(key: str) -> bool:
        return table_key(key) in readers  # also of the sources that publish beside those of the table

    first_ns = last_ns = 0
    for at, stored in enumerate(recording.stored(wanted), 1):
        first_ns = stored.t_ns if at == 1 else min(first_ns, stored.t_ns)
        last_ns = stored.t_ns if at == 1 else max(last_ns, stored.t_ns)
        with contextlib.suppress(WireError):
            header = stored.header()
            for node in readers.get(table_key(stored.key), ()):
                node.take(stored, header, at)
        if is_done():
            break
    for node in nodes:
        node.close()
    return (last_ns - first_ns) / 1e9
