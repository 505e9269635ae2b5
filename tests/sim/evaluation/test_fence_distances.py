"""Distance of the true hull from the zones: of the run's fence, then of those that replace it under way."""

from __future__ import annotations

import pytest

from ltv_mpc.geofence.fence import Disc, Fence
from ltv_mpc.messages import FenceInForce
from ltv_mpc.references.geodesy import Place
from ltv_mpc.vehicle.parameters import Vehicle
from sim.evaluation.fence_distances import FenceDistances
from tests.sim.worlds import S, truth

PAPER = Vehicle.load("paper")
HULL_M = PAPER.hull.radius_m if PAPER.hull else 0.0


def fence(name: str, north_m: float) -> Fence:
    place = Place(north_m=north_m, east_m=0.0)
    return Fence(margin_m=2.0, keep_out_disc=(Disc(name=name, centre=place, radius_m=1.0),))


def in_force(of: Fence | None) -> FenceInForce:
    return FenceInForce(t_ns=0, hull_radius_m=HULL_M, zones=() if of is None else tuple(of.zones()))


def sail(distances: FenceDistances, seconds: range) -> None:
    """Move north at 1 m/s, from the origin at 0 s."""
    for second in seconds:
        distances.add_truth(truth(second * S, position_m=(float(second), 0.0, 0.0), velocity_mps=(1.0, 0.0, 0.0)))


def test_a_fence_set_under_way_counts_from_then_on() -> None:
    distances = FenceDistances(PAPER, fence("wreck", 30.0))
    distances.add_fence(in_force(fence("wreck", 30.0)))
    sail(distances, range(11))
    distances.add_fence(in_force(fence("buoy", 14.0)))
    sail(distances, range(11, 13))
    wreck, buoy = distances.figures()
    assert (wreck.zone, buoy.zone) == ('keep_out_disc[0] "wreck"', 'keep_out_disc[0] "buoy"')
    assert wreck.least_clearance_m == pytest.approx(30.0 - 10.0 - 1.0 - HULL_M)
    assert buoy.least_clearance_m == pytest.approx(14.0 - 12.0 - 1.0 - HULL_M)
    assert (wreck.in_margin_s, buoy.in_margin_s) == (0.0, 2.0)


def test_a_fence_that_is_removed_and_set_again_keeps_its_figures() -> None:
    distances = FenceDistances(PAPER, None)
    sail(distances, range(3))
    assert distances.figures() == ()
    distances.add_fence(in_force(fence("wreck", 8.0)))
    sail(distances, range(3, 8))
    distances.add_fence(in_force(None))
    sail(distances, range(8, 20))
    (before,) = distances.figures()
    distances.add_fence(in_force(fence("wreck", 8.0)))
    sail(distances, range(20, 22))
    (after,) = distances.figures()
    assert after == before
    assert before.least_clearance_m == pytest.approx(8.0 - 7.0 - 1.0 - HULL_M)
    assert before.in_margin_s > before.inside_s > 0.0
