"""Second publisher of estimates in the craft's hold: ten seconds, another epoch, 30 m away; with and without a gap."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from tests.foreign_plant.flight import Figure, Flight, distance_m
from tests.foreign_plant.plant import Sender

BEGIN_US, END_US = 25_000_000, 35_000_000
GAP_US = 28_000_000, 29_200_000
"""Silence of the true publisher meanwhile."""


def run() -> list[Figure]:
    """Return the largest distance from the point, and the time in which the true publisher is not used."""
    beside, in_gap = SecondSource(), SecondSource()
    in_gap.gap_us = GAP_US
    one_way = SecondSource(reports=False)
    for flight in (beside, in_gap, one_way):
        flight.command(action="arm")
        flight.fly(50.0)
    farthest = [float(distance_m(flight.track[1000:]).max()) for flight in (beside, in_gap, one_way)]
    return [
        Figure("distance", farthest[0], 0.3, "m"),
        Figure("distance, true publisher silent for 1.2 s", farthest[1], 0.3, "m"),
        Figure("distance, actuators do not report", farthest[2], 0.3, "m"),
        Figure("estimates of the true publisher not used", float(beside.locked_out), 0.0, "cycles"),
        Figure("cycles that do not report it", float(beside.not_reported), 4.0, "cycles"),
    ]


class SecondSource(Flight):
    """Flight with a second publisher."""

    gap_us = (0, 0)

    def estimates(self, t_ns: int) -> Iterable[tuple[str, Sender, dict[str, Any]]]:
        begin_us, end_us = self.gap_us
        published = [] if begin_us <= self.host_us < end_us else list(super().estimates(t_ns))
        if BEGIN_US <= self.host_us < END_US:
            if not hasattr(self, "second"):
                self.second = Sender()
            fields = self.hull.estimate(t_ns)
            published.append(("estimate", self.second, {**fields, "north_m": fields["north_m"] + 30.0}))
        return published

    @property
    def locked_out(self) -> int:
        """Number of cycles whose estimate is not the newest of the true publisher."""
        return sum(plan.cycle_t_ns - plan.estimate_t_ns > 250_000_000 for plan in self.plans[10:])

    @property
    def not_reported(self) -> int:
        """Number of cycles beside the second publisher whose health does not say so."""
        first_ns = self.plans[0].cycle_t_ns - 500_000_000
        within = [p for p in self.plans if BEGIN_US <= (p.cycle_t_ns - first_ns) // 1000 < END_US]
        return sum("second source on estimate" not in plan.health_why for plan in within)
