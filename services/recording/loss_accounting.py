"""Loss accounting: published and missing messages, from the sequence numbers of each key and epoch.

A duplicate does not replace a message that is missing. Memory is bounded for any number of sources: of those that have
been silent longest only the sums are kept. If such a source publishes again, it is counted from that message on.
"""

from __future__ import annotations

from services.recording.sequence_gaps import SequenceGaps

MAX_SOURCES = 10_000
"""Sources (key and epoch) that are counted separately. A run has about fifty, and ten more for each restart."""

OTHER = "others"
"""Name in place of the key of those that are not counted separately any more."""


class LossAccounting:
    """Account of all recorded messages. Sequence numbers count from 0, by key and epoch of the source."""

    def __init__(self, *, max_sources: int = MAX_SOURCES) -> None:
        self._max_sources = max_sources
        self._sources: dict[tuple[str, int], SequenceGaps] = {}  # in the order of their newest message
        self._published = self._missing = 0  # of the sources that are no longer counted separately

    def add(self, key: str, epoch: int, sequence: int) -> None:
        """Add a recorded message."""
        name = key, epoch
        source = self._sources.pop(name, None)
        if source is None:
            source = SequenceGaps(sequence if self._published else 0)
        self._sources[name] = source
        if len(self._sources) > self._max_sources:
            oldest = self._sources.pop(next(iter(self._sources)))
            self._published, self._missing = self._published + oldest.published, self._missing + oldest.missing
        source.add(sequence)

    def fill(self, key: str, epoch: int, sequence: int) -> bool:
        """Count a message that was refused as no longer missing. Return True if it was missing."""
        source = self._sources.get((key, epoch))
        return source is not None and source.fill(sequence)

    def start_at(self, key: str, epoch: int, sequence: int) -> bool:
        """Count a new source from this message on, because its earlier messages could not be received.

        Return True if the source is new.
        """
        if (key, epoch) in self._sources:
            return False
        self._sources[key, epoch] = SequenceGaps(sequence)
        return True

    def mark_lost(self, key: str, epoch: int) -> None:
        """Count a message that was added as missing after all."""
        source = self._sources.get((key, epoch))
        if source is not None:
            source.mark_lost()
        else:
            self._missing += 1

    @property
    def published(self) -> int:
        """Number of published messages, up to the last recorded one of each source."""
        return self._published + sum(source.published for source in self._sources.values())

    @property
    def missing(self) -> int:
        """Number of missing messages."""
        return sum(self.by_key().values())

    def by_key(self) -> dict[str, int]:
        """Return the number of missing messages of each key that has any."""
        missing = {OTHER: self._missing}
        for (key, _), source in self._sources.items():
            missing[key] = missing.get(key, 0) + source.missing
        return {key: gap for key, gap in missing.items() if gap}
