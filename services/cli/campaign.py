"""Measure: ``campaign``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from services.cli.options import Force, Json

if TYPE_CHECKING:
    from collections.abc import Sequence

    from services.tools.campaign.ranking import Standing
    from services.tools.campaign.trial import Row


def campaign(
    file: Annotated[Path, typer.Argument(metavar="FILE.toml", help="What varies over what; docs/campaigns.md.")],
    cluster: Annotated[
        str | None,
        typer.Option("--cluster", metavar="tcp://HOST:PORT", help="A Dask scheduler, whose workers do it."),
    ] = None,
    workers: Annotated[
        int | None, typer.Option("--workers", metavar="N", help="Processes here. Default: one a core.", min=1, max=1024)
    ] = None,
    as_json: Json = False,
    force: Force = False,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Its folder; one of the same campaign is gone on with."),
    ] = None,
) -> int:
    """A design of many runs in lock step, on all cores or Dask.

    Interrupted and started again it goes on.
    DIR/results.parquet has a row a run, and is the same to the byte whoever computed it.
    """
    import importlib.util

    import msgspec
    from rich.console import Console

    from ltv_mpc.errors import ConfigError
    from services.run import folder
    from services.runtime.stopping import DONE, FAILED, INTERRUPTED, stop_on_signals

    if importlib.util.find_spec("pyarrow") is None:
        raise ConfigError("campaign", "", "needs pyarrow: install the extra campaign")
    if cluster is not None and workers is not None:
        raise ConfigError("option --workers", "", "cannot act together with --cluster, which has its own workers")
    from services.reporting.static_files import NoPlotly
    from services.tools.campaign import file as files
    from services.tools.campaign import page, table, text
    from services.tools.campaign.campaign import opened, plan, run
    from services.tools.campaign.progress import Progress
    from services.tools.campaign.ranking import ranked, scores

    wanted = files.load(file)
    made = plan(wanted, f"campaign {file}")
    place = out or folder.make_default(file.stem)
    with opened(place, made, force=force) as store, stop_on_signals() as request:
        there = [row for _, row in store.results()]
        with Progress(wanted, there, made.runs, quiet=as_json) as progress:
            run(made, store, workers=workers, cluster=cluster, hear=progress.hear, stop=request)
        rows: Sequence[Row] = progress.rows
        table.write(place, wanted, rows, {"made_by": msgspec.json.encode(made.made_by).decode()})
    try:
        page.write(place)
    except NoPlotly as missing:
        typer.echo(f"no {page.NAME}: {missing}, the extra viz brings it", err=True)
    best: list[Standing] = ranked(scores(rows, wanted.minimise, wanted.varied), text.SHOWN)
    failed = [row for row in rows if row["failed"] is not None]
    if as_json:
        result = {
            "out": str(place),
            "runs": made.runs,
            "done": len(rows),
            "failed": len(failed),
            "minimise": wanted.minimise,
            "best": best,
        }
        typer.echo(msgspec.json.format(msgspec.json.encode(result), indent=2).decode())
    else:
        Console().print(text.standings(best, wanted.minimise))
        for line in text.failures(failed):
            typer.echo(line)
        typer.echo(str(place))
    if len(rows) < made.runs:
        typer.echo(
            f"{made.runs - len(rows)} of {made.runs} runs left: the same command with --out {place} goes on", err=True
        )
        return INTERRUPTED if request.interrupted else FAILED
    return FAILED if len(failed) == len(rows) else DONE
