"""Message validation: each frame is decoded, its order is checked, and it is accepted or rejected with a reason.

On a key on which operators command, and on those of plans and estimates, several sources may publish: each epoch is
checked separately. On all other keys one source publishes at a time.
"""

from __future__ import annotations

import base64

from ltv_mpc.messages import Estimate, Message, Plan, RejectedFrame
from ltv_mpc.validation import ReasonCounts
from services.bus.mailbox import Frame
from services.bus.rate_limit import RateLimit
from services.bus.sequence_check import SequenceCheck, silence_us
from services.bus.topics import OPERATOR, Topic
from services.bus.wire import Header, WireError, crc, message_at, unpack

MAX_SHOWN_BYTES = 3072
"""Largest part of a rejected payload that is reported; 4 KiB as base64."""

SHARED: frozenset[type[Message]] = frozenset({Plan, Estimate})
"""Types whose reader chooses among several sources: the actuators' gate, and the controller."""


class RateExceeded(WireError):
    """Frame above the rate limit of its source; it is counted and not answered."""


class MessageValidator:
    """Validation of all frames that one process receives, with counts of the accepted, dropped and rejected ones."""

    def __init__(self, rate_limit: RateLimit | None = None) -> None:
        """``rate_limit``: of the frames that are decoded; None: all of them."""
        self.received = 0  # accepted messages
        self._rate_limit = rate_limit
        self.rejected_by_reason = ReasonCounts()
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
        """Return the message of a frame and its header.

        Raises ``WireError`` with the reason for a rejection, ``RateExceeded`` if the frame was not decoded.
        """
        try:
            if frame.topic is None:
                raise WireError("unknown key")
            if self._rate_limit is not None and not self._rate_limit.admits(frame):
                raise RateExceeded(f"above the rate limit: 100 frames per second on {frame.key}")
            message, header = message_at(frame.topic, frame.key, unpack(frame.payload))
            self.check_order(frame.topic, frame.key, header, frame.received_monotonic_us)
        except WireError as error:
            self.rejected_by_reason.add(str(error))
            raise
        self.received += 1
        return message, header

    def check_order(self, topic: Topic, key: str, header: Header, received_us: int) -> None:
        """Check epoch and sequence number of a header (``SequenceCheck.check``). Raises ``WireError``."""
        if topic.written_by == OPERATOR or topic.message_type in SHARED:
            key = f"{key}@{header.epoch}"
        self._order.check(key, header, received_us, silence_us(topic.period_ns))

    def reject(self, reason: str) -> None:
        """Count the message accepted last as rejected: its reader found that it contradicts what the reader knows."""
        self.received -= 1
        self.rejected_by_reason.add(reason)


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
