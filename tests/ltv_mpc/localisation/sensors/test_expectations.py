"""Expected measurement of each sensor, against the same quantity computed independently."""

import math

import msgspec
import numpy as np
import pytest

from ltv_mpc.frames import rotation, rotation_exp
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import GYRO_BIAS, Belief, Layout
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import adcp, bottom_track, compass, gnss, lbl, pressure, tdcp, usbl
from ltv_mpc.localisation.sensors.adcp import beam_directions
from ltv_mpc.localisation.sensors.bottom_track import BottomTracking
from ltv_mpc.localisation.sensors.lbl import Lbl
from ltv_mpc.localisation.sensors.sensor import Context
from ltv_mpc.localisation.sensors.usbl import Usbl
from ltv_mpc.messages import AdcpPing, BottomTrack, CompassHeading, GnssFix, LblRange, PressureDepth, TdcpFix, UsblFix

SUITE = SensorConfig.load("realistic")
CONFIG = EstimatorConfig()
LAYOUT = Layout.of(SUITE, CONFIG)
AT_ORIGIN = (0.0, 0.0, 0.0)
STILL = (0.0, 0.0, 0.0)
ODD = {"period_ns": 1_000_000_000, "missing_share": 0.0, "outlier_share": 0.0}
LBL = Lbl(
    **ODD,
    transponders_m=((0.0, 0.0, 100.0), (30.0, 40.0, 0.0)),
    sound_speed_mps=1500.0,
    sound_speed_sd_mps=3.0,
    range_sd_m=1.0,
    outlier_m=10.0,
)
USBL = Usbl(**ODD, latency_ns=0, ship_m=(30.0, 0.0), position_sd_m=1.5, bearing_sd_rad=0.05, outlier_m=30.0)
TRACKING = BottomTracking(**ODD, range_m=20.0, beam_noise_sd_mps=0.01, outlier_mps=0.5)


def context(rate=STILL):
    return Context(SUITE, CONFIG.cell_m, rate)


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
    np.testing.assert_allclose(gnss.rows(belief, fix, SUITE.gnss, STILL).residual, [1, 2, 3, 4])


def test_a_change_of_position_is_from_the_clone_to_now(belief):
    belief.x[LAYOUT.epoch] = [4.0, -1.0]  # now at 5, -3
    fix = TdcpFix(t_ns=0, from_t_ns=0, north_m=1.0, east_m=-2.0)
    np.testing.assert_allclose(tdcp.rows(belief, fix, SUITE.tdcp, AT_ORIGIN).residual, 0, atol=1e-15)


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
    z, depths = np.empty((4, 15)), np.empty((4, 15))
    for i, e in enumerate(beam_directions(SUITE.adcp.beam_angle_rad)):
        along = R @ belief.mounting @ e
        for j, r in enumerate(ranges):
            depth = (transducer(0.0) + r * along)[2]
            depths[i, j] = depth
            water = [np.interp(depth, np.arange(71), x[axis]) for axis in (LAYOUT.north, LAYOUT.east)]
            z[i, j] = along @ (np.array([*water, 0.0]) - velocity)
            z[i, j] += x[LAYOUT.beam_bias][i] + x[LAYOUT.near_bias][i] * math.exp(-r / SUITE.adcp.near_bias_length_m)
    ping = AdcpPing(t_ns=0, range_m=ranges, beam_velocity_mps=z)
    linearised = adcp.linearise(belief, ping, SUITE.adcp, context(tuple(measured.tolist())))
    np.testing.assert_allclose(linearised.rows.residual, 0, atol=1e-9)
    np.testing.assert_array_equal(linearised.indices, np.arange(60))
    np.testing.assert_array_equal(linearised.grid_points, np.floor(depths.ravel()))


def test_cells_without_return_or_outside_the_grid_are_counted(belief):
    belief.R, belief.mounting = np.eye(3), np.eye(3)
    belief.x[2] = 60.0
    ranges = 1.4 + np.arange(15.0)
    z = np.zeros((4, 15))
    z[1] = np.nan
    reach = 60.0 + SUITE.adcp.lever_arm_m[2] + ranges * math.cos(SUITE.adcp.beam_angle_rad)
    inside = int((reach < 70.0).sum())
    ping = AdcpPing(t_ns=0, range_m=ranges, beam_velocity_mps=z)
    linearised = adcp.linearise(belief, ping, SUITE.adcp, context())
    assert linearised.unused == {"no_return": 15, "outside_grid": 3 * (15 - inside)}
    assert len(linearised.rows.residual) == 3 * inside


