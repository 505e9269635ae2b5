"""Panel "Your vehicle", dives: ``dive plan`` before one, ``localise`` after one."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Annotated

from services.cli.options import Force, Json, SensorsFile, argument, group, invalid, option, plots_or_a_line, show

dive = group("dive", "Plan a dive: expected drift and its error budget.")

MAX_FIXES = 3600
MAX_LISTED = 8
"""Largest number of fixes, and of different numbers of fixes in one plan."""


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
    depth_m: Annotated[
        float | None, option("D", "Depth at the end of a vertical descent (m). Default: 40.", min=1, max=1000)
    ] = None,
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

    from services.recording.reader import Recording
    from services.recording.recover import segments
    from services.reporting.terminal import progress_bar
    from services.run import folder
    from services.tools.dive_plan import plan, report

    if reference is not None and depth_m is not None:
        raise invalid("option --depth-m", "has no effect with --reference, which has a depth of its own")
    numbers = _numbers(fixes)
    wanted = plan.Dive(sensors, reference, duration_s, 40.0 if depth_m is None else depth_m, max(numbers), 0)
    wanted.run_config()
    recorded = None if against is None else report.recorded_drift(Recording(*segments(folder.find(against))))
    file = None if out is None else folder.open_folder(out, force=force) / "dive-plan.json"
    with progress_bar(f"dives with {sensors} sensors") as progress:
        result = plan.plan(wanted, fixes=numbers, runs=runs, limit_m=limit_m, progress=progress)
    result = msgspec.structs.replace(result, against=recorded)
    if file is not None:
        with plots_or_a_line("no plots"):
            report.write(result, file.with_suffix(".html"))
    show(result, lambda: report.text(result), as_json=as_json, file=file)
    return 0


def _numbers(text: str) -> list[int]:
    """Return the numbers of fixes. Raises ``ConfigError``."""
    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() and 1 <= int(part) <= MAX_FIXES for part in parts) or len(parts) > MAX_LISTED:
        problem = f"must be at most {MAX_LISTED} whole numbers from 1 to {MAX_FIXES}, as in 1,10,30"
        raise invalid("option --fixes", problem, value=text)
    return [int(part) for part in parts]


def localise(
    file: Annotated[Path, argument("FILE.PD0", "PD0 file of a Teledyne RDI instrument.")],
    surface_fixes: Annotated[
        int, option("N", "Number of first ensembles whose bottom track is used.", min=0, max=100000)
    ] = 10,
    start_depth_m: Annotated[
        float | None, option("D", "Start at the first ensemble at or below this depth.", min=0, max=12000)
    ] = None,
    head: Annotated[str | None, option("up|down", "Head to use, of two. Default: that with more ensembles.")] = None,
    as_json: Json = False,
    force: Force = False,
    out: Annotated[Path | None, option("DIR", "Also write track, current profile, result and plot here.")] = None,
) -> int:
    """Localise a recorded ADCP dive that has no inertial unit.

    Bottom track replaces the fix at the surface during the first ensembles; later it is the reference with which the
    track is compared.
    """
    from ltv_mpc.errors import ConfigError
    from services.reporting.terminal import progress_bar
    from services.run import folder
    from services.tools.localise import dive_localisation as dive
    from services.tools.localise import text

    written = None if out is None else folder.open_folder(out, force=force)
    try:
        with progress_bar(file.name) as progress:
            outcome = dive.localise(file, surface_fixes, start_depth_m, head, progress=progress)
    except ConfigError:
        if written is not None:
            with contextlib.suppress(OSError):  # it is not empty
                written.rmdir()
        raise
    if written is not None:
        with plots_or_a_line("no plots"):
            dive.write(outcome, written)
    result = written and written / "localise.json"
    show(outcome.result, lambda: text.text(outcome.result), as_json=as_json, file=result)
    return 0
