"""What was published and what of it is missing, proved by the sequence numbers of each key and epoch. What comes twice
makes up for nothing that did not come.

Memory is bounded, whoever speaks under however many epochs: of the sources that were silent longest only the sums are
kept. One that is heard again after that counts from where it is heard then.
"""

from __future__ import annotations

from typing import NamedTuple

from services.recording.sequence_gaps import SequenceGaps

MAX_SOURCES = 10_000
"""Keys times epochs that are counted apart. A run has some fifty, and ten more for each restart."""

MAX_KEYS = 1_000
OTHER = "others"
"""In place of the key, where there are too many keys as well."""


class _Sum(NamedTuple):
    """Of the sources of one key that are not counted apart any more."""

    sources: int = 0
    published: int = 0
    missing: int = 0


class LossAccounting:
    """Fed with every message that is there. Sequences count from 0 without a gap, by key and epoch of the source."""

    def __init__(self) -> None:
        self._sources: dict[tuple[str, int], SequenceGaps] = {}  # who was heard last is the last
        self._sums: dict[str, _Sum] = {}
        self._forgot = False

    def add(self, key: str, epoch: int, sequence: int) -> bool:
        """A message that is there; whether it was not there before."""
        name = key, epoch
        source = self._sources.pop(name, None)
        if source is None:
            source = SequenceGaps(sequence if self._forgot else 0)
        self._sources[name] = source
        if len(self._sources) > MAX_SOURCES:
            self._forget_oldest()
        return source.add(sequence)

    def start_at(self, key: str, epoch: int, sequence: int) -> None:
        """Count this source from here, if it is new: what it said before was not ours to hear."""
        self._sources.setdefault((key, epoch), SequenceGaps(sequence))

    def mark_lost(self, key: str, epoch: int) -> None:
        """One that was there is not."""
        source = self._sources.get((key, epoch))
        if source is not None:
            source.mark_lost()
        else:
            name = self._sum_of(key)
            of = self._sums.get(name, _Sum())
            self._sums[name] = of._replace(missing=of.missing + 1)

    @property
    def published(self) -> int:
        """How many there were, up to the last one seen of each source."""
        there = sum(source.published for source in self._sources.values())
        return there + sum(of.published for of in self._sums.values())

    @property
    def missing(self) -> int:
        """How many of them are not there."""
        return sum(self.by_key().values())

    def by_key(self) -> dict[str, int]:
        """Missing messages of each key that misses any."""
        missing = {name: of.missing for name, of in self._sums.items()}
        for (key, _), source in self._sources.items():
            missing[key] = missing.get(key, 0) + source.missing
        return {key: gap for key, gap in missing.items() if gap}

    def epochs(self) -> dict[str, int]:
        """How many starts of its source each key has seen."""
        epochs = {name: of.sources for name, of in self._sums.items()}
        for key, _ in self._sources:
            epochs[key] = epochs.get(key, 0) + 1
        return epochs

    def _forget_oldest(self) -> None:
        name = next(iter(self._sources))
        source = self._sources.pop(name)
        key = self._sum_of(name[0])
        of = self._sums.get(key, _Sum())
        self._sums[key] = _Sum(of.sources + 1, of.published + source.published, of.missing + source.missing)
        self._forgot = True

    def _sum_of(self, key: str) -> str:
        return key if key in self._sums or len(self._sums) < MAX_KEYS else OTHER
