"""Command ``campaign``: run a design of many runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from services.cli.options import Force, Json, argument, invalid, needs, option, show

if TYPE_CHECKING:
    from services.tools.campaign.ranking import Standing


SHOWN = 10


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
    if cluster is not None:
        with needs("distributed", "campaign", "campaign --cluster"):
            import distributed  # noqa: F401
    from services.reporting.terminal import progress_bar
    from services.run import folder
    from services.runtime.console import counted
    from services.runtime.stopping import DONE, FAILED, INTERRUPTED, stop_on_signals
    from services.tools.campaign import file as files
    from services.tools.campaign.campaign import open_campaign, plan, run
    from services.tools.campaign.ranking import failures, ranked, scores

    design = files.load(file)
    planned = plan(design, f"campaign {file}")
    place = out or folder.make_default(file.stem)
    with open_campaign(place, planned, force=force) as store, stop_on_signals() as request:
        rows = [row for _, row in store.results()]
        with progress_bar(design.title) as told:
            for row in run(planned, store, workers=workers, cluster=cluster, stop=request):
                rows.append(row)
                told(len(rows) / planned.runs)
        table.write(place, design, rows, {"made_by": msgspec.json.encode(planned.made_by).decode()})
    _write_page(place)
    failed = sum(row["failed"] is not None for row in rows)
    best = ranked(scores(rows, design.minimise, design.varied), SHOWN)
    counts = {"runs": planned.runs, "done": len(rows), "failed": failed}
    show(
        {"out": str(place), **counts, "minimise": design.minimise, "best": best},
        lambda: "\n".join([_text(best, design.minimise), *failures(rows), str(place)]),
        as_json=as_json,
    )
    if len(rows) < planned.runs:
        left = f"{planned.runs - len(rows)} of {counted(planned.runs, 'run')} left"
        typer.echo(f"{left}: continue with the same command and --out {place}", err=True)
        return INTERRUPTED if request.interrupted else FAILED
    return FAILED if failed == len(rows) else DONE


def _write_page(folder: Path) -> None:
    from services.reporting.static_files import NoPlotly
    from services.tools.campaign import page

    try:
        page.write(folder)
    except NoPlotly as missing:
        typer.echo(f"no {page.NAME}: {missing}: pip install plotly (extra viz)", err=True)


def _text(best: list[Standing], minimise: str) -> str:
    """Tabulate the best points."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from services.tools.campaign.ranking import HEAD, cells

    table = Table(title=f"{minimise}, mean over seeds with 95 % interval", title_justify="left", box=None)
    for name in (*(key.rpartition(".")[2] for key in best[0].settings), *HEAD) if best else ():
        table.add_column(name, justify="right")
    for one in best:
        table.add_row(*map(Text, cells(one)))
    console = Console()
    with console.capture() as text:
        console.print(table)
    return text.get().rstrip("\n")
