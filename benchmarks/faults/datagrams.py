"""Datagrams of strangers to the edge to MAVLink: the foreign craft flies with and without them, at simulated time.

They must change nothing: neither the track of the craft, nor the number of frames that the edge counts as lost, nor the
number of datagrams to the autopilot. A stranger sends bytes that are no frame, frames of other systems
and keys, frames of the autopilot that it has seen, and frames in its name, each from one of several addresses.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from typing import Any

import msgspec
import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from benchmarks.faults.draw import Run
from benchmarks.faults.judge import FaultOutcome
from benchmarks.faults.kinds import Fault, Place
from services.edges.edge import Outgoing, Received
from services.edges.mavlink.codec import Codec
from tests.foreign_plant.mavlink_flight import MavlinkFlight

KEY, OTHER_KEY = bytes(range(32)), bytes(32)
ARMED_S, AFTER_S = 13.0, 10.0
SENDERS = 30
SEEN, UNDER_WAY = 200, 20
"""Frames of the autopilot that a stranger remembers, and how many of them may not have arrived yet."""

MOVED_M = 1e-6

LATEST = 2**47
"""Stamp of a signature that none can be newer than."""


class StrangersFlight(MavlinkFlight):
    """Flight with a stranger on the link, who is heard between ``ARMED_S`` and the end of the fault."""

    def __init__(self, fault: Fault, *, stranger: bool) -> None:
        key = KEY if fault.target == "signed" else None
        super().__init__(key=key)
        self.harmed = 0
        self._rng_of_strangers = np.random.default_rng(fault.seed)
        self._share = fault.size * 0.02 if stranger else 0.0  # a step
        self._end_us = round((ARMED_S + fault.end_s - fault.start_s) * 1e6)
        self._seen: list[bytes] = []
        self._forgers = [Codec(1, component=1), Codec(1, OTHER_KEY, component=1, stamp=LATEST), Codec(9, key), Codec(1)]
        self.fly(3.0)
        self.arm()
        self.command(action="arm")
        self.fly(ARMED_S - 3.0)
        self.fly(self._end_us * 1e-6 - ARMED_S + AFTER_S)

    def deliver(self, datagrams: Any) -> None:
        """Let the stranger see what the autopilot sends."""
        sent = list(datagrams)
        self._seen = [*self._seen, *(data for _, data in sent)][-SEEN:]
        super().deliver(sent)

    def pass_on(self, outputs: Any) -> None:
        """Pass on what is not sent to a stranger."""
        super().pass_on(one for one in outputs if not isinstance(one, Outgoing) or not one.channel)

    def _step(self) -> None:
        rng = self._rng_of_strangers
        if ARMED_S * 1e6 <= self.host_us < self._end_us:
            for _ in range(rng.poisson(self._share)):
                sender = f"stranger:{rng.integers(SENDERS)}"
                self.pass_on(self.edge.receive(Received(sender, self._datagram(), b"", self.host_us)))
                self.harmed += 1
        super()._step()

    def _datagram(self) -> bytes:
        rng, forger = self._rng_of_strangers, self._forgers[int(self._rng_of_strangers.integers(len(self._forgers)))]
        make, x = forger.make, float(rng.choice([0.0, 75.0, np.nan, np.inf]))
        ms = int(rng.integers(2**32))
        forged: list[Callable[[], dialect.MAVLink_message]] = [
            lambda: make.heartbeat_encode(11, 3, 0x81, int(rng.integers(16)), int(rng.integers(9))),
            lambda: make.attitude_encode(ms, x, x, x, x, x, x),
            lambda: make.local_position_ned_encode(ms, x, x, x, x, x, x),
            lambda: make.timesync_encode(ms, ms),
            lambda: make.mission_count_encode(255, 190, ms % 2**16),
        ]
        which = int(rng.integers(len(forged) + 3))
        if which < len(forged):
            return forger.encode(forged[which]())
        seen = self._seen[int(rng.integers(SEEN - UNDER_WAY))]
        return (b"x", rng.bytes(int(rng.integers(1, 300))), seen)[which - len(forged)]


def observe(run: Run) -> list[FaultOutcome]:
    """Fly with the strangers of each fault and without."""
    outcomes = []
    for fault in run.faults:
        with redirect_stdout(sys.stderr):  # the simulated autopilot prints what it is told
            flight, alone = (StrangersFlight(fault, stranger=heard) for heard in (True, False))
        moved_m = float(np.hypot(*(flight.track - alone.track).T).max())
        counts = [(one.edge.lost, one.frames["to autopilot"]) for one in (flight, alone)]
        outcome = FaultOutcome(fault=fault, place=Place.LOCKSTEP, run_seed=run.seed, harmed=flight.harmed)
        false = f"lost, sent: {counts[0]} instead of {counts[1]}" if counts[0] != counts[1] else ""
        outcomes.append(msgspec.structs.replace(outcome, grown_m=moved_m, bound_m=MOVED_M, false_figures=false))
    return outcomes
