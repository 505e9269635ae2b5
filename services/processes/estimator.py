"""Estimator process: it estimates the vehicle's state and the water's motion from sensor messages."""

from __future__ import annotations

import os

from ltv_mpc.errors import ConfigError
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import fitted
from ltv_mpc.localisation.sensors.imu import IMU
from ltv_mpc.localisation.sensors.sensor import Availability
from ltv_mpc.messages import ImuSample, ImuSamples
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.vehicle.parameters import Vehicle
from services.processes import settings
from services.run.settings_files import TOO_LARGE, estimator_files, node_settings
from services.run.water import load_prior
from services.runtime.clock import monotonic_us
from services.runtime.console import Console
from services.runtime.lifeline import LIFELINE
from services.runtime.runner import Runner

Config = settings.Estimator


def main(config: Config) -> int:
    """Run the estimator until it is stopped; return the exit code."""
    vehicle = Vehicle.load(config.vehicle)
    if vehicle != vehicle.at_origin():
        problem = "must be 0 or left out: this estimator publishes the vehicle's origin; the controller's likewise"
        raise ConfigError(f"vehicle {config.vehicle}: [reference_point]", "", problem)
    sensor_config, filter_config = SensorConfig.load(config.sensors), config.loaded()
    prior = load_prior(filter_config)
    LIFELINE.connect(os.environ)
    LIFELINE.status("compiling")
    warm_up(sensor_config, filter_config)
    LIFELINE.status("waiting for the router")
    published = node_settings(Estimator.name, estimator_files(config.sensors, filter_config))
    console = Console(Estimator.name, as_json=config.log_json)
    if published is None:
        console.say(TOO_LARGE)
    # Signs of life during a long computation.
    node = Estimator(sensor_config, filter_config, prior, progress=lambda: LIFELINE.beat(monotonic_us()))
    return Runner(node, settings=published).main(console, config.bus)


def warm_up(sensor_config: SensorConfig, config: EstimatorConfig) -> None:
    """Load all compiled code: run one second of a vehicle at rest through an estimator that is then discarded."""
    estimator = Estimator(sensor_config, config)
    second, imu_ns = 1_000_000_000, sensor_config.imu.period_ns
    samples = [IMU.at_rest(t_ns, sensor_config.imu) for t_ns in range(imu_ns, second + imu_ns + 1, imu_ns)]
    start = [sensor.at_rest(0, own) for sensor, own in fitted(sensor_config)]
    end = [sensor.at_rest(second, own) for sensor, own in fitted(sensor_config)]
    late = [
        s.at_rest(second // 2, own) for s, own in fitted(sensor_config) if s.availability is not Availability.SURFACE
    ]
    for message in (*start, *samples[:-1], *end, samples[-1], *late):
        published = ImuSamples(samples=(message,)) if isinstance(message, ImuSample) else message
        estimator.step(message.t_ns, [ReceivedMessage(published, 1, 0, message.t_ns)])
