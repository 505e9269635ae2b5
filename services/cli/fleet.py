"""Command ``fleet``: number of vehicles that one machine can control."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from services.cli.options import Force, Json, Out, VehicleFile

if TYPE_CHECKING:
    from services.tools.fleet.fleet import Fleet
    from services.tools.fleet.trial import Row

MAX_VEHICLES = 1000


def fleet(
    vehicles: Annotated[
        str, typer.Option("--vehicles", metavar="N,...", help="Numbers of vehicles; one trial for each.")
    ] = "1,10,100",
    rate_hz: Annotated[
        float, typer.Option("--rate-hz", metavar="R", help="Cycles per second of each vehicle.", min=0.1, max=50)
    ] = 10.0,
    seconds: Annotated[
        float, typer.Option("--seconds", metavar="S", help="Measured time of each trial.", min=1, max=3600)
    ] = 20.0,
    warm_up_s: Annotated[
        float, typer.Option("--warm-up-s", metavar="S", help="Time before it that is not measured.", min=0, max=600)
    ] = 5.0,
    processes: Annotated[
        int, typer.Option("--processes", metavar="P", help="Number of controller processes.", min=1, max=64)
    ] = 1,
    horizon_s: Annotated[
        float | None,
        typer.Option("--horizon-s", metavar="H", help="Horizon (s). Default: of `vehicle check`.", min=0.3, max=120),
    ] = None,
    vehicle: VehicleFile = "paper",
    as_json: Json = False,
    force: Force = False,
    out: Out = None,
) -> int:
    """Measure how many vehicles this machine can control.

    Runs the controllers, and one light process for all plants, over a router on loopback; estimators are not included.
    """
    counts = _counts(vehicles)
    from ltv_mpc.vehicle.parameters import Vehicle

    Vehicle.load(vehicle)
    import msgspec

    from services.run import folder as folders
    from services.runtime.stopping import DONE, FAILED
    from services.tools.fleet import text, trial
    from services.tools.fleet.fleet import Fleet
    from services.tools.profile import machine_description

    place = None if out is None else folders.make("fleet", {}, out=out, force=force).path
    load = machine_description.load()
    common = Fleet(
        vehicles=1,
        vehicle=vehicle,
        rate_hz=rate_hz,
        seconds=seconds,
        warm_up_s=warm_up_s,
        horizon_s=horizon_s,
        router="",
    )
    try:
        rows = [_trial(common, count, processes) for count in counts]
    except trial.TrialFailed as error:
        typer.echo(f"fleet: {error}", err=True)
        return FAILED
    result = {"rows": msgspec.to_builtins(rows), "machine": machine_description.machine(load)}
    if place is not None:
        (place / "fleet.json").write_bytes(msgspec.json.format(msgspec.json.encode(result)))
    typer.echo(msgspec.json.encode(result).decode() if as_json else text.text(rows))
    if place is not None and not as_json:
        typer.echo(str(place))
    return DONE


def _trial(common: Fleet, vehicles: int, processes: int) -> Row:
    """Run one trial with this number of vehicles, over a new router."""
    from msgspec.structs import replace

    from services.reporting.terminal import progress_bar
    from services.runtime.console import counted
    from services.supervisor.loopback import free_port
    from services.tools.fleet import trial

    count = counted(vehicles, "vehicle")
    typer.echo(f"{count}: {common.warm_up_s:g} s to warm up, {common.seconds:g} s measured", err=True)
    fleet_of = replace(common, vehicles=vehicles, router=f"tcp/127.0.0.1:{free_port()}")
    with progress_bar(count) as progress:
        return trial.run(fleet_of, processes, on_progress=progress)


def _counts(text: str) -> list[int]:
    from ltv_mpc.errors import ConfigError

    counts = []
    for part in text.split(","):
        number = int(part) if part.strip().isascii() and part.strip().isdigit() and len(part) <= 9 else 0
        if not 1 <= number <= MAX_VEHICLES:
            problem = f"must be whole numbers from 1 to {MAX_VEHICLES}, separated by commas"
            raise ConfigError("option --vehicles", "", problem, value=text)
        counts.append(number)
    return counts
