"""Dropouts of the estimates in the craft's hold: 5 s, which the prediction carries, and 30 s, after which it stops."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from math import hypot
from typing import Any

from tests.foreign_plant.flight import Figure, Flight, distance_m
from tests.foreign_plant.plant import Sender

CHANGES = ("nominal", "degraded", "hold", "failsafe", "nominal")
"""Health of the plans from before the long dropout until after it."""


class Dropout(Flight):
    """Flight whose navigation system can fall silent."""

    silent = False

    def estimates(self, t_ns: int) -> Iterable[tuple[str, Sender, dict[str, Any]]]:
        """Return the estimates published now; none while it is silent."""
        return () if self.silent else super().estimates(t_ns)

    def speed_mps(self) -> float:
        """Return the horizontal speed through the water."""
        return hypot(*self.hull.x[7:9])


def run() -> list[Figure]:
    """Return drift, speed, and how often a change of the health was not told exactly once."""
    flight = Dropout()
    flight.command(action="arm")
    flight.fly(20.0)
    flight.silent = True
    short = flight.fly(5.0)
    flight.silent = False
    after = flight.fly(10.0)
    began = len(flight.plans) - 1
    flight.silent = True
    flight.fly(20.5)  # until it lets go
    held_mps = flight.speed_mps()
    flight.fly(9.5)
    flight.silent = False
    flight.fly(1.0)
    states = [(plan.health.value, plan.health_why) for plan in flight.plans[began:]]
    told = tuple(health for (health, _), _ in groupby(states))
    return [
        Figure(
            "5 s without estimates, and after: distance", float(max(*distance_m(short), *distance_m(after))), 0.15, "m"
        ),
        Figure("30 s without estimates: speed as it lets go", held_mps, 0.1, "m/s"),
        Figure(
            "30 s without estimates: changes told wrongly", abs(len(told) - len(CHANGES)) + (told != CHANGES), 0, ""
        ),
    ]