def test_a_suite_without_biases_has_rows_without_them():
    suite = SensorConfig.load("paper")
    layout = Layout.of(suite, CONFIG)
    belief = Belief.blank(layout, 0)
    ping = AdcpPing(t_ns=0, range_m=np.array([3.0]), beam_velocity_mps=np.zeros((4, 1)))
    rows = adcp.linearise(belief, ping, suite.adcp, context()).rows
    assert set(np.flatnonzero(np.abs(rows.dense(layout.size)).sum(axis=0))) <= {
        *range(9),
        *range(layout.north.start, layout.east.stop),
    }


def test_noise_is_the_sensors_own():
    belief = Belief.blank(LAYOUT, 0)
    quiet = msgspec.structs.replace(SUITE.gnss, position_sd_m=2.0, velocity_sd_mps=3.0)
    fix = GnssFix(t_ns=0, north_m=0.0, east_m=0.0, velocity_north_mps=0.0, velocity_east_mps=0.0)
    np.testing.assert_array_equal(gnss.rows(belief, fix, quiet, STILL).variance, [4, 4, 9, 9])
    step = TdcpFix(t_ns=0, from_t_ns=0, north_m=0.0, east_m=0.0)
    np.testing.assert_array_equal(tdcp.rows(belief, step, SUITE.tdcp, AT_ORIGIN).variance, [0.005**2] * 2)
    depth = PressureDepth(t_ns=0, depth_m=0.0)
    np.testing.assert_array_equal(pressure.rows(belief, depth, SUITE.pressure).variance, [0.01**2])
    heading = CompassHeading(t_ns=0, heading_rad=0.0)
    np.testing.assert_allclose(compass.rows(belief, heading, SUITE.compass).variance, [math.radians(1) ** 2])


def heading_east(belief):
    """Level, at the origin, heading east: what is forward lies east, what is to starboard lies south."""
    belief.x[:] = 0.0
    belief.R = rotation(0.0, 0.0, math.pi / 2)
    belief.mounting = np.eye(3)


def test_an_antenna_astern_of_a_turning_vehicle_is_west_of_it_and_moves_north(belief):
    """2 m astern, heading east, turning to starboard at 0.1 rad/s: the stern swings to port, north, at 0.2 m/s."""
    heading_east(belief)
    receiver = msgspec.structs.replace(SUITE.gnss, lever_arm_m=(-2.0, 0.0, -1.0))
    fix = GnssFix(t_ns=0, north_m=0.0, east_m=-2.0, velocity_north_mps=0.2, velocity_east_mps=0.0)
    np.testing.assert_allclose(gnss.rows(belief, fix, receiver, (0.0, 0.0, 0.1)).residual, 0, atol=1e-15)


def test_an_antenna_moves_with_the_rate_less_its_bias(belief):
    heading_east(belief)
    belief.x[GYRO_BIAS.stop - 1] = 0.1
    receiver = msgspec.structs.replace(SUITE.gnss, lever_arm_m=(-2.0, 0.0, -1.0))
    fix = GnssFix(t_ns=0, north_m=0.0, east_m=-2.0, velocity_north_mps=0.0, velocity_east_mps=0.0)
    np.testing.assert_allclose(gnss.rows(belief, fix, receiver, (0.0, 0.0, 0.1)).residual, 0, atol=1e-15)


def test_the_change_of_position_is_that_of_the_antenna(belief):
    """A turn on the spot from north to east moves an antenna 2 m ahead by 2 m south and 2 m east."""
    heading_east(belief)
    belief.R = np.eye(3)
    belief.clone_position((2.0, 0.0, 0.0))
    belief.R = rotation(0.0, 0.0, math.pi / 2)
    step = TdcpFix(t_ns=0, from_t_ns=0, north_m=-2.0, east_m=2.0)
    np.testing.assert_allclose(tdcp.rows(belief, step, SUITE.tdcp, (2.0, 0.0, 0.0)).residual, 0, atol=1e-15)


