"""Fence in the view from above: the line round a zone keeps its distance, and what bounds the plan is another table."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from ltv_mpc.control.ocp.fence import disc_at
from ltv_mpc.geofence.obstacles import OBSTACLE_MARGIN, ObstacleTable
from ltv_mpc.messages import Array, FenceInForce, FenceReport, Obstacle, Obstacles, ZoneInForce
from services.reporting.plots import fence as view
from tests.ltv_mpc.control.fence_scenes import scene
from tests.services.runtime.test_controller_changes import PLAN

SQUARE = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0], [0.0, 10.0]])
SHIP = Obstacle(id=3, t_ns=0, north_m=5.0, east_m=0.0, velocity_north_mps=0.0, velocity_east_mps=2.0, radius_m=4.0)


def in_force(ring: Array, *, keep_in: bool, radius_m: float = 0.0) -> FenceInForce:
    zone = ZoneInForce(label="zone", keep_in=keep_in, vertices_m=ring, radius_m=radius_m, margin_m=2.0)
    return FenceInForce(t_ns=0, hull_radius_m=1.0, zones=(zone,), obstacles=(SHIP,))


def points(columns: dict[str, list[float | None]]) -> Array:
    return np.column_stack([columns["north_m"], columns["east_m"]]).astype(float)


def distance_m(point: Array) -> float:
    """Distance from the square; negative inside."""
    beyond = np.maximum(np.maximum(-point, point - 10.0), 0.0)
    return float(np.hypot(*beyond)) if beyond.any() else -float(min(*point, *(10.0 - point)))


@pytest.mark.parametrize("ring", [SQUARE, SQUARE[::-1]])
@pytest.mark.parametrize(("keep_in", "expected_m"), [(False, 3.0), (True, -3.0)])
def test_the_line_round_a_polygon_has_the_distance_of_hull_and_margin(ring, keep_in, expected_m):
    drawn = view.tables(in_force(ring, keep_in=keep_in), None)
    np.testing.assert_allclose([distance_m(p) for p in points(drawn["kept_free"])], expected_m, atol=1e-3)
    np.testing.assert_array_equal(points(drawn["zones"]), [*ring, ring[0]])
    assert drawn["bounding"] == {"north_m": [], "east_m": []}


def test_a_disc_and_what_bounds_the_plan():
    plan = msgspec.structs.replace(PLAN, fence=FenceReport(clearance_m=1.0, active=("zone",)))
    drawn = view.tables(in_force(SQUARE[:1], keep_in=False, radius_m=4.0), plan)
    np.testing.assert_allclose(np.hypot(*points(drawn["zones"]).T), 4.0, atol=1e-3)
    np.testing.assert_allclose(np.hypot(*points(drawn["bounding"]).T), 7.0, atol=1e-3)
    assert drawn["kept_free"] == {"north_m": [], "east_m": []}


@pytest.mark.parametrize("corners", [1, 2])
def test_a_polygon_of_too_few_corners_is_drawn_all_the_same(corners):
    drawn = view.tables(in_force(SQUARE[:corners], keep_in=False), None)
    assert np.hypot(*points({name: cells[:30] for name, cells in drawn["kept_free"].items()}).T).max() >= 3.0


def test_an_obstacle_is_drawn_where_it_is_and_where_it_will_be():
    plan = msgspec.structs.replace(PLAN, t_ns=np.array([1_000_000_000, 11_000_000_000]))
    drawn = view.tables(in_force(SQUARE, keep_in=False), plan)
    np.testing.assert_allclose(points(drawn["obstacle_paths"]), [[5.0, 2.0], [5.0, 22.0]])
    np.testing.assert_allclose(np.hypot(*(points(drawn["obstacles"]) - [5.0, 2.0]).T), 4.0, atol=1e-3)


@pytest.mark.parametrize(("active", "table"), [((), "obstacles_kept_free"), (("obstacle 3",), "bounding")])
@pytest.mark.parametrize("start_ns", [1_000_000_000, -3_000_000_000])
def test_round_an_obstacle_are_the_circles_that_the_controller_keeps_free(active, table, start_ns):
    """At both ends of the plan, where the uncertainty has grown; those of an active obstacle are marked."""
    ends_ns = np.array([start_ns, start_ns + 10_000_000_000])
    ship = msgspec.structs.replace(SHIP, covariance_m2=(2.0, 1.0, 5.0))
    report = FenceReport(clearance_m=1.0, active=active)
    plan = msgspec.structs.replace(PLAN, t_ns=ends_ns, fence=report)
    fence = msgspec.structs.replace(in_force(SQUARE, keep_in=False), zones=(), obstacles=(ship,))
    drawn = view.tables(fence, plan)
    assert {name for name in ("obstacles_kept_free", "bounding") if drawn[name]["north_m"]} == {table}

    known = ObstacleTable()
    known.add(Obstacles(t_ns=0, obstacles=(ship,)))
    known.update(ship.t_ns)
    kept = scene(discs=known.discs(start_ns), disc_need_m=np.array([(1.0 + OBSTACLE_MARGIN) * fence.hull_radius_m]))
    circles = points(drawn[table])
    half = len(circles) // 2
    for k, part in enumerate((circles[:half], circles[-half:])):
        north, east, need_m = disc_at(kept, 0, 10.0 * k)
        np.testing.assert_allclose(np.hypot(*(part - [north, east]).T), need_m, atol=1e-3)
