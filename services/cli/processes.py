"""Commands that start one process each: the processes of ``sim``, in any order, each in its own terminal."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from services.cli.options import BusOptions, Force, Out, argument, flag, invalid, option_of, process_command, with_bus
from services.processes import settings

router, plant, sensors, estimator, controller = map(
    process_command, (settings.Router, settings.Plant, settings.Sensors, settings.Estimator, settings.Controller)
)


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
    log_json: Annotated[bool, option_of(settings.Recorder, "log_json")] = False,
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
    config = settings.Recorder(bus=bus, folder=Path(), metadata={"mode": VEHICLE_MODE}, log_json=log_json)
    if scenario is None:
        with folder.reserve("recording", {}, out=out, force=force, resume=goes_on) as made:
            return process.main(replace(config, folder=made.path))
    from services.run.run_config import resolve

    run_config = resolve(scenario)
    metadata = settings.recording_metadata(run_config.scenario.run.seed, run_config.files)
    start_ns = run_config.scenario.start_ns
    with folder.reserve(run_config.name, run_config.files, out=out, force=force, resume=goes_on) as made:
        return process.main(replace(config, folder=made.path, start_ns=start_ns, metadata=metadata))


def _is_scenario_of(folder: Path, scenario: str | None) -> bool:
    """Return True if the folder's recording is of this scenario; None: if it is not of a simulation."""
    if scenario is None:
        return not (folder / "scenario.toml").exists()
    return Path(scenario).absolute() == (folder / "scenario.toml").absolute()
