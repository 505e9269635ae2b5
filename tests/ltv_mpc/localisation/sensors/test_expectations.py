"""Expected measurement of each sensor, against the same quantity computed independently."""

import math

import numpy as np
import pytest

from ltv_mpc.frames import rotation, rotation_exp
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import GYRO_BIAS, Belief, Layout
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import BY_MESSAGE
from ltv_mpc.localisation.sensors.adcp import beam_directions
from ltv_mpc.localisation.sensors.sensor import Context
from ltv_mpc.messages import AdcpPing, BottomTrack, CompassHeading, GnssFix, LblRange, PressureDepth, TdcpFix, UsblFix
from tests.ltv_mpc.localisation.sensors.every_sensor import EVERY_SENSOR, with_settings

CONFIG = EstimatorConfig()
SENSORS = with_settings(
    EVERY_SENSOR,
    lbl={"transponders_m": ((0.0, 0.0, 100.0), (30.0, 40.0, 0.0))},
    usbl={"ship_m": (30.0, 0.0), "position_sd_m": 1.5, "bearing_sd_rad": 0.05},
    gnss={"lever_arm_m": (0.0, 0.0, 0.0)},
)
LAYOUT = Layout.of(SENSORS, CONFIG)
EAST = rotation(0.0, 0.0, math.pi / 2)


def linearised(belief, message, *, rate=(0.0, 0.0, 0.0), sensors=SENSORS, **changed):
    """Linearise a message with settings of its sensor ``changed``."""
    sensor = BY_MESSAGE[type(message)]
    sensors = with_settings(sensors, **{sensor.name: changed})
    return sensor.linearise(belief, message, getattr(sensors, sensor.name), Context(sensors, CONFIG.cell_m, rate))


def residual(belief, message, **how):
    return linearised(belief, message, **how).rows.residual


def fix(north=0.0, east=0.0, v_north=0.0, v_east=0.0):
    return GnssFix(t_ns=0, north_m=north, east_m=east, velocity_north_mps=v_north, velocity_east_mps=v_east)


@pytest.fixture
def belief():
    rng = np.random.default_rng(3)
    belief = Belief.blank(LAYOUT, 0)
    belief.x = 0.1 * rng.standard_normal(LAYOUT.size)
    belief.x[:3] = [5.0, -3.0, 12.6]
    belief.R = rotation(0.2, -0.3, 2.0)
    belief.mounting = rotation(0.05, -0.04, 0.03)
    return belief


@pytest.fixture
def at_origin():
    """Level, at the origin, heading east: what is forward lies east, what is to starboard lies south."""
    belief = Belief.blank(LAYOUT, 0)
    belief.R = EAST
    return belief


def test_scalar_sensors_read_the_beliefs_own_quantities(belief):
    n, e, _, vn, ve = belief.x[:5]
    np.testing.assert_allclose(residual(belief, fix(n + 1, e + 2, vn + 3, ve + 4)), [1, 2, 3, 4])
    np.testing.assert_allclose(residual(belief, PressureDepth(t_ns=0, depth_m=13.0)), 0.4)
    belief.x[LAYOUT.epoch] = [4.0, -1.0]  # now at 5, -3
    np.testing.assert_allclose(residual(belief, TdcpFix(t_ns=0, from_t_ns=0, north_m=1.0, east_m=-2.0)), 0, atol=1e-15)
    assert linearised(belief, TdcpFix(t_ns=0, from_t_ns=-1, north_m=0.0, east_m=0.0)).unused == {"other_epoch": 2}


@pytest.mark.parametrize("heading", [-3.1, 0.0, 2.0, 3.1])
def test_a_compass_reads_heading_plus_its_bias_across_the_turn_of_south(belief, heading):
    belief.R = rotation(0.2, -0.3, heading)
    belief.x[LAYOUT.compass_bias] = 0.1
    read = CompassHeading(t_ns=0, heading_rad=math.remainder(heading + 0.1, math.tau))
    np.testing.assert_allclose(residual(belief, read), 0, atol=1e-12)


