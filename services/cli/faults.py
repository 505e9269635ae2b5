"""Command ``faults``: run a fault injection campaign."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from services.cli.options import CampaignFolder, Force, Json

QUICK = 31
FULL = 1000


def faults(
    n: Annotated[
        int | None,
        typer.Option("--n", metavar="N", help=f"Number of faults. Default {FULL}, quick {QUICK}.", min=1, max=100_000),
    ] = None,
    classes: Annotated[
        str, typer.Option("--classes", metavar="NAME,...", help="Only these fault classes; an unknown name lists them.")
    ] = "",
    seed: Annotated[
        int, typer.Option("--seed", metavar="N", help="Seed of times, sizes and scenarios.", min=0, max=2**31)
    ] = 0,
    quick: Annotated[
        bool, typer.Option("--quick", help="Check safety and reactions only, not the errors one minute later.")
    ] = False,
    where: Annotated[
        str, typer.Option("--where", metavar="PLACE", help="Where to inject: lockstep, processes, or both.")
    ] = "both",
    as_json: Json = False,
    force: Force = False,
    out: CampaignFolder = None,
) -> int:
    """Inject faults by the thousand and check the reactions.

    Most faults are injected in lock step, one in five in real processes on a bus. Times and sizes are drawn from the
    seed. Results are stored in DIR when a run ends, so a campaign can be interrupted and continued. Exit code 1: a
    requirement failed, which is printed, or a fault could not be injected.
    """
    import os
    import tempfile
    import time
    from contextlib import nullcontext

    import msgspec
    from rich.console import Console
    from rich.progress import Progress

    from services.runtime.console import counted
    from services.tools.batch.results_store import open_store
    from services.tools.faults import campaign, judge, result, text

    asked = campaign.plan(classes, where, n or (QUICK if quick else FULL), quick=quick)
    started = time.monotonic()
    temporary = tempfile.TemporaryDirectory(prefix="ltv-mpc-faults-") if out is None else nullcontext(out)
    with (
        temporary as place,
        open_store(Path(place), asked.settings(seed=seed, quick=quick), force=force) as store,
        Progress(console=Console(stderr=True)) as progress,
    ):
        task = progress.add_task(counted(asked.total, "fault"), total=asked.total)
        seen = campaign.run(asked, store, seed=seed, quick=quick, progress=lambda count: progress.advance(task, count))
        window_chance = judge.chance(list(campaign.without_faults(store).values()))
    load = os.getloadavg()[0] / (os.cpu_count() or 1)
    wall_s = time.monotonic() - started
    of = result.campaign(seen, seed=seed, quick=quick, wall_s=wall_s, load=load, window_chance=window_chance)
    plain = msgspec.json.format(msgspec.json.encode(of), indent=2).decode()
    typer.echo(plain if as_json else text.table(of))
    if out is not None:
        (out / "faults.json").write_text(plain + "\n", encoding="utf-8")
        typer.echo(str(out), err=as_json)
    if of.injected < asked.total:
        missing = f"{asked.total - of.injected} of {counted(asked.total, 'fault')} not injected"
        typer.echo(f"{missing}: the run ended first", err=True)
    return 0 if result.kept(of) and of.injected == asked.total else 1
