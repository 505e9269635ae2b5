"""Command ``campaign``: run a design of many runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from services.cli.options import Force, Json, argument, invalid, needs, option, show

if TYPE_CHECKING:
    from collections.abc import Sequence

    from services.tools.campaign.ranking import Standing
    from services.tools.campaign.trial import Row


def campaign(
    file: Annotated[Path, argument("FILE.toml", "Design of the campaign: docs/campaigns.md.")],
    cluster: Annotated[str | None, option("tcp://HOST:PORT", "Run on the workers of this Dask scheduler.")] = None,
    workers: Annotated[
        int | None, option("N", "Number of processes. Default: one for each core.", min=1, max=1024)
    ] = None,
    as_json: Json = False,
    force: Force = False,
    out: Annotated[Path | None, option("DIR", "Folder of the campaign; an interrupted one in it is continued.")] = None,
) -> int:
    """Run a design of many runs on all cores or on Dask.

    All runs are in lock step. A campaign that was interrupted continues with the same command and --out.
    DIR/results.parquet has a row for each run; it does not depend on the machines that computed it.
    """
    import msgspec

    if cluster is not None and workers is not None:
        raise invalid("option --workers", "cannot act together with --cluster, which has its own workers")
    with needs("pyarrow", "campaign", "campaign"):
        from services.tools.campaign import table
    from services.run import folder
    from services.runtime.console import counted
    from services.runtime.stopping import DONE, FAILED, INTERRUPTED, stop_on_signals
    from services.tools.campaign import file as files
    from services.tools.campaign import text
    from services.tools.campaign.campaign import open_campaign, plan, run
    from services.tools.campaign.progress import Progress
    from services.tools.campaign.ranking import ranked, scores

    design = files.load(file)
    planned = plan(design, f"campaign {file}")
    place = out or folder.make_default(file.stem)
    with open_campaign(place, planned, force=force) as store, stop_on_signals() as request:
        there = [row for _, row in store.results()]
        with Progress(design, there, planned.runs, quiet=as_json) as progress:
            run(planned, store, workers=workers, cluster=cluster, on_row=progress.add, stop=request)
        rows: Sequence[Row] = progress.rows
        table.write(place, design, rows, {"made_by": msgspec.json.encode(planned.made_by).decode()})
    _write_page(place)
    best = ranked(scores(rows, design.minimise, design.varied), text.SHOWN)
    _print_result(place, rows, best, runs=planned.runs, minimise=design.minimise, as_json=as_json)
    if len(rows) < planned.runs:
        left = f"{planned.runs - len(rows)} of {counted(planned.runs, 'run')} left"
        typer.echo(f"{left}: continue with the same command and --out {place}", err=True)
        return INTERRUPTED if request.interrupted else FAILED
    return FAILED if all(row["failed"] is not None for row in rows) else DONE


def _write_page(folder: Path) -> None:
    from services.reporting.static_files import NoPlotly
    from services.tools.campaign import page

    try:
        page.write(folder)
    except NoPlotly as missing:
        typer.echo(f"no {page.NAME}: {missing}: pip install plotly (extra viz)", err=True)


def _print_result(
    place: Path, rows: Sequence[Row], best: list[Standing], *, runs: int, minimise: str, as_json: bool
) -> None:
    from rich.console import Console

    from services.tools.campaign import text

    failed = [row for row in rows if row["failed"] is not None]
    counts = {"runs": runs, "done": len(rows), "failed": len(failed)}
    console = Console()
    with console.capture() as table:
        console.print(text.standings(best, minimise))
    lines = [table.get().rstrip("\n"), *text.failures(failed), str(place)]
    show({"out": str(place), **counts, "minimise": minimise, "best": best}, lambda: "\n".join(lines), as_json=as_json)
