"""Measurement schedule of the sensors from the first satellite fix on, without latencies."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from ltv_mpc.localisation.sensor_config import SensorConfig

TOGETHER_S = 0.02
"""Largest distance of measurements that share one instant (s), such as a fix at 1 s and a ping at 0.999999999 s."""


class Events(NamedTuple):
    """Measurements of one instant."""

    t_s: float
    kinds: frozenset[str]
    depths: int  # number of pressure readings


def schedule(
    sensor_config: SensorConfig, extra: Sequence[float], surface_s: float, without: Collection[str]
) -> list[Events]:
    """Return all instants from the first satellite fix to the last requested one.

    ``extra`` are the requested times (s), ``surface_s`` is the time at the surface before t = 0, and ``without`` are
    missing sensors. Pressure readings count at the nearest instant.
    """
    last = max(extra)
    gnss_s = sensor_config.gnss.period_ns * 1e-9
    first = -math.floor(surface_s / gnss_s + 1e-9) * gnss_s
    due: list[tuple[float, str]] = [(t, "") for t in extra]
    for kind, period_ns, until in (
        ("gnss", sensor_config.gnss.period_ns, 0.0),
        ("tdcp", sensor_config.tdcp.period_ns, 0.0),
        ("adcp", sensor_config.adcp.period_ns, last),
        ("compass", sensor_config.compass.period_ns, last),
    ):
        h = period_ns * 1e-9
        if kind not in without:
            due += [(k * h, kind) for k in range(math.ceil(first / h - 1e-6), math.floor(until / h + 1e-6) + 1)]
    due = sorted((min(max(t, first), last), kind) for t, kind in due)
    groups: list[tuple[float, set[str]]] = []
    for t, kind in due:
        if not groups or t - groups[-1][0] > TOGETHER_S:
            groups.append((0.0 if abs(t) <= TOGETHER_S else t, set()))
        groups[-1][1].add(kind)
    times = np.array([t for t, _ in groups])
    depths = np.zeros(len(times), dtype=int)
    if "pressure" not in without:
        h = sensor_config.pressure.period_ns * 1e-9
        readings = h * np.arange(math.ceil(first / h - 1e-6), math.floor(last / h + 1e-6) + 1)
        nearest = np.searchsorted(0.5 * (times[1:] + times[:-1]), readings)
        np.add.at(depths, nearest, 1)
    return [Events(t, frozenset(kinds), int(n)) for (t, kinds), n in zip(groups, depths, strict=True)]
