"""What an instrument's message measures, and how far off a broken one is: the only place where that is said."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import msgspec
import numpy as np

from ltv_mpc.messages import AdcpPing, CompassHeading, GnssFix, ImuSample, Message, PressureDepth, TdcpFix


class Reading(NamedTuple):
    """One measured field: a bias that a broken instrument of its kind has, and the range of what it raves (SI)."""

    field: str
    bias: float
    raves: float


READINGS: Mapping[type[Message], tuple[Reading, ...]] = {
    ImuSample: (Reading("angular_rate_radps", 0.02, 2.0), Reading("specific_force_mps2", 0.1, 20.0)),
    AdcpPing: (Reading("beam_velocity_mps", 0.2, 3.0),),
    CompassHeading: (Reading("heading_rad", 0.5, 3.0),),
    PressureDepth: (Reading("depth_m", 3.0, 100.0),),
    GnssFix: (Reading("north_m", 20.0, 1000.0), Reading("east_m", 20.0, 1000.0)),
    TdcpFix: (Reading("north_m", 0.5, 50.0), Reading("east_m", 0.5, 50.0)),
}
"""Biases of a few to a hundred times what a good instrument of the shipped files has."""

TIMES = ("t_ns", "from_t_ns", "interval_ns")


def changed(signal: Message, change: Callable[[Reading, Any], Any]) -> Message:
    """The signal with ``change(reading, value)`` in place of each measured value, of the same shape and type."""
    values: dict[str, Any] = {}
    for reading in READINGS[type(signal)]:
        old = getattr(signal, reading.field)
        new = change(reading, np.asarray(old, dtype=np.float64))
        values[reading.field] = tuple(new.tolist()) if isinstance(old, tuple) else new if np.ndim(old) else float(new)
    return msgspec.structs.replace(signal, **values)


def restamped(old: Message, now: Message) -> Message:
    """What ``old`` measured, at the time of ``now``."""
    times = {name: getattr(now, name) for name in TIMES if name in now.__struct_fields__}
    return msgspec.structs.replace(old, **times)
