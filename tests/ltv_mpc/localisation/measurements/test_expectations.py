"""What each sensor is expected to say, against the same quantity reached by another road."""

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.frames import rotation, rotation_exp
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.measurements import compass, gnss, pressure, tdcp
from ltv_mpc.localisation.measurements.adcp import AdcpModel, beam_directions
from ltv_mpc.localisation.state import GYRO_BIAS, Belief, Layout
from ltv_mpc.localisation.suite import Suite
from ltv_mpc.signals import AdcpPing, CompassHeading, GnssFix, PressureDepth, TdcpFix

SUITE = Suite.load("realistic")
CONFIG = EstimatorConfig()
LAYOUT = Layout.of(SUITE, CONFIG)


@pytest.fixture
def belief():
    rng = np.random.default_rng(3)
    belief = Belief.blank(LAYOUT, 0)
    belief.x = 0.1 * rng.standard_normal(LAYOUT.size)
    belief.x[:3] = [5.0, -3.0, 12.6]
    belief.R = rotation(0.2, -0.3, 2.0)
    belief.mounting = rotation(0.05, -0.04, 0.03)
    return belief


def test_a_fix_at_the_estimate_leaves_no_residual(belief):
    n, e, _, vn, ve = belief.x[:5]
    fix = GnssFix(t_ns=0, north_m=n + 1, east_m=e + 2, velocity_north_mps=vn + 3, velocity_east_mps=ve + 4)
    np.testing.assert_allclose(gnss.rows(belief, fix, SUITE.gnss).residual, [1, 2, 3, 4])


def test_a_change_of_position_is_from_the_clone_to_now(belief):
    belief.x[LAYOUT.epoch] = [4.0, -1.0]  # now at 5, -3
    fix = TdcpFix(t_ns=0, from_t_ns=0, north_m=1.0, east_m=-2.0)
    np.testing.assert_allclose(tdcp.rows(belief, fix, SUITE.tdcp).residual, 0, atol=1e-15)


def test_depth_is_positive_down(belief):
    rows = pressure.rows(belief, PressureDepth(t_ns=0, depth_m=13.0), SUITE.pressure)
    np.testing.assert_allclose(rows.residual, 0.4)


@pytest.mark.parametrize("heading", [-3.1, -1.0, 0.0, 2.0, 3.1])
def test_a_compass_reads_heading_plus_its_bias_across_the_turn_of_south(belief, heading):
    belief.R = rotation(0.2, -0.3, heading)
    belief.x[LAYOUT.compass_bias] = 0.1
    read = CompassHeading(t_ns=0, heading_rad=math.remainder(heading + 0.1, math.tau))
    rows = compass.rows(belief, read, SUITE.compass)
    np.testing.assert_allclose(rows.residual, 0, atol=1e-12)


def test_beams_look_down_ahead_astern_starboard_and_port():
    e = beam_directions(math.radians(20))
    np.testing.assert_allclose(np.linalg.norm(e, axis=1), 1)
    np.testing.assert_allclose(e[:, 2], math.cos(math.radians(20)))
    assert e[0, 0] > 0 > e[1, 0]
    assert e[2, 1] > 0 > e[3, 1]


def test_a_beam_sees_the_rate_at_which_water_recedes_from_the_moving_transducer(belief):
    """The transducer's path r(t) = p + v t + R exp(w t) l is differentiated numerically."""
    x, R = belief.x, belief.R
    measured = np.array([0.3, -0.2, 0.4])
    w = measured - x[GYRO_BIAS]
    lever = np.array(SUITE.adcp.lever_arm_m)
    ranges = 1.4 + np.arange(15.0)

    def transducer(t):
        return x[:3] + x[3:6] * t + R @ rotation_exp(w * t) @ lever

    velocity = (transducer(1e-5) - transducer(-1e-5)) / 2e-5
    z = np.empty((4, 15))
    for i, e in enumerate(beam_directions(SUITE.adcp.beam_angle_rad)):
        along = R @ belief.mounting @ e
        for j, r in enumerate(ranges):
            depth = (transducer(0.0) + r * along)[2]
            water = [np.interp(depth, np.arange(71), x[axis]) for axis in (LAYOUT.north, LAYOUT.east)]
            z[i, j] = along @ (np.array([*water, 0.0]) - velocity)
            z[i, j] += x[LAYOUT.beam_bias][i] + x[LAYOUT.near_bias][i] * math.exp(-r / SUITE.adcp.near_bias_length_m)
    model = AdcpModel(SUITE.adcp, LAYOUT, CONFIG.cell_m)
    ping = AdcpPing(t_ns=0, range_m=ranges, beam_velocity_mps=z)
    linearised = model.linearise(belief, ping, tuple(measured.tolist()))
    assert len(linearised.rows.residual) == 60
    np.testing.assert_allclose(linearised.rows.residual, 0, atol=1e-9)


def test_what_has_no_return_or_lies_outside_the_grid_is_left_out_and_counted(belief):
    belief.R, belief.mounting = np.eye(3), np.eye(3)
    belief.x[2] = 60.0
    ranges = 1.4 + np.arange(15.0)
    z = np.zeros((4, 15))
    z[1] = np.nan
    reach = 60.0 + SUITE.adcp.lever_arm_m[2] + ranges * math.cos(SUITE.adcp.beam_angle_rad)
    inside = int((reach < 70.0).sum())
    linearised = AdcpModel(SUITE.adcp, LAYOUT, CONFIG.cell_m).linearise(
        belief, AdcpPing(t_ns=0, range_m=ranges, beam_velocity_mps=z), (0.0, 0.0, 0.0)
    )
    assert linearised.without_return == 15
    assert linearised.outside_grid == 3 * (15 - inside)
    assert len(linearised.rows.residual) == 3 * inside


def test_a_suite_without_biases_has_rows_without_them():
    suite = Suite.load("paper")
    layout = Layout.of(suite, CONFIG)
    belief = Belief.blank(layout, 0)
    ping = AdcpPing(t_ns=0, range_m=np.array([3.0]), beam_velocity_mps=np.zeros((4, 1)))
    rows = AdcpModel(suite.adcp, layout, CONFIG.cell_m).linearise(belief, ping, (0.0, 0.0, 0.0)).rows
    assert set(np.flatnonzero(np.abs(rows.dense(layout.size)).sum(axis=0))) <= {
        *range(9),
        *range(layout.north.start, layout.east.stop),
    }


def test_noise_is_the_sensors_own():
    belief = Belief.blank(LAYOUT, 0)
    quiet = msgspec.structs.replace(SUITE.gnss, position_sd_m=2.0, velocity_sd_mps=3.0)
    fix = GnssFix(t_ns=0, north_m=0.0, east_m=0.0, velocity_north_mps=0.0, velocity_east_mps=0.0)
    np.testing.assert_array_equal(gnss.rows(belief, fix, quiet).variance, [4, 4, 9, 9])
    step = TdcpFix(t_ns=0, from_t_ns=0, north_m=0.0, east_m=0.0)
    np.testing.assert_array_equal(tdcp.rows(belief, step, SUITE.tdcp).variance, [0.005**2] * 2)
    depth = PressureDepth(t_ns=0, depth_m=0.0)
    np.testing.assert_array_equal(pressure.rows(belief, depth, SUITE.pressure).variance, [0.01**2])
    heading = CompassHeading(t_ns=0, heading_rad=0.0)
    np.testing.assert_allclose(compass.rows(belief, heading, SUITE.compass).variance, [math.radians(1) ** 2])
