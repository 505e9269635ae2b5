"""Loss accounting: missing messages, by the sequence numbers of each key and by the counts that processes report.

A duplicate does not replace a message that is missing. Memory is bounded for any number of sources: of those that have
been silent longest only the sums are kept. If such a source publishes again, it is counted from that message on.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass

from ltv_mpc.bounded import remember
from services.bus.sequence_check import MAX_FIRST

MAX_GAPS = 1_000
"""Gaps that late messages may still fill; beyond that number the oldest count as lost."""

MAX_SOURCES = 10_000
"""Sources (key and epoch) that are counted separately. A run has about fifty, and ten more for each restart."""

MAX_PROCESSES = 1_000
"""Process starts that are counted; beyond that number the one that has been silent longest is forgotten. A run has
eight, and one more for each restart."""

MAX_LOST = 1_000_000
"""Largest number of messages that one process may have lost; a status that gives a larger one is false."""

OTHER = "others"
"""Name in place of the key of those that are not counted separately any more."""


class SequenceGaps:
    """Account of the sequence numbers of one source, for any order of arrival. Memory: two numbers for each gap."""

    def __init__(self, begins: int = 0, *, max_gaps: int = MAX_GAPS) -> None:
        """``begins``: the first sequence number that is expected."""
        self.received = 0
        """Number of messages that are not missing."""
        self.doubled = 0
        self._begins = self._next = begins
        self._max_gaps = max_gaps
        self._missing: list[list[int]] = []  # [first, last], in order
        self._ahead: deque[int] = deque(maxlen=max_gaps)  # of refused messages, which fill the gap that they may be in

    def add(self, sequence: int) -> bool:
        """Add a message. Return False if it is a duplicate."""
        if sequence >= self._next:
            if sequence > self._next:
                self._missing.append([self._next, sequence - 1])
                del self._missing[: -self._max_gaps]
            self._next = sequence + 1
            self.received += 1
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

    def restart(self) -> None:
        """Count from the next message on."""
        self._begins, self.received = self._next, 0
        self._missing.clear()

    @property
    def published(self) -> int:
        """Number of published messages, up to the last one that has arrived."""
        return self._next - self._begins

    @property
    def missing(self) -> int:
        """Number of missing messages."""
        return self.published - self.received

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
                self.received += 1
                return True
        return False


@dataclass(slots=True)
class _Process:
    """One start of a process."""

    began_before: bool
    """It published before counting began, so that its count cannot show a loss."""
    received: int = 0
    node: str = ""
    published: int | None = None
    """Number of published messages, by its last status."""


class LossAccounting:
    """Account of all recorded messages. Sequence numbers count from 0, by key and epoch of the source.

    ``late``: processes may have published before counting began. One whose first message is not number 0 of its key is
    then counted from its next messages on.
    """

    def __init__(self, *, late: bool = False, max_sources: int = MAX_SOURCES) -> None:
        self._late, self._max_sources = late, max_sources
        self._sources: dict[tuple[str, int], SequenceGaps] = {}  # in the order of their newest message
        self._processes: dict[int, _Process] = {}  # by epoch, likewise
        self._published = self._missing = 0  # of the sources that are no longer counted separately

    def is_whole(self, key: str, epoch: int, sequence: int) -> bool:
        """Return True if nothing of a source is missing before a message."""
        source = self._sources.get((key, epoch))
        return sequence == (0 if source is None else source.received)

    def add(self, key: str, epoch: int, sequence: int, *, counts: bool = True) -> None:
        """Add a recorded message; unless it ``counts``, its source is counted from its next message on."""
        process = self._processes.get(epoch) or _Process(began_before=self._late and sequence > 0)
        remember(self._processes, epoch, process, MAX_PROCESSES)
        source = self._sources.get((key, epoch))
        if source is None:
            # More than MAX_FIRST messages are not lost before the first one: its sender began elsewhere.
            from_here = process.began_before or sequence > MAX_FIRST or self._published
            source = SequenceGaps(sequence if from_here else 0)
        if (oldest := remember(self._sources, (key, epoch), source, self._max_sources)) is not None:
            self._published, self._missing = self._published + oldest.published, self._missing + oldest.missing
        before = source.received
        source.add(sequence)
        process.received += source.received - before
        if not counts:
            source.restart()

    def fill(self, key: str, epoch: int, sequence: int) -> bool:
        """Count a message that was refused as no longer missing. Return True if it was missing."""
        source = self._sources.get((key, epoch))
        if source is None or not source.fill(sequence):
            return False
        if epoch in self._processes:
            self._processes[epoch].received += 1
        return True

    def set_published(self, epoch: int, node: str, published: int) -> None:
        """Set the number of messages that a process has published, by its last status, which is included."""
        process = self._processes.get(epoch)
        if process is not None and published - process.received <= MAX_LOST:
            process.node, process.published = node, published

    def unfinished(self, own: int) -> bool:
        """Return True if the last status of any process other than ``own`` is still to come."""
        return any(process.published is None for epoch, process in self._processes.items() if epoch != own)

    def begins_late(self, key: str, epoch: int) -> bool:
        """Return True after the first message of a source whose process published before counting began."""
        source, process = self._sources.get((key, epoch)), self._processes.get(epoch)
        return source is not None and source.published == 1 and process is not None and process.began_before

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
        missing = Counter({OTHER: self._missing})
        for (key, _), source in self._sources.items():
            missing[key] += source.missing
        return {key: gap for key, gap in missing.items() if gap}

    def by_process(self) -> dict[str, int]:
        """Return published minus recorded messages, by process, where the difference is not 0."""
        missing: Counter[str] = Counter()
        for process in self._processes.values():
            if process.published is not None and not process.began_before:
                missing[process.node] += process.published - process.received
        return {node: gap for node, gap in missing.items() if gap}
