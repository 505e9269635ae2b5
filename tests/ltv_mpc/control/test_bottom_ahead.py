"""Bottom ahead by closed loop: the vehicle rises before rising ground that its own bottom track would see too late."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.bathymetry import Bathymetry
from ltv_mpc.control.config import ControllerConfig, MotionLimits
from ltv_mpc.control.controller import Controller
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import Array, Estimate, Plan
from ltv_mpc.references import Line, Place, Point, Reference, Waypoints
from ltv_mpc.vehicle.parameters import Vehicle
from tests.ltv_mpc.control.flights import assert_within_box_and_slew, fly
from tests.ltv_mpc.vehicles import changed

PAPER = Vehicle.load("paper")
LEAST_M = 3.0
CLIFF = ((-100.0, 20.0), (20.0, 20.0), (20.5, 12.0), (300.0, 12.0))
RIDGE = ((-100.0, 20.0), (19.5, 20.0), (20.0, 12.0), (20.5, 20.0), (300.0, 20.0))


def ground(profile: tuple[tuple[float, float], ...]) -> Bathymetry:
    """Return a bottom whose depth depends on north alone."""
    return Bathymetry(np.array([(north, east, depth) for north, depth in profile for east in (-500.0, 500.0)]))


def controller(reference: Reference, bathymetry: Bathymetry | None, vehicle: Vehicle = PAPER) -> Controller:
    made = Controller(vehicle, reference, ControllerConfig(limits=MotionLimits(min_altitude_m=LEAST_M)))
    if bathymetry is not None:
        made.set_bathymetry(bathymetry)
    return made


def travel(of: Controller, over: Bathymetry, seconds: float, *, range_m: float = math.inf) -> tuple[Array, list[Plan]]:
    """Follow plans over a bottom that the bottom track sees within its range.

    Returns north, depth and altitude (K, 3), and the plans.
    """

    def altitude(estimate: Estimate) -> float:
        return float(over.depths(np.array([[estimate.north_m, estimate.east_m]]))[0]) - (estimate.depth_m or 0.0)

    def seen(estimate: Estimate) -> Estimate:
        height = altitude(estimate)
        return msgspec.structs.replace(estimate, altitude_m=height if 0.0 <= height < range_m else None)

    way, plans = fly(of, Estimate.at_rest(depth_m=15.0), round(seconds / 0.3), seen=seen)
    return np.array([(estimate.north_m, estimate.depth_m, altitude(estimate)) for estimate in way]), plans


START, END = Place(north_m=0.0, east_m=0.0), Place(north_m=45.0, east_m=0.0)
LINE = Line(start=START, end=END, depth_m=15.0, speed_mps=0.4)
POINT = Point(north_m=45.0, east_m=0.0, depth_m=15.0)


@pytest.mark.parametrize(
    ("profile", "reference", "descends"),
    [(CLIFF, LINE, False), (RIDGE, POINT, True)],
    ids=["cliff", "ridge"],
)
def test_a_vehicle_rises_in_time_within_box_and_slew_and_descends_beyond(
    profile: tuple[tuple[float, float], ...], reference: Reference, descends: bool
) -> None:
    over = ground(profile)
    way, plans = travel(controller(reference, over), over, 130.0)
    assert way[-1, 0] > 40.0
    assert way[:, 2].min() > LEAST_M
    assert way[way[:, 0] < 5.0, 1].max() < 15.1  # it begins at the depth of its reference
    assert (way[-1, 1] > 14.9) == descends
    assert_within_box_and_slew(plans, PAPER.thrusters[2])


def test_the_path_after_a_corner_counts_not_the_ground_straight_on() -> None:
    """The path turns 12 m before a cliff. A straight line would meet it, so a vehicle at a point beyond it rises."""
    over = ground(CLIFF)
    corner = (START, Place(north_m=8.0, east_m=0.0), Place(north_m=8.0, east_m=30.0))
    way, _ = travel(controller(Waypoints(waypoints=corner, depth_m=15.0, speed_mps=0.4), over), over, 60.0)
    assert way[:, 1].min() > 14.9
    on, _ = travel(controller(POINT, over), over, 40.0)
    assert on[on[:, 0] < 20.0, 1].min() < 13.0


def test_the_shallower_of_chart_and_bottom_track_counts() -> None:
    """Without a reference in force ahead: the vehicle stays at its place."""
    here = Point(north_m=0.0, east_m=0.0, depth_m=30.0)
    flat, deeper = ground(((-100.0, 14.0), (100.0, 14.0))), ground(((-100.0, 16.0), (100.0, 16.0)))
    for chart, truth in ((flat, deeper), (deeper, flat)):
        of = controller(here, chart)
        estimate = Estimate.at_rest(depth_m=5.0)
        bottom = float(truth.depths(np.zeros((1, 2)))[0])
        plan = of.plan(msgspec.structs.replace(estimate, altitude_m=bottom - 5.0))
        assert plan.depth_limit_m == pytest.approx(14.0 - LEAST_M)


def test_where_the_chart_ends_the_bottom_track_remains() -> None:
    chart, truth = ground(((-100.0, 14.0), (-50.0, 14.0))), ground(((-100.0, 18.0), (100.0, 18.0)))
    here = Point(north_m=0.0, east_m=0.0, depth_m=30.0)
    way, plans = travel(controller(here, chart), truth, 30.0, range_m=10.0)
    assert way[:, 2].min() > LEAST_M - 0.02
    assert plans[-1].depth_limit_m == pytest.approx(18.0 - LEAST_M)
    blind = controller(here, chart).plan(Estimate.at_rest(depth_m=5.0))
    assert blind.depth_limit_m is None


def test_the_chart_counts_for_a_file_without_damping_of_heave() -> None:
    """No ascent has a steady speed then."""
    free = changed(PAPER, {"heave.linear_damping_kgps": 0.0, "heave.quadratic_damping_kgpm": 0.0})
    here, chart = Point(north_m=0.0, east_m=0.0, depth_m=30.0), ground(((-100.0, 24.0), (100.0, 24.0)))
    of = controller(here, chart, free)
    assert of.plan(Estimate.at_rest(depth_m=20.9)).depth_limit_m == pytest.approx(24.0 - LEAST_M)


def test_a_vehicle_that_cannot_rise_does_not_descend_into_what_is_ahead() -> None:
    """Its thruster has no thrust up, and its buoyancy is zero."""
    heavy = changed(PAPER, {"thruster.vertical.min_N": 0.0, "net_buoyancy_N": 0.0})
    deep = Point(north_m=60.0, east_m=0.0, depth_m=30.0)
    plan = controller(deep, ground(CLIFF), heavy).plan(Estimate.at_rest(depth_m=5.0))
    assert plan.depth_limit_m == pytest.approx(12.0 - LEAST_M)


def test_a_controller_without_a_least_altitude_refuses_a_bathymetry() -> None:
    with pytest.raises(ConfigError, match=r"min_altitude_m: is missing: a bathymetry needs it"):
        Controller(PAPER, POINT).set_bathymetry(ground(CLIFF))
