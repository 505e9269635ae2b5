"""Inputs and outputs of a node in its process: inbox of the next step, step records, outbox, and its saved state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from ltv_mpc.messages import InboxEntry, Message, RecordedStep, StepRecord
from ltv_mpc.node import ReceivedMessage
from services.bus.outbox import Outbox, SentMessage
from services.bus.time_shift import shifted
from services.bus.topics import STATES, source_of
from services.bus.wire import decode
from services.runtime.clock import monotonic_us
from services.runtime.lifeline import LIFELINE

MAX_RECORDED_STEPS = 1000
"""Largest number of steps in a record: a frame has a largest size."""

STATE_TYPES = tuple(STATES.values())


class SavedState(Protocol):
    """Place in which the states that a node publishes survive its process."""

    failures: int
    """Number of states that could not be kept."""

    def restored(self, t_ns: int, now_us: int, *, own_clock: bool) -> Message | None:
        """Return the state that the node continues from, which becomes the first message of its first step.

        ``t_ns`` is the vehicle time of that step and ``now_us`` the monotonic time. ``own_clock``: vehicle time is this
        process's own monotonic time plus an offset, so both advance alike.
        """
        ...

    def keep(self, state: Message, now_us: int) -> None:
        """Keep a state that the node publishes at the monotonic time ``now_us``, before it is published."""
        ...


class NodeIO:
    """Inbox, step records and outbox of one node; all of its messages have one epoch.

    A replay needs the record of a step before the outputs of the step, so ``publish_outputs`` publishes the record of
    the steps since the last one first. The step loop also publishes it with each node status, within half a second.
    """

    def __init__(self, node: str, outbox: Outbox, saved: SavedState | None = None) -> None:
        """Begin with an empty inbox; ``saved`` keeps the node's states and may have one that it continues from.

        Without it the supervisor, which receives the states from the bus, may have given one.
        """
        self._node = node
        self._outbox = outbox
        self._saved = saved
        self._inbox: list[tuple[ReceivedMessage, InboxEntry]] = []
        self._steps: list[RecordedStep] = []  # without a record so far
        self._recorded = 0  # steps with a record
        self.shift_ns = 0
        """Published time minus vehicle time. The step loop sets it between two steps."""

    def publish(self, message: Message) -> SentMessage:
        """Publish a message of the node or of its process; a state is kept first."""
        return self._outbox.publish(self._published(message))

    def publish_outputs(self, messages: Sequence[Message]) -> list[SentMessage]:
        """Publish the record of the steps without one, then the outputs of these steps. Return the sent outputs."""
        steps, self._steps = tuple(self._steps), []
        outputs = list(map(self._published, messages))
        if not steps:
            return self._outbox.publish_all(outputs)
        record = StepRecord(node=self._node, epoch=self._outbox.epoch, step=self._recorded, steps=steps)
        self._recorded += len(steps)
        return self._outbox.publish_all([record, *outputs])[1:]

    def restore_state(self, t_ns: int, now_us: int, *, own_clock: bool) -> None:
        """Put the state that the node continues from, if there is one, at the head of its first inbox."""
        state: Message | None = None
        if self._saved is not None:
            state = self._saved.restored(t_ns, now_us, own_clock=own_clock)
        elif LIFELINE.state:
            state = decode(STATES[self._node], LIFELINE.state)[0]
        if state is not None:
            self.publish_to_self(state, t_ns)
            self._inbox.insert(0, self._inbox.pop())

    def add_to_inbox(self, message: Message, entry: InboxEntry) -> None:
        """Put a message, its times being vehicle time, into the inbox of the next step; ``entry`` is for its record."""
        arrival = ReceivedMessage(message, entry.epoch, entry.sequence, entry.received_t_ns, source_of(entry.key))
        self._inbox.append((arrival, entry))

    def publish_to_self(self, message: Message, now_ns: int) -> None:
        """Publish a message and put it directly into the node's own inbox, received at ``now_ns`` (vehicle time)."""
        sent = self.publish(message)
        entry = InboxEntry(
            key=sent.key,
            epoch=self._outbox.epoch,
            sequence=sent.sequence,
            crc=sent.crc,
            received_t_ns=now_ns,
            shift_ns=-self.shift_ns,
        )
        self.add_to_inbox(message, entry)

    def take_inbox(self, t_ns: int, cause: str) -> list[ReceivedMessage]:
        """Empty the inbox for a step, keep the step for the next record, and return the messages.

        Parameters
        ----------
        t_ns : vehicle time that the step is for (ns).
        cause : "grid", "cycle", or the key of the message that caused the step.
        """
        taken, self._inbox = self._inbox, []
        entries = tuple([entry for _, entry in taken])
        self._steps.append(RecordedStep(t_ns=t_ns, cause=cause, inbox=entries, shift_ns=self.shift_ns))
        if len(self._steps) == MAX_RECORDED_STEPS:
            self.publish_record()
        return [arrival for arrival, _ in taken]

    def publish_record(self) -> None:
        """Publish the record of the steps without one."""
        self.publish_outputs([])

    def _published(self, message: Message) -> Message:
        """Return a message with published times. A state is kept."""
        published = shifted(message, self.shift_ns)
        if self._saved is not None and isinstance(published, STATE_TYPES):
            self._saved.keep(published, monotonic_us())
        return published
