"""Depth law of a vehicle that cannot follow (afloat, aground, held): no windup, and it dives at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from ltv_mpc import Controller, ControllerConfig, Estimate, Vehicle, references
from ltv_mpc.messages import Plan
from ltv_mpc.vehicle.parameters import Translation
from tests.ltv_mpc.control.flights import column, fly

PAPER = Vehicle.load("paper")
DRAUGHT_M = 0.3
"""Depth of the origin of the floating vehicle: its hull does not let it rise farther."""


def afloat(depth_m: float) -> float:
    return max(depth_m, DRAUGHT_M)


def aground(depth_m: float) -> float:
    return min(depth_m, 12.0)


def held(_: float) -> float:
    return 5.0


def to(depth_m: float) -> references.Point:
    return references.Point(north_m=0.0, east_m=0.0, depth_m=depth_m)


def controller_of(vehicle: Vehicle, depth_m: float) -> Controller:
    return Controller(vehicle, to(depth_m), ControllerConfig(lateral=False, horizon_s=3.0))


def fly_until(
    controller: Controller, estimate: Estimate, seconds: float, stop: Callable[[float], float], **options: Any
) -> tuple[list[Estimate], list[Plan]]:
    """Return the way of a vehicle that ``stop`` keeps from some depths, with its plans."""

    def stopped(moved: Estimate) -> Estimate:
        reached = stop(moved.depth_m)
        return moved if reached == moved.depth_m else replace(moved, depth_m=reached, velocity_down_mps=0.0)

    return fly(controller, estimate, round(seconds / 0.3), moved=stopped, **options)


def lag_of_a_dive(controller: Controller, estimate: Estimate) -> tuple[float, float]:
    """Return the seconds until the vehicle is 5 cm deeper, and the largest distance behind a ramp of 0.2 m/s (m)."""
    way, _ = fly_until(controller, estimate, 45.0, afloat)
    depth = column(way, "depth_m")
    t = np.arange(1, len(way) + 1) * 0.3
    return float(t[np.argmax(depth > DRAUGHT_M + 0.05)]), float((DRAUGHT_M + 0.2 * t - depth).max())


def test_a_dive_after_waiting_afloat_is_that_of_a_new_controller() -> None:
    start = Estimate.at_rest(depth_m=DRAUGHT_M)
    begins_s, behind_m = lag_of_a_dive(controller_of(PAPER, 12.0), start)
    waited = controller_of(PAPER, 0.0)
    way, _ = fly_until(waited, start, 150.0, afloat)
    waited.follow(to(12.0))
    later_s, later_m = lag_of_a_dive(waited, way[-1])
    assert later_s <= begins_s + 1.0
    assert later_m <= behind_m + 0.2


def test_afloat_the_vehicle_needs_no_vertical_thrust() -> None:
    rng = np.random.default_rng(1)

    def noisy(estimate: Estimate) -> Estimate:
        return replace(estimate, depth_m=estimate.depth_m + rng.normal(0.0, 0.02))

    controller = controller_of(PAPER, 0.0)
    _, plans = fly_until(controller, Estimate.at_rest(depth_m=DRAUGHT_M), 180.0, afloat, seen=noisy)
    plans = plans[-200:]
    thrust = np.array([plan.thrust_N[0, 2] for plan in plans])
    assert np.median(abs(thrust)) < 0.1
    assert thrust.min() > -10.0


def test_aground_the_thrust_stays_that_of_the_law_without_integral() -> None:
    """B - W + M_z w0^2 e = 30.5 + 20.25 e."""
    controller = controller_of(PAPER, 13.0)
    _, plans = fly_until(controller, Estimate.at_rest(depth_m=11.9), 90.0, aground)
    assert plans[-1].thrust_N[0, 2] <= 51.0
    assert abs(controller.save(0).depth_integral_N) < 0.1


def test_a_vehicle_that_is_held_goes_to_its_depth_when_it_is_released() -> None:
    controller, wanted_m = controller_of(PAPER, 7.0), 7.0
    way, _ = fly_until(controller, Estimate.at_rest(depth_m=5.0), 100.0, held)
    assert abs(controller.save(0).depth_integral_N) < 1.0
    way, _ = fly(controller, way[-1], 333)
    depth = column(way, "depth_m")
    assert depth[-1] == pytest.approx(wanted_m, abs=0.03)
    assert abs(depth - wanted_m).max() < abs(5.0 - wanted_m) + 0.1  # it does not go the other way


@pytest.mark.parametrize(("off_N", "damping_kgps"), [(-40.0, 200.0), (6.5, 0.0)])
def test_a_wrong_buoyancy_is_still_learned(off_N: float, damping_kgps: float) -> None:
    heave = Translation(mass_kg=225.0, linear_damping_kgps=damping_kgps, quadratic_damping_kgpm=800.0)
    model = replace(PAPER, heave=heave)
    true = replace(model, net_buoyancy_N=PAPER.net_buoyancy_N + off_N)
    way, _ = fly(controller_of(model, 8.0), Estimate.at_rest(depth_m=8.0), 600, true=true)
    assert way[-1].depth_m == pytest.approx(8.0, abs=0.02)


def test_a_new_reference_starts_the_integral_at_zero_and_a_pause_does_not() -> None:
    true = replace(PAPER, net_buoyancy_N=24.0)
    controller = controller_of(PAPER, 8.0)
    way, _ = fly(controller, Estimate.at_rest(depth_m=8.0), 300, true=true)
    assert controller.save(0).depth_integral_N == pytest.approx(-6.5, abs=0.3)
    controller.pause(way[-1])
    controller.resume()
    assert controller.save(0).depth_integral_N == pytest.approx(-6.5, abs=0.3)
    controller.follow(to(9.0))
    assert controller.save(0).depth_integral_N == 0.0
