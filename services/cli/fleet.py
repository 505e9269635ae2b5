"""Measure: ``fleet``."""

from __future__ import annotations

from typing import Annotated

import typer

from services.cli.options import Force, Json, Out, VehicleFile

MAX_VEHICLES = 1000


def fleet(
    vehicles: Annotated[
        str, typer.Option("--vehicles", metavar="N,...", help="How many at once; a trial for each number.")
    ] = "1,10,100",
    rate_hz: Annotated[
        float, typer.Option("--rate-hz", metavar="R", help="Cycles a second of each.", min=0.1, max=50)
    ] = 10.0,
    seconds: Annotated[
        float, typer.Option("--seconds", metavar="S", help="Measured in each trial.", min=1, max=3600)
    ] = 20.0,
    warm_up_s: Annotated[
        float, typer.Option("--warm-up-s", metavar="S", help="Before it, not measured.", min=0, max=600)
    ] = 5.0,
    processes: Annotated[
        int,
        typer.Option("--processes", metavar="P", help="Of controllers; vehicles are shared out.", min=1, max=64),
    ] = 1,
    horizon_s: Annotated[
        float, typer.Option("--horizon-s", metavar="H", help="How far each controller looks ahead.", min=0.3, max=120)
    ] = 5.0,
    vehicle: VehicleFile = "paper",
    as_json: Json = False,
    force: Force = False,
    out: Out = None,
) -> int:
    """N vehicles on this machine: cost, first limit.

    Runs the controllers, and one light process for all plants, over a router on loopback; estimators are not included.
    """
    counts = _counts(vehicles)
    from ltv_mpc.vehicle.parameters import Vehicle

    Vehicle.load(vehicle)
    import msgspec

    from services.reporting.terminal import progress_bar
    from services.run import folder as folders
    from services.runtime.stopping import DONE, FAILED
    from services.supervisor.loopback import free_port
    from services.tools.fleet import trial
    from services.tools.fleet.place import Fleet
    from services.tools.profile import machine

    place = None if out is None else folders.make("fleet", {}, out=out, force=force).path
    load = machine.load()
    rows = []
    for count in counts:
        typer.echo(f"{count} vehicles: {warm_up_s:g} s to warm up, {seconds:g} s measured", err=True)
        try:
            with progress_bar(f"{count} vehicles") as told:
                made = trial.run(
                    Fleet(
                        vehicles=count,
                        vehicle=vehicle,
                        rate_hz=rate_hz,
                        seconds=seconds,
                        warm_up_s=warm_up_s,
                        horizon_s=horizon_s,
                        router=f"tcp/127.0.0.1:{free_port()}",
                    ),
                    processes,
                    told=told,
                )
        except trial.TrialFailed as error:
            typer.echo(f"fleet: {error}", err=True)
            return FAILED
        rows.append(made)
    result = {"rows": msgspec.to_builtins(rows), "machine": machine.machine(load)}
    if place is not None:
        (place / "fleet.json").write_bytes(msgspec.json.format(msgspec.json.encode(result)))
    if as_json:
        typer.echo(msgspec.json.encode(result).decode())
    else:
        from services.tools.fleet.text import text

        typer.echo(text(rows))
        if place is not None:
            typer.echo(str(place))
    return DONE


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
