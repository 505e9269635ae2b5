"""Model monitor: residuals and alarm, against exact motions of vehicles with and without loss of thrust."""

from __future__ import annotations

import math
from collections.abc import Callable

import msgspec
import numpy as np
import pytest

from ltv_mpc.messages import Applied, CurrentProfile, Estimate, ModelCheck
from ltv_mpc.safety.model_monitor import ALARM_NATS, QUIET_CYCLES, ModelMonitor
from ltv_mpc.safety.thrust_loss_detector import WINDOWS
from ltv_mpc.vehicle.dynamics import rates
from ltv_mpc.vehicle.parameters import Coefficients, Vehicle
from tests.ltv_mpc.estimates import moving, water
from tests.ltv_mpc.reports import report
from tests.ltv_mpc.vehicles import off_by

PAPER = Vehicle.load("paper")
UNEQUAL = msgspec.structs.replace(PAPER, sway=msgspec.structs.replace(PAPER.sway, mass_kg=1000.0))
FINS = 200.0  # N s2: at 0.3 m/s a third of the yaw damping of the model
DATA_SHEET = msgspec.structs.replace(PAPER, identified=False)
STILL = water()
PERIOD_NS, CYCLE = 100_000_000, 3  # reports each 0.1 s, estimates each third
STEP_S = 0.01

Thrust = Callable[[float], tuple[float, float]]


def surging(t: float) -> tuple[float, float]:
    """Thrusts of 40 N ahead and astern on each side, with turns."""
    return 40.0 * math.sin(0.8 * t) + 15.0 * math.sin(2.1 * t), 40.0 * math.sin(0.8 * t) - 15.0 * math.sin(1.3 * t)


def applied(k: int, thrust: tuple[float, float]) -> Applied:
    return report(k * PERIOD_NS, [*thrust, 0.0])


class Sea:
    """Vehicle that follows the equations of motion in small steps, with a share of the reported thrusts."""

    def __init__(
        self,
        *,
        thrust: Thrust = surging,
        true: Coefficients | None = None,
        vehicle: Vehicle = PAPER,
    ) -> None:
        self.monitor = ModelMonitor(vehicle)
        self.share = np.ones(2)
        self.cost_Ns = 0.0
        self.messages: list[ModelCheck] = []
        self.current: CurrentProfile | None = STILL
        self.learned: Callable[[float], tuple[float, float]] | None = None  # current by time (s)
        self._thrust, self._p = thrust, true or PAPER.coefficients()
        self.fins = 0.0  # yaw moment of the fins, which the model lacks, over |u| r (N s2)
        self.x, self.cycle = np.zeros(6), 0

    def sail(
        self, seconds: float, *, until_alarm: bool = False, altered: Callable[[Estimate], Estimate] = lambda e: e
    ) -> Sea:
        """Sail on for some seconds, or until there is an alarm."""
        for _ in range(round(seconds / 0.1)):
            t = 0.1 * self.cycle
            self.monitor.add_report(applied(self.cycle, self._thrust(t)))
            if self.cycle % CYCLE == 0:
                learned = None if self.learned is None else (np.array(self.learned(t)), 4e-4 * np.eye(2))
                message = self.monitor.update(altered(self._estimate()), learned)
                if message is not None:
                    self.messages.append(message)
                if until_alarm and self.monitor.alarm:
                    return self
            for i in range(10):
                reported = np.array(self._thrust(t + STEP_S * (i + 0.5)))
                F = self.share * reported
                F[1] += self.fins * abs(self.x[2]) * self.x[5] / self._p.arm_starboard
                self.cost_Ns += STEP_S * np.abs((1.0 - self.share) * reported).sum()
                middle = self.x.copy()
                for x, step_s in ((middle, 0.5 * STEP_S), (self.x, STEP_S)):
                    x += step_s * np.array(rates(*middle[2:], *F, 0.0, 0.0, 0.0, 0.0, self._p))
            self.cycle += 1
        return self

    def _estimate(self) -> Estimate:
        n, e, u, v, psi, r = self.x.tolist()
        cos, sin = math.cos(psi), math.sin(psi)
        place = {"north_m": n, "east_m": e, "heading_rad": math.remainder(psi, math.tau), "yaw_rate_radps": r}
        velocity_mps = cos * u - sin * v, sin * u + cos * v
        return moving(velocity_mps, t_ns=self.cycle * PERIOD_NS, depth_m=0.0, current=self.current, **place)


