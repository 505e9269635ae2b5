"""Plant process: the simulated vehicle, which is also the clock master of a simulated run."""

from __future__ import annotations

from services.processes import settings
from services.run.run_config import RunConfig, resolve
from services.runtime.clock_master import ClockMasterSettings
from services.runtime.console import Console
from services.runtime.process_time import ClockOptions
from services.runtime.runner import Runner
from services.runtime.stopping import DONE, FAILED
from sim.plant import Plant

Config = settings.Plant


def main(config: Config) -> int:
    """Start the clock when all nodes are ready, and run to the scenario's end. Return 1 if stopped before it."""
    run_config = resolve(config.scenario)
    scenario = run_config.scenario
    estimator = () if scenario.run.perfect_state else ("estimator",)
    clock_master = ClockMasterSettings(
        start_ns=scenario.start_ns,
        end_ns=scenario.end_ns,
        speed=scenario.run.speed,
        expects=("sensors", *estimator, "controller", *config.expect),
    )
    warm_up(run_config)
    runner = Runner(_make(run_config), clock=ClockOptions(master=clock_master))
    console = Console(Plant.name, as_json=config.log_json)
    code = runner.main(console, config.bus)
    if code == DONE and not runner.finished:
        console.say("stopped before the end of the run")
        return FAILED
    return code


def warm_up(run_config: RunConfig) -> None:
    """Load all compiled code, by a few steps of a plant that is discarded."""
    plant = _make(run_config)
    for t_ns in range(0, 2 * Plant.schedule.period_ns, Plant.schedule.period_ns):
        plant.step(t_ns, [])


def _make(run_config: RunConfig) -> Plant:
    return Plant(run_config.scenario, run_config.vehicle, run_config.water)
