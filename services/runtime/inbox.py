"""Pending inbox: the messages for the next step, in order of arrival, with their entries for the step's record."""

from __future__ import annotations

from ltv_mpc.messages import InboxEntry, Message
from ltv_mpc.node import ReceivedMessage
from services.bus.topics import BY_TYPE, LATEST, source_of


class PendingInbox:
    """Inbox that fills between two steps. Of a key with delivery LATEST only the newest message is kept."""

    def __init__(self) -> None:
        self._pairs: list[tuple[ReceivedMessage, InboxEntry]] = []

    def add(self, signal: Message, entry: InboxEntry, *, first: bool = False) -> None:
        """Append a message, its times being vehicle time; ``first`` puts it before all others."""
        if BY_TYPE[type(signal)].delivery is LATEST:
            self._pairs = [pair for pair in self._pairs if pair[1].key != entry.key]
        arrival = ReceivedMessage(signal, entry.epoch, entry.sequence, entry.received_t_ns, source_of(entry.key))
        self._pairs.insert(0 if first else len(self._pairs), (arrival, entry))

    def take(self) -> tuple[list[ReceivedMessage], tuple[InboxEntry, ...]]:
        """Return and remove all messages, with their entries for the step's record."""
        pairs, self._pairs = self._pairs, []
        return [arrival for arrival, _ in pairs], tuple([entry for _, entry in pairs])
