"""Message validation: each frame is decoded, its order is checked, and it is accepted or rejected with a reason.

On a key on which operators command, and on that of plans, several sources may publish: each epoch is checked
separately.
"""

from __future__ import annotations

import base64
import re
from collections import Counter

from ltv_mpc.messages import Message, Plan, RejectedFrame
from services.bus.mailbox import Frame
from services.bus.sequence_check import SequenceCheck
from services.bus.topics import OPERATOR
from services.bus.wire import Header, WireError, crc, decode

MAX_SHOWN_BYTES = 3072
"""Largest part of a rejected payload that is reported; 4 KiB as base64."""

VALUES = re.compile(r"[:=(0-9]")
"""Start of the values in a reason. The text before is the kind of reason, by which rejections are counted."""

MAX_REASONS = 200
"""Largest number of kinds of reasons that are counted separately: the sender chooses the name of an unknown field."""

OTHER = "other"


class MessageValidator:
    """Validation of all frames that one process receives, with counts of the accepted, dropped and rejected ones."""

    def __init__(self) -> None:
        self.received = 0  # accepted messages
        self.rejected_by_reason: Counter[str] = Counter()
        self._order = SequenceCheck()

    @property
    def dropped(self) -> int:
        """Number of messages that were published and have not arrived, by the sequence numbers."""
        return self._order.dropped

    @property
    def rejected(self) -> int:
        """Number of rejected messages."""
        return self.rejected_by_reason.total()

    def validate(self, frame: Frame) -> tuple[Message, Header]:
        """Return the message of a frame and its header. Raises ``WireError`` with the reason for a rejection."""
        try:
            if frame.topic is None:
                raise WireError("unknown key")
            message, header = decode(frame.topic.message_type, frame.payload)
            # Of two commanders the actuators' gate chooses: the newest epoch is not always the right one there.
            shared = frame.topic.written_by == OPERATOR or frame.topic.message_type is Plan
            self.check_order(f"{frame.key}@{header.epoch}" if shared else frame.key, header)
        except WireError as error:
            self._count(str(error))
            raise
        self.received += 1
        return message, header

    def check_order(self, key: str, header: Header) -> None:
        """Check epoch and sequence number of a header (``SequenceCheck.check``). Raises ``WireError``."""
        self._order.check(key, header)

    def reject(self, reason: str) -> None:
        """Count the message accepted last as rejected: its reader found that it contradicts what the reader knows."""
        self.received -= 1
        self._count(reason)

    def _count(self, reason: str) -> None:
        kind = VALUES.split(reason, maxsplit=1)[0].strip()
        known = kind in self.rejected_by_reason or len(self.rejected_by_reason) < MAX_REASONS
        self.rejected_by_reason[kind if known else OTHER] += 1


def rejection(frame: Frame, reason: str, *, node: str, t_ns: int) -> RejectedFrame:
    """Return the message that reports a rejected frame."""
    return RejectedFrame(
        t_ns=t_ns,
        node=node,
        key=frame.key,
        reason=reason,
        crc=crc(frame.payload),
        payload_base64=base64.b64encode(frame.payload[:MAX_SHOWN_BYTES]).decode(),
    )
