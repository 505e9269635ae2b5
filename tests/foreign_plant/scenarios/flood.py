"""Flood of the key of the estimates in the craft's hold: 2,000 frames a second under another epoch, for 5 s."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from tests.foreign_plant.flight import Figure, Flight, distance_m
from tests.foreign_plant.plant import Sender

BEGIN_US, END_US = 25_000_000, 30_000_000
FRAMES = 200
"""Every tenth of a second."""


def run() -> list[Figure]:
    """Return the largest distance from the point and the largest number of frames that are decoded."""
    flight = Flood()
    flight.command(action="arm")
    flight.fly(25.0)
    before = flight.validator.received
    flight.fly(5.0)
    decoded = flight.validator.received - before
    flight.fly(15.0)
    late = sum(plan.cycle_t_ns - plan.estimate_t_ns > 250_000_000 for plan in flight.plans[10:])
    return [
        Figure("distance", float(distance_m(flight.track[1000:]).max()), 0.3, "m"),
        Figure("frames decoded a second", decoded / 5.0, 150.0, "frames"),
        Figure("estimates of the true publisher not used", float(late), 0.0, "cycles"),
    ]


class Flood(Flight):
    """Flight whose key of estimates is flooded with the position 2 m away."""

    def estimates(self, t_ns: int) -> Iterable[tuple[str, Sender, dict[str, Any]]]:
        published = list(super().estimates(t_ns))
        if BEGIN_US <= self.host_us < END_US:
            if not hasattr(self, "flooder"):
                self.flooder = Sender()
            fields = {**self.hull.estimate(t_ns), "north_m": self.hull.x[0] + 2.0}
            published += [("estimate", self.flooder, fields)] * FRAMES
        return published
