"""ProcessRow table: which processes a run is made of, in the order of their start, and the config of each."""

from __future__ import annotations

from pathlib import Path

import msgspec

from services.bus.options import BusOptions
from services.run.folder import RunFolder
from services.run.run_config import PRIOR, RunConfig
from sim.scenario import Scenario


class ProcessRow(msgspec.Struct, frozen=True):
    """One row. ``module`` has the process's ``Config`` and ``main``.

    ``restartable``: its death need not end a run; of the others' the run dies. ``needs`` must be ready before it
    starts: the recorder comes first, so that nothing is said before it listens.
    """

    name: str
    module: str
    restartable: bool
    needs: tuple[str, ...]


PROCESSES = (
    ProcessRow("router", "services.processes.router", True, ()),
    ProcessRow("recorder", "services.processes.recorder", True, ()),
    ProcessRow("plant", "services.processes.plant", False, ("recorder",)),
    ProcessRow("sensors", "services.processes.sensors", False, ("recorder",)),
    ProcessRow("estimator", "services.processes.estimator", True, ("recorder",)),
    ProcessRow("controller", "services.processes.controller", True, ("recorder",)),
)


class RunContext(msgspec.Struct, frozen=True, kw_only=True):
    """What the processes of one run share: its folder and its bus."""

    folder: RunFolder
    router: str  # endpoint
    namespace: str
    certs: Path | None = None


def processes(scenario: Scenario) -> tuple[ProcessRow, ...]:
    """The rows that a scenario needs: with the truth given away there is nothing to estimate."""
    return tuple(row for row in PROCESSES if not (row.name == "estimator" and scenario.run.perfect_state))


def config_of(name: str, run_config: RunConfig, place: RunContext) -> msgspec.Struct:
    """The config of a process of this run, which reads its settings from the run's own folder."""
    # Only who starts processes needs these, and not for the list of them.
    from services.processes import controller, estimator, plant, recorder, router, sensors

    scenario, folder = run_config.scenario, RunFolder(place.folder.path.absolute())
    bus = BusOptions(connect=(place.router,), namespace=place.namespace, certs=place.certs, role=name)
    match name:
        case "router":
            return router.Config(bus=msgspec.structs.replace(bus, connect=(), listen=(place.router,)))
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
                settings=scenario.controller,
                compute_delay_s=scenario.run.compute_delay_s,
                failed_qps=folder.path / "failed-qps",
            )
    raise ValueError(f"no process {name}")
