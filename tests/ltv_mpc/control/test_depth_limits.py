"""Depth limits by closed loop: a ramp into the bottom stops above it, with the box and the slew of the thruster."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest
from scipy.optimize import brentq

from ltv_mpc.config import parse
from ltv_mpc.control.config import ControllerConfig, MotionLimits
from ltv_mpc.control.controller import Controller
from ltv_mpc.control.depth_limits import MIN_RATE_RADPS, DepthLimits, braking_rate_radps, clip_to_depths
from ltv_mpc.control.nominal_model import advance
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Array, Authority, Estimate, Plan
from ltv_mpc.references import Hold, Point
from ltv_mpc.safety.command_arbiter import ThrustOverride
from ltv_mpc.safety.health import Health, HealthState
from ltv_mpc.vehicle.dynamics import heave_acceleration
from ltv_mpc.vehicle.parameters import Translation, Vehicle
from tests.ltv_mpc.control.flights import assert_within_box_and_slew, column, fly
from tests.ltv_mpc.vehicles import changed

PAPER = Vehicle.load("paper")
BOTTOM_M = 12.0


def config(**limits: float) -> ControllerConfig:
    return ControllerConfig(limits=MotionLimits(**limits), lateral=False, horizon_s=3.0)


def dive(
    controller: Controller, true: Vehicle, seconds: float, estimate: Estimate
) -> tuple[list[Estimate], list[Plan]]:
    """Follow plans from an estimate over a bottom at ``BOTTOM_M`` that the altimeter sees."""

    def seen(estimate: Estimate) -> Estimate:
        altitude = BOTTOM_M - (estimate.depth_m or 0.0)
        return msgspec.structs.replace(estimate, altitude_m=altitude if altitude >= 0.0 else None)

    return fly(controller, estimate, round(seconds / 0.3), true=true, seen=seen)


def depths(way: list[Estimate]) -> Array:
    return column(way, "depth_m")


def deeper(depth_m: float = 50.0, rate_mps: float = 0.2) -> Point:
    return Point(north_m=0.0, east_m=0.0, depth_m=depth_m, descent_rate_mps=rate_mps)


@pytest.mark.parametrize("rate_mps", [0.2, 5.0])
def test_a_ramp_into_the_bottom_stops_at_the_least_altitude(rate_mps: float) -> None:
    controller = Controller(PAPER, deeper(rate_mps=rate_mps), config(min_altitude_m=3.0))
    way, plans = dive(controller, PAPER, 110.0, Estimate.at_rest(depth_m=5.0))
    assert depths(way).max() < BOTTOM_M - 3.0 + 0.02
    assert depths(way)[-1] == pytest.approx(BOTTOM_M - 3.0, abs=0.02)
    assert [plan.depth_limit_m for plan in plans] == pytest.approx([BOTTOM_M - 3.0] * len(plans))
    assert_within_box_and_slew(plans, PAPER.thrusters[2])


def test_a_wrong_buoyancy_costs_less_than_a_third_of_a_metre_and_is_learned() -> None:
    """Its 6.5 N are 6.5 / (225 x 0.09) = 0.32 m of the law without an integral."""
    true = msgspec.structs.replace(PAPER, net_buoyancy_N=24.0)
    way, _ = dive(Controller(PAPER, deeper(), config(max_depth_m=9.0)), true, 150.0, Estimate.at_rest(depth_m=5.0))
    assert depths(way).max() < 9.0 + 0.33
    assert depths(way)[-1] < 9.0 + 0.05


def test_an_ascent_stops_at_the_least_depth() -> None:
    controller = Controller(PAPER, deeper(0.0, rate_mps=5.0), config(min_depth_m=2.0))
    way, _ = dive(controller, PAPER, 90.0, Estimate.at_rest(depth_m=8.0))
    assert depths(way).min() > 1.98
    assert depths(way)[-1] == pytest.approx(2.0, abs=0.02)


def test_the_bottom_is_harder_than_the_surface() -> None:
    controller = Controller(PAPER, deeper(11.0), config(min_depth_m=10.0, min_altitude_m=3.0))
    way, _ = dive(controller, PAPER, 120.0, Estimate.at_rest(depth_m=6.0))
    assert depths(way).max() < BOTTOM_M - 3.0 + 0.02
    assert depths(way)[-1] == pytest.approx(BOTTOM_M - 3.0, abs=0.02)


def test_a_command_that_is_kept_ends_at_the_limit_too() -> None:
    """A pilot lets go at full thrust down, and the reference has no depth."""
    down = ThrustOverride(Authority.MANUAL, (0.0, 0.0, 62.5), 100_000_000_000, "by hand")
    for limits, sinks in (({}, True), ({"max_depth_m": 0.6}, False)):
        controller, estimate = Controller(PAPER, Hold(), config(**limits)), Estimate.at_rest(depth_m=0.0)
        for _ in range(5):
            estimate = advance(PAPER, estimate, controller.plan(estimate, override=down), duration_s=0.3)
        way, _ = dive(controller, PAPER, 30.0, estimate)
        assert (depths(way).max() > 0.61) == sinks


def test_a_failsafe_is_not_limited() -> None:
    """What the vehicle does in failsafe is in its own file; this one pushes down with all it has."""
    sinks = msgspec.structs.replace(PAPER, failsafe_vertical_N=62.5)
    controller = Controller(sinks, deeper(), config(max_depth_m=9.0))
    estimate = Estimate.at_rest(depth_m=9.0)
    plan = controller.plan(estimate, health=HealthState(Health.FAILSAFE, "leak"))
    assert plan.thrust_N[-1, 2] == 62.5


def test_the_rate_leaves_a_weak_thruster_the_force_to_brake() -> None:
    """2 t brake with their buoyancy alone, from 0.57 m/s."""
    assert braking_rate_radps(PAPER) > 0.3
    assert braking_rate_radps(Vehicle.load("surface")) == math.inf
    heave = {"heave.mass_kg": 2000.0, "heave.quadratic_damping_kgpm": 100.0}
    heavy = changed(PAPER, {"thruster.vertical.min_N": 0.0, **heave})
    assert braking_rate_radps(heavy) == pytest.approx(30.5 / 2000.0 / math.sqrt(32.0 / 100.0))
    helpless = msgspec.structs.replace(heavy, net_buoyancy_N=-5.0)
    assert braking_rate_radps(helpless) == MIN_RATE_RADPS


@pytest.mark.parametrize("w", [-0.4, 0.15, 0.9])
@pytest.mark.parametrize(("wanted_N", "limit_m"), [(-1e4, 3.0), (1e4, 11.0)], ids=["least", "largest"])
def test_the_thrust_at_a_limit_gives_the_acceleration_of_the_barrier(w: float, wanted_N: float, limit_m: float) -> None:
    """z'' + 2 l z' + l^2 (z - limit) = 0; the depth law's integral stands for buoyancy that the model lacks."""
    rate, z, integral_N = 0.3, 7.0, 4.0
    p = msgspec.structs.replace(
        PAPER,
        net_buoyancy_N=9.0,
        heave=Translation(mass_kg=700.0, linear_damping_kgps=30.0, quadratic_damping_kgpm=200.0),
    ).coefficients()
    thrust_N = clip_to_depths(wanted_N, z, w, integral_N, np.array([3.0, 11.0, rate]), p)
    acceleration = heave_acceleration(w, thrust_N - integral_N, p)
    assert acceleration + 2.0 * rate * w + rate**2 * (z - limit_m) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("buoyancy_N", [-8.0, 8.0])
def test_the_rate_is_the_weaker_brake_over_the_speed_that_it_has_to_stop(buoyancy_N: float) -> None:
    heave = Translation(mass_kg=700.0, linear_damping_kgps=30.0, quadratic_damping_kgpm=200.0)
    vehicle = msgspec.structs.replace(PAPER, net_buoyancy_N=buoyancy_N, heave=heave)
    p, thruster, rates = vehicle.coefficients(), vehicle.thrusters[2], []
    for full, back in ((thruster.max_N, thruster.min_N), (thruster.min_N, thruster.max_N)):
        speed = brentq(lambda w, full=full: heave_acceleration(w, full, p), -5.0, 5.0)
        still_N = (30.0 + 200.0 * abs(speed)) * speed  # drag, which brakes too, does not count
        rates.append(abs((heave_acceleration(speed, back, p) * 700.0 + still_N) / 700.0 / speed))
    assert braking_rate_radps(vehicle) == pytest.approx(min(rates))
    assert max(rates) > 1.05 * min(rates)


def test_a_limit_is_named_for_a_depth_beyond_it_alone() -> None:
    both = DepthLimits(PAPER, MotionLimits(min_depth_m=2.0, max_depth_m=30.0), 0.3)
    assert both.is_limited
    assert both.bounds.tolist() == [2.0, 30.0, 0.3]
    assert [both.limit_before(depth_m) for depth_m in (1.0, 2.0, 30.0, 31.0)] == [2.0, None, None, 30.0]
    none = DepthLimits(PAPER, MotionLimits(min_altitude_m=3.0), 0.3)
    assert not none.is_limited
    assert none.limit_before(-1.0) is none.limit_before(1e6) is None
    none.update(Estimate.at_rest(depth_m=5.0))
    assert not none.is_limited
    none.update(msgspec.structs.replace(Estimate.at_rest(depth_m=5.0), altitude_m=10.0))
    assert none.limit_before(13.0) == 12.0


def test_depth_limits_without_a_depth_between_them_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"min_depth_m = 9: must be < max_depth_m = 4"):
        parse({"limits": {"min_depth_m": 9.0, "max_depth_m": 4.0}}, ControllerConfig, source="settings")
