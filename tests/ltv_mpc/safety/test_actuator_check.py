"""Actuator check: actuators that do not do what the plans ask for are noticed, and teach nothing."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import msgspec
import numpy as np
import pytest

from ltv_mpc import Controller, ControllerConfig, Estimate, Vehicle, references
from ltv_mpc.control.nominal_model import as_estimate
from ltv_mpc.control.prediction import Prediction
from ltv_mpc.messages import Applied, Authority, Health, Plan
from ltv_mpc.safety.actuator_check import WHAT_IT_CAN_BE, ActuatorCheck
from ltv_mpc.safety.command_arbiter import ThrustOverride
from ltv_mpc.safety.health import NOMINAL, HealthState
from ltv_mpc.safety.plan_gate import PlanGate
from tests.ltv_mpc.estimates import moving, water
from tests.ltv_mpc.reports import report
from tests.ltv_mpc.vehicles import changed

BOAT = Vehicle.load("bluerobotics-boat")
STEP_NS = 50_000_000
AWAY_S = 25.0
POINT = references.Point(north_m=0.0, east_m=0.0)
LINE = references.Line(
    start=references.Place(north_m=0.0, east_m=0.0), end=references.Place(north_m=60.0, east_m=0.0), speed_mps=0.4
)
CURRENT = (0.3, 0.0)


class Cycle(NamedTuple):
    """What one cycle gave: time, plan, learned current, and the true place before it."""

    t_s: float
    plan: Plan
    learned_mps: np.ndarray
    place_m: np.ndarray


class Loop:
    """A vehicle of the nominal model in a current that the estimates do not contain, behind a plan gate.

    ``delivered`` gives the commands that the thrusters follow and report, from the vehicle's state and those of the
    gate. Plans arrive ``plan_delay_s`` after the start of their cycle, and reports ``report_late_s`` after their stamp.
    """

    def __init__(
        self,
        current=(0.0, 0.0),
        delivered=lambda _, command_N: command_N,
        *,
        vehicle=BOAT,
        config=None,
        names_plans=True,
        plan_delay_s=0.1,
        report_late_s=0.0,
        report_s=0.1,
        start_m=(15.0, 0.0),
        reference=POINT,
    ):
        self.config = config or ControllerConfig()
        self.controller = Controller(vehicle, reference, self.config)
        self.vehicle, self.delivered, self.names_plans = vehicle, delivered, names_plans
        self.plan_delay_ns, self.report_late_ns = round(plan_delay_s * 1e9), round(report_late_s * 1e9)
        self.report_ns = round(report_s * 1e9)
        self.gate, self.model = PlanGate(vehicle), Prediction(vehicle)
        place = {"north_m": start_m[0], "east_m": start_m[1], "heading_rad": 3.0}
        self.truth = moving(current, current=water(*current), **place)
        self.command_N = self.delivered_N = np.zeros(3)
        self.plans, self.reports = deque(), deque()
        self.accepted: Plan | None = None
        self.sequence = 0
        self.cycles: list[Cycle] = []
        self.override = None

    def run(self, until_s: float) -> list[Cycle]:
        """Run to a time; return its cycles."""
        first = len(self.cycles)
        while self.truth.t_ns < until_s * 1e9:
            self._step()
        return self.cycles[first:]

    def _step(self):
        t_ns = self.truth.t_ns
        while self.plans and self.plans[0][0] <= t_ns:
            plan = self.plans.popleft()[1]
            self.gate.offer(plan, 1, self.sequence, t_ns)
            self.sequence += 1
            self.accepted, self.received_ns = plan, t_ns
        command_N = self.command_N
        if t_ns % self.report_ns == 0:
            self.reports.append((t_ns + self.report_late_ns, self._report(t_ns, command_N)))
        if t_ns % self.config.period_ns == 0:
            while self.reports and self.reports[0][0] <= t_ns:
                self.controller.add_report(self.reports.popleft()[1])
            measured = msgspec.structs.replace(self.truth, current=None)
            plan = self.controller.plan(measured, override=self.override)
            self.plans.append((t_ns + self.plan_delay_ns, plan))
            learned = self.controller.observer.current[0].copy()
            self.cycles.append(Cycle(t_ns * 1e-9, plan, learned, np.array([self.truth.north_m, self.truth.east_m])))
        following_N = self.delivered(self.truth, np.array(self.gate.command_at(t_ns + STEP_NS)))
        self.model.sent.knots = np.array([t_ns, t_ns + STEP_NS]), np.array([command_N, following_N])
        self.command_N = following_N
        self.model.add_report(report(t_ns, self.delivered_N))
        end = self.model.state_at(self.truth, t_ns + STEP_NS)
        self.truth = as_estimate(end, self.truth)
        self.delivered_N = np.array([*end.X[6:8], end.vertical_N])

    def _report(self, t_ns, command_N) -> Applied:
        follows = {}
        if self.names_plans and self.accepted is not None:
            follows = {"plan_epoch": 1, "plan_sequence": self.sequence - 1}
            follows |= {"plan_cycle_t_ns": self.accepted.cycle_t_ns, "plan_received_t_ns": self.received_ns}
        return report(t_ns, self.delivered_N, command_N, plans_late=self.gate.plans_late, **follows)


def degraded_s(cycles):
    """Return the times at which the actuators were said to contradict the plans."""
    assert {cycle.plan.health for cycle in cycles} <= {Health.NOMINAL, Health.DEGRADED}
    return [cycle.t_s for cycle in cycles if WHAT_IT_CAN_BE in cycle.plan.health_why]


class Release:
    """Thrusters that are released for AWAY_S, from the first time at which the vehicle is 5 m from its point."""

    def __init__(self):
        self.at_s = None

    def __call__(self, truth, command_N):
        if self.at_s is None and np.hypot(truth.north_m, truth.east_m) < 5.0:
            self.at_s = truth.t_ns * 1e-9
        released = self.at_s is not None and truth.t_ns * 1e-9 < self.at_s + AWAY_S
        return np.zeros(3) if released else command_N


def test_released_thrusters_are_noticed_and_teach_no_current():
    release, beliefs = Release(), []
    loop = Loop(CURRENT, release, names_plans=False)
    observer, update = loop.controller.observer, loop.controller.vehicle_file_check.update

    def watched(t_ns, *args, **options):
        beliefs.append((t_ns * 1e-9, observer.save().mean.tolist()))
        update(t_ns, *args, **options)

    loop.controller.vehicle_file_check.update = watched
    cycles = loop.run(90.0)
    degraded = degraded_s(cycles)
    assert release.at_s + 1.0 < degraded[0] <= release.at_s + 1.5
    assert release.at_s + AWAY_S < degraded[-1] <= release.at_s + AWAY_S + 2.0
    assert np.diff(degraded).max() < 1.2  # it does not toggle
    before = max((c for c in cycles if c.t_s < release.at_s), key=lambda c: c.t_s).learned_mps
    assert max(abs(c.learned_mps - before).max() for c in cycles if release.at_s <= c.t_s < degraded[-1]) <= 0.05
    assert max(abs(c.learned_mps - CURRENT).max() for c in cycles if c.t_s > degraded[-1] + 10.0) <= 0.05
    back_m = np.array([np.hypot(*cycle.place_m) for cycle in cycles if cycle.t_s > degraded[-1]])
    assert back_m[np.argmax(back_m < 0.3) :].max() <= 0.3
    assert back_m[-1] < 0.1
    during = [mean for t_s, mean in beliefs if degraded[0] <= t_s < degraded[-1]]
    assert len(during) > 10
    assert during == during[:1] * len(during)  # neither a current, nor a lever arm, nor another vehicle


def test_what_was_learned_before_late_reports_showed_the_release_is_taken_back():
    cycles = Loop(delivered=Release(), report_late_s=1.0).run(20.0)
    since_s = degraded_s(cycles)[0]
    assert max(abs(cycle.learned_mps).max() for cycle in cycles if since_s - 2.0 < cycle.t_s < since_s) > 0.05
    assert max(abs(cycle.learned_mps).max() for cycle in cycles if cycle.t_s >= since_s) <= 0.05


def test_a_report_that_says_why_no_plan_is_followed_degrades_until_it_ends():
    """Also where the command happens to be that of the plan: somebody else may drive."""
    check, plan = ActuatorCheck(BOAT, 300_000_000), Controller(BOAT, POINT).plan(Estimate.at_rest())
    check.sent(plan)
    given = report(0, (0.0, 0.0, 0.0))
    for at_ns, why in ((100, ""), (200, "autopilot in failsafe"), (300, "autopilot disarmed"), (400, ""), (1000, "")):
        check.add(msgspec.structs.replace(given, t_ns=plan.t_ns[0] + at_ns * 1_000_000, why=why))
        assert check.health == (HealthState(Health.DEGRADED, f"not driving: {why}") if why else NOMINAL)
        assert check.learns is (at_ns in (100, 1000))  # and half a second of agreement later


@pytest.mark.parametrize(
    ("before_N", "command_N", "agrees"),
    [
        (30.0, 25.5, True),  # within a twentieth of the larger limit
        (30.0, 24.5, False),
        (-20.0, 16.0, True),  # nine tenths of the slew, towards the plan
        (-20.0, 10.0, False),  # three quarters
        (60.0, 24.0, False),  # away from it
    ],
)
def test_a_command_agrees_near_that_of_the_plan_or_while_it_goes_there(before_N, command_N, agrees):
    check = ActuatorCheck(
        changed(BOAT, {"thruster.port.min_N": -100.0, "thruster.port.slew_N_per_s": 400.0}), 300_000_000
    )
    plan = Controller(BOAT, POINT).plan(Estimate.at_rest())
    check.sent(msgspec.structs.replace(plan, thrust_N=np.tile([30.0, 0.0, 0.0], (len(plan.t_ns), 1))))
    for after_ns, thrust_N in ((950_000_000, before_N), (1_050_000_000, command_N)):  # at the first no plan is known
        check.add(report(plan.t_ns[0] + after_ns, (thrust_N, 0.0, 0.0)))
    assert check.disagrees is not agrees


def test_a_clock_that_is_set_back_ends_a_contradiction():
    check, plan = ActuatorCheck(BOAT, 300_000_000), Controller(BOAT, POINT).plan(Estimate.at_rest())
    check.sent(plan)
    for k in range(30):
        check.add(report(plan.t_ns[0] + k * 100_000_000, (40.0, 0.0, 0.0)))
    assert check.health is not NOMINAL
    check.add(report(0, (0.0, 0.0, 0.0)))
    assert check.health is NOMINAL


LEGAL = (
    {"report_late_s": 1.0},
    {"plan_delay_s": 0.8, "names_plans": False, "config": ControllerConfig(horizon_s=2.1)},
    {"names_plans": False, "config": ControllerConfig(period_s=1.0)},
    {"report_s": 1.0},
)


@pytest.mark.parametrize(("settings", "reference"), [*zip(LEGAL, 2 * (LINE, POINT), strict=True)], ids=str)
def test_late_reports_and_late_plans_are_no_contradiction(settings, reference):
    assert degraded_s(Loop(CURRENT, start_m=(15.0, 3.0), reference=reference, **settings).run(40.0)) == []


@pytest.mark.parametrize("authority", [Authority.MANUAL, Authority.DISARMED, Authority.STOPPED])
def test_while_an_override_is_in_force_nothing_is_learned_and_the_uncertainty_grows(authority):
    """A tow moves the vehicle at 0.5 m/s, without reports."""
    controller = Controller(BOAT, POINT, ControllerConfig())
    override = ThrustOverride(authority, (0.0, 0.0, 0.0), None, authority.value)
    variances = []
    for i in range(100):
        towed = msgspec.structs.replace(Estimate.at_rest(north_m=0.15 * i), velocity_north_mps=0.5)
        plan = controller.plan(msgspec.structs.replace(towed, t_ns=i * 300_000_000), override=override)
        current, covariance = controller.observer.current
        variances.append(covariance[0, 0])
        assert current.tolist() == [0.0, 0.0]
    assert plan.health is Health.NOMINAL
    assert variances[-1] == pytest.approx(0.15**2)  # the prior's, so that it is learned quickly
