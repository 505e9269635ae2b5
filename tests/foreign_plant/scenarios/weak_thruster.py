"""Starboard delivers a quarter of what it reports for a minute of the hold; a healthy and a weak lap of the square.

The healthy laps are flown with and without the current in the estimates. The craft's vehicle file is a data sheet, so
only the yaw moment tells of a loss: half of the small thrust of a hold is not found, and costs 2 cm.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from ltv_mpc.messages import ModelCheck
from tests.foreign_plant.flight import SQUARE, Figure, Flight, distance_m
from tests.foreign_plant.plant import Sender

SOUND = 1.0, 1.0


class CurrentKnown(Flight):
    """Flight whose estimates contain the current."""

    def estimates(self, t_ns: int) -> Iterable[tuple[str, Sender, dict[str, Any]]]:
        """Return the estimate with the true current."""
        north_mps, east_mps = self.hull.current
        current = {"depth_m": [0.0], "north_mps": [north_mps], "east_mps": [east_mps]}
        return [("estimate", self.sender, {**self.hull.estimate(t_ns), "current": current})]


def run() -> list[Figure]:
    """Return the delays of the report and of the recovery, the errors, and the evidence of the healthy lap."""
    hold = Flight()
    hold.command(action="arm")
    hold.fly(30.0)
    hold.hull.shares = 1.0, 0.25
    weak_m = distance_m(hold.fly(60.0)).max()
    hold.hull.shares = SOUND
    sound_m = distance_m(hold.fly(40.0)).max()
    begin_s = hold.plans[0].cycle_t_ns * 1e-9
    weak_s = [plan.cycle_t_ns * 1e-9 - begin_s for plan in hold.plans if "starboard thruster weak" in plan.health_why]
    healthy = square(Flight(), SOUND, 100.0)
    known_current = CurrentKnown()
    square(known_current, SOUND, 100.0)
    known = [message for message in known_current.outputs if isinstance(message, ModelCheck)]
    weak = square(Flight(), (0.25, 1.0), 30.0)
    return [
        Figure("hold at a quarter: health degraded after", min(weak_s, default=1e3) - 30.0, 15.0, "s"),
        Figure("hold at a quarter: distance", float(weak_m), 0.1, "m"),
        Figure("hold: nominal after the recovery", max(weak_s, default=1e3) - 90.0, 30.0, "s"),
        Figure("hold: distance after the recovery", float(sound_m), 0.05, "m"),
        Figure("degraded before the loss", float(sum(t < 30.0 for t in weak_s)), 0.0, "plans"),
        Figure("square: evidence without a loss", max(check.evidence for check in healthy), 6.0, "nats"),
        Figure("the same, hold and square, current known", max(check.evidence for check in known), 6.0, "nats"),
        Figure("square at 25 %: alarm after", first_alarm_s(weak), 10.0, "s"),
    ]


def square(flight: Flight, shares: tuple[float, float], seconds: float) -> list[ModelCheck]:
    """Return the model checks of a flight along the square, from 12 s after its begin with these shares on."""
    flight.command(action="arm")
    flight.fly(30.0)
    flight.command(action="follow", reference_toml=SQUARE.read_text())
    flight.fly(12.0)
    begin = len(flight.outputs)
    flight.hull.shares = shares
    flight.fly(seconds)
    return [message for message in flight.outputs[begin:] if isinstance(message, ModelCheck)]


def first_alarm_s(checks: list[ModelCheck]) -> float:
    """Return the time from the first of these checks to the first alarm (s); infinite if there is none."""
    return min((check.t_ns - checks[0].t_ns for check in checks if check.alarm), default=10**18) * 1e-9
