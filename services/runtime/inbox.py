"""What has arrived for the next step: one ordered list, and what the step's record will keep of it."""

from __future__ import annotations

from ltv_mpc.messages import InboxEntry, Message
from ltv_mpc.node import ReceivedMessage
from services.bus.topics import BY_TYPE, LATEST


class PendingInbox:
    """Fills between two steps. Of a key of which the newest counts, the newest stays, at its own place."""

    def __init__(self) -> None:
        self._pairs: list[tuple[ReceivedMessage, InboxEntry]] = []

    def add(self, signal: Message, *, key: str, epoch: int, sequence: int, crc: int, received_t_ns: int) -> None:
        """Put at the end."""
        if BY_TYPE[type(signal)].delivery is LATEST:
            self._pairs = [pair for pair in self._pairs if pair[1].key != key]
        arrival = ReceivedMessage(signal, epoch, sequence, received_t_ns)
        entry = InboxEntry(key=key, epoch=epoch, sequence=sequence, crc=crc, received_t_ns=received_t_ns)
        self._pairs.append((arrival, entry))

    def take(self) -> tuple[list[ReceivedMessage], tuple[InboxEntry, ...]]:
        """All of it, for a step and its record."""
        pairs, self._pairs = self._pairs, []
        return [arrival for arrival, _ in pairs], tuple([entry for _, entry in pairs])