def told(e: Estimate, *, ahead_mps: float = 0.0, turn_radps: float = 0.0, **variances: float) -> Estimate:
    """Return an estimate with errors of its velocity ahead and its yaw rate, and with the variances of both."""
    velocity, yaw = variances.get("velocity", 1e-8), variances.get("yaw", 1e-10)
    return msgspec.structs.replace(
        e,
        velocity_north_mps=e.velocity_north_mps + ahead_mps * math.cos(e.heading_rad),
        velocity_east_mps=e.velocity_east_mps + ahead_mps * math.sin(e.heading_rad),
        yaw_rate_radps=e.yaw_rate_radps + turn_radps,
        covariance=np.diag([1.0, 1.0, velocity, velocity, 1e-6, yaw]),
    )


def largest_evidence(sea: Sea, seconds: float, **options: Callable[[Estimate], Estimate]) -> float:
    """Return the largest evidence (nats) while the vehicle sails on."""
    largest = 0.0
    for _ in range(round(seconds / 0.3)):
        sea.sail(0.3, **options)
        largest = max(largest, sea.monitor.evidence)
    return largest


def alarms(sea: Sea, seconds: float, **options: Callable[[Estimate], Estimate]) -> bool:
    """Return True if there is an alarm while the vehicle sails on."""
    sea.sail(seconds, **options)
    return any(message.alarm for message in sea.messages)


def assert_no_loss_if_known(
    seconds: float, altered: Callable[[Estimate, bool], Estimate], vessel=lambda: Sea()
) -> None:
    """Assert that errors of the estimates raise no alarm if the variances contain them, and one if they do not."""
    for known in (True, False):
        assert alarms(vessel(), seconds, altered=lambda e, known=known: altered(e, known)) is not known


def mismatched(thrust: float, drag: float, mass: float) -> Sea:
    """Vehicle whose thrust, drag and mass are off by factors."""
    sea = Sea(true=off_by(PAPER.coefficients(), mass=mass, drag=drag))
    sea.share[:] = thrust
    return sea


def test_a_vehicle_that_follows_its_model_has_no_residual_and_no_evidence():
    sea = Sea()
    sea.x[2:] = 0.2, 0.3, 0.0, 0.2  # sideways and turning: 30 N of Coriolis force at first
    sea.sail(12.0)
    assert sea.monitor.evidence < 0.1
    residuals = [abs(message.residual_N) for message in sea.messages]
    assert len(residuals) == pytest.approx(12, abs=3)  # one a second, at the next estimate
    assert residuals[0] < 3.0
    assert max(residuals[1:]) < 0.5
    assert max(abs(message.residual_Nm) for message in sea.messages) < 0.1


@pytest.mark.parametrize(("thrust", "drag", "mass"), [(0.9, 1.1, 1.1), (1.1, 0.9, 0.9), (0.9, 0.9, 1.1)])
def test_mismatch_of_ten_per_cent_of_everything_gives_no_alarm(thrust, drag, mass):
    sea = mismatched(thrust, drag, mass)
    assert not alarms(sea, 12.0)
    assert sea.monitor.evidence < 0.25 * ALARM_NATS


def test_a_small_change_of_thrust_is_no_loss_however_certain_it_is():
    sea = Sea().sail(12.0)
    sea.share[:] = 1.0, 0.95
    assert not alarms(sea, 12.0)


def losing(sea: Sea, share: tuple[float, float]) -> Sea:
    """Sail on with less thrust until 3 s after the alarm, which comes when the loss has cost 10 N s and a cycle."""
    assert not sea.monitor.alarm
    sea.share[:] = share
    sea.sail(8.0, until_alarm=True)
    assert sea.monitor.alarm
    a_cycle = 0.3 * max(abs(x) for x in surging(0.1 * sea.cycle)) * 2
    assert sea.cost_Ns < 10.0 + a_cycle
    return sea.sail(3.0)


@pytest.mark.parametrize(
    ("start_s", "share", "named"),
    [(3.0, (0.7, 0.7), (0.3, 0.3)), (5.1, (0.7, 1.0), (0.3, 0.0)), (5.1, (1.0, 0.0), (0.0, 1.0))],
)
def test_a_loss_is_found_at_the_first_estimate_after_it_has_cost_ten_newton_seconds(share, named, start_s):
    sea = losing(Sea().sail(start_s), share)
    last = sea.messages[-1]
    assert last.alarm
    assert sea.monitor.weak_thruster.is_weak <= (min(share) < max(share))  # a loss of both leaves the box
    lost, kept = max(last.thrust_loss), min(last.thrust_loss)
    assert (lost > 0.15, kept > 0.15) == (max(named) > 0, min(named) > 0)  # mismatch may explain a part
    assert f"starboard {round(100 * last.thrust_loss[1])} %" in last.why


