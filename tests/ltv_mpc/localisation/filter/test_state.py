"""State layout, error convention and position clone."""

import msgspec
import numpy as np
import pytest

from ltv_mpc.frames import rotation, rotation_log
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import ATTITUDE, CORE, Belief, Layout, grid
from ltv_mpc.localisation.sensor_config import SensorConfig

PAPER, REALISTIC = SensorConfig.load("paper"), SensorConfig.load("realistic")
CONFIG = EstimatorConfig()


@pytest.mark.parametrize(("sensors", "biases"), [(PAPER, 0), (REALISTIC, 4 + 4 + 3 + 1)], ids=["paper", "realistic"])
def test_states_do_not_overlap_and_a_bias_that_the_sensors_lack_is_none(sensors, biases):
    layout = Layout.of(sensors, CONFIG)
    named = [getattr(layout, f) for f in layout.__slots__ if f != "size"]
    assert sorted(i for s in named for i in range(s.start, s.stop)) == list(range(CORE, layout.size))
    assert layout.size == CORE + 2 + biases + 2 + 2 * 71


@pytest.mark.parametrize(("deepest", "cell", "last"), [(70.0, 1.0, 70.0), (70.5, 1.0, 71.0), (16.1, 0.7, 16.1)])
def test_the_waters_grid_reaches_its_deepest_and_no_further(deepest, cell, last):
    depths = grid(msgspec.structs.replace(CONFIG, deepest_m=deepest, cell_m=cell))
    np.testing.assert_allclose(depths, np.linspace(0.0, last, round(last / cell) + 1), atol=1e-9)


def test_attitude_errors_turn_the_body_in_the_world_and_the_instrument_in_the_body():
    layout = Layout.of(REALISTIC, CONFIG)
    belief = Belief.blank(layout, 0)
    belief.R, belief.mounting = rotation(0.1, -0.2, 2.0), rotation(0.01, 0.02, -0.03)
    before, error = belief.copy(), np.zeros(layout.size)
    error[ATTITUDE], error[layout.mounting] = [1e-3, 2e-3, -3e-3], [4e-3, -5e-3, 6e-3]
    belief.apply_error(error)
    np.testing.assert_allclose(rotation_log(belief.R @ before.R.T), error[ATTITUDE], atol=1e-12)
    np.testing.assert_allclose(rotation_log(belief.mounting @ before.mounting.T), error[layout.mounting], atol=1e-12)


def test_a_cloned_antenna_has_the_errors_of_position_and_attitude():
    """P := T P T^T with the clone's rows of T by differences of p + R l."""
    layout, lever = Layout.of(REALISTIC, CONFIG), np.array([2.0, -0.7, -3.0])
    belief, rng, h = Belief.blank(layout, 7), np.random.default_rng(5), 1e-6
    belief.x, belief.R = 0.1 * rng.standard_normal(layout.size), rotation(0.3, -0.2, 2.5)
    root = rng.standard_normal((layout.size, layout.size)) / layout.size
    belief.P = root @ root.T

    def antenna(error):
        other = belief.copy()
        other.apply_error(error)
        return other.x[:2] + (other.R @ lever)[:2]

    T, P, place = np.eye(layout.size), belief.P.copy(), antenna(np.zeros(layout.size))
    T[layout.epoch] = np.stack([(antenna(e) - antenna(-e)) / (2 * h) for e in h * np.eye(layout.size)], axis=1)
    belief.epoch_t_ns = 0
    belief.clone_position(tuple(lever.tolist()))
    np.testing.assert_allclose(belief.P, T @ P @ T.T, atol=1e-10)
    np.testing.assert_array_equal(belief.P, belief.P.T)
    np.testing.assert_allclose(belief.x[layout.epoch], place)
    assert belief.epoch_t_ns == 7


def test_a_copy_is_the_same_and_shares_nothing_that_changes():
    belief = Belief.blank(Layout.of(REALISTIC, CONFIG), 0)
    belief.x += 1.0
    belief.P += np.eye(len(belief.P))
    other = belief.copy()
    for name in ("x", "R", "mounting", "P"):
        assert not np.shares_memory(getattr(belief, name), getattr(other, name))
        np.testing.assert_array_equal(getattr(belief, name), getattr(other, name))
