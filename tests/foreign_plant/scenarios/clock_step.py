"""Steps of the craft's clock in its hold, two-way (the actuators report) and one-way."""

from __future__ import annotations

from functools import cache

from tests.foreign_plant.flight import Figure, Flight, distance_m

STEPS_S = (-86_400.0, -5.0, -0.05, 0.05, 5.0, 86_400.0)


def run() -> list[Figure]:
    """Return the largest drift of all steps."""
    return [
        Figure("drift, two-way", max(drift_m(flown(s, reports=True)) for s in STEPS_S), 0.3, "m"),
        Figure("drift, one-way", max(drift_m(flown(s, reports=False)) for s in STEPS_S), 1.0, "m"),
    ]


@cache  # the tests read the same flights
def flown(step_s: float, *, reports: bool) -> Flight:
    """Return a flight of 35 s with a step of the craft's clock after 20 s."""
    flight = Flight(reports=reports, delay_us=20_000)  # a longer exchange would not tell a step of 0.05 s
    flight.command(action="arm")
    flight.fly(20.0)
    flight.set_clock(step_s)
    flight.fly(15.0)
    return flight


def drift_m(flight: Flight) -> float:
    """Return the largest distance from the point after 20 s."""
    return float(distance_m(flight.track[1000:]).max())
