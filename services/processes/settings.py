"""Settings of the processes: a struct each, which is also the options of its command and what a supervisor passes on.

A field with a ``setting`` is an option of the command line; the struct's docstring is the help of the command. Nothing
here is slow to import, so that help stays fast.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import msgspec

from ltv_mpc.errors import ConfigError
from services.bus.options import BusOptions, setting

if TYPE_CHECKING:
    from ltv_mpc.control.config import ResolvedConfig
    from ltv_mpc.localisation.config import EstimatorConfig
    from ltv_mpc.vehicle.parameters import Vehicle

VehicleName: TypeAlias = Annotated[str, setting("NAME|FILE", "Vehicle: a shipped name or a TOML file.")]
ScenarioName: TypeAlias = Annotated[
    str,
    setting(
        "SCENARIO",
        "Shipped name (demo, descent, hover, paper-5s, paper-2.5s, paper-no-control) or a TOML file.",
        argument=True,
    ),
]


class ProcessSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Settings of every process."""

    bus: BusOptions
    log_json: Annotated[bool, setting("", "Print each line on stderr as a JSON object, for a log collector.")] = False


class Router(ProcessSettings, frozen=True, kw_only=True):
    """Run the router to which all other processes connect.

    Without --listen it listens at tcp/127.0.0.1:7447, with --certs at tls/127.0.0.1:7447.
    """


class Plant(ProcessSettings, frozen=True, kw_only=True):
    """Run the simulated vehicle, which keeps the vehicle time.

    Reads plan; writes world/truth, applied and clock. Starts when sensors, estimator and controller are ready.
    """

    scenario: ScenarioName = "descent"
    expect: Annotated[
        tuple[str, ...], setting("NODE", "Also wait until this node is ready, such as recorder; repeatable.")
    ] = ()


class Sensors(ProcessSettings, frozen=True, kw_only=True):
    """Run the simulated sensors.

    Reads world/truth; writes sensor/*.
    """

    scenario: ScenarioName = "descent"


class Estimator(ProcessSettings, frozen=True, kw_only=True):
    """Run the localisation filter.

    Reads sensor/*; writes estimate.
    """

    vehicle: VehicleName = "paper"
    sensors: Annotated[str, setting("NAME|FILE", "Sensors: a shipped name or a TOML file.")] = "paper"
    settings: Annotated[Path | None, setting("FILE", "TOML file with keys of [estimator], no header.")] = None

    def loaded(self) -> EstimatorConfig:
        """Return the table of the file, whose water prior is found beside it. Raises ``ConfigError``."""
        from ltv_mpc.localisation.config import EstimatorConfig
        from services.run.water import resolve_prior_path

        if self.settings is None:
            return EstimatorConfig()
        return resolve_prior_path(self.settings.parent, EstimatorConfig.load(str(self.settings)))


class Controller(ProcessSettings, frozen=True, kw_only=True):
    """Run the controller alone, with your publishers.

    Reads estimate, applied, command and manual; writes plan, acknowledged and controller/status. It starts disarmed:
    `ltv-mpc ctl arm`. Without a clock topic it takes the time from the stamps of the estimates, whatever their origin.
    """

    vehicle: VehicleName = "paper"
    reference: Annotated[str, setting("NAME|FILE", "Path or point to follow, docs/references.md.")] = "descent"
    settings: Annotated[Path | None, setting("FILE", "TOML file with keys of [controller], without that header.")] = (
        None
    )
    fence: Annotated[str | None, setting("FILE", "Keep-in and keep-out zones, docs/fences.md.")] = None
    bathymetry: Annotated[str | None, setting("FILE", "Soundings of the bottom: CSV, docs/motion-limits.md.")] = None
    compute_delay_s: Annotated[float, setting("D", "Delay each plan by this much (s).", ge=0, le=60)] = 0.0
    rate_hz: Annotated[float, setting("R", "Cycles a second. Default 3.33.", ge=0.02, le=50)] | None = None
    horizon_s: (
        Annotated[float, setting("H", "Length of a plan (s). Default: proposed by `vehicle check`.", ge=0.3, le=120)]
        | None
    ) = None
    metrics: Annotated[int, setting("PORT", "Serve /metrics for Prometheus on 127.0.0.1.", ge=1, le=65535)] | None = (
        None
    )
    input_delay_s: Annotated[
        float, setting("D", "Least delay of an estimate (s), without clock and plan reports in applied.", ge=0, le=10)
    ] = 0.0
    failed_qps: Annotated[Path | None, setting("DIR", "Store unsolved QPs here, for `ltv-mpc qp show`.")] = None
    state: Annotated[Path | None, setting("DIR", "Keep a checkpoint here, and continue from it after a start.")] = None
    resume_armed: Annotated[bool, setting("", "Continue armed; without it: disarmed.")] = False
    resume_within_s: Annotated[float, setting("S", "Largest age of a checkpoint that arms (s).", ge=0, le=3600)] = 60.0

    def resolved(self) -> ResolvedConfig:
        """Return the settings of the file, rate and horizon, for the vehicle. Raises ``ConfigError``."""
        from ltv_mpc.vehicle.parameters import Vehicle

        period_s = self.rate_hz and 1.0 / self.rate_hz
        return resolved(Vehicle.load(self.vehicle), self.settings, period_s=period_s, horizon_s=self.horizon_s)

    @property
    def arms_within_s(self) -> float | None:
        """Largest age of a checkpoint that arms the vehicle; None: none does. Raises ``ConfigError``."""
        if self.resume_armed and self.state is None:
            raise ConfigError("option --resume-armed", "", "needs --state DIR, the folder of the checkpoint")
        return self.resume_within_s if self.resume_armed else None


def resolved(vehicle: Vehicle, settings: Path | None, **given: float | None) -> ResolvedConfig:
    """Return the controller's settings, in which a given value replaces that of the file. Raises ``ConfigError``."""
    from ltv_mpc.control.config import ControllerConfig
    from ltv_mpc.control.resolution import settled

    control = ControllerConfig() if settings is None else ControllerConfig.load(str(settings))
    control = msgspec.structs.replace(control, **{name: value for name, value in given.items() if value is not None})
    source = "options --rate-hz, --horizon-s" if settings is None else f"controller settings {settings}"
    return settled(control, vehicle, source=source)


class Recorder(ProcessSettings, frozen=True, kw_only=True):
    """Settings of the recorder. Its command makes the folder."""

    folder: Path  # of the run
    start_ns: int | None = None  # vehicle time of log time 0; None beside a vehicle, whose times are stored as they are
    metadata: dict[str, str]  # kept in the recording


def recording_metadata(seed: int, files: Mapping[str, str]) -> dict[str, str]:
    """Return the metadata of a recording of a simulation as processes: seed, and the settings files by their path."""
    return {"mode": "services", "seed": str(seed), **files}
