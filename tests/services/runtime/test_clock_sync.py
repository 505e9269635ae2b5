"""Synchronisation with the clocks of the other side: which clock is followed, and how stamps are converted."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import msgspec
import pytest

from ltv_mpc.messages import Applied, ClockMode, ClockState, ClockStep, Estimate
from services.runtime.clock import ClockSegment, VehicleClock
from services.runtime.clock_sync import GRACE_US, ClockSync
from tests.ltv_mpc.reports import report

YEARS_NS = 1_763_740_800_000_000_000  # Unix time of late 2025
EPOCH = 77
THEIRS = 5
"""Epoch of the other side."""


def estimate(t_ns: int) -> Estimate:
    return msgspec.structs.replace(Estimate.at_rest(), t_ns=t_ns)


def applied(t_ns: int, received_ns: int, sequence: int, epoch: int = EPOCH) -> Applied:
    return report(t_ns, (0, 0, 0), plan_epoch=epoch, plan_sequence=sequence, plan_received_t_ns=received_ns)


def begun() -> tuple[VehicleClock, ClockSync, int]:
    """Return an active synchronisation, by estimates delayed by 20 ms, and the time."""
    clock = VehicleClock()
    time = ClockSync(clock, epoch=EPOCH)
    for m_us in range(0, GRACE_US + 100_001, 100_000):
        assert clock.newest is None or m_us > GRACE_US
        assert time.check_stamp(estimate(YEARS_NS + (m_us - 20_000) * 1000), THEIRS, m_us) == ""
    return clock, time, m_us


@pytest.mark.parametrize(
    ("epoch", "sequence", "mode"), [(EPOCH, 3, "two-way"), (EPOCH, 4, "one-way"), (5, 3, "one-way")]
)
def test_only_the_receipt_of_a_plan_that_this_process_sent_makes_it_two_way(epoch, sequence, mode):
    clock, time, m_us = begun()
    assert time.active
    assert clock.read(m_us) == pytest.approx(YEARS_NS + (m_us - 20_000) * 1000, abs=100_000)
    time.on_plan_sent(3, m_us)
    report = applied(YEARS_NS + (m_us + 30_000) * 1000, YEARS_NS + (m_us + 20_000) * 1000, sequence, epoch)
    assert time.check_stamp(report, THEIRS, m_us + 50_000) == ""
    reading = time.offset(m_us + 50_000)
    assert reading.mode == mode
    if mode == "two-way":
        assert reading.offset_ns == pytest.approx(YEARS_NS, abs=200_000)
        assert reading.error_ns == pytest.approx(20_000_000, abs=200_000)
        assert clock.read(m_us + 50_000) == pytest.approx(YEARS_NS + (m_us + 50_000) * 1000, abs=200_000)


def test_a_receipt_that_contradicts_the_clock_is_rejected_with_its_reason():
    _, time, m_us = begun()
    time.on_plan_sent(3, m_us)
    report = applied(YEARS_NS + (m_us + 30_000) * 1000, YEARS_NS + (m_us - 500_000) * 1000, 3)
    assert time.check_stamp(report, THEIRS, m_us + 50_000).startswith("plan_received_t_ns contradicts")


def test_stamps_are_not_compared_with_our_clock_where_a_clock_is_published():
    clock = VehicleClock()
    time = ClockSync(clock, epoch=EPOCH)
    assert time.check_stamp(estimate(0), THEIRS, 0) == ""
    clock.set_segment(ClockSegment(0, 0, 10, 1, ClockState.RUNNING))
    for m_us in range(100_000, 5_000_000, 100_000):
        assert time.check_stamp(estimate(m_us * 10_000), THEIRS, m_us) == ""
    assert not time.active
    assert time.offset(m_us) == (ClockMode.SHARED, 0, 0)
    assert clock.read(m_us) == pytest.approx(m_us * 10_000, abs=600_000_000)


# --- steps, and clocks of their own ----------------------------------------------------------------------------------

NAVIGATION, ACTUATORS = 11, 12


@dataclass
class Link:
    """Exchange of messages at 10 Hz with publishers whose clocks can be set, over delays of 2 ms."""

    thetas: dict[int, int]
    """Offset of each publisher's clock (ns)."""
    reports: bool = True
    clock: VehicleClock = field(default_factory=VehicleClock)
    m_us: int = 0
    steps: list[ClockStep] = field(default_factory=list)
    reasons: Counter[str] = field(default_factory=Counter)
    sent: int = -1
    received: tuple[int, int] = (-1, 0)
    """Newest plan that the actuators have, and its arrival by their clock."""

    def __post_init__(self) -> None:
        self.sync = ClockSync(self.clock, epoch=EPOCH)

    def run(self, seconds: float) -> None:
        """Exchange messages, and hold vehicle time to m plus a constant."""
        for _ in range(round(10 * seconds)):
            navigation, actuators = next(iter(self.thetas)), list(self.thetas)[-1]
            now_us = self.m_us
            self._take(estimate(self.thetas[navigation] + now_us * 1000), navigation)
            if self.reports:
                stamp_ns = self.thetas[actuators] + now_us * 1000
                self._take(applied(stamp_ns, self.received[1], self.received[0]), actuators)
            if self.sync.active and now_us % 300_000 == 0:
                self.sent += 1
                self.sync.on_plan_sent(self.sent, now_us)
                self.received = self.sent, self.thetas[actuators] + (now_us + 2_000) * 1000
            self.m_us += 100_000
        self.steps += self.sync.take_steps()

    def _take(self, message: Estimate | Applied, epoch: int) -> None:
        self.reasons[self.sync.check_stamp(message, epoch, self.m_us + 2_000)] += 1

    @property
    def vehicle_time_ns(self) -> int:
        """Vehicle time minus m."""
        return self.clock.read(self.m_us) - self.m_us * 1000

    def stamp_error_ns(self, epoch: int) -> int:
        """Age that a stamp of this instant has in vehicle time."""
        stamp_ns = self.thetas[epoch] + self.m_us * 1000
        return self.clock.read(self.m_us) - stamp_ns - self.sync.shift_ns(epoch, self.m_us)

    def plan_error_ns(self, epoch: int) -> int:
        """Error of a plan's times by the clock of a publisher."""
        published_ns = self.clock.read(self.m_us) + self.sync.published_shift_ns
        return published_ns - self.thetas[epoch] - self.m_us * 1000