def test_beams_look_down_ahead_astern_starboard_and_port():
    e = beam_directions(math.radians(20))
    np.testing.assert_allclose(np.linalg.norm(e, axis=1), 1)
    np.testing.assert_allclose(e[:, 2], math.cos(math.radians(20)))
    assert e[0, 0] > 0 > e[1, 0]
    assert e[2, 1] > 0 > e[3, 1]


def test_a_beam_sees_the_rate_at_which_water_recedes_from_the_moving_transducer(belief):
    """The transducer's path r(t) = p + v t + R exp(w t) l is differentiated numerically."""
    x, R, adcp = belief.x, belief.R, SENSORS.adcp
    measured = np.array([0.3, -0.2, 0.4])
    w, lever, ranges = measured - x[GYRO_BIAS], np.array(adcp.lever_arm_m), 1.4 + np.arange(15.0)

    def transducer(t):
        return x[:3] + x[3:6] * t + R @ rotation_exp(w * t) @ lever

    velocity = (transducer(1e-5) - transducer(-1e-5)) / 2e-5
    along = beam_directions(adcp.beam_angle_rad) @ (R @ belief.mounting).T
    depths = transducer(0.0)[2] + np.outer(along[:, 2], ranges)
    water = [np.interp(depths, np.arange(71), x[axis]) for axis in (LAYOUT.north, LAYOUT.east)]
    z = along[:, :1] * (water[0] - velocity[0]) + along[:, 1:2] * (water[1] - velocity[1]) - along[:, 2:] * velocity[2]
    z += x[LAYOUT.beam_bias][:, None] + np.outer(x[LAYOUT.near_bias], np.exp(-ranges / adcp.near_bias_length_m))
    seen = linearised(belief, AdcpPing(t_ns=0, range_m=ranges, beam_velocity_mps=z), rate=tuple(measured.tolist()))
    np.testing.assert_allclose(seen.rows.residual, 0, atol=1e-9)
    np.testing.assert_array_equal(seen.indices, np.arange(60))
    np.testing.assert_array_equal(seen.grid_points, np.floor(depths.ravel()))
    np.testing.assert_allclose(seen.beams, np.repeat(along, 15, axis=0), atol=1e-12)


def test_cells_without_return_or_outside_the_grid_are_counted(at_origin):
    at_origin.x[2] = 60.0
    ranges, z = 1.4 + np.arange(15.0), np.zeros((4, 15))
    z[1] = np.nan
    reach = 60.0 + SENSORS.adcp.lever_arm_m[2] + ranges * math.cos(SENSORS.adcp.beam_angle_rad)
    inside = int((reach < 70.0).sum())
    seen = linearised(at_origin, AdcpPing(t_ns=0, range_m=ranges, beam_velocity_mps=z))
    assert seen.unused == {"no_return": 15, "outside_grid": 3 * (15 - inside)}
    assert len(seen.rows.residual) == 3 * inside


def test_a_profiler_without_biases_has_rows_without_them():
    paper = SensorConfig.load("paper")
    layout = Layout.of(paper, CONFIG)
    ping = AdcpPing(t_ns=0, range_m=np.array([3.0]), beam_velocity_mps=np.zeros((4, 1)))
    H = linearised(Belief.blank(layout, 0), ping, sensors=paper).rows.times(np.eye(layout.size))
    assert set(np.flatnonzero(H.any(axis=0))) <= {*range(9), *range(layout.north.start, layout.east.stop)}


def test_noise_is_the_sensors_own(at_origin):
    step, zero = TdcpFix(t_ns=0, from_t_ns=0, north_m=0.0, east_m=0.0), np.zeros(4)
    for message, sd in (
        (fix(), [5.0, 5.0, 0.02, 0.02]),
        (step, [0.005] * 2),
        (PressureDepth(t_ns=0, depth_m=0.0), [0.01]),
        (CompassHeading(t_ns=0, heading_rad=0.0), [math.radians(1)]),
        (BottomTrack(t_ns=0, range_m=zero, beam_velocity_mps=zero), [0.01] * 4),
    ):
        np.testing.assert_allclose(np.sqrt(linearised(at_origin, message).rows.variance), sd)


