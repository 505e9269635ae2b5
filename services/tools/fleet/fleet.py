"""Common settings of the processes of a fleet: names, rates and time."""

from __future__ import annotations

import time
from typing import Any, Protocol

import msgspec


class Fleet(msgspec.Struct, frozen=True, kw_only=True):
    """Settings of one fleet trial."""

    vehicles: int
    vehicle: str  # NAME or FILE
    rate_hz: float  # estimates, and so plans, a second of each
    seconds: float  # that are measured
    warm_up_s: float  # before them
    horizon_s: float | None  # None: the one that suits the vehicle
    router: str  # endpoint

    @property
    def period_ns(self) -> int:
        """Return the period of the estimates of one vehicle (ns)."""
        return round(1e9 / self.rate_hz)

    def due_ns(self, vehicle: int, k: int) -> int:
        """Return when a vehicle's k-th estimate is due (ns); the vehicles are spread evenly over the period."""
        return k * self.period_ns + vehicle * self.period_ns // self.vehicles


def namespace(vehicle: int) -> str:
    """Return the prefix of one vehicle's keys."""
    return f"fleet/v{vehicle:03d}"


class Wire(Protocol):
    """One end of a pipe between the trial and a process of it."""

    def send(self, obj: Any, /) -> None: ...
    def recv(self) -> Any: ...


def wait_for_start(wire: Wire) -> int:
    """Report "ready" and wait for the start: the CLOCK_MONOTONIC time (ns) of the fleet's t = 0."""
    wire.send("ready")
    start: int = wire.recv()
    return start


def now_ns(start_ns: int) -> int:
    """Return the fleet's time (ns); CLOCK_MONOTONIC is common to all processes of a host."""
    return time.monotonic_ns() - start_ns
