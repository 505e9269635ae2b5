"""The registry: each sensor stands under its own name, and its example message fits a vehicle at rest."""

from __future__ import annotations

import numpy as np
import pytest

from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import Belief, Layout
from ltv_mpc.localisation.sensors import BY_MESSAGE, BY_NAME, PUBLISHED, SENSORS, SensorTables, fitted
from ltv_mpc.localisation.sensors.sensor import Context
from ltv_mpc.messages import AdcpPing
from services.bus.topics import BY_TYPE
from sim.sensors import SIMULATED
from tests.ltv_mpc.localisation.sensors.every_sensor import EVERY_SENSOR, REALISTIC, S

NAMES = [sensor.name for sensor in SENSORS]


def test_each_sensor_stands_under_its_name_with_its_settings():
    assert tuple(NAMES) == SensorTables.__struct_fields__
    for sensor in SENSORS:
        assert isinstance(getattr(EVERY_SENSOR, sensor.name), sensor.settings)
    assert len(BY_NAME) == len(BY_MESSAGE) == len(SENSORS)


def test_each_sensor_has_a_topic_and_a_simulation():
    assert set(SIMULATED) == set(NAMES)
    for sensor in SENSORS:
        assert BY_TYPE[PUBLISHED[sensor.name]].key.startswith("sensor/")


@pytest.mark.parametrize("name", [name for name in NAMES if name != "imu"])
def test_the_example_of_a_vehicle_at_rest_leaves_no_residual(name):
    config = EstimatorConfig()
    belief = Belief.blank(Layout.of(EVERY_SENSOR, config), S)
    sensor, settings = BY_NAME[name], getattr(EVERY_SENSOR, name)
    if name == "tdcp":
        belief.epoch_t_ns = S - settings.period_ns
    message = sensor.at_rest(S, settings)
    assert message.t_ns == S
    rows = sensor.linearise(belief, message, settings, Context(EVERY_SENSOR, config.cell_m, (0.0, 0.0, 0.0))).rows
    assert len(rows.residual) >= 1
    assert np.all(rows.residual >= 0)
    np.testing.assert_allclose(rows.residual, 0, atol=2e-6)


@pytest.mark.parametrize("name", [sensor.name for sensor in SENSORS if sensor.reading is not None])
def test_examples_of_two_times_have_two_readings(name):
    """Otherwise the second one would be rejected as stuck."""
    sensor, settings = BY_NAME[name], getattr(EVERY_SENSOR, name)
    one, other = (sensor.reading(sensor.at_rest(t_ns, settings)) for t_ns in (S, 2 * S))
    assert one != other


def test_the_example_ping_has_the_cells_of_the_profiler():
    adcp = EVERY_SENSOR.adcp
    ping = BY_MESSAGE[AdcpPing].at_rest(S, adcp)
    assert ping.range_m[0] == adcp.blanking_m + 0.5 * adcp.cell_m
    np.testing.assert_allclose(np.diff(ping.range_m), adcp.cell_m)
    assert adcp.range_m - 2 * adcp.cell_m < ping.range_m[-1] + 0.5 * adcp.cell_m <= adcp.range_m


def test_a_sensor_that_the_vehicle_lacks_is_not_fitted():
    assert [sensor.name for sensor, _ in fitted(EVERY_SENSOR)] == [name for name in NAMES if name != "imu"]
    assert {"lbl", "usbl", "bottom_track"}.isdisjoint(sensor.name for sensor, _ in fitted(REALISTIC))
