"""Common settings of the processes of a fleet, and how a process waits for the start of the trial."""

from __future__ import annotations

import sys
import time
from typing import Annotated

import msgspec
from msgspec import Meta


class Fleet(msgspec.Struct, frozen=True, kw_only=True):
    """Settings of one fleet trial."""

    vehicles: Annotated[int, Meta(ge=1, le=1000)]
    processes: Annotated[int, Meta(ge=1, le=64)] = 1  # of controllers
    vehicle: str = "paper"  # NAME or FILE
    rate_hz: Annotated[float, Meta(ge=0.1, le=50.0)] = 10.0  # estimates, and so plans, a second of each
    seconds: Annotated[float, Meta(ge=1.0, le=3600.0)] = 20.0  # that are measured
    warm_up_s: Annotated[float, Meta(ge=0.0, le=600.0)] = 5.0  # before them
    horizon_s: Annotated[float, Meta(ge=0.3, le=120.0)] | None = None  # None: the one that suits the vehicle
    router: str  # endpoint

    @property
    def period_ns(self) -> int:
        """Return the period of the estimates of one vehicle (ns)."""
        return round(1e9 / self.rate_hz)

    @property
    def measured_ns(self) -> tuple[int, int]:
        """Return start and end of the measurement in the fleet's time (ns)."""
        return round(self.warm_up_s * 1e9), round((self.warm_up_s + self.seconds) * 1e9)

    def due_ns(self, vehicle: int, k: int) -> int:
        """Return when a vehicle's k-th estimate is due (ns); the vehicles are spread evenly over the period."""
        return k * self.period_ns + vehicle * self.period_ns // self.vehicles


def namespace(vehicle: int) -> str:
    """Return the prefix of one vehicle's keys."""
    return f"fleet/v{vehicle:03d}"


def wait_for_start() -> int:
    """Say that this process is ready and wait for the start: the CLOCK_MONOTONIC time (ns) of the fleet's t = 0."""
    print("ready", flush=True)
    return int(sys.stdin.readline())


def now_ns(start_ns: int) -> int:
    """Return the fleet's time (ns); CLOCK_MONOTONIC is common to all processes of a host."""
    return time.monotonic_ns() - start_ns
