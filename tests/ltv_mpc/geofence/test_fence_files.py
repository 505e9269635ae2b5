"""Fences in files of other programs: QGroundControl plans and ArduPilot's lists of fence items."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from ltv_mpc.errors import ConfigError
from ltv_mpc.geofence.fence import Fence
from ltv_mpc.references.geodesy import Origin, tangent_plane

HOME = Origin(latitude_deg=50.2, longitude_deg=-5.1)
ITEM_0 = (16, 0.0, 0, 50.2, -5.1)


def square(north_deg: float, east_deg: float) -> list[list[float]]:
    """Return the corners of a square of 0.001 degrees as latitude and longitude."""
    n, e = 50.2 + north_deg, -5.1 + east_deg
    return [[n, e], [n + 0.001, e], [n + 0.001, e + 0.001], [n, e + 0.001]]


def plan(polygons: list[tuple[bool, list[list[float]]]], circles: list[tuple[bool, list[float], float]]) -> str:
    fence = {
        "polygons": [{"inclusion": inside, "polygon": ring, "version": 1} for inside, ring in polygons],
        "circles": [
            {"inclusion": inside, "circle": {"center": centre, "radius": radius}, "version": 1}
            for inside, centre, radius in circles
        ],
        "version": 2,
    }
    mission = {"plannedHomePosition": [50.2, -5.1, 0.0], "items": []}
    return json.dumps({"fileType": "Plan", "geoFence": fence, "mission": mission})


def item(command: int, first: float = 0.0) -> tuple[int, float, int, float, float]:
    return command, first, 0, 50.0, -5.0


def items(*rows: tuple[int, float, int, float, float]) -> str:
    lines = [f"{k}\t0\t3\t{c}\t{p1}\t{p2}\t0\t0\t{n:.8f}\t{e:.8f}\t0\t1" for k, (c, p1, p2, n, e) in enumerate(rows)]
    return "\n".join(["QGC WPL 110", *lines])


def test_the_polygons_and_circles_of_a_plan_and_of_a_list_are_zones(tmp_path: Path) -> None:
    out, centre = square(0.0002, 0.0002), [50.2004, -5.0996]
    (tmp_path / "f.plan").write_text(plan([(True, square(0.0, 0.0)), (False, out)], [(False, centre, 4.0)]))
    rows = (
        [ITEM_0]
        + [(5001, 4.0, 0, *corner) for corner in square(0.0, 0.0)]
        + [(5002, 4.0, 0, *corner) for corner in out]
    )
    (tmp_path / "f.WAYPOINTS").write_text(items(*rows, (5004, 4.0, 0, *centre)))
    for name in ("f.plan", "f.WAYPOINTS"):
        notes: list[str] = []
        fence = Fence.load(str(tmp_path / name), notes)
        basin, pier, buoy = fence.zones()
        assert [basin.keep_in, pier.keep_in, buoy.keep_in] == [True, False, False]
        for zone, ring in ((basin, square(0.0, 0.0)), (pier, out), (buoy, [centre])):
            right = [tangent_plane(latitude, longitude, HOME) for latitude, longitude in ring]
            np.testing.assert_allclose(zone.vertices_m, right, atol=1e-3)
        assert buoy.radius_m == 4.0
        assert basin.margin_m == 1.0
        assert "has no margins, each zone has 1 m" in notes[0]


def test_an_inclusion_circle_is_the_polygon_in_it(tmp_path: Path) -> None:
    (tmp_path / "f.plan").write_text(plan([], [(True, [50.2, -5.1], 50.0)]))
    (zone,) = Fence.load(str(tmp_path / "f.plan")).zones()
    np.testing.assert_allclose(np.hypot(*zone.vertices_m.T), 50.0, atol=1e-3)


LEFT, MIDDLE, RIGHT = square(0.0, 0.0), square(0.0, 0.0005), square(0.0, 0.002)


@pytest.mark.parametrize(
    ("groups", "width_deg"),
    [
        (None, 0.0025),  # a plan
        ((0, 0, 0), 0.0025),  # a plan that QGroundControl has sent
        ((0, 0), 0.0015),  # half of each is common to both
        ((1, 2, 3), 0.0025),
        ((1, 1, 2), 0.0015),  # the common half of the first two, or the last one
        ((1, 1, 1), 0.0025),  # no common area
    ],
)
def test_the_vehicle_is_inside_all_inclusion_zones_of_any_group(
    tmp_path: Path, groups: tuple[int, ...] | None, width_deg: float
) -> None:
    shapely = pytest.importorskip("shapely")
    rings = (LEFT, MIDDLE, RIGHT)[: 3 if groups is None else len(groups)]
    if groups is None:
        (tmp_path / "f.plan").write_text(plan([(True, ring) for ring in rings], []))
    else:
        rows = [(5001, 4.0, group, *corner) for group, ring in zip(groups, rings, strict=True) for corner in ring]
        (tmp_path / "f.plan").with_suffix(".waypoints").write_text(items(*rows))
    fence = Fence.load(str(tmp_path / ("f.plan" if groups is None else "f.waypoints")), None, HOME)
    inside, *outside = (shapely.Polygon(zone.vertices_m) for zone in fence.zones())
    area_m2 = (inside - shapely.union_all(outside)).area
    north_m, east_m = tangent_plane(50.201, -5.1 + width_deg, HOME)
    assert area_m2 == pytest.approx(north_m * east_m, rel=1e-3)


def test_a_list_of_positions_is_a_return_point_and_a_closed_ring(tmp_path: Path) -> None:
    mavwp = pytest.importorskip("pymavlink.mavwp")
    loader, path = mavwp.MAVFenceLoader(), tmp_path / "fence.txt"
    for latitude, longitude in (LEFT[0], *LEFT, LEFT[0]):
        loader.add_latlon(latitude, longitude)
    loader.save(str(path))
    (zone,) = Fence.load(str(path), None, HOME).zones()
    assert zone.keep_in
    np.testing.assert_allclose(zone.vertices_m, [tangent_plane(*corner, HOME) for corner in LEFT], atol=1e-3)


def test_what_a_fence_does_not_use_is_a_note(tmp_path: Path) -> None:
    content = json.loads(plan([(True, LEFT)], []))
    content["mission"]["items"], content["rallyPoints"] = [{}, {}], {"points": [[50.2, -5.1, 0.0]]}
    (tmp_path / "f.plan").write_text(json.dumps(content))
    notes: list[str] = []
    Fence.load(str(tmp_path / "f.plan"), notes)
    assert notes[0].endswith("not used are 2 items of its mission, 1 rally points")


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        (
            "f.plan",
            '{"mission": {"items": [], "plannedHomePosition": null}}',
            "has no home: give it one, or the reference",
        ),
        ("f.plan", plan([(True, LEFT)], []).replace("1}]", "2}]", 1), "geoFence: polygons[0].version = 2: must be 1"),
        ("f.plan", plan([(1, LEFT)], []), "geoFence: polygons[0].inclusion = 1: must be true or false"),  # type: ignore[list-item]
        (
            "f.plan",
            plan([], [(True, [50.2, -5.1], -5.0)]),
            "item 0 MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION (5003) radius = -5.0: must be",
        ),
        ("f.waypoints", items(ITEM_0, item(5001, 3.0), item(5002, 3.0)), "(5002): the polygon before it has 1 of 3"),
        ("f.waypoints", items(ITEM_0, item(5001, 3.0)), "the last polygon has 1 of 3 vertices"),
        ("f.waypoints", items(item(16), item(16)), "item 1 MAV_CMD_NAV_WAYPOINT (16): is no part of a fence"),
        ("f.waypoints", items(item(5003, 9.0)), "has no home"),
        (
            "f.waypoints",
            items(ITEM_0, *[item(5001, 2.0)] * 2),
            "item 2 MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION (5001): is no polygon",
        ),
        ("f.waypoints", items(ITEM_0, (5001, 3.0, 0, math.nan, -5.0)), "(5001): latitude_deg = nan: must be finite"),
        ("f.waypoints", items(ITEM_0, (5003, 9.0, 0, 50.2, math.inf)), "(5003): longitude_deg = inf: must be finite"),
        ("f.waypoints", items(ITEM_0, (5003, 9.0, math.inf, 50.2, -5.1)), "(5003) group = inf: must be a number"),
        ("f.waypoints", items(ITEM_0, item(5003)), "item 1 MAV_CMD_NAV_FENCE_CIRCLE_INCLUSION (5003) radius = 0"),
    ],
)
def test_what_is_no_fence_is_refused_by_item(tmp_path: Path, name: str, text: str, says: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError) as error:
        Fence.load(str(tmp_path / name))
    assert says in str(error.value)
