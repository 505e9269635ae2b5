"""One start of a node, replayed: a new node is fed the inbox of each of its step records, in their order."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import msgspec

from ltv_mpc.messages import InboxEntry, Message
from ltv_mpc.node import Node
from services.bus.wire import WireError
from services.recording.reader import StoredMessage
from services.replay.frames import Frames, Header, arrival
from services.replay.verdict import Gap

REACH = 100_000
"""How many messages may lie in the file between a step's record and a message of its inbox: what was written by several
processes stands there in the order in which the recorder heard it, and a mailbox holds 50,000."""


class Record(msgspec.Struct, frozen=True):
    """A step record, as far as a replay reads it."""

    epoch: int
    step: int
    t_ns: int
    inbox: tuple[InboxEntry, ...]


class Outcome(Protocol):
    """What becomes of the replayed outputs of an epoch."""

    @property
    def behind(self) -> bool:
        """Whether the file holds outputs of later steps than were replayed."""
        ...

    def add_replayed(self, record: Record, signals: Sequence[Message]) -> None:
        """A step made these."""
        ...

    def step_failed(self, record: Record, error: Exception) -> None:
        """A step that has a record, and so was survived, ended like this."""
        ...

    def add_recorded(self, stored: StoredMessage, header: Header) -> None:
        """The file holds this output of the epoch."""
        ...

    def stop(self) -> None:
        """After a gap: no step will make anything any more."""
        ...

    def close(self, gap: Gap | None) -> None:
        """Nothing more comes."""
        ...


class Epoch:
    """From its first record to its last. After a gap nothing is stepped any more: the node's state is not known."""

    def __init__(self, number: int, make: Callable[[], Node], frames: Frames, outcome: Outcome) -> None:
        self.number = number
        self.outcome = outcome
        self.last_at = 0  # place in the file of its newest record
        self.steps_run = 0  # as its records and its status say
        self.gap: Gap | None = None
        self._make = make
        self._node: Node | None = None
        self._frames = frames
        self._records: dict[int, tuple[int, Record]] = {}  # that wait for their turn, with their places in the file
        self._next = 0

    @property
    def waits(self) -> bool:
        """Whether something is still to come for it."""
        return bool(self._records)

    def take(self, record: Record, at: int) -> None:
        """A record of the file. One that was doubled on its way counts once."""
        self.last_at = at
        self.steps_run = max(self.steps_run, record.step + 1)
        if self.gap is None and record.step >= self._next:
            self._records.setdefault(record.step, (at, record))
            self.advance(at)

    def advance(self, at: int | None) -> None:
        """Do every step whose turn it is. ``at``: how far the file is read; None: to its end."""
        while self._records and self.gap is None:
            since, record = self._records.get(self._next, (None, None))
            if record is None or since is None:
                lacks = f"the record of step {self._next}"
                since, record = next(iter(self._records.values()))
            else:
                inbox = [self._frames.find(entry) for entry in record.inbox]
                if None not in inbox:
                    self._step(record, inbox)  # type: ignore[arg-type]
                    continue
                lacks = _name(record.inbox[inbox.index(None)])
            if at is not None and at - since <= REACH:
                return
            self._stop(f"{lacks} is not in the file", record.t_ns)

    def close(self) -> None:
        """The file has been read, or a newer epoch has taken over long ago."""
        self.advance(None)
        if self.gap is None and self.outcome.behind:  # killed before its status told of them
            self.steps_run = max(self.steps_run, self._next + 1)
        if self.gap is not None:
            self.gap = msgspec.structs.replace(self.gap, steps=self.steps_run - self.gap.first_step)
        elif self._next < self.steps_run:
            self._stop("the records of its last steps are not in the file", None)
        self.outcome.close(self.gap)
        self._node = None

    def _step(self, record: Record, inbox: Sequence[StoredMessage]) -> None:
        del self._records[record.step]
        try:
            arrivals = list(map(arrival, inbox, record.inbox))
        except WireError as error:
            self._stop(f"this version does not know the message: {error}", record.t_ns)
            return
        for entry in record.inbox:
            self._frames.discard_through(entry)
        if self._node is None:
            self._node = self._make()
        self._next += 1
        try:
            (signals,) = self._node.steps([(record.t_ns, arrivals)])
        except Exception as error:
            self.outcome.step_failed(record, error)
            self._stop(f"the replayed step {record.step} raised {type(error).__name__}", record.t_ns)
            return
        self.outcome.add_replayed(record, signals)

    def _stop(self, why: str, t_ns: int | None) -> None:
        steps = self.steps_run - self._next
        self.gap = Gap(epoch=self.number, first_step=self._next, steps=steps, t_ns=t_ns, why=why)
        self._records.clear()
        self._node = None
        self.outcome.stop()


def _name(entry: InboxEntry) -> str:
    return f"{entry.key} {entry.sequence} (epoch {entry.epoch:012x}, crc {entry.crc:08x})"
