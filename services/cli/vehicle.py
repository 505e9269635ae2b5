"""Command ``controller``; the other commands of the vehicle panel have files of their own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from ltv_mpc.errors import ConfigError
from services.cli.bus import with_bus
from services.cli.localise import localise
from services.cli.options import BathymetryFile, ControllerSettings, FenceFile, LogJson, ReferenceFile, VehicleFile
from services.cli.topics import topics
from services.cli.vehicle_file import vehicle as vehicle_file

if TYPE_CHECKING:
    from services.bus.options import BusOptions


def register(app: typer.Typer, panel: str) -> None:
    """Add the commands to their panel."""
    app.command(rich_help_panel=panel)(controller)
    app.add_typer(vehicle_file, name="vehicle", rich_help_panel=panel)
    app.command(rich_help_panel=panel)(localise)
    app.command(rich_help_panel=panel)(topics)


ComputeDelay: TypeAlias = Annotated[
    float, typer.Option("--compute-delay-s", metavar="D", help="Delay each plan by this much (s).", min=0, max=60)
]
Rate: TypeAlias = Annotated[
    float | None,
    typer.Option("--rate-hz", metavar="R", help="Cycles a second. Default 3.33.", min=0.02, max=50),
]
Horizon: TypeAlias = Annotated[
    float | None,
    typer.Option(
        "--horizon-s",
        metavar="H",
        help="Length of a plan (s). Default: proposed by `vehicle check`.",
        min=0.3,
        max=120,
    ),
]
Metrics: TypeAlias = Annotated[
    int | None,
    typer.Option("--metrics", metavar="PORT", help="Serve /metrics for Prometheus on 127.0.0.1.", min=1, max=65535),
]
InputDelay: TypeAlias = Annotated[
    float,
    typer.Option(
        "--input-delay-s",
        metavar="D",
        help="Smallest delay of an estimate (s), used without clock and without plan reports in applied.",
        min=0,
        max=10,
    ),
]
FailedQps: TypeAlias = Annotated[
    Path | None,
    typer.Option("--failed-qps", metavar="DIR", help="Store QPs that were not solved here, for `ltv-mpc qp show`."),
]
State: TypeAlias = Annotated[
    Path | None,
    typer.Option("--state", metavar="DIR", help="Keep a checkpoint here, and continue from it after a restart."),
]
ResumeArmed: TypeAlias = Annotated[
    bool, typer.Option("--resume-armed", help="Continue armed after a restart. Without it: disarmed.")
]
ResumeWithin: TypeAlias = Annotated[
    float,
    typer.Option("--resume-within-s", metavar="S", help="Largest age of a checkpoint that arms (s).", min=0, max=3600),
]


@with_bus("controller")
def controller(
    vehicle: VehicleFile = "paper",
    reference: ReferenceFile = "descent",
    settings: ControllerSettings = None,
    fence: FenceFile = None,
    bathymetry: BathymetryFile = None,
    compute_delay_s: ComputeDelay = 0.0,
    rate_hz: Rate = None,
    horizon_s: Horizon = None,
    metrics: Metrics = None,
    input_delay_s: InputDelay = 0.0,
    failed_qps: FailedQps = None,
    log_json: LogJson = False,
    state: State = None,
    resume_armed: ResumeArmed = False,
    resume_within_s: ResumeWithin = 60.0,
    *,
    bus: BusOptions,
) -> int:
    """Run the controller alone, with your publishers.

    Reads estimate, applied, command and manual; writes plan, acknowledged and controller/status. It starts disarmed:
    `ltv-mpc ctl arm`. Without a clock topic it takes the time from the stamps of the estimates, whatever their origin.
    """
    from msgspec.structs import replace

    from ltv_mpc import references
    from ltv_mpc.control.config import ControllerConfig
    from ltv_mpc.control.resolution import settled
    from ltv_mpc.geofence.fence import fence_for
    from ltv_mpc.vehicle.parameters import Vehicle

    if resume_armed and state is None:
        raise ConfigError("option --resume-armed", "", "needs --state DIR, the folder of the checkpoint")
    parameters = Vehicle.load(vehicle)
    fence_for(parameters, references.load(reference), fence or "")
    control = ControllerConfig() if settings is None else ControllerConfig.load(str(settings))
    if rate_hz is not None:
        control = replace(control, period_s=1.0 / rate_hz)
    if horizon_s is not None:
        control = replace(control, horizon_s=horizon_s)
    source = "options --rate-hz, --horizon-s" if settings is None else f"controller settings {settings}"
    control = settled(control, parameters, source=source)
    from services.processes import controller as process

    return process.main(
        process.Config(
            bus=bus,
            vehicle=vehicle,
            reference=reference,
            fence=fence or "",
            bathymetry=bathymetry or "",
            settings=control,
            compute_delay_s=compute_delay_s,
            input_delay_s=input_delay_s,
            metrics_port=metrics,
            failed_qps=failed_qps,
            log_json=log_json,
            state=state,
            resume_within_s=resume_within_s if resume_armed else None,
        )
    )
