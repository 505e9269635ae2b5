"""What the processes of a fleet agree on: names, rates and the time that counts for all of them."""

from __future__ import annotations

import time
from typing import Any, Protocol

import msgspec


class Fleet(msgspec.Struct, frozen=True, kw_only=True):
    """One trial."""

    vehicles: int
    vehicle: str  # NAME or FILE
    rate_hz: float  # estimates, and so plans, a second of each
    seconds: float  # that are measured
    warm_up_s: float  # before them
    horizon_s: float
    router: str  # endpoint

    @property
    def period_ns(self) -> int:
        """Between two estimates of one vehicle."""
        return round(1e9 / self.rate_hz)

    def due_ns(self, vehicle: int, k: int) -> int:
        """When a vehicle's k-th estimate is made: the fleet's are spread evenly, as those of separate hosts are."""
        return k * self.period_ns + vehicle * self.period_ns // self.vehicles


def namespace(vehicle: int) -> str:
    """Put before each key of one vehicle."""
    return f"fleet/v{vehicle:03d}"


class Wire(Protocol):
    """One end of a pipe between the trial and a process of it."""

    def send(self, obj: Any, /) -> None: ...
    def recv(self) -> Any: ...


def begin(wire: Wire) -> int:
    """Say "ready" and wait for the start: the instant of CLOCK_MONOTONIC (ns) that is the fleet's t = 0."""
    wire.send("ready")
    start: int = wire.recv()
    return start


def now_ns(start_ns: int) -> int:
    """The fleet's time: CLOCK_MONOTONIC is one for all processes of a host."""
    return time.monotonic_ns() - start_ns