def test_an_antenna_astern_of_a_turning_vehicle_is_west_of_it_and_moves_north(at_origin):
    """2 m astern, heading east, turning to starboard at 0.1 rad/s: the stern swings to port, north, at 0.2 m/s."""
    mast = {"lever_arm_m": (-2.0, 0.0, -1.0), "rate": (0.0, 0.0, 0.1)}
    np.testing.assert_allclose(residual(at_origin, fix(0.0, -2.0, 0.2, 0.0), **mast), 0, atol=1e-15)
    at_origin.x[GYRO_BIAS.stop - 1] = 0.1  # the rate is the bias
    np.testing.assert_allclose(residual(at_origin, fix(0.0, -2.0, 0.0, 0.0), **mast), 0, atol=1e-15)


def test_the_change_of_position_is_that_of_the_antenna(at_origin):
    """A turn on the spot from north to east moves an antenna 2 m ahead by 2 m south and 2 m east."""
    mast = with_settings(SENSORS, gnss={"lever_arm_m": (2.0, 0.0, 0.0)})
    at_origin.R = np.eye(3)
    at_origin.clone_position((2.0, 0.0, 0.0))
    at_origin.R = EAST
    step = TdcpFix(t_ns=0, from_t_ns=0, north_m=-2.0, east_m=2.0)
    np.testing.assert_allclose(residual(at_origin, step, sensors=mast), 0, atol=1e-15)


def test_a_gauge_in_the_bow_is_higher_when_the_bow_is_up(at_origin):
    at_origin.x[2], at_origin.R = 10.0, rotation(0.0, math.radians(30), 1.0)
    bow = residual(at_origin, PressureDepth(t_ns=0, depth_m=9.0), lever_arm_m=(2.0, 0.0, 0.0))
    np.testing.assert_allclose(bow, 0, atol=1e-14)


def test_a_travel_time_is_there_and_back_from_the_transducer_at_the_speed_of_sound(at_origin):
    """The second transponder is 30 m north and 40 m east; with the transducer 10 m ahead, 30 sqrt(2) away."""

    def heard(transponder, range_m, speed_mps=1500.0, **settings):
        message = LblRange(t_ns=0, transponder=transponder, travel_time_s=2 * range_m / speed_mps)
        return residual(at_origin, message, **settings)

    assert heard(0, 100.0) == pytest.approx(0, abs=1e-12)
    assert heard(1, 50.0) == pytest.approx(0, abs=1e-12)
    assert heard(1, 30 * math.sqrt(2), lever_arm_m=(10.0, 0.0, 0.0)) == pytest.approx(0, abs=1e-12)
    quick = with_settings(SENSORS, lbl={"sound_speed_sd_mps": 3.0})
    belief = Belief.blank(Layout.of(quick, CONFIG), 0)
    belief.x[belief.layout.sound_speed] = 0.01
    late = LblRange(t_ns=0, transponder=0, travel_time_s=2 * 100 / 1515.0)
    assert residual(belief, late, sensors=quick) == pytest.approx(0, abs=1e-12)


def test_the_second_order_range_term_agrees_with_drawn_positions(at_origin):
    """Against 400 000 draws: mean and twice the deviation of the range beyond its tangent."""
    at_origin.x[:3] = [10.0, -20.0, 30.0]
    root = np.array([[9.0, 0.0, 0.0], [-4.0, 8.0, 0.0], [0.5, 1.0, 2.0]])
    at_origin.P[:3, :3] = root @ root.T
    drawn = np.random.default_rng(0).standard_normal((400_000, 3)) @ root.T
    away = at_origin.x[:3] - SENSORS.lbl.transponders_m[1]
    r = np.linalg.norm(away)
    beyond = np.linalg.norm(away + drawn, axis=1) - r - drawn @ away / r
    rows = linearised(at_origin, LblRange(t_ns=0, transponder=1, travel_time_s=2 * r / 1500.0)).rows
    np.testing.assert_allclose(-rows.residual, beyond.mean(), rtol=0.03)
    np.testing.assert_allclose(rows.variance - 1.0, 4 * beyond.var(), rtol=0.15)


