"""Vehicle time at which recorded messages were published.

a clock is announced     that clock
no clock                 the vehicle's own clock, by the stamps of estimates and actuators (``clock_sync.py``)
neither                  in a simulation its start; otherwise unknown, until the host's clock is taken instead

Messages that arrive while the time is unknown wait in the recorder.
"""

from __future__ import annotations

import time

from ltv_mpc.messages import ClockState, Estimate, Message
from services.bus.topics import BY_TYPE
from services.runtime.clock import ClockError, ClockSegment, VehicleClock, monotonic_us
from services.runtime.clock_sync import ClockSync
from services.runtime.node_status import CLOCK_MESSAGE, CLOCK_OR_ESTIMATE
from services.runtime.stopping import Say

FOLLOWS_VEHICLE = f"no clock is announced: following the vehicle's own clock, by the stamps on {BY_TYPE[Estimate].key}"
FOLLOWS_HOST = "neither a clock nor a stamped message: times are those of this host's clock (UTC)"


class PublicationTime:
    """Vehicle time of publication, from the messages received so far.

    ``start_ns``: vehicle time of the start of a simulation; None beside a vehicle.
    """

    def __init__(self, *, start_ns: int | None, say: Say) -> None:
        self.clock = VehicleClock()
        self.beside_vehicle = start_ns is None
        self.clock_source = CLOCK_OR_ESTIMATE if start_ns is None else CLOCK_MESSAGE
        """What the process waits for while no clock is followed."""
        self._start_ns = start_ns
        self._sync = ClockSync(self.clock, epoch=0)  # a recorder publishes no plans
        self._say = say

    @property
    def known(self) -> bool:
        """True once messages can be dated."""
        return self._start_ns is not None or self.clock.newest is not None

    def add(self, message: Message, epoch: int, received_us: int) -> None:
        """Add an announced clock, or a message with a stamp of the publisher ``epoch``.

        Once the vehicle's own clock is followed, a clock that is announced later is ignored: times have one origin.
        """
        was_active = self._sync.active
        try:
            self._sync.take(message, epoch, received_us)
        except ClockError as error:  # the messages of any clock master are recorded
            self._say(str(error))
        if self._sync.active and not was_active:
            self._say(FOLLOWS_VEHICLE)

    def at(self, sent_us: int, received_us: int) -> int | None:
        """Return the vehicle time (ns) of a message's publication; None while it is unknown.

        A clock is announced to the processes of one host, so the monotonic time ``sent_us`` counts. No message is sent
        after its arrival, whatever it says. Beside a vehicle the sender may be on another host, so the arrival counts.
        """
        newest = self.clock.newest
        if newest is None:
            return self._start_ns
        if not self._sync.active:
            return self.clock.at(min(sent_us, received_us))
        return newest.vehicle_ns + (received_us - newest.at_us) * 1000  # also before the newest stamp

    def follow_host(self) -> None:
        """Take the host's clock for that of the vehicle."""
        self._say(FOLLOWS_HOST)
        began_ns = time.time_ns() - monotonic_us() * 1000  # at monotonic time 0, so that it dates earlier messages too
        self.clock.set_segment(ClockSegment(0, began_ns, 1, 1, ClockState.RUNNING))
