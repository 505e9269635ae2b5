"""Replay of one start of a node: a new node steps on the inbox of each recorded step, in their order."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import msgspec

from ltv_mpc.messages import InboxEntry, Message, RecordedStep, StepRecord
from ltv_mpc.node import Node
from services.bus.time_shift import shifted
from services.bus.wire import Header, WireError
from services.recording.node_settings import NoSettingsError
from services.recording.reader import StoredMessage
from services.replay.frames import Frames, received_message
from services.replay.verdict import Gap

REACH = 100_000
"""Largest distance in the file, in messages, between a step's record and a message of its inbox. The file has the
messages of several processes in the order in which the recorder received them, and a mailbox holds 50,000."""


FIRST_STEP = "the record of its first step, which it published before the recorder was there,"


class Outcome:
    """Consumer of an epoch's replayed and recorded outputs."""

    behind = False
    """True if the file has outputs of later steps than were replayed."""

    def add_replayed(self, number: int, step: RecordedStep, messages: Sequence[Message]) -> None:
        """Add the outputs of a replayed step."""
        raise NotImplementedError

    def step_failed(self, number: int, step: RecordedStep, error: Exception) -> None:
        """Add a replayed step that raised. The recorded one did not, because the node survived it."""
        raise NotImplementedError

    def add_recorded(self, stored: StoredMessage, header: Header) -> None:
        """Add a recorded output of the epoch."""
        raise NotImplementedError

    def stop(self) -> None:
        """Note a gap: no more steps are replayed."""

    def close(self, gap: Gap | None) -> None:
        """Note the end of the file."""


class Epoch:
    """Epoch of a node, from its first record to its last. No step is replayed after a gap: the state is unknown."""

    def __init__(self, number: int, make: Callable[[], Node], frames: Frames, outcome: Outcome) -> None:
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
            self._frames.discard_through(entry)
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
