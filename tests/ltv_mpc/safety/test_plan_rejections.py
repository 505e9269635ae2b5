"""Rejections of plans by the actuators degrade the health of the controller."""

from __future__ import annotations

import msgspec

from ltv_mpc.control.node import PlanRejections
from ltv_mpc.messages import Applied, Health
from ltv_mpc.references import Point
from ltv_mpc.safety.health import NOMINAL
from tests.ltv_mpc import reports
from tests.ltv_mpc.control.flights import Flight

MS = 1_000_000
PERIOD_NS = 300 * MS


def report(rejected: int, health: Health = Health.NOMINAL) -> Applied:
    return reports.report(0, (0.0, 0.0, 0.0), plan_epoch=1, plan_sequence=0, plans_rejected=rejected, health=health)


def states(*counts: tuple[int, int]) -> list[bool]:
    """Return after each report whether the health is degraded; ``counts`` are its arrival (ms) and its count."""
    rejections, found = PlanRejections(PERIOD_NS), []
    for at_ms, rejected in counts:
        rejections.add(report(rejected), at_ms * MS)
        state = rejections.health(at_ms * MS)
        assert state in (NOMINAL, (Health.DEGRADED, "the actuators reject plans"))
        found.append(state is not NOMINAL)
    return found


def test_the_second_rejection_in_a_row_degrades_until_there_are_no_more() -> None:
    counts = (0, 0), (300, 1), (600, 2), (900, 3), (1650, 3), (1651, 3)
    assert states(*counts) == [False, False, True, True, True, False]


def test_one_rejection_now_and_then_is_nominal() -> None:
    assert not any(states(*((1000 * k, k) for k in range(50))))


def test_several_rejections_in_one_report_degrade_at_once() -> None:
    assert states((0, 7), (1000, 9)) == [False, True]


def test_rejections_before_the_first_report_or_a_restart_of_the_count_do_not_count() -> None:
    assert not any(states((0, 206), (100, 206), (200, 0), (300, 1)))


def test_the_end_of_the_last_plan_degrades_until_there_is_a_new_one() -> None:
    rejections = PlanRejections(PERIOD_NS)
    for health in (Health.NOMINAL, Health.DEGRADED, Health.FAILSAFE, Health.FAILSAFE, Health.NOMINAL):
        rejections.add(report(0, health), 0)
        assert ("no plan arrives at the actuators" in rejections.health(0).why) is (health is Health.FAILSAFE)


def test_a_node_says_that_its_plans_are_rejected() -> None:
    flight = Flight(Point(north_m=0.0, east_m=0.0))
    for rejected in range(4):
        plan = flight.step(msgspec.structs.replace(report(rejected), t_ns=flight.estimate.t_ns))
    assert (plan.health, plan.health_why) == (Health.DEGRADED, "the actuators reject plans")