def test_an_alarm_is_published_at_once_and_ends_some_time_after_the_loss():
    sea = Sea().sail(3.0)
    sea.share[:] = 0.5
    sea.sail(8.0, until_alarm=True)
    assert sea.messages[-1].alarm
    assert sea.messages[-1].t_ns == sea.cycle * PERIOD_NS
    sea.share[:] = 1.0
    sea.sail(0.3 * (WINDOWS[-1] + QUIET_CYCLES) + 3.0)
    assert not sea.monitor.alarm
    assert sea.messages[-1].why == ""


@pytest.mark.parametrize("missing", ["reports", "current"])
def test_without_reports_or_a_current_nothing_is_published(missing):
    sea = Sea()
    sea.share[:] = 0.3
    if missing == "reports":
        sea.monitor.add_report = lambda _: None
    else:
        sea.current = None
    sea.sail(5.0)
    assert sea.messages == []
    assert not sea.monitor.alarm


def test_a_correction_that_shows_in_the_variance_is_no_loss():
    """A fix changes the velocity by 4 cm/s, 20 N s, against the thrust: as much as its variance falls."""

    def altered(estimate: Estimate, known: bool) -> Estimate:
        wrong_mps = 0.04 if estimate.t_ns < 4 * 10**9 else 0.0
        return told(estimate, ahead_mps=wrong_mps, velocity=max(wrong_mps**2, 1e-6) if known else 0.0)

    assert_no_loss_if_known(8.0, altered)


def test_a_velocity_error_that_varies_within_its_variance_is_no_loss():
    """The error ahead has 1 cm/s rms and varies over some seconds."""
    waves = 2.0 * math.pi * np.array([0.07, 0.11, 0.16, 0.23])

    def altered(estimate: Estimate, known: bool) -> Estimate:
        wrong = 0.01 * math.sqrt(2.0 / len(waves)) * float(np.sin(waves * estimate.t_ns * 1e-9 + waves).sum())
        return told(estimate, ahead_mps=wrong, velocity=0.01**2 if known else 1e-8)

    assert_no_loss_if_known(40.0, altered, lambda: mismatched(0.9, 1.1, 1.1))


