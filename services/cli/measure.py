"""Panel "Measure": ``profile``, ``campaign``, and ``qp show`` and ``export-c``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from services.cli.options import (
    ControllerSettings,
    Force,
    Json,
    VehicleFile,
    argument,
    group,
    invalid,
    needs,
    option,
    plots_or_a_line,
    show,
)

if TYPE_CHECKING:
    from services.tools.campaign.ranking import Standing

SHOWN = 10
"""Number of the best points of a campaign that are printed."""


def profile(
    horizons: Annotated[
        str, option("STAGES,...", "Stages of 0.3 s (17: 5.1 s); default: the vehicle's.")
    ] = "default,17",
    solvers: Annotated[str, option("NAME,...", "Installed solvers. Riccati is always measured too.")] = "osqp,riccati",
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
    to 3 rad. Every solver solves each cycle, in random order. The ratios compare it with the Riccati solver.
    """
    from services.reporting.terminal import progress_bar

    with progress_bar("loading and compiling") as show_progress:  # before the imports, which take seconds
        from services.run import folder
        from services.tools.profile import problems, table
        from services.tools.profile import run as latency

        stages = latency.parse_horizons(horizons)
        recorded = None if run is None else [problems.recorded(run, N, cycles) for N in stages]
        by_horizon = recorded or [problems.simulated(N, cycles, seed) for N in stages]
        named = latency.parse_solvers(solvers, by_horizon[0][0])
        file = None if out is None else folder.open_folder(out, force=force) / "profile.json"
        text = f"cycles at {', '.join(str(episodes[0].config.stages) for episodes in by_horizon)} stages"
        measured = latency.run(by_horizon, named, seed=seed, progress=lambda share: show_progress(share, text))
    show(measured, lambda: table.text(measured), as_json=as_json, file=file)
    return 0


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
    from services.tools.campaign import page
    from services.tools.campaign.campaign import open_campaign, plan, run
    from services.tools.campaign.ranking import failures, ranked, scores

    design = files.load(file)
    planned = plan(design, f"campaign {file}")
    place = out or folder.make_default(file.stem)
    with open_campaign(place, planned, force=force) as store, stop_on_signals() as request:
        rows = [row for _, row in store.results()]
        with progress_bar(design.title, line_s=10.0) as show_progress:
            for row in run(planned, store, workers=workers, cluster=cluster, stop=request):
                rows.append(row)
                show_progress(len(rows) / planned.runs)
        table.write(place, design, rows, {"made_by": msgspec.json.encode(planned.made_by).decode()})
    with plots_or_a_line(f"no {page.NAME}"):
        page.write(place)
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


def _text(best: list[Standing], minimise: str) -> str:
    """Tabulate the best points."""
    from services.runtime.console import columns
    from services.tools.campaign.ranking import HEAD, cells

    head = [*(key.rpartition(".")[2] for key in best[0].settings), *HEAD] if best else []
    table = columns([head, *map(cells, best)], numbers=True)
    return "\n".join([f"{minimise}, mean over seeds with 95 % interval", *table])


qp = group("qp", "Show a QP that was not solved, or export the QP as C.")


@qp.command("show")
def show_(
    file: Annotated[Path, argument("FILE", "A QP that the controller saved because it was not solved.")],
    solver: Annotated[str, option("NAME", "Solver that solves it again, without a warm start.")] = "piqp",
    as_json: Json = False,
) -> None:
    """Show a QP that was not solved: its errors, and the result of another solver."""
    from ltv_mpc.control.failed_qp import NamedQp
    from ltv_mpc.control.solvers import solve_qp
    from services.reporting import qp_text

    failed = NamedQp.load(file)
    shown = qp_text.figures(failed, solver, solve_qp(failed.qp, solver))
    show(shown, lambda: qp_text.text(shown), as_json=as_json)


@qp.command()
def export_c(
    folder: Annotated[Path, argument("DIR", "Folder for the code; it is created if missing.")],
    vehicle: VehicleFile = "paper",
    settings: ControllerSettings = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Export the QP of one cycle as C code generated by OSQP, with a sample that solves it.

    Build and run the sample: make -C DIR && DIR/emosqp
    """
    from ltv_mpc.vehicle.parameters import Vehicle
    from services.processes.settings import resolved
    from services.run import folder as folders

    loaded = Vehicle.load(vehicle)
    config = resolved(loaded, settings)
    from services.tools.c_code import export, solved_cycle

    cycle = solved_cycle(loaded, config)
    place = folders.make("qp", {}, out=folder, force=force).path
    exported = export(place, cycle, loaded, config)
    size = f"{exported.stages} stages: {exported.variables} variables, {exported.rows} rows"
    text = f"{size}\nmake -C {place} && {place}/emosqp\n{place}"
    show({**exported._asdict(), "folder": str(place)}, lambda: text, as_json=as_json)
