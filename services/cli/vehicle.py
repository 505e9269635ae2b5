"""Command ``controller``: run the controller alone."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from services.cli.bus import with_bus
from services.cli.options import (
    BathymetryFile,
    ControllerSettings,
    FenceFile,
    LogJson,
    ReferenceFile,
    VehicleFile,
    flag,
    invalid,
    option,
)  # fmt: skip

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ltv_mpc.control.config import ResolvedConfig
    from ltv_mpc.vehicle.parameters import Vehicle
    from services.bus.options import BusOptions


InputDelay: TypeAlias = Annotated[
    float,
    option("D", "Smallest delay of an estimate (s), used without clock and plan reports in applied.", min=0, max=10),
]


@with_bus("controller")
def controller(
    vehicle: VehicleFile = "paper",
    reference: ReferenceFile = "descent",
    settings: ControllerSettings = None,
    fence: FenceFile = None,
    bathymetry: BathymetryFile = None,
    compute_delay_s: Annotated[float, option("D", "Delay each plan by this much (s).", min=0, max=60)] = 0.0,
    rate_hz: Annotated[float | None, option("R", "Cycles a second. Default 3.33.", min=0.02, max=50)] = None,
    horizon_s: Annotated[
        float | None, option("H", "Length of a plan (s). Default: proposed by `vehicle check`.", min=0.3, max=120)
    ] = None,
    metrics: Annotated[
        int | None, option("PORT", "Serve /metrics for Prometheus on 127.0.0.1.", min=1, max=65535)
    ] = None,
    input_delay_s: InputDelay = 0.0,
    failed_qps: Annotated[
        Path | None, option("DIR", "Store QPs that were not solved here, for `ltv-mpc qp show`.")
    ] = None,
    log_json: LogJson = False,
    state: Annotated[
        Path | None, option("DIR", "Keep a checkpoint here, and continue from it after a restart.")
    ] = None,
    resume_armed: Annotated[
        bool, flag("--resume-armed", "Continue armed after a restart. Without it: disarmed.")
    ] = False,
    resume_within_s: Annotated[
        float, option("S", "Largest age of a checkpoint that arms (s).", min=0, max=3600)
    ] = 60.0,
    *,
    bus: BusOptions,
) -> int:
    """Run the controller alone, with your publishers.

    Reads estimate, applied, command and manual; writes plan, acknowledged and controller/status. It starts disarmed:
    `ltv-mpc ctl arm`. Without a clock topic it takes the time from the stamps of the estimates, whatever their origin.
    """
    from ltv_mpc import references
    from ltv_mpc.geofence.fence import fence_for
    from ltv_mpc.vehicle.parameters import Vehicle

    if resume_armed and state is None:
        raise invalid("option --resume-armed", "needs --state DIR, the folder of the checkpoint")
    parameters = Vehicle.load(vehicle)
    fence_for(parameters, references.load(reference), fence or "")
    control = _control(parameters, settings, {"period_s": rate_hz and 1.0 / rate_hz, "horizon_s": horizon_s})
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


def _control(vehicle: Vehicle, settings: Path | None, given: Mapping[str, float | None]) -> ResolvedConfig:
    """Return the controller's settings, in which a given value replaces that of the file. Raises ``ConfigError``."""
    from msgspec.structs import replace

    from ltv_mpc.control.config import ControllerConfig
    from ltv_mpc.control.resolution import settled

    control = ControllerConfig() if settings is None else ControllerConfig.load(str(settings))
    control = replace(control, **{name: value for name, value in given.items() if value is not None})
    source = "options --rate-hz, --horizon-s" if settings is None else f"controller settings {settings}"
    return settled(control, vehicle, source=source)
