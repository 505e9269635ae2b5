"""Changes of a controller's state are told once each."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from ltv_mpc.messages import Authority, FenceInForce, FenceReport, Health, ZoneInForce
from services.runtime.controller_changes import ControllerChanges, FenceChanges
from tests.ltv_mpc.reports import report
from tests.services.controller_status import status
from tests.services.edges.plans import plan

PLAN = plan(7)
STATUS = msgspec.structs.replace(status(), t_ns=5, authority=Authority.CONTROLLER, health=Health.NOMINAL, health_why="")
Told = list[tuple[str, str, str, int, dict[str, Any]]]


@pytest.fixture
def told() -> Told:
    return []


@pytest.fixture
def changes(told: Told) -> ControllerChanges:
    def tell(level: str, kind: str, text: str, *, t_ns: int, fields: dict[str, Any]) -> None:
        told.append((level, kind, text, t_ns, fields))

    return ControllerChanges(tell)


def test_health_is_told_at_each_change_of_state_or_reason(changes: ControllerChanges, told: Told) -> None:
    for health, why in (
        *[("nominal", "")] * 3,
        *[("degraded", "the estimates are too old")] * 3,
        *[("degraded", "second source")] * 3,
        *[("failsafe", "the estimates are too old")] * 3,
        ("nominal", ""),
    ):
        changes.on_message(msgspec.structs.replace(PLAN, health=Health(health), health_why=why))
    assert [(level, text) for level, kind, text, _, _ in told if kind == "health"] == [
        ("info", "health: nominal"),
        ("warning", "health: degraded (the estimates are too old)"),
        ("warning", "health: degraded (second source)"),
        ("error", "health: failsafe (the estimates are too old)"),
        ("info", "health: nominal"),
    ]
    assert told[-1][3:] == (7, {"health": "nominal", "why": ""})


def test_a_status_tells_again_nothing_that_a_plan_has_told(changes: ControllerChanges, told: Told) -> None:
    changes.on_message(PLAN)
    assert [text for _, _, text, _, _ in told] == ["health: nominal", "authority: controller"]
    for _ in range(10):
        changes.on_status(STATUS)
        changes.on_message(PLAN)
    assert len(told) == 2
    changes.on_status(msgspec.structs.replace(STATUS, authority=Authority.STOPPED))
    assert told[2:] == [("info", "authority", "authority: stopped", 5, {"authority": "stopped"})]


def test_the_source_of_the_estimates_is_told_when_it_or_its_publisher_changes(changes, told) -> None:
    for source, epoch in (("", 0), ("default", 7), ("default", 7), ("default", 8), ("usbl", 9), ("usbl", 9)):
        changes.on_status(msgspec.structs.replace(STATUS, source=source, source_epoch=epoch))
    assert [(text, fields) for _, kind, text, _, fields in told if kind == "source"] == [
        ("source of the estimates: default, epoch 7", {"source": "default", "epoch": 7}),
        ("source of the estimates: default, epoch 8", {"source": "default", "epoch": 8}),
        ("source of the estimates: usbl, epoch 9", {"source": "usbl", "epoch": 9}),
    ]


def test_rejections_are_told_by_reason_at_one_ten_a_hundred(changes: ControllerChanges, told: Told) -> None:
    for second in range(1, 251):
        changes.on_status(msgspec.structs.replace(STATUS, rejected={"out of order": second, "north_m": 1}))
    rejected = [(text, fields) for _, kind, text, _, fields in told if kind == "rejected"]
    assert rejected == [
        ("rejected: out of order", {"reason": "out of order", "count": 1}),
        ("rejected: north_m", {"reason": "north_m", "count": 1}),
        ("rejected: out of order: 10 so far", {"reason": "out of order", "count": 10}),
        ("rejected: out of order: 100 so far", {"reason": "out of order", "count": 100}),
    ]


def test_plans_rejected_and_late_are_counted_from_the_first_report_on(changes: ControllerChanges, told: Told) -> None:
    for rejected, late in ((206, 3), (206, 3), (207, 3), (220, 4), (0, 0), (1, 0), (90, 0)):
        changes.on_message(report(9, (0, 0, 0), plans_rejected=rejected, plans_late=late))
    assert [(level, kind, text) for level, kind, text, _, _ in told] == [
        ("warning", "plans", "plans rejected by the actuators"),
        ("warning", "plans", "plans rejected by the actuators: 14 so far"),
        ("warning", "plans", "plans late at the actuators"),
        ("warning", "plans", "plans rejected by the actuators: 104 so far"),
    ]


def test_zones_and_margins_are_reported_when_they_are_entered_and_left(changes: ControllerChanges, told: Told) -> None:
    buoy = 'keep_out_disc[0] "buoy"'
    reports = (
        {"in_margin": (buoy,)},
        {"in_margin": (buoy,), "inside": (buoy,)},
        {"in_margin": (buoy,), "inside": (buoy,)},
        {"in_margin": (buoy,)},
        {"dropped": (12,)},
        {"exceeded": 3},
        {"exceeded": 8},
        {"no_way": True, "skipped_m": 4.0},
        {"skipped_m": 4.0, "time_to_zone_ns": 85_000_000_000},
        {"skipped_m": 4.0, "time_to_zone_ns": 84_000_000_000},
    )
    changes.on_message(PLAN)
    del told[:]
    for fence in reports:
        changes.on_message(msgspec.structs.replace(PLAN, fence=FenceReport(clearance_m=5.0, **fence)))
    assert [(level, text) for level, _, text, _, _ in told] == [
        ("warning", f"margin entered: {buoy}"),
        ("error", f"zone entered: {buoy}"),
        ("info", f"zone left: {buoy}"),
        ("info", f"margin left: {buoy}"),
        ("warning", "a report of obstacle 12 is dropped: too old, or ahead of the clock of the estimates"),
        ("warning", "the plan lacks more than 1 cm of a required clearance at 3 of its points"),
        ("info", "the plan keeps the required clearances again"),
        ("warning", "no way round the zones leads to the target"),
        ("warning", "the reference lies in a zone or its margin: 4.0 m are left out"),
        ("info", "a way to the target is found"),
        ("warning", "the hull will be in a zone or obstacle in 85 s"),
    ]


def test_another_fence_in_force_is_reported_once(changes: ControllerChanges, told: Told) -> None:
    """Also one whose zones have the same names; obstacles without a fence, and a repetition, are not reported."""

    def fence(t_ns: int, *keep_in: bool, north_m: float = 0.0) -> FenceInForce:
        vertices = np.array([[north_m, 0.0], [0.0, 5.0], [5.0, 0.0]])
        zones = (
            ZoneInForce(label=f"zone {of}", keep_in=inside, vertices_m=vertices, radius_m=0.0, margin_m=2.0)
            for of, inside in enumerate(keep_in)
        )
        return FenceInForce(t_ns=t_ns, hull_radius_m=1.0, zones=tuple(zones))

    both = True, False, False
    for message in (fence(0), fence(1, *both), fence(2, *both), fence(3, *both, north_m=1.0), fence(4), fence(5)):
        changes.on_message(message)
    text = "fence in force: 1 keep-in and 2 keep-out zones"
    assert told == [
        ("info", "fence", text, 1, {}),
        ("info", "fence", text, 3, {}),
        ("info", "fence", "no fence in force", 4, {}),
    ]


def test_the_time_to_a_zone_is_reported_below_each_bound_once_until_it_is_far_again():
    reporter, told = FenceChanges(), []
    for time_s in (None, 500, 310, 243, 280, 61, 59, 70, 59, 22, 19, 25, 19, 31, 19, None, 15, 400, 451, 299, None):
        time_ns = None if time_s is None else time_s * 1_000_000_000
        for level, text in reporter.update(FenceReport(clearance_m=5.0, time_to_zone_ns=time_ns)):
            told.append((level, time_s))
            assert text == f"the hull will be in a zone or obstacle in {time_s} s"
    assert told == [("warning", time_s) for time_s in (243, 59, 19, 19, 15, 299)]
