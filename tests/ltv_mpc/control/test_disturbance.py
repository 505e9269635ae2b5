"""Disturbance observer: the bias of the current is estimated where it is observable, and improves the control."""

from __future__ import annotations

from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from ltv_mpc import Controller, ControllerConfig, CurrentProfile, Estimate, Vehicle, references
from ltv_mpc.control.config import Disturbance
from ltv_mpc.control.disturbance import DOUBTED_ESTIMATES, DisturbanceObserver, heading_free_mps
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.control.nominal_model import as_estimate
from ltv_mpc.control.prediction import Prediction
from ltv_mpc.messages import Action, Plan
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.vehicle.reference_point import ReferencePoint
from tests.ltv_mpc.estimates import moving, water
from tests.ltv_mpc.plans import plan_of
from tests.ltv_mpc.reports import report

PAPER = Vehicle.load("paper")
ON = Disturbance(sd_mps=0.1)
OFF = Disturbance(sd_mps=0.0)
DEFAULT = Disturbance()
WATER = np.array([0.03, -0.025])
HURRYING = references.Line(
    start=references.Place(north_m=0.0, east_m=0.0), end=references.Place(north_m=30.0, east_m=0.0), speed_mps=0.35
)


def held(
    disturbance: Disturbance,
    known: CurrentProfile | None,
    cycles: int = 200,
    wind_mps2: float = 0.0,
):
    """Hold station in WATER with the profile ``known``: return the observer, mean |F| and mean distance."""
    config = ControllerConfig(disturbance=disturbance)
    controller = Controller(PAPER, references.Point(north_m=0.0, east_m=0.0), config)
    truth = moving(WATER, heading_rad=1.0, current=water(*WATER))
    vehicle = Prediction(PAPER)
    force, off = [], []
    for _ in range(cycles):
        plan = controller.plan(msgspec.structs.replace(truth, current=known))
        vehicle.sent.add(plan)
        truth = as_estimate(vehicle.state_at(truth, truth.t_ns + 300_000_000), truth)
        blown_mps = truth.velocity_north_mps + 0.3 * wind_mps2
        truth = msgspec.structs.replace(truth, velocity_north_mps=blown_mps)
        force.append(np.abs(plan.thrust_N[0, :2]).mean())
        off.append(np.hypot(truth.north_m, truth.east_m))
    late = slice(cycles // 2, None)
    return controller.observer, float(np.mean(force[late])), float(np.mean(off[late]))


def test_an_unknown_current_is_estimated_and_then_costs_no_more_than_a_known_one():
    bias, force, off = held(ON, None)
    _, known_force, known_off = held(OFF, water(*WATER))
    np.testing.assert_allclose(bias.bias_mps, WATER, atol=0.005)
    assert off < known_off + 0.008
    assert force < known_force + 1.0


WIND_MPS2 = 0.1 * 2.0 * PAPER.thrusters[0].max_N / PAPER.surge.mass_kg
"""Acceleration by a wind of a tenth of both thrusters."""


@pytest.mark.parametrize(("wrong_mps", "wind_mps2"), [(0.04, 0.0), (0.0, WIND_MPS2)])
def test_no_offset_stays_where_a_profile_or_the_wind_contradicts_the_model(wrong_mps, wind_mps2):
    """It is 0.10 and 0.40 m without a bias."""
    _, _, off = held(DEFAULT, water(*(WATER + wrong_mps)), 400, wind_mps2=wind_mps2)
    assert off < 0.03


def test_the_bias_survives_an_estimate_with_a_profile():
    """It is used again after that estimate, and is not updated across it."""
    bias, last = drifting(0.3, 50, DEFAULT, velocity_north_mps=0.2)
    learned = bias.bias_mps.copy()
    assert learned[0] > 0.05
    known = msgspec.structs.replace(last, t_ns=50 * 300_000_000, current=water(*WATER))
    assert bias.correct(known, Prediction(PAPER)) is known
    later = msgspec.structs.replace(last, t_ns=51 * 300_000_000, current=None)
    again = bias.correct(later, Prediction(PAPER))
    assert again.current.north_mps[0] == learned[0]


@pytest.mark.parametrize(("share", "used"), [(0.25, 0.0), (0.4, 0.5 / 1.5), (0.6, 1.0)])
def test_an_untold_current_is_used_beyond_what_a_wrong_drag_looks_like(share, used):
    """Share of the speed below which the heading is free. A current that is not there would turn with the hull."""
    observer, vehicle = DisturbanceObserver(DEFAULT, PAPER), Prediction(PAPER)
    belief = observer.save()
    belief.mean[0] = share * heading_free_mps(PAPER)
    observer.restore(belief, 0)
    told = observer.correct(Estimate.at_rest(), vehicle, learns=False).current
    np.testing.assert_allclose(told.north_mps, used * belief.mean[0], atol=1e-12)


def drifting(seconds: float, steps: int, settings: Disturbance = ON, **changes: float):
    """Return the observer after ``steps`` estimates without a profile of a vehicle without thrust."""
    bias, vehicle = DisturbanceObserver(settings, PAPER), Prediction(PAPER)
    estimate = msgspec.structs.replace(Estimate.at_rest(), **changes)
    for i in range(steps):
        corrected = bias.correct(msgspec.structs.replace(estimate, t_ns=round(i * seconds * 1e9)), vehicle)
    return bias, corrected


def test_a_vehicle_at_rest_without_thrust_does_not_observe_the_bias():
    bias, _ = drifting(0.3, 400, Disturbance(sd_mps=0.1, noise_mps=1.0))
    np.testing.assert_allclose(bias.bias_mps, 0.0, atol=1e-12)
    assert np.linalg.eigvalsh(bias.covariance).max() <= 0.1**2 * (1 + 1e-9)


@pytest.mark.parametrize(("sinks_m", "variance"), [(0.0, 9e-6 * 9.0), (2.0, 9e-6 * 9.0 + 4e-4 * 2.0)])
def test_over_a_long_interval_the_bias_stays_and_becomes_less_certain(sinks_m: float, variance: float):
    """By hand: a random walk of 3 mm/s per sqrt(s) over 9 s, and one of 2 cm/s per sqrt(m) over the change of depth."""
    bias, last = drifting(0.3, 50, velocity_north_mps=0.2, depth_m=5.0)
    before, learned, late_ns = bias.covariance, bias.bias_mps.copy(), 49 * 300_000_000 + 9_000_000_000
    late = msgspec.structs.replace(last, t_ns=late_ns, depth_m=5.0 + sinks_m, current=None)
    bias.correct(late, Prediction(PAPER))
    np.testing.assert_array_equal(bias.bias_mps, learned)
    np.testing.assert_allclose(bias.covariance - before, variance * np.eye(2), rtol=1e-6, atol=1e-12)


def noisy(sd_mps: float, speed_mps: float = 0.0) -> Iterator[Estimate]:
    """Estimates of a vehicle under way, whose velocity differs from their profile by what varies over 3 s."""
    rng, error = np.random.default_rng(5), np.zeros(2)
    for k in range(300):
        error = 0.9 * error + sd_mps * np.sqrt(1 - 0.9**2) * rng.standard_normal(2)
        yield moving(WATER + error + [speed_mps, 0.0], t_ns=k * 300_000_000, current=water(*WATER))


def test_the_noise_of_a_navigation_filter_is_not_taken_for_a_current():
    """The velocity error has 1 cm/s rms, as the covariance says."""
    knowing, sure = DisturbanceObserver(ON, PAPER), DisturbanceObserver(ON, PAPER)
    vehicle = Prediction(PAPER)
    largest, errors = {knowing: 0.0, sure: 0.0}, []
    for estimate in noisy(0.01):
        certain = np.diag([1.0, 1.0, 1e-4, 1e-4, 1e-4, 1e-6])
        knowing.correct(msgspec.structs.replace(estimate, covariance=certain), vehicle)
        sure.correct(estimate, vehicle)
        for bias in largest:
            largest[bias] = max(largest[bias], float(np.hypot(*bias.bias_mps)))
        errors.append(knowing.model_error_mps2)
    assert largest[knowing] < 0.5 * largest[sure]
    assert np.median(errors) < 0.003  # and hardly for an error of the model: 0.3 % of what 1 cm/s in one interval are


@pytest.mark.parametrize("speed_mps", [0.03, 0.2])
def test_the_noise_of_a_navigation_filter_is_no_error_of_its_profile(speed_mps):
    """Its velocity differs from its profile by 3 mm/s rms, as in the descents."""
    observer, vehicle = DisturbanceObserver(DEFAULT, PAPER), Prediction(PAPER)
    drag_N = PAPER.surge.quadratic_damping_kgpm * speed_mps**2 / 2.0
    for given in noisy(0.003, speed_mps):
        vehicle.sent.add(pushing(given.t_ns, (drag_N, drag_N)))
        certain = np.diag([1.0, 1.0, 25e-6, 25e-6, 1e-4, 1e-6])
        current = observer.correct(msgspec.structs.replace(given, covariance=certain), vehicle).current
        # 0.007 where the bias is always used
        assert np.hypot(current.north_mps[0] - WATER[0], current.east_mps[0] - WATER[1]) < 0.002


@pytest.mark.parametrize("broken", [{"velocity_north_mps": float("nan")}, {"covariance": -np.eye(6)}], ids=str)
def test_a_broken_estimate_teaches_nothing(broken):
    bias, vehicle = DisturbanceObserver(ON, PAPER), Prediction(PAPER)
    first = Estimate.at_rest()
    bias.correct(first, vehicle)
    for k in (1, 2):
        bias.correct(msgspec.structs.replace(first, t_ns=k * 300_000_000, **broken), vehicle)
    np.testing.assert_array_equal(bias.bias_mps, 0.0)
    assert np.isfinite(bias.covariance).all()


def test_the_bias_is_bounded():
    tight, _ = drifting(0.3, 50, Disturbance(sd_mps=0.1, max_mps=0.01), velocity_north_mps=0.2)
    assert tight.bias_mps[0] == 0.01


def test_a_current_that_changes_with_time_as_the_profile_says_needs_no_bias():
    """By hand: without thrust, 500 u' = -500 u|u| - 200 c' along the heading; c has an amplitude of 5 cm/s in 60 s."""
    bias, vehicle = DisturbanceObserver(ON, PAPER), Prediction(PAPER)
    heading, u, step_s = 0.7, 0.0, 1e-3
    along = np.array([np.cos(heading), np.sin(heading)])
    current = lambda t_s: 0.05 * np.sin(2.0 * np.pi * t_s / 60.0)  # noqa: E731
    for k in range(45_000):
        t_s = k * step_s
        if k % 300 == 0:
            velocity_mps, known = (u + current(t_s)) * along, water(*(current(t_s) * along))
            bias.correct(moving(velocity_mps, heading_rad=heading, t_ns=k * 1_000_000, current=known), vehicle)
        u += -u * abs(u) * step_s - 0.4 * (current(t_s + step_s) - current(t_s))
    assert abs(u) > 0.005  # the change of the current has moved it through the water
    np.testing.assert_allclose(bias.bias_mps, 0.0, atol=1e-3)


def test_a_thruster_in_doubt_teaches_no_current():
    """The bias of the last seconds is taken back, and it learns again after the doubt."""
    bias, vehicle = DisturbanceObserver(ON, PAPER), Prediction(PAPER)
    estimate = msgspec.structs.replace(Estimate.at_rest(), velocity_north_mps=0.2)
    seen = []
    for i in range(60):
        bias.thrust_in_doubt = 40 <= i < 50
        bias.correct(msgspec.structs.replace(estimate, t_ns=i * 300_000_000), vehicle)
        seen.append(bias.bias_mps[0])
    assert seen[39 - DOUBTED_ESTIMATES] < seen[39 - DOUBTED_ESTIMATES + 1] < seen[39]  # it was learning
    assert set(seen[40:50]) == {seen[40 - DOUBTED_ESTIMATES]}
    assert bias.bias_mps[0] > seen[49]


def largest_bias(share: float) -> float:
    """Return the largest bias (m/s) in still water, in the 12 s after port begins to deliver a share of its thrust."""
    node = ControllerNode(PAPER, HURRYING, ControllerConfig(disturbance=ON))
    node.arbiter.request(Action.ARM)
    truth = msgspec.structs.replace(Estimate.at_rest(depth_m=0.0), current=water())
    vehicle, reported, largest = Prediction(PAPER), np.zeros(3), 0.0
    for k in range(80):
        t_ns = k * 300_000_000
        shares = (share if k >= 40 else 1.0, 1.0)
        vehicle.set_shares(shares)
        applied = report(t_ns, reported, vehicle.sent.at(np.array([t_ns]))[0])
        vehicle.add_report(applied)
        inbox = [ReceivedMessage(applied, 1, k, t_ns), ReceivedMessage(truth, 1, k, t_ns)]
        (plan,) = (message for message in node.step(t_ns, inbox) if isinstance(message, Plan))
        vehicle.sent.add(plan)
        end = vehicle.state_at(truth, t_ns + 300_000_000)
        truth, reported = as_estimate(end, truth), np.array([*end.X[6:] / shares, end.vertical_N])
        learned, _ = node.controller.observer.current
        largest = max(largest, float(np.hypot(*learned)))
    return largest


def test_a_thruster_that_fails_teaches_no_current():
    assert largest_bias(0.4) < 0.045  # 0.06 where the loss teaches it
    assert largest_bias(0.02) < 0.075  # 0.099 where it learns while the thruster has the smallest share


def test_a_current_of_three_standard_deviations_is_learned_in_the_first_seconds():
    """Drag is quadratic: a linear correction stops halfway, at 0.15 m/s, and is then sure of it."""
    bias, _ = drifting(0.3, 4, DEFAULT, velocity_north_mps=0.3)
    assert bias.bias_mps[0] > 0.22
    assert abs(bias.bias_mps[0] - 0.3) < 4.0 * np.sqrt(bias.covariance[0, 0])


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("arm_m", [(0.0, 0.0), (-0.25, 0.0), (0.1, -0.2)])
def test_the_lever_arm_to_the_estimated_point_is_learned_while_the_vehicle_turns(arm_m, known):
    """The corrected estimates are then those of the origin, and a current that is not known is learned beside it."""
    observer, vehicle = DisturbanceObserver(DEFAULT, PAPER), Prediction(PAPER)
    truth = moving(WATER, current=water(*WATER))
    away = ReferencePoint(forward_m=-arm_m[0], starboard_m=-arm_m[1])  # its origin is the point that is estimated
    for k in range(200):
        side_N = 20.0 * np.sin(0.2 * k)
        vehicle.sent.add(pushing(truth.t_ns, (10.0 + side_N, 10.0 - side_N)))
        given = away.to_origin(truth)
        corrected = observer.correct(given if known else msgspec.structs.replace(given, current=None), vehicle)
        if k == 199:
            break
        truth = as_estimate(vehicle.state_at(truth, truth.t_ns + 300_000_000), truth)
    state = observer.save()
    mean, covariance = state.mean[2:4], state.covariance[2:4, 2:4]
    np.testing.assert_allclose(mean, arm_m, atol=0.03)
    assert np.all(np.abs(mean - arm_m) < 4.0 * np.sqrt(np.diag(covariance)))
    velocity = corrected.velocity_north_mps, corrected.velocity_east_mps
    np.testing.assert_allclose(velocity, (truth.velocity_north_mps, truth.velocity_east_mps), atol=0.003)
    # under way the heading is given, so the estimated point is the one that is held
    np.testing.assert_allclose((corrected.north_m, corrected.east_m), (given.north_m, given.east_m), atol=0.03)
    if not known:
        np.testing.assert_allclose(observer.bias_mps, WATER, atol=0.01)
    if arm_m == (0.0, 0.0) and known:
        assert (corrected.north_m, corrected.east_m) == (given.north_m, given.east_m)  # not without evidence


FORWARD = 0.2 / (0.2 - 0.15j)
"""Share of the arm that is its forward part."""


@pytest.mark.parametrize(
    ("flow_mps", "heading", "yaw_radps", "held"),
    [
        ((0.0, 0.0), 0.5, 0.0, FORWARD * np.exp(0.5j)),  # at rest the forward part,
        ((0.0, 0.0), 0.5, 0.5, 0.0),  # while it turns the origin
        ((-0.3, 0.0), 0.0, 0.0, 1.0),  # in a current the whole arm: the bow points against it,
        ((0.0, 0.3), 0.5 * np.pi, 0.0, 1j),  # or the stern,
        ((-0.3, 0.0), 0.5, 0.5, np.cos(0.5)),  # or nearly, and then the vehicle swings, but not the arm
        ((-0.015, 0.0), 0.0, 0.0, 0.5 * (1.0 + FORWARD)),  # half of either at 0.03 of the top speed
    ],
)
def test_the_estimated_point_is_held_along_the_water_and_at_rest_its_forward_part(flow_mps, heading, yaw_radps, held):
    """A target that turns with the vehicle would make it turn for ever."""
    arm = np.array([0.2, -0.15])
    observer, vehicle = DisturbanceObserver(DEFAULT, PAPER), Prediction(PAPER)
    belief = observer.save()
    belief.mean[2:4], belief.covariance[2:4, 2:4] = arm, 1e-6 * np.eye(2)
    observer.restore(belief, 0)
    turning = 1j * yaw_radps * complex(*arm) * np.exp(1j * heading)  # the origin is at rest
    velocity_mps, current = (turning.real, turning.imag), water(*flow_mps)
    for k in range(400):
        given = moving(
            velocity_mps, heading_rad=heading, yaw_rate_radps=yaw_radps, t_ns=k * 300_000_000, current=current
        )
        corrected = observer.correct(given, vehicle, learns=False)
    origin = complex(*arm) * (held - np.exp(1j * heading))
    np.testing.assert_allclose((corrected.north_m, corrected.east_m), (origin.real, origin.imag), atol=0.004)


@pytest.mark.parametrize("period_s", [3.0, 7.0])
def test_waves_are_no_current_no_arm_and_no_other_vehicle_and_the_vehicle_yields_to_them(period_s):
    """It drifts with the water and turns its bow slowly through the direction of the waves; then they end."""
    observer, vehicle = DisturbanceObserver(DEFAULT, PAPER), Prediction(PAPER)
    rate, speed_mps, slow = 2.0 * np.pi / period_s, 0.08, []
    for k in range(500):
        t_s = 0.3 * k
        speed = speed_mps * np.sin(rate * t_s) * (t_s < 90.0)
        moved = speed_mps / rate * (1.0 - np.cos(rate * t_s)) * (t_s < 90.0)
        turning = {"heading_rad": 0.02 * t_s, "yaw_rate_radps": 0.02}
        place = {"north_m": 0.6 * moved, "east_m": 0.8 * moved, "depth_m": 1.0}
        given = moving((0.6 * speed, 0.8 * speed), t_ns=k * 300_000_000, **place, **turning)
        corrected = observer.correct(given, vehicle)
        slow.append((corrected.north_m, corrected.east_m, corrected.velocity_north_mps, corrected.velocity_east_mps))
        if t_s == pytest.approx(84.0):
            x_m, v_mps = np.std(slow[-100:], axis=0).reshape(2, 2).max(axis=1)
            assert x_m < 0.4 * 0.8 * speed_mps / rate / np.sqrt(2.0)
            assert v_mps < 0.1 * 0.8 * speed_mps / np.sqrt(2.0)
            np.testing.assert_allclose(observer.bias_mps, 0.0, atol=0.02)
            np.testing.assert_allclose(observer.save().mean[2:4], 0.0, atol=0.05)
            np.testing.assert_allclose(observer.save().mean[4:], 0.0, atol=0.5)
            assert 0.2 < observer.waves_m / (speed_mps / rate) < 1.5
            assert observer.in_waves
    assert observer.waves_m == 0.0
    assert not observer.in_waves
    assert slow[-1][:2] == (given.north_m, given.east_m)


def test_a_steady_course_shows_no_lever_arm():
    observer, _ = drifting(0.3, 100, DEFAULT, velocity_north_mps=0.2)
    state = observer.save()
    mean, covariance = state.mean[2:4], state.covariance[2:4, 2:4]
    np.testing.assert_allclose(mean, 0.0, atol=1e-6)
    np.testing.assert_allclose(np.diag(covariance), 0.04, rtol=1e-6)


def pushing(t_ns: int, thrust_N: tuple[float, float]) -> Plan:
    """Return a plan of constant thrusts of port and starboard."""
    return plan_of(t_ns, [[*thrust_N, 0.0]] * 2, 3_000_000_000)


@pytest.mark.parametrize("share", [1.0, 0.6])
def test_an_acceleration_that_is_not_explained_is_the_model_s_error(share: float):
    """Both thrusters of a vehicle at rest push, and deliver a share of what they report; nothing is learned."""
    observer = DisturbanceObserver(Disturbance(sd_mps=0.0, model_sd=0.0, lever_arm_sd_m=0.0), PAPER)
    vehicle, model = Prediction(PAPER), Prediction(PAPER)
    model.sent = vehicle.sent
    vehicle.set_shares((share, share))
    estimate, wrong = msgspec.structs.replace(Estimate.at_rest(), current=water()), []
    for k in range(60):
        vehicle.sent.add(pushing(estimate.t_ns, (5.0, 5.0) if k < 20 else (0.0, 0.0)))
        observer.correct(estimate, model)
        wrong.append(observer.model_error_mps2)
        estimate = as_estimate(vehicle.state_at(estimate, estimate.t_ns + 300_000_000), estimate)
    missing_mps2 = (1.0 - share) * 10.0 / PAPER.coefficients().mass_surge
    assert 0.7 * missing_mps2 <= max(wrong) <= missing_mps2 + 1e-6  # less the noise
    assert wrong[-1] == pytest.approx(max(wrong) * np.exp(-12.0 / 30.0), rel=0.1, abs=1e-6)  # 12 s later
