"""Measure: ``localisation-check``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from services.cli.options import Force, Json, SensorsFile, short


def localisation_check(
    runs: Annotated[int, typer.Option("--runs", metavar="N", help="Seeds, one run each.", min=2, max=100_000)] = 20,
    sensors: SensorsFile = "paper",
    surface_time_s: Annotated[
        str, short("--surface-time-s", "run.surface_time_s", "S", "Afloat before the descent: one TDCP fix a second.")
    ] = "1",
    seed: Annotated[int, typer.Option("--seed", metavar="FIRST", help="First seed.", min=0, max=2**53 - 1)] = 0,
    scenario: Annotated[
        str, typer.Option("--scenario", metavar="NAME|FILE", help="What is run: a shipped scenario or a TOML file.")
    ] = "descent",
    as_json: Json = False,
    force: Force = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", help="Also write localisation-check.json and .png here; runs that are there stay."
        ),
    ] = None,
) -> int:
    """Drift against the bound of theory, errors against sigma.

    Of the drift after a descent; and whether errors are as large as the filter says.
    Full-loop runs in lock step on all cores. Exit code 1: a figure is not as it should be, which few runs may show of a
    good filter too.
    """
    import tempfile
    import time
    from contextlib import nullcontext

    import msgspec
    from rich.console import Console
    from rich.progress import Progress

    from services.tools.batch.results_store import open_store
    from services.tools.localisation_check import check

    settings = (f"sensors={sensors}", f"run.surface_time_s={surface_time_s}")
    jobs = check.jobs(scenario, settings, first_seed=seed, runs=runs)
    made_of = dict(jobs[0].run_config().files)
    started = time.monotonic()
    temporary = tempfile.TemporaryDirectory(prefix="ltv-mpc-localisation-") if out is None else nullcontext(out)
    with (
        temporary as place,
        open_store(Path(place), made_of, force=force) as store,
        Progress(console=Console(stderr=True)) as progress,
    ):
        task = progress.add_task(f"{runs} runs of {scenario}, sensors {sensors}", total=runs)
        records = check.measure(jobs, store, progress=lambda count: progress.advance(task, count))
    result = check.result(records, jobs, wall_s=time.monotonic() - started)
    plain = msgspec.json.format(msgspec.json.encode(result), indent=2).decode()
    problems = check.failed(result)
    typer.echo(plain if as_json else check.table(result))
    for problem in problems:
        typer.echo(f"not held: {problem}", err=as_json)
    if out is not None:
        (out / "localisation-check.json").write_text(plain + "\n", encoding="utf-8")
        try:
            from services.tools.localisation_check import plot
        except ImportError:
            typer.echo("no picture: matplotlib is not installed (extra viz)", err=True)
        else:
            nees = check.over_runs([record.nees for record in records])
            title = f"{result.runs} runs, sensors {result.sensors}, {result.surface_time_s:g} s afloat"
            plot.draw(nees, title, out / "localisation-check.png")
        typer.echo(str(out), err=as_json)
    return 1 if problems else 0
