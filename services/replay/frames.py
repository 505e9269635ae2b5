"""The messages of a recording that a node may still ask for, found as its step records name them.

A record names a message by its key, its source's epoch, its sequence and the CRC-32 of the frame. The file may hold a
frame twice, or a damaged copy under the same number, where the recorder listened on both sides of a bad link: the CRC
tells which one the node was given.
"""

from __future__ import annotations

import base64

import msgspec

from ltv_mpc.messages import InboxEntry, InjectorFrame
from ltv_mpc.node import ReceivedMessage
from services.bus import wire
from services.bus.topics import BY_TYPE, topic_at
from services.recording.reader import StoredMessage


class Header(wire.Header, frozen=True, kw_only=True, forbid_unknown_fields=False):
    """Of any message in a file; its other fields are skipped."""


HANDED = BY_TYPE[InjectorFrame].key
"""On which a recording has the frames that travelled between an injector and the node under test alone."""


class _Handed(msgspec.Struct, frozen=True):
    """Of such a message, what a replay reads."""

    key: str
    payload_base64: str


_handed = msgspec.json.Decoder(_Handed).decode


def unwrap(stored: StoredMessage) -> StoredMessage | None:
    """Return the frame inside an ``InjectorFrame`` as if it were recorded on its own key; None if it is unreadable."""
    try:
        handed = _handed(stored.data)
        payload = base64.b64decode(handed.payload_base64)
        data = msgspec.json.encode(wire.unpack(payload))
    except (ValueError, TypeError, RecursionError):  # a damaged frame: the node's door could not read it either
        return None
    topic = topic_at(handed.key)
    return StoredMessage(handed.key, topic.message_type if topic else None, stored.t_ns, wire.crc(payload), data)


class Frames:
    """Filled in the order of the file. ``at`` counts the messages of the file: by it what is old is forgotten."""

    def __init__(self) -> None:
        self._of_source: dict[tuple[str, int], dict[int, list[tuple[int, StoredMessage]]]] = {}

    def add(self, stored: StoredMessage, header: Header, at: int) -> None:
        """A message of the file."""
        source = self._of_source.setdefault((stored.key, header.epoch), {})
        source.setdefault(header.sequence, []).append((at, stored))

    def find(self, entry: InboxEntry) -> StoredMessage | None:
        """The very frame that the node was given; None where it is not here."""
        copies = self._of_source.get((entry.key, entry.epoch), {}).get(entry.sequence, ())
        return next((stored for _, stored in copies if stored.crc == entry.crc), None)

    def discard_through(self, entry: InboxEntry) -> None:
        """Up to this one no message of its source is asked for again: a door lets in no sequence that does not grow."""
        source = self._of_source[entry.key, entry.epoch]
        for sequence in [sequence for sequence in source if sequence <= entry.sequence]:
            del source[sequence]

    def discard_before(self, before: int) -> None:
        """What the file held before message ``before`` of it."""
        for source in self._of_source.values():
            for sequence in [sequence for sequence, copies in source.items() if copies[-1][0] < before]:
                del source[sequence]
        self._of_source = {name: source for name, source in self._of_source.items() if source}

    def __len__(self) -> int:
        return sum(map(len, self._of_source.values()))


def arrival(stored: StoredMessage, entry: InboxEntry) -> ReceivedMessage:
    """The entry as the node was given it. Raises ``WireError`` where this version knows no such message."""
    if stored.kind is None:
        raise wire.WireError(f"{stored.key}: no topic has this key")
    signal = wire.from_validated_map(stored.kind, msgspec.json.decode(stored.data))
    return ReceivedMessage(signal, entry.epoch, entry.sequence, entry.received_t_ns)
