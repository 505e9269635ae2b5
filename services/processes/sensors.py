"""Sensors process: simulated measurements of the true state."""

from __future__ import annotations

from ltv_mpc.messages import Truth
from ltv_mpc.node import ReceivedMessage
from services.processes import settings
from services.run.run_config import RunConfig, resolve
from services.runtime.console import Console
from services.runtime.process_time import ClockOptions
from services.runtime.runner import Runner
from sim.plant import Plant
from sim.sensors.node import Sensors

Config = settings.Sensors


def main(config: Config) -> int:
    """Run the sensors until they are stopped; return the exit code."""
    run_config = resolve(config.scenario)
    warm_up(run_config)
    runner = Runner(_make(run_config), clock=ClockOptions(speed=run_config.scenario.run.speed))
    return runner.main(Console(Sensors.name, as_json=config.log_json), config.bus)


def warm_up(run_config: RunConfig) -> None:
    """Load all compiled code: run 1.4 s of a plant without plans through sensors; both are then discarded."""
    plant, sensors = Plant(run_config.scenario, run_config.vehicle, run_config.water), _make(run_config)
    for t_ns in range(-1_000_000_000, 400_000_000, Plant.schedule.period_ns):
        for message in plant.step(t_ns, []):
            if isinstance(message, Truth):
                sensors.step(message.t_ns, [ReceivedMessage(message, 1, 0, message.t_ns)])


def _make(run_config: RunConfig) -> Sensors:
    return Sensors(run_config.scenario, run_config.sensor_config, run_config.water)
