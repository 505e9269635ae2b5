"""A node's door: each frame is decoded, checked and held against its predecessors, then let in or refused by reason.

Of one key the newest epoch counts: a restarted source takes over from its former self, whose frames are refused from
then on. Within an epoch the sequence must grow; what it skips is counted as dropped on the way. On a key on which
operators command, several may speak, and each epoch is a source of its own.
"""

from __future__ import annotations

import base64
import re
from collections import Counter

from ltv_mpc.signals import Rejected, Signal
from services.bus.mailbox import Frame
from services.bus.topics import OPERATOR
from services.bus.wire import Header, WireError, crc, decode

SHOWN_BYTES = 3072  # of a refused payload; 4 KiB as base64
VALUES = re.compile(r"[:=(0-9]")
"""Where a reason goes over to its case: what stands before is counted, a bounded number of kinds."""


class _Source:
    __slots__ = ("epoch", "former", "sequence")

    def __init__(self, epoch: int, sequence: int) -> None:
        self.epoch = epoch
        self.sequence = sequence
        self.former: set[int] = set()


class Door:
    """Counts what it admits (``received``), what never came (``dropped``) and what it refuses, by reason."""

    def __init__(self) -> None:
        self.received = 0
        self.dropped = 0
        self.refused: Counter[str] = Counter()
        self._sources: dict[str, _Source] = {}

    def admit(self, frame: Frame) -> tuple[Signal, Header]:
        """The signal, if it may pass. Raises ``WireError`` with the reason."""
        try:
            if frame.topic is None:
                raise WireError("unknown key")
            signal, header = decode(frame.topic.signal, frame.payload)
            shared = frame.topic.written_by == OPERATOR
            self._in_order(f"{frame.key}@{header.epoch}" if shared else frame.key, header)
        except WireError as error:
            self._count(str(error))
            raise
        self.received += 1
        return signal, header

    def turn_back(self, reason: str) -> None:
        """What was let in last does not fit what its reader knows."""
        self.received -= 1
        self._count(reason)

    def _count(self, reason: str) -> None:
        self.refused[VALUES.split(reason, maxsplit=1)[0].strip()] += 1

    @property
    def rejected(self) -> int:
        """How many were refused so far."""
        return self.refused.total()

    def _in_order(self, key: str, header: Header) -> None:
        source = self._sources.get(key)
        if source is None:
            self._sources[key] = _Source(header.epoch, header.sequence)
            return
        if header.epoch == source.epoch:
            if header.sequence <= source.sequence:
                raise WireError(f"out of order: sequence {header.sequence} after {source.sequence}")
            self.dropped += header.sequence - source.sequence - 1
        elif header.epoch in source.former:
            raise WireError("former epoch: its source was started anew since")
        else:
            source.former.add(source.epoch)
            source.epoch = header.epoch
        source.sequence = header.sequence


def rejection(frame: Frame, reason: str, *, node: str, t_ns: int) -> Rejected:
    """What the door's keeper publishes of a frame that it refused."""
    return Rejected(
        t_ns=t_ns,
        node=node,
        key=frame.key,
        reason=reason,
        crc=crc(frame.payload),
        payload_base64=base64.b64encode(frame.payload[:SHOWN_BYTES]).decode(),
    )
