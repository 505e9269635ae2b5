"""Check of a mission: each thing that cannot be is found, with its numbers, and nothing else is."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.bathymetry import Bathymetry
from ltv_mpc.control.config import MotionLimits
from ltv_mpc.errors import ConfigError
from ltv_mpc.geofence.fence import Disc, Fence, Polygon
from ltv_mpc.references import Hold, Line, Place, Point
from ltv_mpc.vehicle.parameters import Vehicle
from services.tools.mission_check import MissionCheck, check_mission, table

PAPER = Vehicle.load("paper")
HULL_M = 0.5 * math.hypot(2.0, 0.65)
NORTH = Line(start=Place(north_m=0.0, east_m=0.0), end=Place(north_m=100.0, east_m=0.0), speed_mps=0.3)


def ring(*corners: tuple[float, float], margin_m: float | None = None) -> Polygon:
    return Polygon(vertices=tuple(Place(north_m=n, east_m=e) for n, e in corners), margin_m=margin_m)


def box(south: float, north: float, west: float, east: float) -> Polygon:
    return ring((south, west), (south, east), (north, east), (north, west))


def disc(north_m: float, east_m: float, radius_m: float) -> Disc:
    return Disc(centre=Place(north_m=north_m, east_m=east_m), radius_m=radius_m)


def checked(fence: Fence | None = None, **more: float) -> MissionCheck:
    return check_mission(PAPER, NORTH, fence, **more)  # type: ignore[arg-type]


def test_a_mission_far_from_its_zones_has_no_problems() -> None:
    result = checked(Fence(margin_m=2.0, keep_in=(box(-50, 150, -50, 50),), keep_out_disc=(disc(50, 30, 5),)))
    assert result.problems == []
    assert result.length_m == pytest.approx(100.0)
    assert [zone.zone for zone in result.zones] == ["keep_in[0]", "keep_out_disc[0]"]
    buoy = result.zones[1]
    assert buoy.clearance_m == pytest.approx(25.0 - HULL_M, abs=0.01)
    assert buoy.way_m == pytest.approx(50.0, abs=0.3)
    assert buoy.inside_m == buoy.in_margin_m == 0.0


def test_a_start_outside_is_found() -> None:
    [problem] = checked(Fence(margin_m=2.0, keep_in=(box(5, 150, -50, 50),))).problems
    assert problem == f"the start is not allowed: hull {5.0 + HULL_M:.1f} m beyond the boundary of keep_in[0]"


def test_a_path_through_a_zone_is_found_with_its_length() -> None:
    """A disc of 5 m and the hull leave a chord of 2 sqrt((5 + hull)^2 - 3^2)."""
    result = checked(Fence(margin_m=2.0, keep_out_disc=(disc(50, 3, 5),)))
    assert result.zones[0].inside_m == pytest.approx(2.0 * math.sqrt((5.0 + HULL_M) ** 2 - 9.0), abs=0.5)
    assert any("the path is not allowed for" in problem for problem in result.problems)


def test_a_margin_that_is_entered_is_found() -> None:
    result = checked(Fence(margin_m=2.0, keep_out_disc=(disc(50, 7, 5),)))
    assert result.zones[0].inside_m == 0.0
    assert result.zones[0].in_margin_m > 2.0
    assert any("enters the margin of keep_out_disc[0]" in problem for problem in result.problems)


def test_a_corridor_is_too_narrow_only_in_a_current() -> None:
    walls = Fence(margin_m=0.5, keep_out=(box(40, 60, 2, 9), box(40, 60, -9, -2)))
    still, moving = checked(walls), checked(walls, current_mps=0.25)
    assert still.corridor_m == pytest.approx(4.0, abs=0.1)
    assert still.needed_m == pytest.approx(2.0 * HULL_M + 1.0)
    assert not any("corridor" in problem for problem in still.problems)
    assert moving.drift_m is not None
    assert moving.needed_m == pytest.approx(2.0 * HULL_M + 1.0 + moving.drift_m)
    assert any("the corridor is 4.0 m wide" in problem for problem in moving.problems)


def test_a_margin_shorter_than_the_stopping_distance_is_found_only_near_the_path() -> None:
    near, far = (Fence(margin_m=0.1, keep_out_disc=(disc(50, east, 1),)) for east in (2.3, 40.0))
    result = checked(near, current_mps=0.1)
    assert result.stopping_m is not None
    assert 0.1 < result.stopping_m < 2.0
    assert any(f"takes {result.stopping_m:.1f} m, margin 0.1 m" in problem for problem in result.problems)
    assert checked(far, current_mps=0.1).problems == []


def test_a_current_that_is_too_strong_is_found_without_a_fence() -> None:
    assert checked(current_mps=0.3).problems == []
    [problem] = checked(current_mps=0.6).problems
    assert "a current of 0.6 m/s carries the vehicle away" in problem


def test_a_fixed_heading_in_a_current_is_found() -> None:
    facing = Point(north_m=0.0, east_m=0.0, heading_deg=90.0)
    assert check_mission(PAPER, facing, None).problems == []
    [problem] = check_mission(PAPER, facing, None, current_mps=0.2).problems
    assert problem.startswith("heading_deg = 90 is not held in a current of 0.2 m/s across it")
    turning = Point(north_m=0.0, east_m=0.0, into_current=True)
    assert check_mission(PAPER, turning, None, current_mps=0.2).problems == []


def test_a_descent_into_the_bottom_is_found() -> None:
    deep = Point(north_m=0.0, east_m=0.0, depth_m=30.0)
    assert check_mission(PAPER, deep, None, bottom_m=40.0).problems == []
    [problem] = check_mission(PAPER, deep, None, bottom_m=20.0).problems
    assert "descends to 30 m, the bottom is at 20 m: no min_altitude_m stops the vehicle" in problem
    limits = MotionLimits(min_altitude_m=3.0, max_depth_m=25.0)
    low, deepest = check_mission(PAPER, deep, None, bottom_m=20.0, limits=limits).problems
    assert "with min_altitude_m = 3 the vehicle stops at 17 m" in low
    assert "max_depth_m = 25" in deepest


def test_a_point_in_a_zone_is_found_and_a_fence_needs_a_hull() -> None:
    fence = Fence(margin_m=1.0, keep_out_disc=(disc(0, 0, 5),))
    point = Point(north_m=1.0, east_m=0.0)
    assert "the start is not allowed" in check_mission(PAPER, point, fence).problems[0]
    with pytest.raises(ConfigError, match=r"\[hull\] is missing|\[hull\]: is missing"):
        check_mission(msgspec.structs.replace(PAPER, hull=None), point, fence)


def test_the_text_has_the_numbers_and_the_problems() -> None:
    text = table(checked(Fence(margin_m=2.0, keep_out_disc=(disc(50, 3, 5),)), current_mps=0.1))
    assert text.startswith("mission: 100 m in ")
    assert "hull from keep_out_disc[0]" in text
    assert "problem: the path is not allowed" in text
    assert table(checked()).endswith("no problems")


def test_a_corridor_must_be_wider_than_the_drift_while_the_vehicle_turns() -> None:
    drift_m = checked(current_mps=0.1).drift_m
    assert drift_m is not None
    wide, narrow = (MotionLimits(max_cross_track_m=factor * drift_m) for factor in (1.01, 0.99))
    assert check_mission(PAPER, NORTH, None, current_mps=0.1, limits=wide).problems == []
    (problem,) = check_mission(PAPER, NORTH, None, current_mps=0.1, limits=narrow).problems
    assert problem == (
        f"max_cross_track_m = {0.99 * drift_m:g} is not kept: the vehicle drifts {drift_m:.2f} m while it turns into "
        "0.1 m/s"
    )
    point = Point(north_m=1.0, east_m=0.0)
    assert check_mission(PAPER, point, None, current_mps=0.1, limits=narrow).problems == []


def ground(*profile: tuple[float, float], half_width_m: float = 50.0) -> Bathymetry:
    """Return a bottom whose depth depends on north alone."""
    return Bathymetry(np.array([(n, e, z) for n, z in profile for e in (-half_width_m, half_width_m)]))


def over(bathymetry: Bathymetry, least_m: float | None = 3.0, depth_m: float | None = 15.0) -> MissionCheck:
    reference = msgspec.structs.replace(NORTH, depth_m=depth_m)
    limits = MotionLimits(min_altitude_m=least_m)
    return check_mission(PAPER, reference, None, bathymetry=bathymetry, limits=limits)


def test_a_reference_too_deep_for_a_bathymetry_is_found_with_place_depth_and_lack() -> None:
    """The bottom rises from 22 m by 1 m in 10 m: from north 40 m on it is less than 18 m deep."""
    result = over(ground((-10.0, 23.0), (110.0, 11.0)))
    [problem] = result.problems
    assert problem.startswith("the reference is too deep for 60.")
    assert problem.endswith(
        " m of the path, by up to 6.0 m at 100 m of the path (north 100 m, east 0 m): depth 15.0 m, bottom 12.0 m, "
        "min_altitude_m = 3"
    )
    assert result.bottom is not None
    assert (result.bottom.altitude_m, result.bottom.depth_m) == (pytest.approx(-3.0), 15.0)
    assert "altitude of the reference             -3 m or more, at 100 m of the path" in table(result)


def test_a_reference_above_the_bottom_of_a_bathymetry_has_no_problem() -> None:
    result = over(ground((-10.0, 23.0), (110.0, 18.2)))
    assert result.problems == []
    assert result.bottom is not None
    assert (result.bottom.altitude_m, result.bottom.way_m) == (pytest.approx(3.6), pytest.approx(100.0))
    assert (result.bottom.too_deep_m, result.bottom.unknown_m) == (0.0, 0.0)
    assert over(ground((-10.0, 16.0), (110.0, 16.0)), None).problems == []
    assert over(ground((-10.0, 14.0), (110.0, 14.0)), depth_m=None).problems == []


def test_a_path_beyond_the_soundings_is_found() -> None:
    [problem] = over(ground((-10.0, 30.0), (80.0, 30.0))).problems
    assert problem == "the bathymetry does not reach 20.0 m of the path"
    [problem] = over(ground((-50.0, 30.0), (-10.0, 30.0))).problems
    assert problem == "the bathymetry does not reach the reference"


def test_a_point_below_the_bottom_of_a_bathymetry_is_found_and_here_has_no_place() -> None:
    point, flat = Point(north_m=10.0, east_m=0.0, depth_m=30.0), ground((-50.0, 25.0), (50.0, 25.0))
    [problem] = check_mission(PAPER, point, None, bathymetry=flat).problems
    assert "by up to 5.0 m at 0 m of the path (north 10 m, east 0 m)" in problem
    assert check_mission(PAPER, Hold(depth_m=30.0), None, bathymetry=flat).bottom is None
