"""Panel "Your vehicle": ``vehicle new``, ``check`` and ``identify``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from services.cli.options import ControllerSettings, FenceFile, Json, argument, flag, group, invalid, option, show

if TYPE_CHECKING:
    from ltv_mpc.bathymetry import Bathymetry
    from ltv_mpc.references import Origin


vehicle = group("vehicle", "Create, check or identify a vehicle file.")

Overwrite = Annotated[bool, flag("--force", "Replace a file that is there.")]


@vehicle.command()
def new(
    file: Annotated[Path, argument("FILE", "File to write.")] = Path("vehicle.toml"), force: Overwrite = False
) -> None:
    """Write a commented vehicle file to fill in. It loads as it is."""
    from importlib import resources

    text = (resources.files("ltv_mpc.vehicle") / "template.toml").read_text(encoding="utf-8")
    _write(file, text, force=force)
    typer.echo(f"ltv-mpc vehicle check {file}")


@vehicle.command()
def check(
    file: Annotated[str, argument("NAME|FILE", "A shipped name or a TOML file.")],
    reference: Annotated[
        str | None, option("NAME|FILE", "Check this mission too; exit code 1 if it cannot be.")
    ] = None,
    fence: FenceFile = None,
    start: Annotated[
        str | None, option("NORTH,EAST", "Position of the vehicle (m). Default: the path's start.")
    ] = None,
    current: Annotated[
        str | None, option("V|FILE", "Speed of the water, from any side (m/s), or the strongest of a CSV.")
    ] = None,
    bottom: Annotated[str | None, option("D|FILE", "Depth of the bottom (m), or a CSV of soundings.")] = None,
    settings: ControllerSettings = None,
    as_json: Json = False,
) -> None:
    """Print performance, horizon, weights and their margins, and warnings about implausible values; these exit with 0.

    With a reference, also what of the mission cannot be: start or point in a zone, no way round a zone, corridor or
    margin too narrow in the current, descent into the bottom.
    """
    from msgspec.structs import replace

    from ltv_mpc.vehicle.parameters import Vehicle

    needing = {"--fence": fence, "--start": start, "--current": current, "--bottom": bottom, "--settings": settings}
    for name, value in needing.items():
        if reference is None and value:
            raise invalid(f"option {name}", "needs --reference NAME|FILE, the mission to check")
    loaded, place = Vehicle.load(file), None if start is None else _place(start)
    from services.tools import mission_check, vehicle_check

    result = vehicle_check.check(loaded)
    if reference is not None:
        from ltv_mpc import references
        from ltv_mpc.control.config import ControllerConfig
        from ltv_mpc.geofence.fence import fence_for

        notes: list[str] = []
        current_mps = 0.0 if current is None else _current(current, notes)
        followed = references.load(reference, notes)
        zones = fence_for(loaded, followed, fence or "", notes)
        picture = mission_check.picture(loaded, followed, zones, place)
        mission = mission_check.check_mission(
            loaded,
            followed,
            zones,
            start=place,
            current_mps=current_mps,
            bottom=None if bottom is None else _bottom(bottom, followed.origin),
            limits=None if settings is None else ControllerConfig.load(str(settings)).limits,
        )
        result = replace(result, mission=replace(mission, notes=[*notes, *mission.notes]))
    text = vehicle_check.table(loaded, result)
    if result.mission is not None:
        text += f"\n{mission_check.table(result.mission)}\n{picture}"
    show(result, lambda: text, as_json=as_json)
    if result.mission is not None and result.mission.problems:
        raise typer.Exit(1)


@vehicle.command()
def identify(
    run: Annotated[str, argument("RUN", "latest, a run's folder, its run.mcap, or .bin, .tlog.")],
    name: Annotated[
        str | None, option("NAME|FILE", "Vehicle to start from. Default: that of the run.", "--vehicle")
    ] = None,
    known: Annotated[
        Literal["thrust", "mass"], flag("--known", "Mass and thrust are not separable: take this one from the file.")
    ] = "thrust",
    known_yaw: Annotated[
        Literal["arm", "inertia"], flag("--known-yaw", "Inertia and arms are not separable: this is the file's.")
    ] = "arm",
    out: Annotated[Path | None, option("FILE", "Write the identified vehicle.")] = None,
    force: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Identify masses, damping, thrust, arms and lags from a run or a log of ArduPilot, with 95 % intervals."""
    from services.tools import vehicle_identify

    source = vehicle_identify.open_run(run)
    loaded = vehicle_identify.load_vehicle(source, name)
    if out is not None:
        _free(out, force=force)
    from services.reporting.terminal import reading_progress

    with reading_progress(source):
        report = vehicle_identify.identify_run(source, loaded, known, known_yaw)
    show(report, lambda: vehicle_identify.format_text(report), as_json=as_json)
    if out is not None:
        identified = vehicle_identify.identified_vehicle(source, loaded, report)
        _write(out, vehicle_identify.format_toml(report, identified), force=force, quiet=as_json)


def _current(text: str, notes: list[str]) -> float:
    """Return the speed of the water (m/s) of the option --current."""
    from ltv_mpc.currents import read_profile

    try:
        speed_mps = float(text)
    except ValueError:
        profile = read_profile(text, notes)
        depth_m, speed_mps = profile.depth_m, max(map(math.hypot, profile.north_mps, profile.east_mps))
        notes.append(f"currents {text}: {depth_m[0]:g} to {depth_m[-1]:g} m, the strongest {speed_mps:.2g} m/s")
    if not 0.0 <= speed_mps <= 5.0:
        raise invalid("option --current", "must be >= 0 and <= 5 m/s, or a file of currents", value=text)
    return speed_mps


def _bottom(text: str, origin: Origin | None) -> float | Bathymetry:
    """Return the depth (m) or the soundings of the option --bottom."""
    from ltv_mpc.bathymetry import Bathymetry

    try:
        depth_m = float(text)
    except ValueError:
        return Bathymetry.load(text, origin)
    if not 0.0 <= depth_m <= 11_000.0:
        raise invalid("option --bottom", "must be >= 0 and <= 11000 m, or a file of soundings", value=text)
    return depth_m


def _place(text: str) -> tuple[float, float]:
    """Return north and east (m) of the option --start."""
    try:
        north, east = (float(part) for part in text.split(","))
    except ValueError:
        north = east = math.nan
    if not (abs(north) <= 1e6 and abs(east) <= 1e6):
        raise invalid("option --start", "must be NORTH,EAST in metres, for example 3.5,-2", value=text)
    return north, east


def _free(file: Path, *, force: bool) -> None:
    if file.exists() and not force:
        raise invalid("vehicle file", "exists already: name another, or add --force", value=str(file))


def _write(file: Path, text: str, *, force: bool, quiet: bool = False) -> None:
    """Write the file and print its name as the last line."""
    _free(file, force=force)
    try:
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        problem = f"cannot be written ({error.strerror})"
        raise invalid("vehicle file", problem, value=str(file)) from None
    typer.echo(str(file), err=quiet)
