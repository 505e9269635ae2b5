"""State layout, error convention and position clone."""

import msgspec
import numpy as np
import pytest

from ltv_mpc.frames import rotation, rotation_log
from ltv_mpc.localisation.adaptive.failure_signatures import FailureSignatures
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import ATTITUDE, CORE, Belief, Layout, grid, reach_m
from ltv_mpc.localisation.sensor_config import SensorConfig


def length(states: slice) -> int:
    return states.stop - states.start


def test_a_bias_that_the_sensors_lack_is_no_state():
    paper = Layout.of(SensorConfig.load("paper"), EstimatorConfig())
    assert [length(s) for s in (paper.beam_bias, paper.near_bias, paper.mounting, paper.compass_bias)] == [0, 0, 0, 0]
    assert paper.size == CORE + 2 + 2 + 2 * 71


def test_states_of_realistic_sensors_do_not_overlap():
    layout = Layout.of(SensorConfig.load("realistic"), EstimatorConfig())
    named = [getattr(layout, f) for f in layout.__slots__ if f not in ("nodes", "size")]
    places = [i for s in named for i in range(s.start, s.stop)]
    assert sorted(places) == list(range(CORE, layout.size))
    assert layout.size == CORE + 2 + 4 + 4 + 3 + 1 + 2 + 2 * 71


@pytest.mark.parametrize(("deepest", "cell", "last"), [(70.0, 1.0, 70.0), (70.5, 1.0, 71.0), (10.0, 0.1, 10.0)])
def test_the_waters_grid_reaches_its_deepest_and_no_further(deepest, cell, last):
    depths = grid(msgspec.structs.replace(EstimatorConfig(), deepest_m=deepest, cell_m=cell))
    assert depths[0] == 0
    assert depths[-1] == pytest.approx(last, abs=1e-9)
    np.testing.assert_allclose(np.diff(depths), cell, rtol=1e-9)


def test_attitude_errors_turn_the_body_in_the_world_and_the_instrument_in_the_body():
    layout = Layout.of(SensorConfig.load("realistic"), EstimatorConfig())
    belief = Belief.blank(layout, 0)
    belief.R = rotation(0.1, -0.2, 2.0)
    belief.mounting = rotation(0.01, 0.02, -0.03)
    before = belief.copy()
    error = np.zeros(layout.size)
    error[ATTITUDE] = [1e-3, 2e-3, -3e-3]
    error[layout.mounting] = [4e-3, -5e-3, 6e-3]
    belief.apply_error(error)
    np.testing.assert_allclose(rotation_log(belief.R @ before.R.T), error[ATTITUDE], atol=1e-12)
    np.testing.assert_allclose(rotation_log(belief.mounting @ before.mounting.T), error[layout.mounting], atol=1e-12)


def test_a_cloned_position_has_the_positions_errors():
    layout = Layout.of(SensorConfig.load("paper"), EstimatorConfig())
    belief = Belief.blank(layout, 7)
    root = np.random.default_rng(0).standard_normal((layout.size, layout.size))
    belief.P = root @ root.T
    belief.x[:3] = [3.0, 4.0, 5.0]
    P = belief.P.copy()
    belief.clone_position()
    e = layout.epoch
    # y = T x with the clone's rows of T those of the position
    T = np.eye(layout.size)
    T[e] = 0
    T[e.start, 0] = T[e.start + 1, 1] = 1
    np.testing.assert_allclose(belief.P, T @ P @ T.T, rtol=1e-13)
    np.testing.assert_array_equal(belief.x[e], [3.0, 4.0])
    assert belief.epoch_t_ns == 7


def test_a_cloned_antenna_has_the_mean_errors_of_the_antenna():
    """Reference: the antenna p + R l of the state that the error is applied to."""
    layout = Layout.of(SensorConfig.load("paper"), EstimatorConfig())
    rng = np.random.default_rng(1)
    belief, lever_m, h = Belief.blank(layout, 7), (0.7, -0.4, -1.1), 1e-6
    belief.R = rotation(0.2, -0.3, 2.0)
    E = rng.standard_normal((layout.size, 2))
    belief.signatures = FailureSignatures(E.copy(), np.zeros(2), np.zeros((2, 2)))
    belief.clone_position(lever_m)
    for k in range(2):
        up, down = belief.copy(), belief.copy()
        up.apply_error(h * E[:, k])
        down.apply_error(-h * E[:, k])
        antenna = [b.x[:2] + (b.R @ np.array(lever_m))[:2] for b in (up, down)]
        expected = (antenna[0] - antenna[1]) / (2 * h)
        np.testing.assert_allclose(belief.signatures.error[layout.epoch, k], expected, atol=1e-8)


def test_a_copy_is_the_same_and_shares_nothing_that_changes():
    belief = Belief.blank(Layout.of(SensorConfig.load("realistic"), EstimatorConfig()), 0)
    belief.x += 1.0
    belief.P += np.eye(len(belief.P))
    other = belief.copy()
    for name in ("x", "R", "mounting", "P"):
        assert not np.shares_memory(getattr(belief, name), getattr(other, name))
        np.testing.assert_array_equal(getattr(belief, name), getattr(other, name))


@pytest.mark.parametrize(
    ("roll_pitch_deg", "above", "below"),
    [
        ((0, 0), 0.0, 15.0),
        ((20, -20), 0.0, 15.0),
        ((39, 0), 0.0, 15.0),  # a beam at 20 deg and 28.6 deg of roll reach the horizontal from 41.4 deg on
        ((43, 0), 15.0, 15.0),
        ((0, 90), 15.0, 15.0),
        ((137, 0), 15.0, 15.0),
        ((141, 0), 15.0, 0.0),
        ((180, 0), 15.0, 0.0),
        ((0, -170), 15.0, 0.0),
    ],
)
def test_nodes_are_wanted_where_a_beam_of_a_rolling_vehicle_can_reach(roll_pitch_deg, above, below):
    """In addition to 3 m of a plan and 0.5 m of the lever arm. At 90 deg pitch, downward beams look ahead."""
    roll, pitch = np.radians(roll_pitch_deg)
    adcp = msgspec.structs.replace(
        SensorConfig.load("realistic").adcp, lever_arm_m=(0.3, 0.0, -0.4), mounting_rad=(roll, pitch, 0.4), range_m=15.0
    )
    np.testing.assert_allclose(reach_m(adcp), (3.5 + above, 3.5 + below))


def test_a_window_holds_what_is_kept_and_what_can_be_reached_on_either_side():
    """At any position between two grid points: one more at each end, and one because n intervals have n + 1 points."""
    suite = SensorConfig.load("realistic")
    config = msgspec.structs.replace(EstimatorConfig(), deepest_m=900.0, kept_m=21.0, cell_m=2.0)
    above, below = reach_m(suite.adcp)
    layout = Layout.of(suite, config)
    cells = length(layout.north)
    assert 2.0 * (cells - 1) >= 21.0 + above + below + 2 * 2.0
    assert 2.0 * (cells - 3) < 21.0 + above + below + 2 * 2.0
    assert length(layout.east) == cells
    assert layout.nodes == 451


def test_a_copy_has_a_column_of_its_own():
    belief = Belief.blank(Layout.of(SensorConfig.load("paper"), EstimatorConfig()), 0)
    copy = belief.copy()
    copy.column.observed[3] = True
    copy.column.first = 2
    copy.column.dropped[0] = copy.column.prior.link(0, 1, 0.0)
    assert not belief.column.observed.any()
    assert (belief.column.first, belief.column.dropped) == (0, {})
