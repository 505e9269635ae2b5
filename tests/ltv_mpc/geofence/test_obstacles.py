"""Table of obstacles: which reports are in force, where they are predicted, when they are dropped."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.errors import ConfigError
from ltv_mpc.geofence.obstacles import MAX_AGE_NS, MAX_AHEAD_NS, MAX_OBSTACLES, ObstacleTable
from ltv_mpc.messages import Obstacle, Obstacles


def report(number: int, t_s: float, north_m: float = 0.0, **more) -> Obstacle:
    return Obstacle(
        id=number,
        t_ns=round(t_s * 1e9),
        north_m=north_m,
        east_m=1.0,
        velocity_north_mps=0.5,
        velocity_east_mps=-1.0,
        radius_m=3.0,
        **more,
    )


def table(*reports: Obstacle) -> ObstacleTable:
    out = ObstacleTable()
    for each in reports:
        out.add(Obstacles(t_ns=each.t_ns, obstacles=(each,)))
    out.update(max(each.t_ns for each in reports))
    return out


def test_an_obstacle_moves_at_constant_velocity_from_its_newest_report():
    of = table(report(1, 10.0, 100.0), report(1, 8.0, 0.0), report(2, 9.0, 50.0))
    rows = of.discs(14_000_000_000)
    assert sorted(rows[:, 0]) == [52.5, 102.0]
    assert rows[rows[:, 0] == 102.0][0] == pytest.approx([102.0, -3.0, 0.5, -1.0, 3.0, 0.0, 4.0])


def test_its_variance_is_the_largest_in_any_direction():
    covariance = np.array([[2.0, 1.5], [1.5, 3.0]])
    rows = table(report(1, 0.0, covariance_m2=(2.0, 1.5, 3.0))).discs(0)
    assert rows[0, 5] == pytest.approx(np.linalg.eigvalsh(covariance)[-1])


def test_an_old_obstacle_is_dropped_and_named():
    of = table(report(1, 0.0), report(2, 1.0))
    assert of.update(MAX_AGE_NS) == ()
    assert of.update(MAX_AGE_NS + 1) == (1,)
    assert [each.id for each in of.reports] == [2]


def test_a_report_from_the_future_is_dropped_and_shadows_no_current_one():
    """As with UTC beside a vehicle whose time begins at 0; also if both come between two cycles, in either order."""
    first, utc, next_one = report(1, 0.0), report(1, 1.7e9, 500.0), report(1, 2.0, 50.0)
    of = table(first)
    of.add(Obstacles(t_ns=0, obstacles=(utc,)))
    assert of.update(1_000_000_000) == (1,)
    assert of.reports == (first,)
    of.add(Obstacles(t_ns=0, obstacles=(utc, next_one, utc)))
    assert of.update(2_000_000_000) == (1,)
    assert of.reports == (next_one,)
    of.add(Obstacles(t_ns=0, obstacles=tuple(report(number, 1.7e9) for number in range(MAX_OBSTACLES))))
    assert of.update(3_000_000_000) == tuple(range(MAX_OBSTACLES))
    assert of.reports == (next_one,)
    assert of.update(-1_000_000_000) == (1,)  # vehicle time has begun again
    assert len(of) == 0


def test_a_report_that_is_ahead_by_a_small_difference_of_clocks_counts():
    of = table(report(1, 0.0))
    assert of.update(-MAX_AHEAD_NS) == ()
    assert of.update(-MAX_AHEAD_NS - 1) == (1,)


def test_of_two_reports_with_the_same_time_the_later_one_counts():
    of = table(report(1, 0.0, 10.0), report(1, 0.0, 20.0))
    of.add(Obstacles(t_ns=0, obstacles=(report(1, 0.0, 30.0),)))
    of.update(0)
    assert [each.north_m for each in of.reports] == [30.0]


@pytest.mark.parametrize(
    "wrong",
    [
        {"north_m": math.nan},
        {"radius_m": -1.0},
        {"covariance_m2": (-1.0, 0.0, 0.0)},
        {"covariance_m2": (1.0, 5.0, 1.0)},
    ],
    ids=str,
)
def test_a_wrong_report_is_an_error_and_leaves_the_known_ones(wrong):
    of, (name,) = table(report(1, 0.0)), wrong
    with pytest.raises(ConfigError, match=rf"obstacles\[1\]\.{name} = .*: must be"):
        of.add(Obstacles(t_ns=0, obstacles=(report(2, 1.0), msgspec.structs.replace(report(1, 1.0), **wrong))))
    assert of.reports == (report(1, 0.0),)
    of.add(Obstacles(t_ns=0, obstacles=(report(1, 1.0, covariance_m2=(4.0, 6.0, 9.0)),)))  # known in one direction
    of.update(0)
    assert of.discs(0)[0, 5] == pytest.approx(13.0)


def test_of_too_many_the_newest_reports_are_kept():
    of = table(*(report(number, 0.5 * number) for number in range(MAX_OBSTACLES + 3)))
    assert sorted(each.id for each in of.reports) == list(range(3, MAX_OBSTACLES + 3))
    of.add(Obstacles(t_ns=0, obstacles=(report(999, 0.0),)))
    of.update(40_000_000_000)
    assert 999 not in {each.id for each in of.reports}


def test_obstacles_that_hardly_move_stand_where_they_drift_to() -> None:
    """The distance to keep has the uncertainty of a report that is 10 s old, or older."""
    table, slow = ObstacleTable(), {"velocity_north_mps": 0.03, "velocity_east_mps": -0.04, "radius_m": 2.0}
    anchored = Obstacle(id=9, t_ns=0, north_m=10.0, east_m=5.0, covariance_m2=(4.0, 0.0, 1.0), **slow)
    buoy = Obstacle(id=4, t_ns=0, north_m=-7.0, east_m=1.0, **slow)
    ferry = Obstacle(
        id=1, t_ns=0, north_m=0.0, east_m=0.0, velocity_north_mps=0.04, velocity_east_mps=0.04, radius_m=9.0
    )
    table.add(Obstacles(t_ns=0, obstacles=(anchored, ferry, buoy)))
    table.update(0)
    for t_s, growth_m in ((4.0, 0.5), (20.0, 1.0)):
        expected = [
            [-7.0 + 0.03 * t_s, 1.0 - 0.04 * t_s, 2.0 + 3.0 * growth_m + 1.5],
            [10.0 + 0.03 * t_s, 5.0 - 0.04 * t_s, 2.0 + 3.0 * math.sqrt(4.0 + growth_m**2) + 1.5],
        ]
        np.testing.assert_allclose(table.standing(round(t_s * 1e9), 0.051, 1.5), expected)
    assert table.standing(0, 0.049, 1.5).shape == (0, 3)
