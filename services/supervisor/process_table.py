"""Process table: the processes of a run, in the order of their start, and the config of each."""

from __future__ import annotations

import msgspec

from services.bus.options import BusOptions
from services.processes import settings
from services.run.folder import RunFolder
from services.run.run_config import RunConfig
from services.run.settings_files import BATHYMETRY
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
    scenario, folder = run_config.scenario, RunFolder(folder.path.absolute())
    bus = msgspec.structs.replace(bus, role=name)
    match name:
        case "router":
            return settings.Router(bus=msgspec.structs.replace(bus, connect=(), listen=bus.connect))
        case "recorder":
            metadata = settings.recording_metadata(scenario.run.seed, run_config.files)
            return settings.Recorder(bus=bus, folder=folder.path, start_ns=scenario.start_ns, metadata=metadata)
        case "plant":
            return settings.Plant(bus=bus, scenario=str(folder.scenario), expect=("recorder",))
        case "sensors":
            return settings.Sensors(bus=bus, scenario=str(folder.scenario))
        case "estimator":
            return settings.Estimator(
                bus=bus,
                vehicle=str(folder.config("vehicle")),
                sensors=str(folder.config("sensors")),
                settings=folder.config("estimator"),
            )
        case "controller":
            return settings.Controller(
                bus=bus,
                vehicle=str(folder.config("vehicle")),
                reference=str(folder.config("reference")),
                settings=folder.config("controller"),
                fence=str(folder.config("fence")) if run_config.fence is not None else None,
                bathymetry=str(folder.path / BATHYMETRY) if run_config.bathymetry is not None else None,
                compute_delay_s=scenario.run.compute_delay_s,
                failed_qps=folder.path / "failed-qps",
            )
    raise ValueError(f"no process {name}")
