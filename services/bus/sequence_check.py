"""Check of epoch and sequence number: each header is compared with the last one accepted on its key.

- The newest epoch of a key counts. A restarted source replaces its former epoch, whose frames are rejected from then
  on.
- Within an epoch the sequence number must increase. Numbers that it skips are counted as dropped.
- One frame alone changes neither by much. Its header may be the damaged part, and then every correct frame after it
  would seem old. A sequence number far ahead, or another epoch that does not start near 0, is accepted with the second
  frame that agrees with it.
"""

from __future__ import annotations

from typing import Any

from services.bus.wire import Header, WireError

MAX_SKIPPED = 20
"""Largest number of sequence numbers that one frame may skip. A longer gap costs one frame more; a damaged sequence
number below this limit costs that many frames."""

MAX_APART = 10_000
"""Largest difference of the sequence numbers of two frames that confirm each other."""

MAX_FIRST = 10
"""Largest sequence number at which another epoch is accepted at once, as that of a source that has just started."""

MAX_SOURCES = 1000
"""Largest number of keys, and of former epochs of one key, that are remembered; beyond it the oldest is forgotten."""


class _Source:
    """Last accepted header of a key, its former epochs, and an unconfirmed header."""

    __slots__ = ("epoch", "former", "sequence", "unconfirmed")

    def __init__(self, epoch: int, sequence: int) -> None:
        self.epoch = epoch
        self.sequence = sequence
        self.former: dict[int, None] = {}
        self.unconfirmed: Header | None = None  # too far off to be accepted alone


class SequenceCheck:
    """Check of the headers of any number of keys."""

    def __init__(self) -> None:
        self.dropped = 0  # messages that were skipped, on all keys
        self._sources: dict[str, _Source] = {}

    def check(self, key: str, header: Header) -> None:
        """Check epoch and sequence number against the last header accepted on ``key``.

        Raises ``WireError`` if they are stale, duplicated or implausibly far ahead.
        """
        source = self._sources.pop(key, None)
        if source is None:
            self._sources[key] = _Source(header.epoch, header.sequence)
            _forget_oldest(self._sources)
            return
        self._sources[key] = source  # now the last one to be forgotten
        restarted = header.epoch != source.epoch
        skipped = header.sequence - (-1 if restarted else source.sequence) - 1
        if skipped < 0:
            raise WireError(f"out of order: sequence {header.sequence} after {source.sequence}")
        if header.epoch in source.former:
            raise WireError("former epoch: its source has restarted since")
        if skipped > (MAX_FIRST if restarted else MAX_SKIPPED):
            first, source.unconfirmed = source.unconfirmed, header
            if first is None or first.epoch != header.epoch or not 0 < header.sequence - first.sequence <= MAX_APART:
                raise WireError(
                    f"implausibly far ahead: sequence {header.sequence} of epoch {header.epoch}; accepted if repeated"
                )
            skipped -= 1  # the first of the two frames was rejected, and is counted there
        if restarted:
            source.former[source.epoch] = None
            _forget_oldest(source.former)
            source.epoch = header.epoch
        else:
            self.dropped += skipped
        source.sequence, source.unconfirmed = header.sequence, None


def _forget_oldest(entries: dict[Any, Any]) -> None:
    if len(entries) > MAX_SOURCES:
        del entries[next(iter(entries))]
