"""Types that the settings of several sensors share.

Standard deviations are 1 sigma. A bias is constant, or drifts as a first-order Gauss-Markov process with its time
constant; its standard deviation is that of the ensemble. ``latency_ns`` is the time from a measurement's validity to
its arrival. ``lever_arm_m`` is measured from the vehicle's origin, in body axes (forward, starboard, down).
"""

from __future__ import annotations

from typing import Annotated, TypeAlias

import msgspec
from msgspec import Meta

Period: TypeAlias = Annotated[int, Meta(ge=1_000_000, le=3_600_000_000_000)]
Sd: TypeAlias = Annotated[float, Meta(ge=0, le=1e3)]
PositiveSd: TypeAlias = Annotated[float, Meta(gt=0, le=1e3)]
Seconds: TypeAlias = Annotated[float, Meta(gt=0, le=1e9)]
Share: TypeAlias = Annotated[float, Meta(ge=0, le=0.5)]
Latency: TypeAlias = Annotated[int, Meta(ge=0, le=1_000_000_000)]
Coordinate: TypeAlias = Annotated[float, Meta(ge=-1e5, le=1e5)]
Position: TypeAlias = tuple[Coordinate, Coordinate, Annotated[float, Meta(ge=-10, le=12_000)]]
Offset: TypeAlias = Annotated[float, Meta(ge=-50, le=50)]
Lever: TypeAlias = tuple[Offset, Offset, Offset]
Angle: TypeAlias = Annotated[float, Meta(ge=-6.2832, le=6.2832)]
Angles: TypeAlias = tuple[Angle, Angle, Angle]


class Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Base of a table of the sensors file."""


class SensorSettings(Table, frozen=True, kw_only=True):
    """Base of the settings of a sensor, which measures at the multiples of its period."""

    period_ns: Period


def latency_ns(settings: SensorSettings) -> int | None:
    """Return the latency (ns) of a sensor; None if it differs from message to message."""
    return getattr(settings, "latency_ns", None)
