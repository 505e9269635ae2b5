"""Recorded frames that a node's steps may still need, found as step records name them.

A record names a message by its key, its source's epoch, its sequence number and the CRC-32 of the frame. If the
recorder listened on both sides of a bad link, the file may have a frame twice, or a damaged copy under the same number:
the CRC identifies the one that the node received.
"""

from __future__ import annotations

from ltv_mpc.messages import InboxEntry
from ltv_mpc.node import ReceivedMessage
from services.bus import wire
from services.bus.time_shift import shifted
from services.bus.topics import source_of
from services.recording.reader import StoredMessage


class Frames:
    """Frames in the order of the file. ``at`` is the position in the file, by which old frames are discarded."""

    def __init__(self) -> None:
        self._of_source: dict[tuple[str, int], dict[int, list[tuple[int, StoredMessage]]]] = {}

    def add(self, stored: StoredMessage, header: wire.Header, at: int) -> None:
        """Add a message of the file."""
        source = self._of_source.setdefault((stored.key, header.epoch), {})
        source.setdefault(header.sequence, []).append((at, stored))

    def find(self, entry: InboxEntry) -> StoredMessage | None:
        """Return the frame that the node received; None if it is not here."""
        copies = self._of_source.get((entry.key, entry.epoch), {}).get(entry.sequence, ())
        return next((stored for _, stored in copies if stored.crc == entry.crc), None)

    def discard_through(self, entry: InboxEntry) -> None:
        """Discard the frames of the entry's source up to this one: a node accepts growing sequence numbers only."""
        source = self._of_source[entry.key, entry.epoch]
        for sequence in [sequence for sequence in source if sequence <= entry.sequence]:
            del source[sequence]

    def discard_before(self, before: int) -> None:
        """Discard the frames before position ``before``."""
        for source in self._of_source.values():
            for sequence in [sequence for sequence, copies in source.items() if copies[-1][0] < before]:
                del source[sequence]
        self._of_source = {name: source for name, source in self._of_source.items() if source}

    def __len__(self) -> int:
        return sum(map(len, self._of_source.values()))


def received_message(stored: StoredMessage, entry: InboxEntry) -> ReceivedMessage:
    """Return the entry as the node received it. Raises ``WireError`` if this version has no such message."""
    return ReceivedMessage(
        shifted(stored.message(), entry.shift_ns),
        entry.epoch,
        entry.sequence,
        entry.received_t_ns,
        source_of(entry.key),
    )
