"""Processor time of a cycle with a new report of an anchored ship beside a long mission, and of one without.

.venv/bin/python -m benchmarks.long_mission [WAYPOINTS]
"""

from __future__ import annotations

import statistics
import sys
import time

import numpy as np
from msgspec import structs

from ltv_mpc import Controller, Estimate, Vehicle, references
from ltv_mpc.messages import Obstacle, Obstacles

CYCLES, SCATTER_M = 40, 1.0
STEP_NS = 300_000_000


def cycle_ms(waypoints: int) -> tuple[float, float]:
    """Return the medians (ms) of cycles without and with a report, whose positions scatter by ``SCATTER_M``."""
    at = np.arange(waypoints)
    places = np.column_stack([50.0 * np.sin(0.2 * at), 3.0 * at])
    path = tuple(references.Waypoint(north_m=north, east_m=east) for north, east in places.tolist())
    controller = Controller(Vehicle.load("surface"), references.Waypoints(waypoints=path, speed_mps=1.0))
    rng, times = np.random.default_rng(0), {False: list[float](), True: list[float]()}
    for k in range(CYCLES):
        t_ns, reports = k * STEP_NS, k % 2 == 1
        if reports:
            north, east = (places[waypoints // 2] + rng.normal(0.0, SCATTER_M, 2)).tolist()
            place = {"north_m": north, "east_m": east, "velocity_north_mps": 0.0, "velocity_east_mps": 0.0}
            ship = Obstacle(id=1, t_ns=t_ns, radius_m=5.0, **place)
            controller.add_obstacles(Obstacles(t_ns=t_ns, obstacles=(ship,)))
        begin = time.process_time()
        controller.plan(structs.replace(Estimate.at_rest(), t_ns=t_ns))
        times[reports].append(1e3 * (time.process_time() - begin))
    without, reported = (statistics.median(each[CYCLES // 4 :]) for each in times.values())
    return without, reported


if __name__ == "__main__":
    without_ms, reported_ms = cycle_ms(int(sys.argv[1]) if len(sys.argv) > 1 else 10_000)
    print(
        f"{without_ms:.1f} ms a cycle, {reported_ms:.1f} ms with a report: {reported_ms - without_ms:.1f} ms a report"
    )
