"""Check of epoch and sequence number: each header is compared with the last ones accepted on its key.

- One source of a key at a time, by its epoch. While its frames arrive, those of other sources are rejected. After a
  silence of three of its periods, at least 0.5 s and at most 1.5 s, another one takes over: a restarted source, or a
  former one. No source is excluded for ever.
- Within an epoch the sequence number must increase, also of a source that takes over again. Numbers that it skips are
  counted as dropped.
- One frame alone changes neither by much. Its header may be the damaged part, and then every correct frame after it
  would seem old. A sequence number far ahead, or another epoch that does not start near 0, is accepted with the second
  frame that agrees with it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from ltv_mpc.bounded import remember
from services.bus.wire import Header, WireError

SECOND_SOURCE = "second source"
"""Begin of the reason for which a frame of a second source is rejected."""

MAX_SKIPPED = 20
"""Largest number of sequence numbers that one frame may skip. A longer gap costs one frame more; a damaged sequence
number below this limit costs that many frames."""

MAX_APART = 10_000
"""Largest difference of the sequence numbers of two frames that confirm each other."""

MAX_PER_S = 10_000
"""Largest number of messages a second of one source: a sequence number farther ahead is never accepted."""

FAR_AHEAD = "implausibly far ahead"
"""Begin of the reason for which a frame is rejected that the next one may confirm."""

MAX_FIRST = 10
"""Largest sequence number at which another epoch is accepted at once, as that of a source that has just started."""

MAX_SOURCES = 1000
"""Largest number of keys, and of former epochs of one key, that are remembered; beyond it the oldest is forgotten."""

MIN_SILENCE_US, MAX_SILENCE_US = 500_000, 1_500_000
SILENT_PERIODS = 3


def silence_us(period_ns: int) -> int:
    """Return the silence after which another source takes over a key whose messages have this period."""
    return min(max(SILENT_PERIODS * period_ns // 1000, MIN_SILENCE_US), MAX_SILENCE_US)


@dataclass(slots=True)
class _Source:
    """Last accepted header of a key and its arrival, the former epochs, and an unconfirmed header."""

    epoch: int
    sequence: int
    received_us: int
    former: dict[int, int] = field(default_factory=dict)  # last accepted sequence by epoch
    unconfirmed: Header | None = None  # too far off to be accepted alone


class SequenceCheck:
    """Check of the headers of any number of keys."""

    def __init__(self) -> None:
        self.dropped = 0  # messages that were skipped, on all keys
        self._sources: dict[str, _Source] = {}

    def check(self, key: str, header: Header, received_us: int, silent_us: int = MIN_SILENCE_US) -> None:
        """Check epoch and sequence number against the last header accepted on ``key``.

        ``silent_us`` is the silence after which another source takes over. Raises ``WireError`` if the header is of a
        second source, or its sequence number is old, duplicated or implausibly far ahead.
        """
        source = self._sources.get(key)
        remember(self._sources, key, source or _Source(header.epoch, header.sequence, received_us), MAX_SOURCES)
        if source is None:
            return
        another = header.epoch != source.epoch
        if another and 0 <= received_us - source.received_us < silent_us:
            raise WireError(f"{SECOND_SOURCE}: epoch {header.epoch} while epoch {source.epoch} publishes")
        last = source.former.get(header.epoch, -1) if another else source.sequence
        skipped = header.sequence - last - 1
        if skipped < 0:
            raise WireError(f"out of order: sequence {header.sequence} after {last}")
        if skipped > (MAX_FIRST if another else MAX_SKIPPED):
            first, source.unconfirmed = source.unconfirmed, header
            possible = 2 * MAX_APART + max(0, received_us - source.received_us) * MAX_PER_S // 1_000_000
            if not another and skipped > possible:
                raise WireError(f"impossibly far ahead: sequence {header.sequence} after {last}")
            if first is None or first.epoch != header.epoch or not 0 < header.sequence - first.sequence <= MAX_APART:
                raise WireError(
                    f"{FAR_AHEAD}: sequence {header.sequence} of epoch {header.epoch}; accepted if repeated"
                )
            skipped -= 1  # the first of the two frames was rejected, and is counted there
        if another:
            source.former.pop(header.epoch, None)
            remember(source.former, source.epoch, source.sequence, MAX_SOURCES)
            source.epoch = header.epoch
        else:
            self.dropped += skipped
        source.sequence, source.received_us, source.unconfirmed = header.sequence, received_us, None
