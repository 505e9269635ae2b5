"""Measure: ``faults``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from services.cli.options import Force, Json

QUICK = 30
FULL = 1000


def faults(
    n: Annotated[
        int | None, typer.Option("--n", metavar="N", help=f"Faults. Default {FULL}, quick {QUICK}.", min=1, max=100_000)
    ] = None,
    classes: Annotated[
        str, typer.Option("--classes", metavar="NAME,...", help="Of these classes alone; an unknown name lists them.")
    ] = "",
    seed: Annotated[
        int, typer.Option("--seed", metavar="N", help="Of times, sizes and scenarios.", min=0, max=2**31)
    ] = 0,
    quick: Annotated[
        bool, typer.Option("--quick", help="Safety and reactions alone: not what the error is a minute later.")
    ] = False,
    where: Annotated[str, typer.Option("--where", metavar="PLACE", help="lockstep, processes, or both.")] = "both",
    as_json: Json = False,
    force: Force = False,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="DIR", help="Also write faults.json and the runs' folders here.")
    ] = None,
) -> int:
    """Inject faults from outside, by the thousand, and count what got through.

    Most of them in lock step, a fifth in real processes on a bus; each with a seeded time and size. Exit code 1: a
    promise was not kept, and which is said.
    """
    import os
    import time

    import msgspec
    from rich.console import Console
    from rich.progress import Progress

    from services.faults import campaign, result
    from services.run import folder
    from services.views import faults_text

    asked = campaign.plan(classes, where, n or (QUICK if quick else FULL))
    written = None if out is None else folder.make("faults", {}, out=out, force=force)
    started = time.monotonic()
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task(f"{asked.total} faults", total=asked.total)
        seen = campaign.run(
            asked,
            seed=seed,
            quick=quick,
            keep=None if written is None else written.path,
            progress=lambda count: progress.advance(task, count),
        )
    load = os.getloadavg()[0] / (os.cpu_count() or 1)
    of = result.campaign(seen, seed=seed, quick=quick, wall_s=time.monotonic() - started, load=load)
    plain = msgspec.json.format(msgspec.json.encode(of), indent=2).decode()
    typer.echo(plain if as_json else faults_text.table(of))
    if written is not None:
        (written.path / "faults.json").write_text(plain + "\n", encoding="utf-8")
        typer.echo(str(written.path), err=as_json)
    return 0 if result.kept(of) else 1
