"""Actuators that refuse every plan for 20 s: the controller's health is degraded meanwhile, with the reason."""

from __future__ import annotations

from typing import Any

from ltv_mpc.messages import Health, Plan
from tests.foreign_plant.flight import Figure, Flight, distance_m

REFUSED_S, SPENT_S = 20.0, 30.0


class Refusing(Flight):
    """Flight whose actuators refuse plans while ``refusing``."""

    refusing = False

    def accepts(self, plan: dict[str, Any]) -> bool:
        del plan
        return not self.refusing


def run() -> list[Figure]:
    """Return the times to the change of the health, both ways, and what the health was else."""
    flight = Refusing()
    flight.command(action="arm")
    flight.fly(30.0)
    before = flight.plans
    flight.refusing, flight.plans = True, []
    flight.fly(REFUSED_S)
    refused = flight.plans
    flight.refusing, flight.plans = False, []
    flight.fly(SPENT_S)
    after = flight.plans
    reasons = {plan.health_why for plan in refused if plan.health is Health.DEGRADED}
    return [
        Figure("plans not nominal before", _count(before[10:], nominal=False), 0, ""),
        Figure("time to degraded", _time_s(refused, nominal=False), 1.5, "s"),
        Figure("reasons other than the actuators'", len(reasons ^ {"the actuators reject plans"}), 0, ""),
        Figure("time to nominal again", _time_s(after, nominal=True), 1.5, "s"),
        Figure("distance 10 s after", float(distance_m(flight.track[-1000:]).max()), 0.3, "m"),
    ]


def _count(plans: list[Plan], *, nominal: bool) -> int:
    return sum((plan.health is Health.NOMINAL) is nominal for plan in plans)


def _time_s(plans: list[Plan], *, nominal: bool) -> float:
    """Return the time from the first plan to the one from which on all are nominal, or none is."""
    last = max((plan.cycle_t_ns for plan in plans if (plan.health is Health.NOMINAL) is not nominal), default=None)
    return 0.0 if last is None else (last - plans[0].cycle_t_ns) * 1e-9 + 0.3
