"""Process table: the processes of a run, in the order of their start, and the config of each."""

from __future__ import annotations

import msgspec

from services.bus.options import BusOptions
from services.run.folder import RunFolder
from services.run.run_config import RunConfig
from services.run.settings_files import BATHYMETRY, PRIOR
from sim.scenario import Scenario


class ProcessRow(msgspec.Struct, frozen=True):
    """One row of the table. ``module`` has the process's ``Config`` and ``main``.

    ``restartable``: the process is restarted if it fails; otherwise the run ends.
    """

    name: str
    module: str
    restartable: bool


PROCESSES = (
    ProcessRow("router", "services.processes.router", True),
    ProcessRow("recorder", "services.processes.recorder", True),
    ProcessRow("plant", "services.processes.plant", False),
    ProcessRow("sensors", "services.processes.sensors", False),
    ProcessRow("estimator", "services.processes.estimator", True),
    ProcessRow("controller", "services.processes.controller", True),
)


def processes(scenario: Scenario) -> tuple[ProcessRow, ...]:
    """Return the rows that a scenario needs. With ``run.perfect_state`` there is no estimator."""
    return tuple(row for row in PROCESSES if not (row.name == "estimator" and scenario.run.perfect_state))


def config_of(name: str, run_config: RunConfig, folder: RunFolder, bus: BusOptions) -> msgspec.Struct:
    """Return the config of a process of this run, whose router ``bus`` connects to.

    The process reads its settings from the run's own folder.
    """
    # Imported here: a reader of the table alone does not need them, and the router starts before the others are loaded.
    from services.processes import router

    scenario, folder = run_config.scenario, RunFolder(folder.path.absolute())
    bus = msgspec.structs.replace(bus, role=name)
    if name == "router":
        return router.Config(bus=msgspec.structs.replace(bus, connect=(), listen=bus.connect))
    from services.processes import controller, estimator, plant, recorder, sensors

    match name:
        case "recorder":
            metadata = recorder.metadata(scenario.run.seed, run_config.files)
            return recorder.Config(bus=bus, folder=folder.path, start_ns=scenario.start_ns, metadata=metadata)
        case "plant":
            return plant.Config(bus=bus, scenario=str(folder.scenario), expects=("recorder",))
        case "sensors":
            return sensors.Config(bus=bus, scenario=str(folder.scenario))
        case "estimator":
            settings = scenario.estimator
            if settings.water_prior:
                settings = msgspec.structs.replace(settings, water_prior=str(folder.path / "config" / PRIOR))
            return estimator.Config(bus=bus, sensors=str(folder.config("sensors")), settings=settings)
        case "controller":
            return controller.Config(
                bus=bus,
                vehicle=str(folder.config("vehicle")),
                reference=str(folder.config("reference")),
                fence=str(folder.config("fence")) if run_config.fence is not None else "",
                bathymetry=str(folder.path / BATHYMETRY) if run_config.bathymetry is not None else "",
                settings=run_config.controller,
                compute_delay_s=scenario.run.compute_delay_s,
                failed_qps=folder.path / "failed-qps",
            )
    raise ValueError(f"no process {name}")