@pytest.mark.parametrize("side", [1, -1])
def test_a_yaw_rate_that_is_as_uncertain_as_it_is_wrong_is_no_loss(side):
    """Every second yaw rate is off by 0.02 rad/s, as if the port thruster were weak from it on, or up to it."""

    def altered(estimate: Estimate, known: bool) -> Estimate:
        t = estimate.t_ns * 1e-9
        wrong = 0.02 * side * np.sign(surging(t + 0.15 * side)[0]) * (estimate.t_ns // (CYCLE * PERIOD_NS) % 2)
        return told(estimate, turn_radps=wrong, yaw=1e-10 + wrong * wrong * known)

    assert_no_loss_if_known(12.0, altered)


def test_the_noise_of_a_yaw_rate_does_not_add_up_over_the_window():
    """It is new in each estimate, so the change of yaw rate over a window contains that of two estimates alone."""
    sea = without_current(Sea()).sail(6.0, altered=lambda e: told(e, yaw=0.005**2))
    sea.share[:] = 0.7, 1.0
    assert largest_evidence(sea, 8.0, altered=lambda e: told(e, yaw=0.005**2)) > ALARM_NATS


def test_a_restored_monitor_knows_the_behaviour_of_the_vehicle():
    """The vehicle was stronger than its model and loses 30 %: compared with its model alone, it loses 23 %."""
    before = mismatched(1.1, 0.9, 0.9).sail(30.0)
    products = before.monitor.products
    knowing, forgetful = (mismatched(0.77, 0.9, 0.9) for _ in range(2))  # 30 % less than it was
    knowing.monitor.restore(products)
    np.testing.assert_array_equal(knowing.monitor.products, products)
    assert forgetful.monitor.products is None
    for sea in (knowing, forgetful):
        sea.sail(3.0)
    assert knowing.monitor.evidence > 2.0 * forgetful.monitor.evidence


def test_after_a_gap_the_window_starts_empty():
    sea = Sea()
    sea.share[:] = 0.5
    sea.sail(0.6)
    sea.sail(2.0, altered=lambda e: msgspec.structs.replace(e, current=None))  # no current
    assert sea.monitor.evidence == 0.0
    sea.sail(3.0)
    assert sea.monitor.alarm


# --- estimates without a current ---


def without_current(sea: Sea, learned: Callable[[float], tuple[float, float]] = lambda _: (0.0, 0.0)) -> Sea:
    """Let the estimates of the vehicle have no current; the controller has learned one."""
    sea.current, sea.learned = None, learned
    return sea


@pytest.mark.parametrize(
    ("start_s", "share", "name"),
    [(12.0, (0.7, 1.0), "port"), (3.0, (1.0, 0.7), "starboard"), (12.0, (1.0, 0.0), "starboard")],
)
def test_without_a_current_a_loss_of_one_thruster_shows_in_the_turn(share, name, start_s):
    sea = losing(without_current(Sea()).sail(start_s), share)
    weak, sound = sorted(sea.messages[-1].thrust_loss, reverse=True)
    assert weak > 0.2
    assert sound < 0.1
    if start_s > 10.0:  # before, mismatch may explain a part of it for longer than this
        assert sea.monitor.weak_thruster.health(PAPER).why.startswith(name)


def test_a_learned_current_that_follows_other_forces_is_no_loss():
    """It swings by 10 cm/s within seconds: 50 N s of surge impulse a swing, if it counted."""
    sea = without_current(Sea(), lambda t: (0.1 * math.sin(t), 0.1 * math.cos(0.7 * t)))
    assert not alarms(sea, 40.0)
    assert sea.monitor.evidence < 0.25 * ALARM_NATS


def munk() -> Sea:
    """Vehicle with 1.3 times the sway mass of the model: its Munk moment is 150 kg u v and not zero."""
    p = PAPER.coefficients()
    sea = without_current(Sea(true=p._replace(mass_sway=1.3 * p.mass_sway), vehicle=DATA_SHEET))
    sea.x[3] = 0.2
    return sea


def finned() -> Sea:
    sea = Sea(vehicle=DATA_SHEET)
    sea.fins = FINS
    return sea


def wrong_current(*, given: bool) -> Sea:
    """Vehicle of unequal masses, which turns if the water moves like a current that is wrong by 2 or 5 cm/s."""
    if not given:
        return without_current(Sea(vehicle=UNEQUAL, true=UNEQUAL.coefficients()), lambda _: (0.05, 0.0))
    sea = Sea(vehicle=msgspec.structs.replace(UNEQUAL, identified=False), true=UNEQUAL.coefficients())
    sea.current = water(0.02)
    return sea


@pytest.mark.parametrize(
    "sea", [munk, finned, lambda: wrong_current(given=False), lambda: wrong_current(given=True)], ids=range(4)
)
def test_moments_that_a_model_lacks_are_learned_or_uncertain_and_no_loss(sea: Callable[[], Sea]) -> None:
    assert largest_evidence(sea(), 30.0) < 1.0


def test_a_loss_shows_beside_a_moment_that_was_learned():
    sea = munk().sail(30.0)
    sea.share[:] = 1.0, 0.5
    sea.sail(8.0, until_alarm=True)
    assert sea.monitor.alarm


@pytest.mark.parametrize(("vehicle", "alarm"), [(DATA_SHEET, False), (PAPER, True)])
def test_more_drag_than_on_the_data_sheet_is_no_loss_unless_identified(vehicle, alarm):
    """At low speed the true drag is several times that of the model: as if half of the thrust were missing."""
    draggy = PAPER.coefficients()._replace(linear_surge=100.0, linear_sway=100.0)
    sea = Sea(true=draggy, vehicle=vehicle, thrust=lambda t: (10.0 + math.sin(t), 10.0 - math.sin(t)))
    assert alarms(sea, 60.0) is alarm


def test_moments_that_a_data_sheet_may_lack_are_weak_evidence():
    """Without the noise from the thrust, or that from the motion, a loss of 20 % gives 7 or 9 nats within 2 s."""
    sea = Sea(vehicle=DATA_SHEET).sail(3.0)
    sea.share[:] = 0.8, 1.0
    assert 1.0 < largest_evidence(sea, 1.8) < 4.0
