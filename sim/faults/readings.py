"""Measured fields of each sensor message, with the bias and the range of a faulty sensor."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import msgspec
import numpy as np

from ltv_mpc.messages import AdcpPing, CompassHeading, GnssFix, ImuSample, Message, PressureDepth, TdcpFix


class Reading(NamedTuple):
    """Measured field of a message, in SI units."""

    field: str
    bias: float  # of a faulty sensor of this kind
    garbage: float  # random values lie within +- this


READINGS: Mapping[type[Message], tuple[Reading, ...]] = {
    ImuSample: (Reading("angular_rate_radps", 0.02, 2.0), Reading("specific_force_mps2", 0.1, 20.0)),
    AdcpPing: (Reading("beam_velocity_mps", 0.2, 3.0),),
    CompassHeading: (Reading("heading_rad", 0.5, 3.0),),
    PressureDepth: (Reading("depth_m", 3.0, 100.0),),
    GnssFix: (Reading("north_m", 20.0, 1000.0), Reading("east_m", 20.0, 1000.0)),
    TdcpFix: (Reading("north_m", 0.5, 50.0), Reading("east_m", 0.5, 50.0)),
}
"""Readings by type. The biases are a few to a hundred times those of a good sensor of the shipped files."""

TIMES = ("t_ns", "from_t_ns", "interval_ns")


def changed(signal: Message, change: Callable[[Reading, Any], Any]) -> Message:
    """Return the message with each measured value replaced by ``change(reading, value)``, of equal shape and type."""
    values: dict[str, Any] = {}
    for reading in READINGS[type(signal)]:
        old = getattr(signal, reading.field)
        new = change(reading, np.asarray(old, dtype=np.float64))
        values[reading.field] = tuple(new.tolist()) if isinstance(old, tuple) else new if np.ndim(old) else float(new)
    return msgspec.structs.replace(signal, **values)


def restamped(old: Message, now: Message) -> Message:
    """Return the reading of ``old`` with the stamps of ``now``."""
    times = {name: getattr(now, name) for name in TIMES if name in now.__struct_fields__}
    return msgspec.structs.replace(old, **times)
