"""Loss accounting: published and missing messages, from the sequence numbers of each key and epoch.

A duplicate does not replace a message that is missing. Memory is bounded for any number of sources: of those that have
been silent longest only the sums are kept. If such a source publishes again, it is counted from that message on.
"""

from __future__ import annotations

from typing import NamedTuple

from services.recording.sequence_gaps import SequenceGaps

MAX_SOURCES = 10_000
"""Sources (key and epoch) that are counted separately. A run has about fifty, and ten more for each restart."""

MAX_KEYS = 1_000
OTHER = "others"
"""Name in place of the key, if there are too many keys as well."""


class _Sum(NamedTuple):
    """Sums over the sources of one key that are no longer counted separately."""

    sources: int = 0
    published: int = 0
    missing: int = 0


class LossAccounting:
    """Account of all recorded messages. Sequence numbers count from 0, by key and epoch of the source."""

    def __init__(self, *, max_sources: int = MAX_SOURCES, max_keys: int = MAX_KEYS) -> None:
        self._max_sources, self._max_keys = max_sources, max_keys
        self._sources: dict[tuple[str, int], SequenceGaps] = {}  # in the order of their newest message
        self._sums: dict[str, _Sum] = {}
        self._has_dropped = False

    def add(self, key: str, epoch: int, sequence: int) -> bool:
        """Add a recorded message. Return False if it is a duplicate."""
        name = key, epoch
        source = self._sources.pop(name, None)
        if source is None:
            source = SequenceGaps(sequence if self._has_dropped else 0)
        self._sources[name] = source
        if len(self._sources) > self._max_sources:
            self._drop_oldest()
        return source.add(sequence)

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
            name = self._sum_of(key)
            total = self._sums.get(name, _Sum())
            self._sums[name] = total._replace(missing=total.missing + 1)

    @property
    def published(self) -> int:
        """Number of published messages, up to the last recorded one of each source."""
        separate = sum(source.published for source in self._sources.values())
        return separate + sum(total.published for total in self._sums.values())

    @property
    def missing(self) -> int:
        """Number of missing messages."""
        return sum(self.by_key().values())

    def by_key(self) -> dict[str, int]:
        """Return the number of missing messages of each key that has any."""
        missing = {name: total.missing for name, total in self._sums.items()}
        for (key, _), source in self._sources.items():
            missing[key] = missing.get(key, 0) + source.missing
        return {key: gap for key, gap in missing.items() if gap}

    def epochs(self) -> dict[str, int]:
        """Return the number of sources of each key: one for each start of the process that writes it."""
        epochs = {name: total.sources for name, total in self._sums.items()}
        for key, _ in self._sources:
            epochs[key] = epochs.get(key, 0) + 1
        return epochs

    def _drop_oldest(self) -> None:
        name = next(iter(self._sources))
        source = self._sources.pop(name)
        key = self._sum_of(name[0])
        total = self._sums.get(key, _Sum())
        self._sums[key] = _Sum(total.sources + 1, total.published + source.published, total.missing + source.missing)
        self._has_dropped = True

    def _sum_of(self, key: str) -> str:
        return key if key in self._sums or len(self._sums) < self._max_keys else OTHER