def test_a_transponder_at_the_vehicles_position_gives_finite_rows(at_origin):
    at_origin.x[:3], at_origin.P[:3, :3] = SENSORS.lbl.transponders_m[0], np.eye(3)
    rows = linearised(at_origin, LblRange(t_ns=0, transponder=0, travel_time_s=0.01)).rows
    assert all(np.isfinite(part).all() for part in rows)


def test_a_ship_measures_the_beacon_less_precisely_from_afar(at_origin):
    """Beacon 2 m ahead at 40 m depth, ship 30 m north: 50 m of slant range from the vehicle below its origin."""
    at_origin.x[2] = 40.0
    ahead = residual(at_origin, UsblFix(t_ns=0, north_m=1.0, east_m=4.0), lever_arm_m=(2.0, 0.0, 0.0))
    np.testing.assert_allclose(ahead, [1.0, 2.0], atol=1e-14)
    variance = linearised(at_origin, UsblFix(t_ns=0, north_m=0.0, east_m=0.0)).rows.variance
    np.testing.assert_allclose(variance, 1.5**2 + 2.5**2)


def test_the_bottom_moves_astern_and_up_past_a_vehicle_that_moves_ahead_and_down(at_origin):
    """Level, heading east at 1 m/s, sinking at 0.2: it comes nearer ahead, and recedes astern less 0.2 cos a."""
    at_origin.x[4], at_origin.x[5] = 1.0, 0.2
    s, c = math.sin(SENSORS.adcp.beam_angle_rad), math.cos(SENSORS.adcp.beam_angle_rad)
    z = np.array([-s, s, 0.0, 0.0]) - 0.2 * c
    ping = BottomTrack(t_ns=0, range_m=np.full(4, 9.0), beam_velocity_mps=z)
    np.testing.assert_allclose(residual(at_origin, ping), 0, atol=1e-15)


def test_still_water_looks_like_the_bottom(belief):
    """Against the profiler's own model: no beam bias, any attitude, mounting, lever arm and rate."""
    for states in (LAYOUT.north, LAYOUT.east, LAYOUT.beam_bias, LAYOUT.near_bias):
        belief.x[states] = 0.0
    zero, rate = np.zeros((4, 1)), (0.3, -0.2, 0.4)
    water = residual(belief, AdcpPing(t_ns=0, range_m=np.array([9.0]), beam_velocity_mps=zero), rate=rate)
    bed = BottomTrack(t_ns=0, range_m=np.full(4, 9.0), beam_velocity_mps=zero[:, 0])
    np.testing.assert_allclose(residual(belief, bed, rate=rate), water, atol=1e-14)


def test_a_beam_that_has_not_found_the_bottom_is_counted(belief):
    lost = np.array([9.0, np.nan, 9.0, np.nan])
    seen = linearised(belief, BottomTrack(t_ns=0, range_m=lost, beam_velocity_mps=lost))
    assert seen.unused == {"no_return": 2}
    np.testing.assert_array_equal(seen.indices, [0, 2])
    assert len(residual(belief, BottomTrack(t_ns=0, range_m=lost * np.nan, beam_velocity_mps=lost * np.nan))) == 0


def test_a_deeper_window_measures_the_same_water_by_states_of_lower_index(belief):
    """Residuals and derivatives are those of the window at the surface, and so are the grid points."""
    ping, moved, by = (
        AdcpPing(t_ns=0, range_m=1.4 + np.arange(6.0), beam_velocity_mps=np.zeros((4, 6))),
        belief.copy(),
        4,
    )
    for water in (LAYOUT.north, LAYOUT.east):
        moved.x[water][:-by] = belief.x[water][by:]
    moved.column.first += by
    first, second = (linearised(b, ping) for b in (belief, moved))
    np.testing.assert_array_equal(second.grid_points, first.grid_points)
    np.testing.assert_allclose(second.rows.residual, first.rows.residual, atol=1e-12)
    np.testing.assert_allclose(second.rows.partial, first.rows.partial, atol=1e-12)
    is_water = first.rows.state >= LAYOUT.north.start
    np.testing.assert_array_equal(second.rows.state, np.where(is_water, first.rows.state - by, first.rows.state))
