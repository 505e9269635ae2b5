"""Which sequence numbers of one source are missing: whatever the order they came in, and however often."""

from __future__ import annotations

MAX_GAPS = 1_000
"""That may still be filled: of more, the oldest are lost for good."""


class SequenceGaps:
    """Fed with the sequence numbers that are there; they count without a gap. Memory: two numbers a gap."""

    def __init__(self, begins: int = 0) -> None:
        """``begins``: the first number that counts."""
        self.messages = 0
        self.doubled = 0
        self._begins = self._next = begins
        self._missing: list[list[int]] = []  # [first, last], in order
        self._lost = 0  # for good

    def add(self, sequence: int) -> bool:
        """A message that is there; whether it was not there before."""
        self.messages += 1
        if sequence >= self._next:
            if sequence > self._next:
                self._missing.append([self._next, sequence - 1])
                if len(self._missing) > MAX_GAPS:
                    first, last = self._missing.pop(0)
                    self._lost += last - first + 1
            self._next = sequence + 1
            return True
        if self._fill(sequence):
            return True
        self.doubled += 1
        return False

    def mark_lost(self) -> None:
        """One that was there is not."""
        self.messages -= 1
        self._lost += 1

    @property
    def published(self) -> int:
        """How many there were, up to the last one that is there."""
        return self._next - self._begins

    @property
    def missing(self) -> int:
        """How many of them are not there."""
        return self._lost + sum(last - first + 1 for first, last in self._missing)

    @property
    def ranges(self) -> tuple[tuple[int, int], ...]:
        """First and last number of each gap that may still be filled."""
        return tuple((first, last) for first, last in self._missing)

    def _fill(self, sequence: int) -> bool:
        """Whether a late one fills a place; most recent gaps first, where it is as a rule."""
        for i in range(len(self._missing) - 1, -1, -1):
            first, last = self._missing[i]
            if sequence > last:
                return False
            if sequence >= first:
                rest = [[first, sequence - 1], [sequence + 1, last]]
                self._missing[i : i + 1] = [gap for gap in rest if gap[0] <= gap[1]]
                return True
        return False
