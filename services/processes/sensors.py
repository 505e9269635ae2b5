"""Sensors process: simulated measurements of the true state."""

from __future__ import annotations

from ltv_mpc.messages import Truth
from ltv_mpc.node import ReceivedMessage
from services.processes import settings
from services.run.run_config import RunConfig, resolve
from services.runtime.console import Console
from services.runtime.process_time import ClockOptions
from services.runtime.runner import Runner
from sim.plant import STEP_NS
from sim.sensors.node import Sensors

Config = settings.Sensors


def main(config: Config) -> int:
    """Run the sensors until they are stopped; return the exit code."""
    run_config = resolve(config.scenario)
    warm_up(run_config)
    runner = Runner(_make(run_config), clock=ClockOptions(speed=run_config.scenario.run.speed))
    return runner.main(Console(Sensors.name, as_json=config.log_json), config.bus)


def warm_up(run_config: RunConfig) -> None:
    """Load all compiled code: run 1.4 s of a vehicle at rest through sensors that are then discarded."""
    sensors = _make(run_config)
    still = (0.0, 0.0, 0.0)
    for t_ns in range(-1_000_000_000, 400_000_000, STEP_NS):
        truth = Truth(
            t_ns=t_ns,
            position_m=still,
            velocity_mps=still,
            attitude_rad=still,
            water_velocity_mps=still,
            yaw_rate_radps=0.0,
            current_mps=(0.0, 0.0),
            thrust_N=still,
        )
        sensors.step(t_ns, [ReceivedMessage(truth, 1, 0, t_ns)])


def _make(run_config: RunConfig) -> Sensors:
    return Sensors(run_config.scenario, run_config.sensor_config, run_config.water)
