"""Commands that start one process each: the processes of ``sim``, in any order, each in its own terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from services.cli.options import (
    BusOptions,
    Force,
    LogJson,
    Out,
    ScenarioName,
    SensorsFile,
    VehicleFile,
    argument,
    flag,
    invalid,
    option,
    with_bus,
)


@with_bus("router")
def router(log_json: LogJson = False, *, bus: BusOptions) -> int:
    """Run the router to which all other processes connect.

    Without --listen it listens at tcp/127.0.0.1:7447, with --certs at tls/127.0.0.1:7447.
    """
    from services.processes import router as process

    return process.main(process.Config(bus=bus, log_json=log_json))


@with_bus("plant")
def plant(
    scenario: ScenarioName = "descent",
    expect: Annotated[
        list[str] | None, option("NODE", "Also wait until this node is ready, such as recorder; repeatable.")
    ] = None,
    log_json: LogJson = False,
    *,
    bus: BusOptions,
) -> int:
    """Run the simulated vehicle, which keeps the vehicle time.

    Reads plan; writes world/truth, applied and clock. Starts when sensors, estimator and controller are ready.
    """
    from services.processes import plant as process

    return process.main(process.Config(bus=bus, scenario=scenario, expects=tuple(expect or ()), log_json=log_json))


@with_bus("sensors")
def sensors(scenario: ScenarioName = "descent", log_json: LogJson = False, *, bus: BusOptions) -> int:
    """Run the simulated sensors.

    Reads world/truth; writes sensor/*.
    """
    from services.processes import sensors as process

    return process.main(process.Config(bus=bus, scenario=scenario, log_json=log_json))


@with_bus("estimator")
def estimator(
    vehicle: VehicleFile = "paper",
    sensors: SensorsFile = "paper",
    settings: Annotated[Path | None, option("FILE", "TOML file with keys of [estimator], no header.")] = None,
    log_json: LogJson = False,
    *,
    bus: BusOptions,
) -> int:
    """Run the localisation filter.

    Reads sensor/*; writes estimate.
    """
    from ltv_mpc.localisation.config import EstimatorConfig
    from ltv_mpc.vehicle.parameters import Vehicle
    from services.processes import estimator as process
    from services.run.water import resolve_prior_path

    loaded = Vehicle.load(vehicle)
    if loaded != loaded.at_origin():
        problem = "must be 0 or left out: this estimator publishes the vehicle's origin; the controller's likewise"
        raise invalid(f"vehicle {vehicle}: [reference_point]", problem)
    table = EstimatorConfig()
    if settings is not None:
        table = resolve_prior_path(settings.parent, EstimatorConfig.load(str(settings)))
    return process.main(process.Config(bus=bus, sensors=sensors, settings=table, log_json=log_json))


@with_bus("recorder")
def recorder(
    scenario: Annotated[
        str | None, argument("SCENARIO", "Simulated scenario, whose settings are recorded. None: a real vehicle.")
    ] = None,
    out: Out = None,
    force: Force = False,
    goes_on: Annotated[
        bool, flag("--continue", "Continue the recording in --out with the next segment, run.2.mcap.")
    ] = False,
    log_json: LogJson = False,
    *,
    bus: BusOptions,
) -> int:
    """Record every message into one folder.

    Reads everything; run.mcap opens in Foxglove. Without SCENARIO it follows the vehicle's own clock, and records the
    settings that controller and estimator publish.
    """
    from msgspec.structs import replace

    from services.processes import recorder as process
    from services.recording.writer import VEHICLE_MODE
    from services.run import folder

    if goes_on and (out is None or not _is_scenario_of(out, scenario)):
        problem = "needs --out DIR, the folder of a recording; that of a simulation with its DIR/scenario.toml"
        raise invalid("option --continue", problem)
    config = process.Config(bus=bus, folder=Path(), metadata={"mode": VEHICLE_MODE}, log_json=log_json)
    if scenario is None:
        with folder.reserve("recording", {}, out=out, force=force, resume=goes_on) as made:
            return process.main(replace(config, folder=made.path))
    from services.run.run_config import resolve

    run_config = resolve(scenario)
    metadata = process.metadata(run_config.scenario.run.seed, run_config.files)
    start_ns = run_config.scenario.start_ns
    with folder.reserve(run_config.name, run_config.files, out=out, force=force, resume=goes_on) as made:
        return process.main(replace(config, folder=made.path, start_ns=start_ns, metadata=metadata))


def _is_scenario_of(folder: Path, scenario: str | None) -> bool:
    """Return True if the folder's recording is of this scenario; None: if it is not of a simulation."""
    if scenario is None:
        return not (folder / "scenario.toml").exists()
    return Path(scenario).absolute() == (folder / "scenario.toml").absolute()
