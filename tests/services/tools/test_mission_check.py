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
from ltv_mpc.references import Hold, Line, Origin, Place, Point, Timed, load
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.performance import performance
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
    assert problem == f"the start is not allowed: hull {5.0 + HULL_M:.3g} m beyond the boundary of keep_in[0]"


def test_a_path_through_a_zone_is_led_round_it_and_the_length_is_printed() -> None:
    """A disc of 5 m and the hull leave a chord of 2 sqrt((5 + hull)^2 - 3^2)."""
    result = checked(Fence(margin_m=2.0, keep_out_disc=(disc(50, 3, 5),)))
    assert result.zones[0].inside_m == pytest.approx(2.0 * math.sqrt((5.0 + HULL_M) ** 2 - 9.0), abs=0.5)
    assert result.problems == []
    left_m = result.zones[0].in_margin_m
    assert left_m == pytest.approx(2.0 * math.sqrt((7.0 + HULL_M) ** 2 - 9.0), abs=0.5)
    assert result.notes == [
        f"the path lies in keep_out_disc[0] or its margin: {left_m:.1f} m are left out, and the way leads round it"
    ]
    assert result.corridor_m is None  # the other side is open


def test_the_time_of_the_mission_is_that_with_the_ways_round_its_zones() -> None:
    """Half a circle around the disc, of 8 m and the hull, is longer than its diameter."""
    fence, radius_m = Fence(margin_m=2.0, keep_out_disc=(disc(50, 0, 6),)), 8.0 + HULL_M
    clear, led_round = checked(), checked(fence)
    longer_s = (math.pi - 2.0) * radius_m / 0.3
    assert clear.duration_s + 0.5 * longer_s < led_round.duration_s < clear.duration_s + longer_s
    assert f" in {led_round.duration_s:.0f} s" in table(led_round)
    stay = Timed(rows=((0.0, 0.0, 0.0), (40.0, 12.0, 0.0), (100.0, 12.0, 0.0), (180.0, 30.0, 0.0)))
    in_zone = check_mission(PAPER, stay, Fence(margin_m=1.0, keep_out_disc=(disc(12, 0.5, 2),)))
    assert in_zone.duration_s == pytest.approx(180.0)
    assert in_zone.problems == []


def test_a_wall_without_a_way_round_it_is_a_problem() -> None:
    """The path meets the wall at 45 m and ends 30 m behind it; a second zone has a way round it."""
    basin, wall = box(-20, 120, -20, 20), box(50, 53, -30, 30)
    result = checked(Fence(margin_m=1.0, keep_in=(basin,), keep_out=(wall,), keep_out_disc=(disc(20, 0, 2),)))
    left_m = 3.0 + 2.0 * (1.0 + HULL_M)
    assert result.zones[1].in_margin_m == pytest.approx(left_m, abs=0.3)
    (problem,) = result.problems
    assert problem.startswith("there is no way round keep_out[0]: ")
    assert problem.endswith(f"{result.zones[1].in_margin_m:.1f} m of the path cannot be followed")
    (note,) = result.notes
    assert note.startswith("the path lies in keep_out_disc[0] or its margin: ")


def test_the_corridor_is_that_of_the_way_round_a_zone() -> None:
    """The way between disc and box is 4 m wide; the path itself has an open side, or lies in the disc."""
    zones = Fence(margin_m=0.5, keep_out_disc=(disc(50, -1, 3),), keep_out=(box(40, 60, 6, 12),))
    still, moving = checked(zones), checked(zones, current_mps=0.25)
    assert still.problems == []
    assert still.corridor_m == pytest.approx(4.0, abs=0.1)
    wide = "the corridor is 4.0 m wide at 50 m of the path: the vehicle needs "
    assert any(problem.startswith(wide) for problem in moving.problems)


def test_a_path_that_leaves_the_fence_and_comes_back_is_led_along_it() -> None:
    notch = ring((-20, -20), (-20, 20), (120, 20), (120, -20), (60, -20), (60, 5), (40, 5), (40, -20))
    result = checked(Fence(margin_m=1.0, keep_in=(notch,)))
    assert result.problems == []
    (note,) = result.notes
    assert note.startswith("the path leaves keep_in[0] or enters its margin: 2")


