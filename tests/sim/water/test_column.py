"""Water column: measured profiles, interpolation against numpy's, and the slow change in time."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ltv_mpc.currents import write_profile
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import CurrentProfile
from sim.scenario import Water
from sim.water import WaterColumn, make

S = 1_000_000_000


def test_a_measured_profile_is_interpolated_and_held_constant_beyond_its_ends(tmp_path):
    draws = np.random.default_rng(1)
    depth, (north, east) = 2.5 + np.cumsum(draws.random(60)), draws.normal(0.0, 0.1, (2, 60))
    write_profile(tmp_path / "c.csv", CurrentProfile(depth_m=depth, north_mps=north, east_mps=east))
    water = make(Water(kind="measured", file=str(tmp_path / "c.csv")), 0)
    assert water.at(0.0, 0) == water.at(depth[0], 0) == (north[0], east[0])
    assert water.at(depth[-1] + 1000.0, 0) == water.at(depth[-1], 0) == (north[-1], east[-1])
    at = np.linspace(-2.0, depth[-1] + 50.0, 997)
    expected = np.column_stack([np.interp(at, depth, north), np.interp(at, depth, east)])
    np.testing.assert_allclose(water.over(at, 5 * S), expected, atol=1e-15)
    np.testing.assert_array_equal([water.at(z, 5 * S) for z in at], water.over(at, 5 * S))


def test_a_measured_water_without_a_file_is_refused():
    with pytest.raises(ConfigError, match="file"):
        make(Water(kind="measured"), 0)


def test_one_depth_is_a_uniform_current(tmp_path):
    (tmp_path / "c.csv").write_text("depth_m,v_north_mps,u_east_mps\n5,0.1,-0.2\n")
    water = make(Water(kind="measured", file=str(tmp_path / "c.csv")), 0)
    for depth in (0.0, 5.0, 40.0):
        assert water.at(depth, 0) == (0.1, -0.2)
        assert water.gradient(depth, 0) == (0.0, 0.0)


@pytest.mark.parametrize("change", [0.0, 1e-3])
def test_the_gradient_is_the_slope_of_the_current(change):
    water = make(Water(change_mps_per_rts=change), 2)
    t, h = 3 * S + 700_000_000, 1e-4
    for depth in (0.5, 17.3, 42.9, 69.5):
        up, down = np.array(water.at(depth - h, t)), np.array(water.at(depth + h, t))
        np.testing.assert_allclose(water.gradient(depth, t), (down - up) / (2 * h), atol=1e-9)
    for depth in (-0.1, 70.1):
        assert water.gradient(depth, t) == (0.0, 0.0)


@pytest.mark.parametrize("change", [0.0, 1e-3])
def test_profile_and_single_depths_say_the_same(change):
    water = make(Water(change_mps_per_rts=change), 2)
    for t in (-S // 3, 0, 7 * S + 250_000_000):
        profile = water.profile(t)
        at_cells = water.over(profile.depth_m, t)
        np.testing.assert_allclose(profile.north_mps, at_cells[:, 0], atol=1e-16)
        np.testing.assert_allclose(profile.east_mps, at_cells[:, 1], atol=1e-16)


def test_water_that_changes_is_the_same_for_everyone_in_whatever_order_they_ask():
    plant, sensors = (make(Water(change_mps_per_rts=1e-3), 11) for _ in range(2))
    times = [0, 5 * S + 1, 700 * S, 3 * S + 5, -2 * S - 7, 699 * S + 999_999_999, -40 * S, 1]
    forward = {t: plant.at(20.2, t) for t in sorted(times)}
    assert {t: sensors.at(20.2, t) for t in times} == forward
    assert make(Water(change_mps_per_rts=1e-3), 12).at(20.2, S) != plant.at(20.2, S)


def test_the_change_is_continuous_and_starts_from_the_named_profile_at_zero():
    still, moving = make(Water(), 4), make(Water(change_mps_per_rts=1e-3), 4)
    assert moving.at(20.0, 0) == still.at(20.0, 0)
    assert moving.at(20.0, 9 * S) != still.at(20.0, 9 * S)
    for t in (-S, 0, S, 4 * S):
        np.testing.assert_allclose(moving.at(20.0, t - 1), moving.at(20.0, t), atol=1e-10)


@pytest.mark.parametrize("seconds", [4, 64, -64])
def test_the_change_grows_with_the_square_root_of_time_and_past_and_future_are_independent(seconds):
    depth = np.arange(71.0)
    water = [WaterColumn(depth, np.zeros((71, 2)), change_mps_per_rts=1e-3, seed=seed) for seed in range(40)]
    rows, opposite = ([column.over(depth, t * S) for column in water] for t in (seconds, -seconds))
    assert np.std(rows) == pytest.approx(1e-3 * math.sqrt(abs(seconds)), rel=4 / math.sqrt(2 * np.size(rows)))
    assert abs(np.corrcoef(np.ravel(rows), np.ravel(opposite))[0, 1]) < 4 / math.sqrt(np.size(rows))
