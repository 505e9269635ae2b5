"""Node status: queue delay counts always, transit only if the clock runs faster than real time."""

from __future__ import annotations

from typing import Any

import pytest

from ltv_mpc.messages import Battery, ClockState, Estimate, GnssFix, Leak, Manual, UsblFix
from services.runtime.clock import ClockSegment, VehicleClock
from services.runtime.node_status import (
    HURRIED_PERIOD_US,
    MAX_BACKLOG_US,
    MAX_TRANSIT_US,
    NodeStatusReporter,
    WaitingFor,
)

MS = 1_000
SENT, WAY = 10**9, 70 * MS


def running(speed: int) -> VehicleClock:
    clock = VehicleClock()
    clock.set_segment(ClockSegment(0, 0, speed, 1, ClockState.RUNNING))
    return clock


def behind(speed: int, *, sent_us: int = SENT, waits_us: int = 5 * MS) -> NodeStatusReporter:
    """Return the reporter after a message with 70 ms of transit that then waited."""
    nothing: Any = None
    report = NodeStatusReporter(
        "n", outbox=nothing, counts=nothing, mailbox=nothing, waiting=WaitingFor(running(speed), ()), say=print
    )
    report.due_us = 10**18
    report.on_delivery(sent_us, SENT + WAY, SENT + WAY + waits_us)
    return report


@pytest.mark.parametrize(
    ("speed", "sent_us", "waited_us"),
    [
        (10, SENT, WAY + 5 * MS),
        (1, SENT, 5 * MS),  # in real time a long link is a long link
        (10, 0, 5 * MS),  # not stamped
        (10, SENT + WAY - MAX_TRANSIT_US - 1, 5 * MS),  # stamped by another host's clock
    ],
)
def test_the_way_counts_faster_than_real_time_alone(speed: int, sent_us: int, waited_us: int) -> None:
    assert behind(speed, sent_us=sent_us).min_queue_delay_us == waited_us


def test_a_node_that_is_far_behind_reports_earlier() -> None:
    assert behind(1, waits_us=MAX_BACKLOG_US).due_us == 10**18
    late_us = MAX_BACKLOG_US + 1
    assert behind(1, waits_us=late_us).due_us == SENT + WAY + late_us + HURRIED_PERIOD_US


def test_the_queue_after_one_long_step_is_no_backlog() -> None:
    report = behind(1, waits_us=500 * MS)
    assert report.min_queue_delay_us == 500 * MS
    report.on_delivery(SENT, SENT + WAY, SENT + WAY + 2 * MS)
    report.on_delivery(SENT, SENT + WAY, SENT + WAY + 300 * MS)
    assert report.min_queue_delay_us == 2 * MS


@pytest.mark.parametrize(
    ("inputs", "node_waits", "says"),
    [
        ((GnssFix, UsblFix), None, "sensor/gnss, sensor/usbl"),  # all that it never heard of
        ((GnssFix, UsblFix), lambda: "imu", "imu"),  # a node's own account of its needs
        ((GnssFix, UsblFix), lambda: "", ""),  # begun: that this vehicle has no acoustic fixes is nothing to wait for
        ((Estimate, Battery, Leak, Manual), None, "estimate"),  # nor the instruments that a vehicle may lack
    ],
)
def test_what_a_process_waits_for_is_what_its_node_needs(inputs, node_waits, says) -> None:
    assert WaitingFor(running(1), inputs, node_waits=node_waits).text(SENT) == says