def test_a_gauge_in_the_bow_is_higher_when_the_bow_is_up(belief):
    heading_east(belief)
    belief.x[2] = 10.0
    belief.R = rotation(0.0, math.radians(30), 1.0)
    gauge = msgspec.structs.replace(SUITE.pressure, lever_arm_m=(2.0, 0.0, 0.0))
    rows = pressure.rows(belief, PressureDepth(t_ns=0, depth_m=9.0), gauge)
    np.testing.assert_allclose(rows.residual, 0, atol=1e-14)


@pytest.mark.parametrize(("transponder", "range_m"), [(0, 100.0), (1, 50.0)])
def test_a_travel_time_is_there_and_back(belief, transponder, range_m):
    heading_east(belief)
    heard = LblRange(t_ns=0, transponder=transponder, travel_time_s=2 * range_m / 1500.0)
    rows = lbl.rows(belief, heard, LBL)
    np.testing.assert_allclose(rows.residual, 0, atol=1e-12)
    np.testing.assert_array_equal(rows.variance, [1.0])


def test_a_transducer_ahead_is_nearer_to_a_transponder_ahead(belief):
    """Heading east with the transducer 10 m ahead, a transponder 30 m north and 40 m east is 30 sqrt(2) away."""
    heading_east(belief)
    ahead = msgspec.structs.replace(LBL, lever_arm_m=(10.0, 0.0, 0.0))
    heard = LblRange(t_ns=0, transponder=1, travel_time_s=2 * 30 * math.sqrt(2) / 1500.0)
    np.testing.assert_allclose(lbl.rows(belief, heard, ahead).residual, 0, atol=1e-12)


def test_faster_sound_makes_ranges_shorter():
    """100 m at 1515 m/s take as long as 99.0 m at 1500."""
    layout = Layout.of(msgspec.structs.replace(SUITE, lbl=LBL), CONFIG)
    quick = Belief.blank(layout, 0)
    quick.x[layout.sound_speed] = 0.01
    heard = LblRange(t_ns=0, transponder=0, travel_time_s=2 * 100 / 1515.0)
    np.testing.assert_allclose(lbl.rows(quick, heard, LBL).residual, 0, atol=1e-12)


def test_the_second_order_range_term_agrees_with_drawn_positions(belief):
    """Against 400 000 draws: mean and twice the deviation of the range beyond its tangent."""
    heading_east(belief)
    belief.x[:3] = [10.0, -20.0, 30.0]
    rng = np.random.default_rng(0)
    root = np.array([[9.0, 0.0, 0.0], [-4.0, 8.0, 0.0], [0.5, 1.0, 2.0]])
    belief.P[:3, :3] = root @ root.T
    drawn = rng.standard_normal((400_000, 3)) @ root.T
    away = belief.x[:3] - LBL.transponders_m[1]
    r = np.linalg.norm(away)
    beyond = np.linalg.norm(away + drawn, axis=1) - r - drawn @ away / r
    rows = lbl.rows(belief, LblRange(t_ns=0, transponder=1, travel_time_s=2 * r / 1500.0), LBL)
    np.testing.assert_allclose(-rows.residual, beyond.mean(), rtol=0.03)
    np.testing.assert_allclose(rows.variance - 1.0, 4 * beyond.var(), rtol=0.15)


def test_a_transponder_at_the_vehicles_position_gives_finite_rows(belief):
    heading_east(belief)
    belief.x[:3] = LBL.transponders_m[0]
    belief.P[:3, :3] = np.eye(3)
    rows = lbl.rows(belief, LblRange(t_ns=0, transponder=0, travel_time_s=0.01), LBL)
    assert all(np.isfinite(part).all() for part in rows)


def test_a_ship_measures_the_beacon_less_precisely_from_afar(belief):
    """Beacon 2 m ahead at 40 m depth, ship 30 m north: 50 m of slant range from the vehicle below its origin."""
    heading_east(belief)
    belief.x[2] = 40.0
    beacon = msgspec.structs.replace(USBL, lever_arm_m=(2.0, 0.0, 0.0))
    rows = usbl.rows(belief, UsblFix(t_ns=0, north_m=1.0, east_m=4.0), beacon)
    np.testing.assert_allclose(rows.residual, [1.0, 2.0], atol=1e-14)
    np.testing.assert_allclose(
        usbl.rows(belief, UsblFix(t_ns=0, north_m=0.0, east_m=0.0), USBL).variance, 1.5**2 + 2.5**2
    )


