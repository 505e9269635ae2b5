"""Estimates with velocities or yaw rates of another kind: the vehicle is steered by its positions and headings."""

from __future__ import annotations

import cmath
import math
from itertools import cycle

import msgspec
import pytest

from benchmarks.strangers.flight import Conditions, Ours, Start, fly, load
from benchmarks.strangers.tasks import TASKS, figures
from ltv_mpc.messages import Applied, Estimate
from ltv_mpc.references import Point

CURRENT_MPS = 0.25


class Slipped(Ours):
    """Pilot whose estimates have a slip."""

    def __init__(self, name: str, slip) -> None:
        super().__init__(load(name)[1], Point(north_m=4.0, east_m=3.0))
        self._slip, self.said = slip, []

    def plan(self, estimate: Estimate, t_ns: int, applied: Applied | None):
        """Return the plan of one cycle."""
        given = msgspec.structs.replace(estimate, **self._slip(estimate))
        plan = super().plan(given, t_ns, applied)
        self.said.append((t_ns * 1e-9, self.controller.health(t_ns).why))
        return plan


def of_velocity(given):
    """Return the slip of a velocity: ``given`` makes it from the right one, north + j east, and the heading."""

    def slip(e: Estimate) -> dict[str, float]:
        velocity = given(complex(e.velocity_north_mps, e.velocity_east_mps), e.heading_rad)
        return {"velocity_north_mps": velocity.real, "velocity_east_mps": velocity.imag}

    return slip


SLIPS = {
    "no velocity": of_velocity(lambda v, _: 0.0 * v),
    "velocity in knots": of_velocity(lambda v, _: v * 3600.0 / 1852.0),
    "velocity along the axes": of_velocity(lambda v, heading: v * cmath.exp(-1j * heading)),
    "velocity through the water": of_velocity(lambda v, _: v - CURRENT_MPS),
    "no yaw rate": lambda _: {"yaw_rate_radps": 0.0},
    "yaw rate of the other sign": lambda e: {"yaw_rate_radps": -e.yaw_rate_radps},
    "yaw rate in degrees": lambda e: {"yaw_rate_radps": math.degrees(e.yaw_rate_radps)},
}


@pytest.mark.parametrize(("name", "slip"), list(zip(cycle(("ellipsoid", "light_boat")), SLIPS, strict=False)))
def test_a_stranger_holds_its_point_with_rates_that_are_not_those_of_its_motion(name, slip):
    """Once 13 to 60 m off with most of them, and `nominal` for a third of the time."""
    pilot, conditions = Slipped(name, SLIPS[slip]), Conditions(current_mps=CURRENT_MPS, reports_s=0.0)
    flight = fly(name, pilot, conditions, Start.drawn(1, 0.3), duration_s=100.0)
    found = figures(TASKS["hold"], flight, conditions, load(name)[0].max_N)
    assert found.mean_m < 0.15
    assert found.wrongly_nominal == 0.0
    kind = "yaw rates of the estimates" if "yaw" in slip else "velocities of the estimates"
    assert next(t for t, why in pilot.said if kind in why) < 10.0
    assert not math.isinf(found.arrival_s)


def test_positions_that_come_each_5_s_are_moved_on_and_nothing_that_was_learned_is_forgotten():
    seen: list[Estimate] = []

    def each_5_s(e: Estimate) -> dict[str, float]:
        if not seen or e.t_ns - seen[-1].t_ns >= 5_000_000_000:
            seen.append(e)
        return {"north_m": seen[-1].north_m, "east_m": seen[-1].east_m}

    pilot, conditions = Slipped("light_boat", each_5_s), Conditions(current_mps=CURRENT_MPS, reports_s=0.0)
    observer = pilot.controller.observer
    flight = fly("light_boat", pilot, conditions, Start.drawn(1, 0.3), duration_s=40.0)
    assert flight.distance_m((4.0, 3.0), 20.0, 40.0).max() < 0.5
    assert pilot.controller.observer is observer
