"""What was published and what of it is missing, proved by the sequence numbers of each key and epoch."""

from __future__ import annotations


class Losses:
    """Fed with every message that is there. Sequences count from 0 without a gap, by key and epoch of the source."""

    def __init__(self) -> None:
        self._seen: dict[tuple[str, int], int] = {}
        self._published: dict[tuple[str, int], int] = {}
        self._first: dict[tuple[str, int], int] = {}

    def saw(self, key: str, epoch: int, sequence: int) -> None:
        """A message that is there."""
        source = (key, epoch)
        self._seen[source] = self._seen.get(source, 0) + 1
        self._published[source] = max(self._published.get(source, 0), sequence + 1)

    def begins(self, key: str, epoch: int, sequence: int) -> None:
        """Count this source from here, if it is new: what it said before was not ours to hear."""
        if (key, epoch) not in self._seen:
            self._first[key, epoch] = sequence

    def lost(self, key: str, epoch: int) -> None:
        """One that was there is not."""
        self._seen[key, epoch] -= 1

    @property
    def published(self) -> int:
        """How many there were, up to the last one seen of each source."""
        return sum(self._published.values()) - sum(self._first.values())

    @property
    def missing(self) -> int:
        """How many of them are not there."""
        return self.published - sum(self._seen.values())

    def by_key(self) -> dict[str, int]:
        """Missing messages of each key that misses any."""
        missing: dict[str, int] = {}
        for source, published in self._published.items():
            if gap := published - self._seen[source] - self._first.get(source, 0):
                missing[source[0]] = missing.get(source[0], 0) + gap
        return missing

    def epochs(self) -> dict[str, int]:
        """How many starts of its source each key has seen."""
        epochs: dict[str, int] = {}
        for key, _ in self._seen:
            epochs[key] = epochs.get(key, 0) + 1
        return epochs
