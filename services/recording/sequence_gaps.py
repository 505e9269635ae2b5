"""Gaps in the sequence numbers of one source, for any order of arrival and any duplicates."""

from __future__ import annotations

from collections import deque

MAX_GAPS = 1_000
"""Gaps that late messages may still fill; beyond that number the oldest count as lost."""


class SequenceGaps:
    """Account of the sequence numbers that have arrived. Memory: two numbers for each gap."""

    def __init__(self, begins: int = 0, *, max_gaps: int = MAX_GAPS) -> None:
        """``begins``: the first sequence number that is expected."""
        self.messages = 0
        self.doubled = 0
        self._begins = self._next = begins
        self._max_gaps = max_gaps
        self._missing: list[list[int]] = []  # [first, last], in order
        self._lost = 0  # no longer fillable
        self._ahead: deque[int] = deque(maxlen=max_gaps)  # of refused messages, which fill the gap that they may be in

    def add(self, sequence: int) -> bool:
        """Add a message. Return False if it is a duplicate."""
        self.messages += 1
        if sequence >= self._next:
            if sequence > self._next:
                self._missing.append([self._next, sequence - 1])
                if len(self._missing) > self._max_gaps:
                    first, last = self._missing.pop(0)
                    self._lost += last - first + 1
            self._next = sequence + 1
            while self._ahead:
                self._fill(self._ahead.popleft())
            return True
        if self._fill(sequence):
            return True
        self.doubled += 1
        return False

    def fill(self, sequence: int) -> bool:
        """Count a message that was refused as no longer missing. Return True if it was missing."""
        if sequence < self._next:
            return self._fill(sequence)
        self._ahead.append(sequence)
        return False

    def mark_lost(self) -> None:
        """Count a message that was added as missing after all."""
        self.messages -= 1
        self._lost += 1

    @property
    def published(self) -> int:
        """Number of published messages, up to the last one that has arrived."""
        return self._next - self._begins

    @property
    def missing(self) -> int:
        """Number of missing messages."""
        return self._lost + sum(last - first + 1 for first, last in self._missing)

    @property
    def ranges(self) -> tuple[tuple[int, int], ...]:
        """First and last sequence number of each gap that may still be filled."""
        return tuple((first, last) for first, last in self._missing)

    def _fill(self, sequence: int) -> bool:
        """Fill a gap with a late message. Return True if it belongs to one; the newest gap is the most likely."""
        for i in range(len(self._missing) - 1, -1, -1):
            first, last = self._missing[i]
            if sequence > last:
                return False
            if sequence >= first:
                rest = [[first, sequence - 1], [sequence + 1, last]]
                self._missing[i : i + 1] = [gap for gap in rest if gap[0] <= gap[1]]
                return True
        return False
