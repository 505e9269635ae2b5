"""Check of a mission: each thing that cannot be is found, with its numbers, and nothing else is."""

from __future__ import annotations

import math
import re
from typing import Any

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

PAPER, WEAK = Vehicle.load("paper"), Vehicle.load("weak-reverse")
HULL_M = 0.5 * math.hypot(2.0, 0.65)
NORTH = Line(start=Place(north_m=0.0, east_m=0.0), end=Place(north_m=100.0, east_m=0.0), speed_mps=0.3)
ROUND = r"the path lies in keep_out_disc\[0\] or its margin: "


def ring(*corners: tuple[float, float]) -> Polygon:
    return Polygon(vertices=tuple(Place(north_m=n, east_m=e) for n, e in corners))


def box(south: float, north: float, west: float, east: float) -> Polygon:
    return ring((south, west), (south, east), (north, east), (north, west))


def disc(north_m: float, east_m: float, radius_m: float) -> Disc:
    return Disc(centre=Place(north_m=north_m, east_m=east_m), radius_m=radius_m)


def out(*zones: Disc | Polygon, margin_m: float = 2.0, keep_in: tuple[Polygon, ...] = ()) -> Fence:
    discs, polygons = ([zone for zone in zones if isinstance(zone, kind)] for kind in (Disc, Polygon))
    return Fence(margin_m=margin_m, keep_in=keep_in, keep_out=tuple(polygons), keep_out_disc=tuple(discs))


def checked(fence: Fence | None = None, reference: Any = NORTH, vehicle: Vehicle = PAPER, **more: Any) -> MissionCheck:
    return check_mission(vehicle, reference, fence, **more)


def point(north_m: float = 0.0, east_m: float = 0.0, **more: Any) -> Point:
    return Point(north_m=north_m, east_m=east_m, **more)


def ground(*profile: tuple[float, float]) -> Bathymetry:
    """Return a bottom whose depth depends on north alone."""
    return Bathymetry(np.array([(n, e, z) for n, z in profile for e in (-50.0, 50.0)]))


def at(start_m: float, reference: Any = None) -> dict[str, Any]:
    return {"reference": reference or point(20.0), "start": (start_m, 0.0)}


def in_current(mps: float, reference: Any = NORTH, **more: Any) -> dict[str, Any]:
    return {"reference": reference, "current_mps": mps, **more}


def over(bottom: Any, reference: Any = None, least_m: float | None = 3.0) -> dict[str, Any]:
    level = msgspec.structs.replace(NORTH, depth_m=15.0)
    return {"reference": reference or level, "bottom": bottom, "limits": MotionLimits(min_altitude_m=least_m)}


FACING, DEEP, HERE = point(heading_deg=90.0), point(depth_m=30.0), Hold(depth_m=30.0)
ASTERN_MPS = performance(WEAK).top_speed_astern_mps or 0.0
ACROSS_N = PAPER.sway.quadratic_damping_kgpm * 0.2**2
DRIFT_M = checked(current_mps=0.1).drift_m or 0.0
WIDE, CLOSE = (MotionLimits(max_cross_track_m=factor * DRIFT_M) for factor in (1.01, 0.99))
BUOY, FLAT = out(disc(10, 0, 3)), ground((-50.0, 25.0), (50.0, 25.0))
YARD, BASIN = box(-50, 150, -50, 50), box(-20, 120, -20, 20)
WALLED = out(box(20, 25, -30, 30), margin_m=1.0, keep_in=(box(-20, 60, -20, 20),))
WALLS = out(box(40, 60, 2, 9), box(40, 60, -9, -2), margin_m=0.5)
NOTCH = ring((-20, -20), (-20, 20), (120, 20), (120, -20), (60, -20), (60, 5), (40, 5), (40, -20))
GAP = out(disc(50, -1, 3), box(40, 60, 6, 12), margin_m=0.5)
BEYOND = f"hull {2.0 + HULL_M:.3g} m beyond the boundary of keep_out_disc[0]"
BESIDE = f"vehicle holds at (100.0, {-3.0 - HULL_M:.1f}) instead, {3.0 + HULL_M:.1f} m away"
SINKING = Line(
    start=Place(north_m=0.0, east_m=0.0, depth_m=0.0), end=Place(north_m=100.0, east_m=0.0, depth_m=9.0), speed_mps=0.3
)
RISING = ground((-10.0, 23.0), (110.0, 11.0))  # from 22 m by 1 m in 10 m: from north 40 m on less than 18 m deep
LACK = "by up to 6.0 m at 100 m of the path (north 100 m, east 0 m): depth 15.0 m, bottom 12.0 m, min_altitude_m = 3"