def test_the_bottom_moves_astern_and_up_past_a_vehicle_that_moves_ahead_and_down(belief):
    """Level, heading east at 1 m/s, sinking at 0.2: it comes nearer ahead, and recedes astern less 0.2 cos a."""
    heading_east(belief)
    belief.x[4], belief.x[5] = 1.0, 0.2
    s, c = math.sin(SUITE.adcp.beam_angle_rad), math.cos(SUITE.adcp.beam_angle_rad)
    z = np.array([-s, s, 0.0, 0.0]) - 0.2 * c
    ping = BottomTrack(t_ns=0, range_m=np.full(4, 9.0), beam_velocity_mps=z)
    seen = bottom_track.linearise(belief, ping, TRACKING, context())
    np.testing.assert_allclose(seen.rows.residual, 0, atol=1e-15)
    np.testing.assert_array_equal(seen.rows.variance, [1e-4] * 4)


def test_water_that_moves_with_the_bottom_looks_like_the_bottom(belief):
    """Against the profiler's own model: still water, no beam bias, any attitude, mounting, lever arm and rate."""
    for states in (LAYOUT.north, LAYOUT.east, LAYOUT.beam_bias, LAYOUT.near_bias):
        belief.x[states] = 0.0
    rate = (0.3, -0.2, 0.4)
    zero = np.zeros((4, 1))
    ping = AdcpPing(t_ns=0, range_m=np.array([9.0]), beam_velocity_mps=zero)
    water = adcp.linearise(belief, ping, SUITE.adcp, context(rate))
    bed = bottom_track.linearise(
        belief, BottomTrack(t_ns=0, range_m=np.full(4, 9.0), beam_velocity_mps=zero[:, 0]), TRACKING, context(rate)
    )
    np.testing.assert_allclose(bed.rows.residual, water.rows.residual, atol=1e-14)


def test_a_beam_that_has_not_found_the_bottom_is_counted(belief):
    lost = np.array([9.0, np.nan, 9.0, np.nan])
    ping = BottomTrack(t_ns=0, range_m=lost, beam_velocity_mps=lost)
    seen = bottom_track.linearise(belief, ping, TRACKING, context())
    assert seen.unused == {"no_return": 2}
    np.testing.assert_array_equal(seen.indices, [0, 2])
    assert seen.rows.state.shape[0] == 2
    nothing = BottomTrack(t_ns=0, range_m=np.full(4, np.nan), beam_velocity_mps=np.full(4, np.nan))
    assert len(bottom_track.linearise(belief, nothing, TRACKING, context()).rows.residual) == 0


def ping_of_zeros():
    return AdcpPing(t_ns=0, range_m=1.4 + np.arange(6.0), beam_velocity_mps=np.zeros((4, 6)))


def test_the_beams_of_a_linearised_ping_point_along_the_beams_in_ned(belief):
    directions = adcp.linearise(belief, ping_of_zeros(), SUITE.adcp, context()).beams
    expected = beam_directions(SUITE.adcp.beam_angle_rad) @ (belief.R @ belief.mounting).T
    np.testing.assert_allclose(directions, np.repeat(expected, 6, axis=0), atol=1e-12)


def test_a_deeper_window_measures_the_same_water_by_states_of_lower_index(belief):
    """Residuals and derivatives are those of the window at the surface, and so are the grid points."""
    moved, by = belief.copy(), 4
    for water in (LAYOUT.north, LAYOUT.east):
        moved.x[water][:-by] = belief.x[water][by:]
    moved.column.first += by
    first, second = (adcp.linearise(b, ping_of_zeros(), SUITE.adcp, context()) for b in (belief, moved))
    np.testing.assert_array_equal(second.grid_points, first.grid_points)
    np.testing.assert_allclose(second.rows.residual, first.rows.residual, atol=1e-12)
    np.testing.assert_allclose(second.rows.partial, first.rows.partial, atol=1e-12)
    is_water = first.rows.state >= LAYOUT.north.start
    np.testing.assert_array_equal(second.rows.state, np.where(is_water, first.rows.state - by, first.rows.state))
    assert is_water.any()
