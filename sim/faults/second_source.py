"""Second source of estimates: another publisher on the same key, whose position is wrong."""

from __future__ import annotations

from typing import NamedTuple

import msgspec

from ltv_mpc.messages import Estimate, Pair
from ltv_mpc.node import ReceivedMessage
from sim.faults.interval import Interval

EPOCH = 9
"""Epoch of its messages."""


class SecondSource(NamedTuple):
    """Interval in which a second source publishes beside each estimate, and by how far its position is off."""

    interval: Interval
    offset_m: Pair  # north, east

    def message(self, received: ReceivedMessage) -> ReceivedMessage | None:
        """Return what it publishes beside a message; None outside the interval, and for all but estimates."""
        estimate = received.message
        if not isinstance(estimate, Estimate) or not self.interval.contains(received.received_t_ns):
            return None
        north_m, east_m = self.offset_m
        moved = msgspec.structs.replace(estimate, north_m=estimate.north_m + north_m, east_m=estimate.east_m + east_m)
        return msgspec.structs.replace(received, message=moved, epoch=EPOCH)