CASES: tuple[tuple[Fence | None, dict[str, Any], tuple[str, ...]], ...] = (
    (out(disc(50, 30, 5), keep_in=(YARD,)), {}, ()),
    (out(keep_in=(box(5, 150, -50, 50),)), {}, (f"start is not allowed: hull {5.0 + HULL_M:.3g} m beyond",)),
    (out(box(50, 53, -30, 30), disc(20, 0, 2), margin_m=1.0, keep_in=(BASIN,)), {}, ("no way round keep_out[0]: 7.2",)),
    (out(box(50, 53, -30, 30), margin_m=1.0, keep_in=(BASIN,)), {"reference": SINKING}, ("no way round keep_out[0]",)),
    (out(disc(100, 3, 5), margin_m=1.0), {}, (f"end of the path is not allowed (keep_out_disc[0]): the {BESIDE}",)),
    (out(margin_m=1.0, keep_in=(box(-1, 101, -1, 1),)), {}, ("start is not", "(keep_in[0]), and no allowed point")),
    (WALLS, in_current(0.25), ("the corridor is 4.0 m wide at 40 m of the path: the vehicle needs 5.2 m",)),
    (GAP, in_current(0.25), ("takes 0.8 m, margin 0.5 m", "the corridor is 4.0 m wide at 50 m of the path")),
    (out(disc(50, 2.3, 1), margin_m=0.1), in_current(0.1), (" m, margin 0.1 m",)),
    (out(disc(50, 40, 1), margin_m=0.1), in_current(0.1), ()),
    (None, in_current(0.3), ()),
    (None, in_current(0.6), ("a current of 0.6 m/s carries the vehicle away: full thrust holds 0.50 m/s",)),
    (None, in_current(0.46), ("full thrust makes 0.04 m/s against it, without a reserve",)),
    (None, in_current(0.0, FACING), ()),
    (None, in_current(0.2, FACING), (f"with {ACROSS_N / 2:.1f} N, at 90 degrees with {ACROSS_N:.1f} N",)),
    (None, in_current(0.2, FACING), ("only with bow or stern into the current (0 or 180 degrees)",)),
    (None, in_current(1.01 * ASTERN_MPS, FACING, vehicle=WEAK), ("only with the bow into the current (0 degrees)",)),
    (None, in_current(0.2, point(into_current=True)), ()),
    (None, in_current(0.1, limits=WIDE), ()),
    (None, in_current(0.1, limits=CLOSE), (f"{0.99 * DRIFT_M:g} is not kept: the vehicle drifts {DRIFT_M:.2f} m",)),
    (None, in_current(0.1, point(1.0), limits=CLOSE), ()),
    (None, over(40.0, DEEP), ()),
    (None, over(20.0, DEEP, None), ("descends to 30 m, the bottom is at 20 m: no min_altitude_m stops the vehicle",)),
    (None, over(20.0, DEEP), ("with min_altitude_m = 3 the vehicle stops at 17 m",)),
    (None, {"reference": DEEP, "limits": MotionLimits(max_depth_m=25.0)}, ("max_depth_m = 25",)),
    (BUOY, at(9.0), (f"the start is not allowed: {BEYOND}",)),
    (BUOY, at(5.5), (f"in the margin of keep_out_disc[0]: hull {1.5 - HULL_M:.3g} m from it, margin 2 m",)),
    (BUOY, at(40.0), ()),
    (BUOY, at(9.0, Hold()), ("the start is not allowed", "the point is not allowed")),
    (WALLED, at(0.0, point(40.0)), ("there is no way round the zones from the start to (40.0, 0.0)",)),
    (None, over(RISING), (LACK,)),
    (None, over(ground((-10.0, 23.0), (110.0, 18.2))), ()),
    (None, over(ground((-10.0, 16.0), (110.0, 16.0)), least_m=None), ()),
    (None, over(ground((-10.0, 14.0), (110.0, 14.0)), NORTH), ()),
    (None, over(ground((-10.0, 30.0), (80.0, 30.0))), ("the bathymetry does not reach 20.0 m of the path",)),
    (None, over(ground((-50.0, 30.0), (-10.0, 30.0))), ("the bathymetry does not reach the reference",)),
    (None, over(FLAT, point(10.0, depth_m=30.0), None), ("by up to 5.0 m at 0 m of the path (north 10 m, east 0 m)",)),
    (BUOY, over(FLAT, HERE), ("--fence is not checked: the reference begins where", "--bottom is not checked")),
    (None, over(40.0, HERE), ()),  # the same depth everywhere
    (BUOY, over(FLAT, HERE) | {"start": (10.0, 0.0)}, ("by up to 8.0 m", "start is not allowed", "point is not")),
)  # fmt: skip


@pytest.mark.parametrize(("fence", "more", "expected"), CASES)
def test_each_thing_that_cannot_be_is_found_and_nothing_else(fence, more, expected) -> None:
    problems = checked(fence, **more).problems
    assert len(problems) == len(expected), problems
    assert all(part in problem for problem, part in zip(problems, expected, strict=True)), problems


