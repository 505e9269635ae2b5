"""Expected measurement of each sensor, against the simulated one, which tests/sim/sensors has by hand; derivatives."""

import math

import numpy as np
import pytest

from ltv_mpc.frames import rotation
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import GYRO_BIAS, Belief, Layout
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import BY_MESSAGE, fitted
from ltv_mpc.localisation.sensors.sensor import Context
from ltv_mpc.messages import AdcpPing, BottomTrack, CompassHeading, GnssFix, LblRange, PressureDepth, TdcpFix, UsblFix
from sim.sensors import SIMULATED
from sim.sensors.adcp import Instrument
from sim.sensors.simulated import Environment
from sim.sensors.vehicle_state import motion_between
from sim.water import WaterColumn
from tests.ltv_mpc.localisation.sensors.every_sensor import EVERY_SENSOR, S, dense, with_settings
from tests.sim.worlds import instant, truth

CONFIG = EstimatorConfig()
SENSORS = with_settings(
    EVERY_SENSOR,
    lbl={"transponders_m": ((0.0, 0.0, 100.0), (30.0, 40.0, 0.0))},
    usbl={"ship_m": (30.0, 0.0), "position_sd_m": 1.5, "bearing_sd_rad": 0.05},
    gnss={"lever_arm_m": (0.0, 0.0, 0.0)},
)
LAYOUT = Layout.of(SENSORS, CONFIG)
NOISELESS = with_settings(
    SENSORS,
    gnss={"position_sd_m": 0.0, "velocity_sd_mps": 0.0, "lever_arm_m": (0.7, -0.4, -1.1)},
    tdcp={"displacement_sd_m": 0.0},
    adcp={"beam_noise_sd_mps": 0.0, "missing_share": 0.0, "outlier_share": 0.0, "mounting_rad": (0.02, -0.03, 0.5)},
    bottom_track={"beam_noise_sd_mps": 0.0},
    pressure={"depth_sd_m": 0.0, "lever_arm_m": (-0.6, 0.3, 0.2)},
    compass={"heading_sd_rad": 0.0},
    lbl={"range_sd_m": 0.0, "sound_speed_sd_mps": 5.0, "lever_arm_m": (1.0, 0.5, 0.4)},
    usbl={"position_sd_m": 0.0, "bearing_sd_rad": 0.0, "lever_arm_m": (-0.8, 0.2, -0.3)},
)


def linearised(belief, message, *, rate=(0.0, 0.0, 0.0), sensors=SENSORS):
    """Linearise a message."""
    sensor = BY_MESSAGE[type(message)]
    return sensor.linearise(belief, message, getattr(sensors, sensor.name), Context(sensors, CONFIG.cell_m, rate))


def scene(name):
    """Return a belief that is right, the reading of a sensor without noise, and the measured angular rate.

    In a turn about all axes, in sheared water, with lever arms, mounting and biases; a range is that of a rest.
    """
    seed, water_mps = 4, 0.1 * np.random.default_rng(3).standard_normal((71, 2))
    device = SIMULATED[name](
        getattr(NOISELESS, name), Environment(NOISELESS, seed, WaterColumn(np.arange(71.0), water_mps), bottom_m=30.0)
    )
    motion = {} if name == "lbl" else {"velocity": (0.4, -0.3, 0.1), "rate": (0.3, -0.2, 0.4)}
    before = instant(-S, attitude=(0.1, -0.2, 2.0), position=(4.0, -2.0, 12.0))
    now = instant(0, attitude=(0.2, -0.3, -3.1), position=(5.0, -3.0, 12.6), **motion)
    device.sample(before)
    messages = device.sample(now)
    if name == "lbl":
        still = [truth(t_ns, position_m=now.position_m, attitude_rad=(0.2, -0.3, -3.1)) for t_ns in (0, S)]
        messages = device.answers(motion_between(*still), S)

    layout = Layout.of(NOISELESS, CONFIG)
    belief, instrument = Belief.blank(layout, 0), Instrument(NOISELESS.adcp, seed)
    belief.x[:3], belief.R, belief.t_ns = before.position_m, before.rotation, -S
    belief.clone_position(NOISELESS.gnss.lever_arm_m)
    belief.x[:6], belief.R = [*now.position_m, *now.velocity_mps], now.rotation
    belief.x[layout.north], belief.x[layout.east] = water_mps.T
    belief.mounting = instrument.mounting
    belief.x[layout.beam_bias], belief.x[layout.near_bias] = instrument.beam_bias_mps, instrument.near_bias_mps
    belief.x[layout.compass_bias] = getattr(device, "bias_rad", 0.0)
    belief.x[layout.sound_speed] = getattr(device, "sound_speed_mps", 1500.0) / 1500.0 - 1.0
    belief.x[GYRO_BIAS] = 0.02, -0.03, 0.01
    return belief, messages[-1], tuple(now.angular_rate_radps() + belief.x[GYRO_BIAS])


