"""Command ``dive plan``: expected drift of a dive before it is made."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from services.cli.options import Force, Json, SensorsFile, group, invalid, option, show

dive = group("dive", "Plan a dive: expected drift and its error budget.")

MAX_FIXES = 3600
MAX_LISTED = 8
"""Largest number of fixes, and of different numbers of fixes in one plan."""


Depth: TypeAlias = Annotated[
    float | None,
    typer.Option("--depth-m", metavar="D", help="Depth at the end of a vertical descent (m). Default: 40.", min=1),
]


@dive.command(name="plan")
def plan_(
    sensors: SensorsFile = "paper",
    duration_s: Annotated[
        float | None,
        option(
            "T",
            "Length of the dive (s). Default: 200 s; for a path until it is complete, at most 3600 s.",
            min=10,
            max=36000,
        ),
    ] = None,
    depth_m: Depth = None,
    reference: Annotated[str | None, option("NAME|FILE", "Reference to follow instead of a vertical descent.")] = None,
    fixes: Annotated[str, option("N,...", "Satellite fixes before the dive. The first is the plan.")] = "1,10,30,120",
    limit_m: Annotated[float | None, option("L", "Drift of one axis (m) whose time is wanted.", min=0.001)] = None,
    against: Annotated[
        str | None, option("RUN", "Compare with a recorded run: its folder, run.mcap, or latest.")
    ] = None,
    runs: Annotated[int, option("N", "Number of simulated dives per number of fixes.", min=1, max=100)] = 4,
    as_json: Json = False,
    force: Force = False,
    out: Annotated[Path | None, option("DIR", "Also write dive-plan.json and .html into this folder.")] = None,
) -> int:
    """Plan a dive: expected drift over time, its error budget, and what would reduce it.

    Simulates the dive a few times and computes the posterior Cramer-Rao bound along each track, the smallest drift that
    these sensors allow.
    """
    import msgspec
    from rich.console import Console
    from rich.progress import Progress

    from services.recording.reader import Recording
    from services.run import folder
    from services.tools.dive_plan import plan, report

    if reference is not None and depth_m is not None:
        raise invalid("option --depth-m", "has no effect with --reference, which has a depth of its own")
    numbers = _numbers(fixes)
    wanted = plan.Dive(sensors, reference, duration_s, 40.0 if depth_m is None else depth_m, max(numbers), 0)
    wanted.run_config()
    recorded = None if against is None else report.recorded_drift(Recording(folder.find(against)))
    written = None if out is None else folder.open_folder(out, force=force)
    with Progress(console=Console(stderr=True)) as progress:
        task = progress.add_task(f"dives with {sensors} sensors", total=plan.count_of_results(numbers, runs))
        result = plan.plan(
            wanted, fixes=numbers, runs=runs, limit_m=limit_m, progress=lambda count: progress.advance(task, count)
        )
    result = msgspec.structs.replace(result, against=recorded)
    plain = show(result, lambda: report.text(result), as_json=as_json)
    if written is not None:
        (written / "dive-plan.json").write_text(plain + "\n", encoding="utf-8")
        from services.reporting.static_files import NoPlotly

        try:
            report.write(result, written / "dive-plan.html")
        except NoPlotly as error:
            typer.echo(f"no plots: {error}: pip install plotly (extra viz)", err=True)
        typer.echo(str(written), err=as_json)
    return 0


def _numbers(text: str) -> list[int]:
    """Return the numbers of fixes. Raises ``ConfigError``."""
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() and 1 <= int(part) <= MAX_FIXES for part in parts) or len(parts) > MAX_LISTED:
        problem = f"must be at most {MAX_LISTED} whole numbers from 1 to {MAX_FIXES}, as in 1,10,30"
        raise invalid("option --fixes", problem, value=text)
    return [int(part) for part in parts]
