"""Restart of the publisher of the estimates in the craft's hold: a new epoch, also with a clock of its own."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from tests.foreign_plant.flight import Figure, Flight, distance_m
from tests.foreign_plant.plant import Sender

BEHIND_S = (0.0, -0.5, -5.0, 60.0)
"""Clock of the restarted publisher relative to that of the craft."""


def run() -> list[Figure]:
    """Return the largest age of the estimate in use, and the largest distance from the point."""
    figures = []
    for reports, way in ((True, "two-way"), (False, "one-way")):
        flights = [restarted(behind_s, reports=reports) for behind_s in BEHIND_S]
        farthest = max(float(distance_m(flight.track[1000:]).max()) for flight in flights)
        figures += [
            Figure(f"age of the estimate in use, {way}", max(flight.oldest_s for flight in flights), 1.5, "s"),
            Figure(f"distance, {way}", farthest, 0.3, "m"),
        ]
    return figures


class Restarted(Flight):
    """Flight whose publisher of estimates starts again, at once, after 25 s."""

    behind_s = 0.0
    oldest_s = 0.0
    """Largest age of the estimate in use since then."""

    def estimates(self, t_ns: int) -> Iterable[tuple[str, Sender, dict[str, Any]]]:
        if self.host_us < 25_000_000:
            return super().estimates(t_ns)
        if not hasattr(self, "restarted"):
            self.restarted = Sender()
        if self.plans:
            plan = self.plans[-1]
            self.oldest_s = max(self.oldest_s, (plan.cycle_t_ns - plan.estimate_t_ns) * 1e-9)
        return [("estimate", self.restarted, self.hull.estimate(t_ns + round(self.behind_s * 1e9)))]


def restarted(behind_s: float, *, reports: bool) -> Restarted:
    """Return a flight of 32 s."""
    flight = Restarted(reports=reports)
    flight.behind_s = behind_s
    flight.command(action="arm")
    flight.fly(32.0)
    return flight
