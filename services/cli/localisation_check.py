"""Command ``localisation-check``: drift and consistency of the localisation filter over many runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from services.cli.options import Force, Json, SensorsFile, short

if TYPE_CHECKING:
    from collections.abc import Sequence

    from services.tools.localisation_check.check import Result
    from services.tools.localisation_check.probe import Record


def localisation_check(
    runs: Annotated[
        int, typer.Option("--runs", metavar="N", help="Number of runs, one seed each.", min=2, max=100_000)
    ] = 20,
    sensors: SensorsFile = "paper",
    surface_time_s: Annotated[
        str, short("--surface-time-s", "run.surface_time_s", "S", "Time at the surface: one TDCP fix per second.")
    ] = "1",
    seed: Annotated[int, typer.Option("--seed", metavar="FIRST", help="First seed.", min=0, max=2**53 - 1)] = 0,
    scenario: Annotated[
        str, typer.Option("--scenario", metavar="NAME|FILE", help="Scenario: a shipped name or a TOML file.")
    ] = "descent",
    as_json: Json = False,
    force: Force = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", help="Write localisation-check.json and .png here; finished runs in it are reused."
        ),
    ] = None,
) -> int:
    """Check localisation drift and consistency over many runs.

    Compares the drift after a descent with the posterior Cramer-Rao bound, and the errors with the filter's covariance.
    Closed-loop runs in lock step on all cores. Exit code 1: a figure is outside its limits, at a family-wise
    level of 1 %: a good filter fails one check in a hundred.
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
        typer.echo(f"outside its limit: {problem}", err=as_json)
    if out is not None:
        (out / "localisation-check.json").write_text(plain + "\n", encoding="utf-8")
        _write_plot(records, result, out / "localisation-check.png")
        typer.echo(str(out), err=as_json)
    return 1 if problems else 0


def _write_plot(records: Sequence[Record], result: Result, file: Path) -> None:
    from services.tools.localisation_check import check

    try:
        from services.tools.localisation_check import plot
    except ImportError:
        typer.echo("no plot: matplotlib is not installed: pip install matplotlib (extra viz)", err=True)
        return
    nees = check.over_runs([record.nees for record in records])
    title = f"{result.runs} runs, sensors {result.sensors}, {result.surface_time_s:g} s at the surface"
    plot.draw(nees, title, file)
