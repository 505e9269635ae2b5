"""Own clock of the vehicle, which is set during a fault, and the controller's synchronisation with it.

In lock step all nodes have one clock. During a fault the stamps of estimates and actuator reports come from a clock
that is set by ``step_ns``. They pass the synchronisation of a controller process, and plans return by that clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import msgspec

from benchmarks.faults.effects import Interval
from benchmarks.faults.message_faults import Delivery
from ltv_mpc.messages import Applied, Estimate, Message, Plan
from ltv_mpc.node import ReceivedMessage
from services.bus.time_shift import shifted
from services.runtime.clock import VehicleClock
from services.runtime.clock_sync import ClockSync

PUBLISHERS = {Estimate: 101, Applied: 102}
"""Epochs of the estimator and of the actuators, which are two processes."""

HOST_BEGAN_US = 1_000_000_000
"""Monotonic time of the host at vehicle time 0."""


class ClockStepFault(NamedTuple):
    """Interval in which the vehicle's clock is set, and by how much."""

    interval: Interval
    step_ns: int


class OwnClock:
    """Clock of the vehicle and the controller's view of it."""

    def __init__(self, faults: Sequence[ClockStepFault], *, epoch: int) -> None:
        """``epoch``: that of the controller."""
        self._faults = faults
        self._sync = ClockSync(VehicleClock(), epoch=epoch)
        self._steps = 0

    def carry(self, writer: str, reader: str, message: ReceivedMessage) -> list[Delivery]:
        """Return the deliveries of a message, with the times that its reader computes."""
        t_ns = message.received_t_ns
        if not self._faults:
            return [Delivery(t_ns, message)]
        step_ns = next((fault.step_ns for fault in self._faults if fault.interval.contains(t_ns)), 0)
        host_us = HOST_BEGAN_US + t_ns // 1000
        if reader == "controller" and isinstance(message.message, Estimate | Applied):
            return self._received(message, step_ns, host_us)
        if writer == "controller" and isinstance(message.message, Plan):
            self._sync.on_plan_sent(message.sequence, host_us)
            if step_ns:
                message = _with(message, shifted(message.message, self._sync.published_shift_ns - step_ns))
        return [Delivery(t_ns, message)]

    def _received(self, message: ReceivedMessage, step_ns: int, host_us: int) -> list[Delivery]:
        """Synchronise with a stamp. Only while a fault is active the synchronisation's times count."""
        stamped = shifted(message.message, step_ns)
        epoch = PUBLISHERS[type(message.message)]
        rejected = self._sync.check_stamp(stamped, epoch, host_us)
        steps = self._sync.take_steps()
        t_ns = message.received_t_ns
        if not step_ns:
            return [Delivery(t_ns, message)]
        deliveries = [Delivery(t_ns, ReceivedMessage(one, 0, self._steps + i, t_ns)) for i, one in enumerate(steps)]
        self._steps += len(steps)
        if not rejected:
            deliveries.append(Delivery(t_ns, _with(message, shifted(stamped, self._sync.shift_ns(epoch, host_us)))))
        return deliveries


def _with(message: ReceivedMessage, content: Message) -> ReceivedMessage:
    return msgspec.structs.replace(message, message=content)