def test_a_path_that_ends_in_a_zone_ends_beside_it() -> None:
    result = checked(Fence(margin_m=1.0, keep_out_disc=(disc(100, 3, 5),)))
    (problem,) = result.problems
    east_m = 3.0 - 6.0 - HULL_M
    assert problem == (
        f"the end of the path is not allowed (keep_out_disc[0]): the vehicle holds at (100.0, {east_m:.1f}) instead, "
        f"{-east_m:.1f} m away"
    )
    nowhere = checked(Fence(margin_m=1.0, keep_in=(box(-1, 101, -1, 1),)))
    assert "the end of the path is not allowed (keep_in[0]), and no allowed point is near it" in nowhere.problems
    assert nowhere.notes == []


def test_a_path_through_a_margin_is_led_round_it_too() -> None:
    result = checked(Fence(margin_m=2.0, keep_out_disc=(disc(50, 7, 5),)))
    assert result.zones[0].inside_m == 0.0
    assert result.zones[0].in_margin_m > 2.0
    assert result.problems == []
    (note,) = result.notes
    assert note.startswith("the path lies in keep_out_disc[0] or its margin: ")


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
    assert problem == "a current of 0.6 m/s carries the vehicle away: full thrust holds 0.50 m/s"


def test_a_current_that_leaves_no_reserve_is_found_with_the_speed_against_it() -> None:
    [problem] = checked(current_mps=0.46).problems
    assert "full thrust makes 0.04 m/s against it, without a reserve" in problem


def test_a_fixed_heading_in_a_current_is_found() -> None:
    facing = Point(north_m=0.0, east_m=0.0, heading_deg=90.0)
    assert check_mission(PAPER, facing, None).problems == []
    [problem] = check_mission(PAPER, facing, None, current_mps=0.2).problems
    assert problem.startswith(
        "heading_deg = 90 is held in a current of 0.2 m/s only with bow or stern into the current"
    )
    across_N = PAPER.sway.quadratic_damping_kgpm * 0.2**2
    assert PAPER.sway.linear_damping_kgps == 0.0
    assert (
        f"45 degrees the water pushes sideways with {across_N / 2:.1f} N, at 90 degrees with {across_N:.1f} N"
        in problem
    )
    weak = Vehicle.load("weak-reverse")
    astern_mps = performance(weak).strongest_current_stern_mps
    assert astern_mps is not None
    (problem,) = check_mission(weak, facing, None, current_mps=1.01 * astern_mps).problems
    assert "only with the bow into the current (0 degrees)" in problem
    turning = Point(north_m=0.0, east_m=0.0, into_current=True)
    assert check_mission(PAPER, turning, None, current_mps=0.2).problems == []


def test_a_descent_into_the_bottom_is_found() -> None:
    deep = Point(north_m=0.0, east_m=0.0, depth_m=30.0)
    assert check_mission(PAPER, deep, None, bottom=40.0).problems == []
    [problem] = check_mission(PAPER, deep, None, bottom=20.0).problems
    assert "descends to 30 m, the bottom is at 20 m: no min_altitude_m stops the vehicle" in problem
    limits = MotionLimits(min_altitude_m=3.0, max_depth_m=25.0)
    low, deepest = check_mission(PAPER, deep, None, bottom=20.0, limits=limits).problems
    assert "with min_altitude_m = 3 the vehicle stops at 17 m" in low
    assert "max_depth_m = 25" in deepest


def test_a_point_in_a_zone_is_found_and_a_fence_needs_a_hull() -> None:
    fence = Fence(margin_m=1.0, keep_out_disc=(disc(0, 0, 5),))
    point = Point(north_m=1.0, east_m=0.0)
    text = table(check_mission(PAPER, point, fence))
    assert f"hull from keep_out_disc[0]            {4.0 + HULL_M:.3g} m beyond the boundary, margin 1 m" in text
    assert "path" not in text
    assert "corridor" not in text
    assert check_mission(PAPER, point, fence).problems == [
        f"the point is not allowed (keep_out_disc[0]): the vehicle holds at ({6.0 + HULL_M:.1f}, 0.0) instead, "
        f"{5.0 + HULL_M:.1f} m away"
    ]
    with pytest.raises(ConfigError, match=r"\[hull\] is missing|\[hull\]: is missing"):
        check_mission(msgspec.structs.replace(PAPER, hull=None), point, fence)