@pytest.mark.parametrize("step_s", [-86_400.0, -60.0, -5.0, -1.0, -0.05, 0.05, 1.0, 5.0, 86_400.0])
@pytest.mark.parametrize("reports", [True, False])
def test_vehicle_time_runs_on_over_a_step_and_plans_go_by_the_new_clock(step_s, reports):
    link = Link({THEIRS: YEARS_NS}, reports=reports)
    link.run(10.0)
    before_ns = link.vehicle_time_ns
    link.thetas[THEIRS] += round(step_s * 1e9)
    link.run(0.4 if step_s > 0 or step_s < -10 else 1.3)
    if step_s == -0.05 and not reports:
        assert not link.steps  # it cannot be told from a slower link
        return
    link.run(5.0)
    (step,) = link.steps
    assert step.step_ns == pytest.approx(step_s * 1e9, abs=5_000_000)
    assert step.publisher == THEIRS
    assert step.certain == (reports or step_s > 0 or step_s < -10)
    assert link.vehicle_time_ns == pytest.approx(before_ns, abs=5_000_000)
    assert link.stamp_error_ns(THEIRS) == pytest.approx(0, abs=5_000_000)
    assert link.plan_error_ns(THEIRS) == pytest.approx(0, abs=5_000_000)


def test_a_report_of_a_plan_from_before_a_step_is_rejected():
    """Its times come from two clocks."""
    link = Link({THEIRS: YEARS_NS})
    link.run(10.0)
    assert set(link.reasons) == {""}
    link.thetas[THEIRS] += 5_000_000_000
    link.run(5.0)
    assert 1 <= link.reasons["plan_received_t_ns is of a plan that was sent before the clock stepped"] <= 5


@pytest.mark.parametrize("apart_s", [-3600.0, -5.0, 0.3, 5.0, 86_400.0])
def test_two_publishers_may_have_clocks_of_their_own_and_plans_go_by_the_actuators(apart_s):
    link = Link({NAVIGATION: YEARS_NS + round(apart_s * 1e9), ACTUATORS: YEARS_NS})
    link.run(5.0)
    link.sync.follow_source(NAVIGATION, link.m_us)  # whichever source is in use
    link.run(1.0)
    assert link.steps == []
    for epoch in (NAVIGATION, ACTUATORS):
        assert link.stamp_error_ns(epoch) == pytest.approx(0, abs=10_000_000)
    assert link.plan_error_ns(ACTUATORS) == pytest.approx(0, abs=5_000_000)


@pytest.mark.parametrize("apart_s", [0.0, -3600.0, 86_400.0])
def test_a_publisher_of_other_messages_has_the_clock_of_the_estimates(apart_s):
    """As one of obstacles; also after that clock has been set."""
    link, obstacles = Link({NAVIGATION: YEARS_NS + round(apart_s * 1e9), ACTUATORS: YEARS_NS}), 13
    link.sync.follow_source(NAVIGATION, 0)
    assert link.sync.shift_ns(obstacles, 0) == 0
    for step_s in (0, 60):
        link.thetas[NAVIGATION] += step_s * 10**9
        link.run(10.0)
        now_ns = link.thetas[NAVIGATION] + link.m_us * 1000
        error_ns = link.clock.read(link.m_us) - now_ns - link.sync.shift_ns(obstacles, link.m_us)
        assert error_ns == pytest.approx(0, abs=10_000_000)


