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

    def take(self, received_until_ns: int | None = None) -> tuple[list[ReceivedMessage], tuple[InboxEntry, ...]]:
        """Return and remove the messages, with their entries for the step's record.

        ``received_until_ns``: the first message that arrived later stays, and all after it; None: none stays.
        """
        taken, self._pairs = self._pairs, []
        if received_until_ns is not None:
            later = (i for i, (arrival, _) in enumerate(taken) if arrival.received_t_ns > received_until_ns)
            first_later = next(later, len(taken))
            taken, self._pairs = taken[:first_later], taken[first_later:]
        return [arrival for arrival, _ in taken], tuple([entry for _, entry in taken])
