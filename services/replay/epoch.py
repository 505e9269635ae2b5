"""Replay of one start of a node: a new node steps on the inbox of each recorded step, in their order.

A record names a message by its key, its source's epoch, its sequence number and the CRC-32 of the frame. If the
recorder listened on both sides of a bad link, the file may have a frame twice, or a damaged copy under the same number:
the CRC identifies the one that the node received.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import takewhile

import msgspec

from ltv_mpc.messages import InboxEntry, RecordedStep, StepRecord
from ltv_mpc.node import Node, ReceivedMessage
from services.bus import wire
from services.bus.time_shift import shifted
from services.bus.topics import source_of
from services.bus.wire import WireError
from services.recording.node_settings import NoSettingsError
from services.recording.reader import StoredMessage
from services.replay.comparison import Comparison
from services.replay.verdict import Gap
from services.replay.what_if import WhatIf

REACH = 100_000
"""Largest distance in the file, in messages, between a step's record and a message of its inbox. The file has the
messages of several processes in the order in which the recorder received them, and a mailbox holds 50,000."""


FIRST_STEP = "the record of its first step, which it published before the recorder was there,"


class Frames:
    """Frames in the order of the file, until they are used or too old: each by its key, epoch, sequence and CRC."""

    def __init__(self) -> None:
        self._frames: dict[tuple[str, int, int, int], tuple[int, StoredMessage]] = {}  # with the position in the file

    def add(self, stored: StoredMessage, header: wire.Header, at: int) -> None:
        """Add the message at position ``at`` of the file."""
        self._frames.setdefault((stored.key, header.epoch, header.sequence, stored.crc), (at, stored))

    def find(self, entry: InboxEntry) -> StoredMessage | None:
        """Return the frame that the node received; None if it is not here."""
        return self._frames.get(_identity(entry), (0, None))[1]

    def discard(self, entry: InboxEntry) -> None:
        """Discard the frame, which a node accepts once."""
        self._frames.pop(_identity(entry), None)

    def discard_before(self, before: int) -> None:
        """Discard the frames before position ``before``."""
        for frame in list(takewhile(lambda frame: self._frames[frame][0] < before, self._frames)):
            del self._frames[frame]

    def __len__(self) -> int:
        return len(self._frames)


def _identity(entry: InboxEntry) -> tuple[str, int, int, int]:
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
        self.last_at = 0  # position of its newest record in the file
        self.steps_run = 0  # by its records and its status
        self.gap: Gap | None = None
        self._make = make
        self._node: Node | None = None
        self._frames = frames
        self._steps: dict[int, tuple[int, RecordedStep]] = {}  # in waiting, with the position of the record
        self._next = 0

    @property
    def waits(self) -> bool:
        """True while steps wait for their turn."""
        return bool(self._steps)

    def take(self, record: StepRecord, at: int) -> None:
        """Add a record of the file. A duplicate counts once."""
        self.last_at = at
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
                inbox = [self._frames.find(entry) for entry in step.inbox]
                if None not in inbox:
                    self._step(step, inbox)  # type: ignore[arg-type]
                    continue
                missing = _name(step.inbox[inbox.index(None)])
            if at is not None and at - since <= REACH:
                return
            self._stop(f"{missing} is not in the file", step.t_ns)

    def close(self) -> None:
        """Finish: the file has been read, or a newer epoch started long ago."""
        self.advance(None)
        if self.gap is None and self.outcome.behind:  # killed before it published a status
            self.steps_run = max(self.steps_run, self._next + 1)
        if self.gap is not None:
            self.gap = msgspec.structs.replace(self.gap, steps=self.steps_run - self.gap.first_step)
        elif self._next < self.steps_run:
            self._stop("the records of its last steps are not in the file", None)
        self.outcome.close(self.gap)
        self._node = None

    def _step(self, step: RecordedStep, inbox: Sequence[StoredMessage]) -> None:
        number = self._next
        del self._steps[number]
        try:
            arrivals = list(map(received_message, inbox, step.inbox))
        except WireError as error:
            self._stop(f"this version does not know the message: {error}", step.t_ns)
            return
        for entry in step.inbox:
            self._frames.discard(entry)
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
        steps = self.steps_run - self._next
        self.gap = Gap(epoch=self.number, first_step=self._next, steps=steps, t_ns=t_ns, why=why)
        self._steps.clear()
        self._node = None
        self.outcome.stop()


def _name(entry: InboxEntry) -> str:
    return f"{entry.key} {entry.sequence} (epoch {entry.epoch:012x}, crc {entry.crc:08x})"
