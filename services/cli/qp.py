"""Measure: ``qp``, the QP itself: ``show`` one that was not solved, ``export-c``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from services.cli.options import Force, Json, VehicleFile

qp = typer.Typer(no_args_is_help=True, context_settings={"help_option_names": ["-h", "--help"]})


@qp.callback()
def _about() -> None:
    """The controller's QP: show FILE | export-c DIR."""


@qp.command()
def show(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="One that a controller saved when it was not solved.")],
    solver: Annotated[
        str, typer.Option("--solver", metavar="NAME", help="Solve it again with this one, from nothing.")
    ] = "piqp",
    as_json: Json = False,
) -> None:
    """A QP that was not solved: what is wrong with it, and what another solver makes of it."""
    from ltv_mpc.control.qp.failed_qp import FailedQp
    from ltv_mpc.control.solvers import solve_qp
    from services.reporting import qp_text

    failed = FailedQp.load(file)
    shown = qp_text.figures(failed, solver, solve_qp(failed.qp, solver))
    if as_json:
        import msgspec

        typer.echo(msgspec.json.encode(shown).decode())
    else:
        typer.echo(qp_text.text(shown))


@qp.command()
def export_c(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Where to; made if it is not there.")],
    vehicle: VehicleFile = "paper",
    settings: Annotated[
        Path | None, typer.Option("--settings", metavar="FILE", help="The [controller] table alone, as TOML.")
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """The QP as C code that OSQP generates, with a sample that solves it: make -C DIR && DIR/emosqp."""
    from ltv_mpc.control.config import ControllerConfig
    from ltv_mpc.vehicle.parameters import Vehicle
    from services.run import folder as folders

    config = ControllerConfig() if settings is None else ControllerConfig.load(str(settings))
    loaded = Vehicle.load(vehicle)
    from services.tools.c_code import export, solved

    problem = solved(loaded, config)
    place = folders.make("qp", {}, out=folder, force=force).path
    made = export(place, *problem, config)
    if as_json:
        import msgspec

        fields = {**made._asdict(), "thrust_N": made.thrust_N.tolist(), "folder": str(place)}
        typer.echo(msgspec.json.encode(fields).decode())
        return
    port, starboard = made.thrust_N
    size = f"{made.stages} stages: {made.variables} variables, {made.rows} rows"
    typer.echo(f"{size}; first free thrusts {port:.2f} and {starboard:.2f} N")
    typer.echo(f"make -C {place} && {place}/emosqp")
    typer.echo(str(place))
