"""Measure: ``profile``; ``localisation-check`` has a file of its own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from services.cli.localisation_check import localisation_check
from services.cli.options import Force, Json


def register(app: typer.Typer, panel: str) -> None:
    """Add the commands to their panel."""
    app.command(rich_help_panel=panel)(profile)
    app.command(rich_help_panel=panel)(localisation_check)


def profile(
    horizons: Annotated[
        str, typer.Option("--horizons", metavar="S,S,...", help="Horizons in seconds. Key controller.horizon_s.")
    ] = "2.5,5,10,20",
    cycles: Annotated[int, typer.Option("--cycles", metavar="N", help="Cycles a horizon.", min=10, max=100_000)] = 600,
    seed: Annotated[str, typer.Option("--seed", metavar="N", help="Of the run. Key run.seed.")] = "0",
    as_json: Json = False,
    force: Force = False,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Also write profile.json into this folder.")
    ] = None,
) -> int:
    """How long a controller cycle and its stages take, by horizon.

    Measured on the problems of the paper's descent in lock step, with the true state given to the controller.
    """
    import msgspec

    from services.measure import profile as latency
    from services.run import folder

    situations = latency.situations(latency.parse_horizons(horizons), cycles=cycles, seed=seed)
    written = None if out is None else folder.make("profile", {}, out=out, force=force)
    rows = latency.measure_all(situations, cycles=cycles, progress=lambda text: typer.echo(text, err=True))
    plain = json.dumps(msgspec.to_builtins(rows), indent=2)
    if written is not None:
        (written.path / "profile.json").write_text(plain + "\n", encoding="utf-8")
    typer.echo(plain if as_json else latency.table(rows))
    if written is not None:
        typer.echo(str(written.path), err=as_json)
    return 0
