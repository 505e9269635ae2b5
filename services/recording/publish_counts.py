"""Publish counts: messages that each process has published, by its last status, compared with the recorded ones."""

from __future__ import annotations

from collections import Counter

MAX_EPOCHS = 1_000
"""Process starts that are counted; beyond that number the one that has been silent longest is forgotten. A run has
eight, and one more for each restart."""

MAX_LOST = 1_000_000
"""Largest number of messages that one process may have lost; a status that gives a larger one is false."""


class PublishCounts:
    """Counts of recorded messages by the epoch of their process. The last status counts as a message too."""

    def __init__(self) -> None:
        # Recorded messages, in the order of their newest one; None: the process published before counting began.
        self._counts: dict[int, int | None] = {}
        self._published: dict[int, tuple[str, int]] = {}  # node and number, by its last status

    def count(self, epoch: int, *, late: bool = False) -> bool:
        """Count a message. Return True if the process is counted from its first message on.

        A new process with ``late`` is not: it has published before, so its count cannot show a loss.
        """
        before = self._counts.pop(epoch) if epoch in self._counts else None if late else 0
        self._counts[epoch] = None if before is None else before + 1
        if len(self._counts) > MAX_EPOCHS:
            oldest = next(iter(self._counts))
            del self._counts[oldest]
            self._published.pop(oldest, None)
        return before is not None

    def discount(self, epoch: int) -> None:
        """Remove one counted message: it is not in the file after all, or it is a duplicate."""
        if count := self._counts.get(epoch):
            self._counts[epoch] = count - 1

    def set_published(self, epoch: int, node: str, published: int) -> None:
        """Set the number of messages that a process has published, by its last status, which is included."""
        if epoch in self._counts and published - (self._counts[epoch] or 0) <= MAX_LOST:
            self._published[epoch] = node, published

    def unfinished(self, own: int) -> bool:
        """Return True if the last status of any process other than ``own`` is still to come."""
        return bool(self._counts.keys() - self._published.keys() - {own})

    @property
    def missing(self) -> dict[str, int]:
        """Published minus recorded messages, by process, where the difference is not 0."""
        gaps: Counter[str] = Counter()
        for epoch, (node, published) in self._published.items():
            count = self._counts[epoch]
            gaps[node] += 0 if count is None else published - count
        return {node: gap for node, gap in gaps.items() if gap}
