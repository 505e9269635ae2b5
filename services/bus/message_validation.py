"""Message validation: each frame is decoded, checked against its predecessors, then accepted or rejected with a reason.

Of one key the newest epoch counts: a restarted source takes over from its former self, whose frames are refused from
then on. Within an epoch the sequence must grow; what it skips is counted as dropped on the way. One frame alone moves
neither far, for its header may be what was damaged, and all true ones after it would seem old: a sequence far ahead, or
another epoch in the midst of its count, is let in with the second frame that says so. On a key on which
operators command, several may speak, and each epoch is a source of its own.
"""

from __future__ import annotations

import base64
import re
from collections import Counter
from typing import Any

from ltv_mpc.messages import Message, Plan, RejectedFrame
from services.bus.mailbox import Frame
from services.bus.topics import OPERATOR
from services.bus.wire import Header, WireError, crc, decode

SHOWN_BYTES = 3072  # of a refused payload; 4 KiB as base64
VALUES = re.compile(r"[:=(0-9]")
"""Where a reason goes over to its case: what stands before is counted, a bounded number of kinds."""

FURTHEST = 20
"""So many a sequence may skip at once. A longer gap costs one frame more; a damaged sequence below it costs so many."""
AGREEING = 10_000
"""So far apart two frames may be that say the same of a source."""
FRESH = 10
"""Another epoch that has not counted further is a source that was started."""
MOST_KINDS = 200
"""Reasons that are counted apart: an unknown field's name is the sender's choice."""
OTHER = "other"
MOST_SOURCES = 1000
"""Epochs that are remembered of a key, and sources in all: beyond that the one that was silent longest is forgotten."""


class _Source:
    __slots__ = ("claim", "epoch", "former", "sequence")

    def __init__(self, epoch: int, sequence: int) -> None:
        self.epoch = epoch
        self.sequence = sequence
        self.former: dict[int, None] = {}
        self.claim: Header | None = None  # of a frame that was too far off to be believed alone


class MessageValidator:
    """Counts what it admits (``received``), what never came (``dropped``) and what it refuses, by reason."""

    def __init__(self) -> None:
        self.received = 0
        self.dropped = 0
        self.rejected_by_reason: Counter[str] = Counter()
        self._sources: dict[str, _Source] = {}

    def validate(self, frame: Frame) -> tuple[Message, Header]:
        """The signal, if it may pass. Raises ``WireError`` with the reason."""
        try:
            if frame.topic is None:
                raise WireError("unknown key")
            signal, header = decode(frame.topic.message_type, frame.payload)
            # Of two commanders the actuators' gate chooses: the newest epoch is not the right one there.
            shared = frame.topic.written_by == OPERATOR or frame.topic.message_type is Plan
            self.check_order(f"{frame.key}@{header.epoch}" if shared else frame.key, header)
        except WireError as error:
            self._count(str(error))
            raise
        self.received += 1
        return signal, header

    def reject(self, reason: str) -> None:
        """What was let in last does not fit what its reader knows."""
        self.received -= 1
        self._count(reason)

    def _count(self, reason: str) -> None:
        kind = VALUES.split(reason, maxsplit=1)[0].strip()
        self.rejected_by_reason[
            kind if kind in self.rejected_by_reason or len(self.rejected_by_reason) < MOST_KINDS else OTHER
        ] += 1

    @property
    def rejected(self) -> int:
        """How many were refused so far."""
        return self.rejected_by_reason.total()

    def check_order(self, key: str, header: Header) -> None:
        """Hold a header against its predecessors of ``key``. Raises ``WireError`` where it is none of its turn."""
        source = self._sources.pop(key, None)
        if source is None:
            self._sources[key] = _Source(header.epoch, header.sequence)
            _forget_oldest(self._sources)
            return
        self._sources[key] = source  # the last to be forgotten
        anew = header.epoch != source.epoch
        skipped = header.sequence - (-1 if anew else source.sequence) - 1
        if skipped < 0:
            raise WireError(f"out of order: sequence {header.sequence} after {source.sequence}")
        if header.epoch in source.former:
            raise WireError("former epoch: its source has restarted since")
        if skipped > (FRESH if anew else FURTHEST):
            claim, source.claim = source.claim, header
            if claim is None or claim.epoch != header.epoch or not 0 < header.sequence - claim.sequence <= AGREEING:
                raise WireError(
                    f"implausibly far ahead: sequence {header.sequence} of epoch {header.epoch}; accepted if repeated"
                )
            skipped -= 1  # the first that said so was refused, and is counted there
        if anew:
            source.former[source.epoch] = None
            _forget_oldest(source.former)
            source.epoch = header.epoch
        else:
            self.dropped += skipped
        source.sequence, source.claim = header.sequence, None


def _forget_oldest(kept: dict[Any, Any]) -> None:
    if len(kept) > MOST_SOURCES:
        del kept[next(iter(kept))]


def rejection(frame: Frame, reason: str, *, node: str, t_ns: int) -> RejectedFrame:
    """Return the message that reports a rejected frame."""
    return RejectedFrame(
        t_ns=t_ns,
        node=node,
        key=frame.key,
        reason=reason,
        crc=crc(frame.payload),
        payload_base64=base64.b64encode(frame.payload[:SHOWN_BYTES]).decode(),
    )