def test_two_publishers_on_one_clock_need_no_shift():
    link = Link({NAVIGATION: YEARS_NS}, reports=False)
    link.run(5.0)
    link.thetas, link.reports = {NAVIGATION: YEARS_NS, ACTUATORS: YEARS_NS}, True  # the actuators start later
    link.run(5.0)
    assert link.steps == []
    assert (link.sync.shift_ns(NAVIGATION, link.m_us), link.sync.published_shift_ns) == (0, 0)


def test_estimates_that_are_always_half_a_second_late_share_the_actuators_clock():
    link = Link({NAVIGATION: YEARS_NS - 500_000_000, ACTUATORS: YEARS_NS})
    link.run(10.0)
    assert link.steps == []
    assert link.stamp_error_ns(NAVIGATION) == pytest.approx(500_000_000, abs=5_000_000)


@pytest.mark.parametrize("stepping", [NAVIGATION, ACTUATORS])
@pytest.mark.parametrize("step_s", [-60.0, -2.0, -0.5, 2.0, 60.0])
def test_a_step_of_one_publishers_clock_leaves_the_other_in_use(stepping, step_s):
    link = Link({NAVIGATION: YEARS_NS, ACTUATORS: YEARS_NS})
    link.run(10.0)
    before_ns = link.vehicle_time_ns
    link.thetas[stepping] += round(step_s * 1e9)
    link.run(5.0)
    assert link.vehicle_time_ns == pytest.approx(before_ns, abs=5_000_000)
    for epoch in (NAVIGATION, ACTUATORS):
        assert link.stamp_error_ns(epoch) == pytest.approx(0, abs=10_000_000)
    assert link.plan_error_ns(ACTUATORS) == pytest.approx(0, abs=5_000_000)


def test_a_step_that_two_publishers_share_is_certain_where_reports_confirm_it():
    link = Link({NAVIGATION: YEARS_NS, ACTUATORS: YEARS_NS})
    link.run(10.0)
    link.thetas = {epoch: theta_ns - 2_000_000_000 for epoch, theta_ns in link.thetas.items()}
    link.run(5.0)
    assert {step.publisher for step in link.steps} == {NAVIGATION, ACTUATORS}
    assert all(step.certain for step in link.steps)
    assert link.stamp_error_ns(NAVIGATION) == pytest.approx(0, abs=10_000_000)


def test_two_sources_of_estimates_that_alternate_do_not_set_the_clock():
    """Vehicle time follows the first one until the estimates of the other are used, also while it is silent."""
    clock = VehicleClock()
    sync = ClockSync(clock, epoch=EPOCH)
    for m_us in range(0, 5_000_000, 100_000):
        for epoch, theta_ns in ((1, YEARS_NS), (2, YEARS_NS + 5_000_000_000)):
            assert sync.check_stamp(estimate(theta_ns + m_us * 1000), epoch, m_us) == ""
    assert sync.take_steps() == []
    before_ns = clock.read(m_us) - m_us * 1000
    for m_us in range(5_000_000, 8_000_000, 100_000):
        sync.check_stamp(estimate(YEARS_NS + 5_000_000_000 + m_us * 1000), 2, m_us)
    assert sync.take_steps() == []
    assert sync.published_shift_ns == 0
    sync.follow_source(2, m_us)
    (step,) = sync.take_steps()
    assert step.publisher == 2
    assert clock.read(m_us) - m_us * 1000 == pytest.approx(before_ns, abs=1_000_000)
    assert sync.shift_ns(2, m_us) == pytest.approx(-5_000_000_000, abs=1_000_000)


def test_actuators_that_restart_with_a_clock_of_their_own_are_followed():
    link = Link({NAVIGATION: YEARS_NS, ACTUATORS: YEARS_NS})
    link.run(10.0)
    before_ns = link.vehicle_time_ns
    link.thetas = {NAVIGATION: YEARS_NS, ACTUATORS + 1: 0}
    link.run(5.0)
    assert link.vehicle_time_ns == pytest.approx(before_ns, abs=5_000_000)
    assert link.plan_error_ns(ACTUATORS + 1) == pytest.approx(0, abs=5_000_000)
    assert link.stamp_error_ns(NAVIGATION) == pytest.approx(0, abs=10_000_000)