def test_a_start_in_a_zone_or_its_margin_is_found_and_the_way_from_it() -> None:
    fence, point = Fence(margin_m=2.0, keep_out_disc=(disc(10, 0, 3),)), Point(north_m=20.0, east_m=0.0)

    def from_(north_m: float) -> MissionCheck:
        return check_mission(PAPER, point, fence, start=(north_m, 0.0))

    assert from_(9.0).problems == [
        f"the start is not allowed: hull {2.0 + HULL_M:.3g} m beyond the boundary of keep_out_disc[0]"
    ]
    free_m = 4.5 - 3.0 - HULL_M
    assert from_(5.5).problems == [
        f"the start is in the margin of keep_out_disc[0]: hull {free_m:.3g} m from it, margin 2 m"
    ]
    behind, beside = from_(0.0), from_(40.0)
    assert behind.problems == beside.problems == beside.notes == []
    (note,) = behind.notes
    assert note.startswith("the way from the start leads round the zones: 2")
    here = check_mission(PAPER, Hold(), fence, start=(9.0, 0.0))
    assert [problem.split(" is not allowed")[0] for problem in here.problems] == ["the start", "the point"]


def test_a_start_without_a_way_to_the_point_is_found() -> None:
    fence = Fence(margin_m=1.0, keep_in=(box(-20, 60, -20, 20),), keep_out=(box(20, 25, -30, 30),))
    point = Point(north_m=40.0, east_m=0.0)
    assert check_mission(PAPER, point, fence, start=(0.0, 0.0)).problems == [
        "there is no way round the zones from the start to (40.0, 0.0)"
    ]
    result = check_mission(PAPER, NORTH, fence, start=(30.0, 10.0))
    assert result.length_m == pytest.approx(100.0 + math.hypot(30.0, 10.0), abs=0.1)
    assert any(problem.startswith("there is no way round keep_out[0]") for problem in result.problems)


def test_origins_that_differ_are_an_error() -> None:
    fence = msgspec.structs.replace(
        Fence.load("examples/fences/harbour.toml"), origin=Origin(latitude_deg=60.4, longitude_deg=5.33)
    )
    with pytest.raises(ConfigError, match=r"latitude 60.4.* away from the origin of the reference, 50.2"):
        check_mission(PAPER, load("examples/references/harbour.toml"), fence)


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
    return check_mission(PAPER, reference, None, bottom=bathymetry, limits=limits)


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


def test_a_point_below_the_bottom_of_a_bathymetry_is_found() -> None:
    point, flat = Point(north_m=10.0, east_m=0.0, depth_m=30.0), ground((-50.0, 25.0), (50.0, 25.0))
    [problem] = check_mission(PAPER, point, None, bottom=flat).problems
    assert "by up to 5.0 m at 0 m of the path (north 10 m, east 0 m)" in problem


def test_here_without_a_start_is_checked_against_neither_fence_nor_soundings() -> None:
    here, flat = Hold(depth_m=30.0), ground((-50.0, 25.0), (50.0, 25.0))
    fence = Fence(margin_m=1.0, keep_out_disc=(disc(0, 0, 5),))
    why = "is not checked: the reference begins where the vehicle is; give this position with --start NORTH,EAST"
    result = check_mission(PAPER, here, fence, bottom=flat)
    assert result.problems == [f"--fence {why}", f"--bottom {why}"]
    assert (result.zones, result.bottom) == ([], None)
    assert check_mission(PAPER, here, None, bottom=40.0).problems == []  # the same depth everywhere
    at_home = check_mission(PAPER, here, fence, bottom=flat, start=(0.0, 0.0))
    assert at_home.bottom is not None
    assert [zone.zone for zone in at_home.zones] == ["keep_out_disc[0]"]
    assert not any("not checked" in problem for problem in at_home.problems)
