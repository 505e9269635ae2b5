"""Command ``profile``: measure the time of a control cycle."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from services.cli.options import Force, Json, option, show


def profile(
    horizons: Annotated[
        str, option("STAGES,...", "Stages of 0.3 s (17: 5.1 s); default: the vehicle's.")
    ] = "default,17",
    solvers: Annotated[str, option("NAME,...", "Installed solvers. PIQP is always measured too.")] = "osqp,riccati",
    cycles: Annotated[int, option("N", "Number of cycles per horizon.", min=10, max=100000)] = 600,
    run: Annotated[
        str | None, option("RUN", "Use the problems of a recorded run: its folder, its run.mcap, or latest.")
    ] = None,
    seed: Annotated[int, option("N", "Seed of the closed loops and of the order.", min=0, max=2**53 - 1)] = 0,
    as_json: Json = False,
    force: Force = False,
    out: Annotated[Path | None, option("DIR", "Also write profile.json into this folder.")] = None,
) -> int:
    """Measure the time of a control cycle by solver and horizon.

    The cycles come from closed loops in lock step with the true state: half of them from the paper's descent, a quarter
    with a current of 4 cm/s that the controller does not know, a quarter that start 2 m off with a heading error of up
    to 3 rad. Every solver solves each cycle, in random order. The ratios compare it with PIQP by its own interface.
    """
    from services.reporting.terminal import progress_bar

    with progress_bar("loading and compiling") as told:  # before the imports, which take seconds
        from services.run import folder
        from services.tools.profile import problems, table
        from services.tools.profile import run as latency

        stages = latency.parse_horizons(horizons)
        recorded = None if run is None else [problems.recorded(run, N, cycles) for N in stages]
        by_horizon = recorded or [problems.simulated(N, cycles, seed) for N in stages]
        named = latency.parse_solvers(solvers, by_horizon[0][0])
        written = None if out is None else folder.open_folder(out, force=force)
        text = f"cycles at {', '.join(str(episodes[0].config.stages) for episodes in by_horizon)} stages"
        measured = latency.run(by_horizon, named, seed=seed, progress=lambda share: told(share, text))
    plain = show(measured, lambda: table.text(measured), as_json=as_json)
    if written is not None:
        (written / "profile.json").write_text(plain + "\n", encoding="utf-8")
        typer.echo(str(written), err=as_json)
    return 0
