"""Hold of a point from 3.6 m away, with and without reports of the actuators."""

from __future__ import annotations

from tests.foreign_plant.flight import Figure, Flight, distance_m


def run() -> list[Figure]:
    """Return the largest distance from the point after it was reached."""
    return [
        Figure("distance, actuators report", _farthest_m(reports=True), 0.3, "m"),
        Figure("distance, no reports", _farthest_m(reports=False), 0.3, "m"),
    ]


def _farthest_m(*, reports: bool) -> float:
    flight = Flight(reports=reports, heading_rad=1.0)
    flight.hull.x[0], flight.hull.x[1] = 3.0, -2.0
    flight.command(action="arm")
    flight.fly(40.0)
    return float(distance_m(flight.fly(50.0)).max())
