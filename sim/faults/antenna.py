"""Antenna away from the vehicle's origin that no vehicle file declares: the estimates are those of its place."""

from __future__ import annotations

from typing import NamedTuple

import msgspec

from ltv_mpc.messages import Estimate
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.vehicle.reference_point import ReferencePoint
from sim.faults.interval import Interval


class Antenna(NamedTuple):
    """Interval in which the estimates are those of a point of the vehicle."""

    interval: Interval
    point: ReferencePoint

    def moved(self, received: ReceivedMessage) -> ReceivedMessage:
        """Return a message as measured at the antenna; all but estimates are unchanged."""
        estimate = received.message
        if not isinstance(estimate, Estimate) or not self.interval.contains(received.received_t_ns):
            return received
        # The origin lies as far from the antenna as the antenna from the origin, in the opposite direction.
        opposite = ReferencePoint(
            forward_m=-self.point.forward_m, starboard_m=-self.point.starboard_m, down_m=-self.point.down_m
        )
        return msgspec.structs.replace(received, message=opposite.to_origin(estimate))