@pytest.mark.parametrize(
    ("fence", "more", "note"),
    [
        (out(disc(50, 7, 5)), {}, f"{ROUND}[2-9]"),
        (out(margin_m=1.0, keep_in=(NOTCH,)), {}, r"the path leaves keep_in\[0\] or enters its margin: 2"),
        (BUOY, at(0.0), "the way from the start leads round the zones: 2"),
    ],
)
def test_what_the_controller_does_otherwise_is_a_note(fence: Fence, more: dict[str, Any], note: str) -> None:
    result = checked(fence, **more)
    assert result.problems == []
    assert [re.match(note, one) is not None for one in result.notes] == [True]


def test_of_each_zone_the_least_clearance_and_the_length_within_are_told() -> None:
    """A disc of 5 m and the hull leave a chord of 2 sqrt((5 + hull)^2 - 3^2)."""
    far = checked(out(disc(50, 30, 5), keep_in=(YARD,)))
    assert far.length_m == pytest.approx(100.0)
    buoy = far.zones[1]
    assert (buoy.zone, buoy.inside_m, buoy.in_margin_m) == ("keep_out_disc[0]", 0.0, 0.0)
    assert (buoy.clearance_m, buoy.way_m) == (pytest.approx(25.0 - HULL_M, abs=0.01), pytest.approx(50.0, abs=0.3))
    near = checked(out(disc(50, 3, 5)))
    assert near.zones[0].inside_m == pytest.approx(2.0 * math.sqrt((5.0 + HULL_M) ** 2 - 9.0), abs=0.5)
    left_m = near.zones[0].in_margin_m
    assert left_m == pytest.approx(2.0 * math.sqrt((7.0 + HULL_M) ** 2 - 9.0), abs=0.5)
    assert [note.partition(": ")[2] for note in near.notes] == [
        f"{left_m:.1f} m are left out, and the way leads round it"
    ]
    assert near.corridor_m is None  # the other side is open


def test_the_time_of_the_mission_is_that_with_the_ways_round_its_zones() -> None:
    """Half a circle around the disc, of 8 m and the hull, is longer than its diameter."""
    clear, led_round = checked(), checked(out(disc(50, 0, 6)))
    longer_s = (math.pi - 2.0) * (8.0 + HULL_M) / 0.3
    assert clear.duration_s + 0.5 * longer_s < led_round.duration_s < clear.duration_s + longer_s
    assert f" in {led_round.duration_s:.0f} s" in table(led_round)
    stay = Timed(rows=((0.0, 0.0, 0.0), (40.0, 12.0, 0.0), (100.0, 12.0, 0.0), (180.0, 30.0, 0.0)))
    assert checked(out(disc(12, 0.5, 2), margin_m=1.0), stay).duration_s == pytest.approx(180.0)


def test_corridor_and_needed_width_are_those_of_the_allowed_way() -> None:
    """The way between disc and box is 4 m wide; the path itself has an open side, or lies in the disc."""
    for fence in (WALLS, GAP):
        still, moving = checked(fence), checked(fence, current_mps=0.25)
        assert still.corridor_m == pytest.approx(4.0, abs=0.1)
        assert still.needed_m == pytest.approx(2.0 * HULL_M + 1.0)
        assert moving.needed_m == pytest.approx(2.0 * HULL_M + 1.0 + (moving.drift_m or 0.0))
    stopping_m = checked(current_mps=0.1).stopping_m
    assert stopping_m is not None
    assert 0.1 < stopping_m < 2.0
    beside = checked(WALLED, start=(30.0, 10.0))
    assert beside.length_m == pytest.approx(100.0 + math.hypot(30.0, 10.0), abs=0.1)


def test_the_table_has_the_figures_of_a_point_and_of_a_path() -> None:
    text = table(checked(out(disc(0, 0, 5), margin_m=1.0), point(1.0)))
    assert f"hull from keep_out_disc[0]            {4.0 + HULL_M:.3g} m beyond the boundary, margin 1 m" in text
    assert not re.search("path|corridor", text)
    deep = checked(None, **over(RISING))
    assert "altitude of the reference             -3 m or more, at 100 m of the path" in table(deep)
    above = checked(None, **over(ground((-10.0, 23.0), (110.0, 18.2)))).bottom
    assert above is not None
    assert (above.altitude_m, above.way_m) == (pytest.approx(3.6), pytest.approx(100.0))
    assert (above.depth_m, above.too_deep_m, above.unknown_m) == (15.0, 0.0, 0.0)


def test_a_fence_needs_a_hull_and_the_origin_of_the_reference() -> None:
    with pytest.raises(ConfigError, match=r"\[hull\] is missing|\[hull\]: is missing"):
        checked(BUOY, vehicle=msgspec.structs.replace(PAPER, hull=None))
    fence = msgspec.structs.replace(
        Fence.load("examples/fences/harbour.toml"), origin=Origin(latitude_deg=60.4, longitude_deg=5.33)
    )
    with pytest.raises(ConfigError, match=r"latitude 60.4.* away from the origin of the reference, 50.2"):
        checked(fence, load("examples/references/harbour.toml"))
