"""Estimates with velocities or yaw rates of another kind: the vehicle is steered by its positions and headings."""

from __future__ import annotations

import math

import msgspec
import pytest

from benchmarks.strangers.flight import Conditions, Ours, Start, fly, load
from benchmarks.strangers.tasks import TASKS, figures
from ltv_mpc.messages import Applied, Estimate
from ltv_mpc.references import Point
from tests.ltv_mpc.safety.test_installation_slips import ESTIMATES

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


SLIPS = {
    "no velocity": lambda _: {"velocity_north_mps": 0.0, "velocity_east_mps": 0.0},
    "through the water": lambda e: {"velocity_north_mps": e.velocity_north_mps - CURRENT_MPS},
    "no yaw rate": lambda _: {"yaw_rate_radps": 0.0},
    **{slip: ESTIMATES[slip] for slip in ESTIMATES if slip.startswith(("the vel", "the yaw"))},
}


@pytest.mark.parametrize("slip", SLIPS)
@pytest.mark.parametrize("name", ["light_boat", "ellipsoid"])
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