NAMES = [sensor.name for sensor, _ in fitted(NOISELESS)]


@pytest.mark.parametrize("name", NAMES)
def test_a_reading_without_noise_leaves_no_residual(name):
    belief, message, rate = scene(name)
    residual = linearised(belief, message, rate=rate, sensors=NOISELESS).rows.residual
    assert len(residual) > 0
    np.testing.assert_allclose(residual, 0.0, atol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_partials_are_minus_the_derivatives_of_the_residual(name):
    """Central differences, 1e-6 relative to the largest of a row; a residual is z - h, so its derivative is -H."""
    belief, message, rate = scene(name)

    def rows(error):
        at = belief.copy()
        at.apply_error(error)
        return linearised(at, message, rate=rate, sensors=NOISELESS).rows

    size, h = belief.layout.size, 1e-5
    H = dense(rows(np.zeros(size)), size)
    difference = np.stack([(rows(-e).residual - rows(e).residual) / (2 * h) for e in h * np.eye(size)], axis=1)
    scale = np.abs(difference).max(axis=1, keepdims=True)
    np.testing.assert_allclose(H / scale, difference / scale, atol=1e-6)


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
    return Belief.blank(LAYOUT, 0)


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
    """That of a ship's fix grows with its distance: 30 m north of the vehicle and 40 m above it."""
    at_origin.x[2] = 40.0
    step, zero = TdcpFix(t_ns=0, from_t_ns=0, north_m=0.0, east_m=0.0), np.zeros(4)
    for message, sd in (
        (GnssFix(t_ns=0, **dict.fromkeys(GnssFix.__struct_fields__[1:], 0.0)), [5.0, 5.0, 0.02, 0.02]),
        (step, [0.005] * 2),
        (PressureDepth(t_ns=0, depth_m=0.0), [0.01]),
        (CompassHeading(t_ns=0, heading_rad=0.0), [math.radians(1)]),
        (BottomTrack(t_ns=0, range_m=zero, beam_velocity_mps=zero), [0.01] * 4),
        (UsblFix(t_ns=0, north_m=0.0, east_m=0.0), [math.hypot(1.5, 0.05 * 50.0)] * 2),
    ):
        np.testing.assert_allclose(np.sqrt(linearised(at_origin, message).rows.variance), sd)


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


def test_a_beam_that_has_not_found_the_bottom_is_counted(belief):
    lost = np.array([9.0, np.nan, 9.0, np.nan])
    seen = linearised(belief, BottomTrack(t_ns=0, range_m=lost, beam_velocity_mps=lost))
    assert seen.unused == {"no_return": 2}
    np.testing.assert_array_equal(seen.indices, [0, 2])
    none = np.full(4, np.nan)
    assert len(linearised(belief, BottomTrack(t_ns=0, range_m=none, beam_velocity_mps=none)).rows.residual) == 0
