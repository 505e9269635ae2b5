"""Settings of the processes: a struct each, which is also the options of its command and what a supervisor passes on.

A field with a ``setting`` is an option of the command line; the struct's docstring is the help of the command. Nothing
here is slow to import, so that help stays fast.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

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


class Ros2(ProcessSettings, frozen=True, kw_only=True):
    """Connect to ROS 2: odometry and goals in, thrusts out.

    Reads plan, controller/status and topics; writes estimate, command, applied and topics. It replaces the estimator.
    """

    middleware: Annotated[
        Literal["ros2dds", "rmw_zenoh"],
        setting("ros2dds|rmw_zenoh", "zenoh-bridge-ros2dds, or ROS 2 nodes with rmw_zenoh."),
    ] = "ros2dds"
    domain_id: Annotated[int, setting("D", "ROS_DOMAIN_ID, for rmw_zenoh.", ge=0, le=232)] = 0
    topic: Annotated[tuple[str, ...], setting("NAME=/TOPIC", "Other topic for a row of docs/ros2.md; repeatable.")] = ()
    array: Annotated[str, setting("ORDER", "One Float64MultiArray, such as port,starboard.")] = ""
    scale: Annotated[float, setting("S", "Factor of that array, per N.")] = 1.0
    vehicle: Annotated[str, setting("NAME|FILE", "Vehicle, for its arms and its reference point.")] = "paper"
    speed_mps: Annotated[float, setting("V", "Speed on a route (m/s).", ge=0.01, le=20.0)] = 0.5
    ros_namespace: Annotated[str, setting("NAME", "Namespace of the bridge, the prefix of its keys.")] = ""
    rate_hz: Annotated[float, setting("R", "Rate of the thrusts (Hz).", ge=1.0, le=200.0)] = 20.0


class Mavlink(ProcessSettings, frozen=True, kw_only=True):
    """Connect to ArduPilot: position in, thrusts out.

    Reads plan and controller/status; writes estimate, command and applied. It replaces the estimator.
    """

    autopilot: Annotated[str, setting("udpin|udpout:HOST:PORT", "Where the autopilot sends, or listens.")] = (
        "udpin:127.0.0.1:14550"
    )
    gcs_sysid: Annotated[int, setting("N", "MAV_GCS_SYSID of the autopilot.", ge=1, le=255)] = 255
    vehicle: Annotated[str, setting("NAME|FILE", "Vehicle, with pwm_us and pwm_N of each thruster.")] = (
        "bluerobotics-boat"
    )
    signing_key: Annotated[Path | None, setting("FILE", "32 bytes: signed frames alone, both ways.")] = None
    sd: Annotated[str, setting("P,V,H,R", "Standard deviations that it does not send: m, m/s, rad, rad/s of yaw.")] = (
        "1,0.1,0.05,0.01"
    )
    no_mission: Annotated[bool, setting("", "Ignore the mission and the fence of the autopilot.")] = False


class Recorder(ProcessSettings, frozen=True, kw_only=True):
    """Settings of the recorder. Its command makes the folder."""

    folder: Path  # of the run
    start_ns: int | None = None  # vehicle time of log time 0; None beside a vehicle, whose times are stored as they are
    metadata: dict[str, str]  # kept in the recording


def recording_metadata(seed: int, files: Mapping[str, str]) -> dict[str, str]:
    """Return the metadata of a recording of a simulation as processes: seed, and the settings files by their path."""
    return {"mode": "services", "seed": str(seed), **files}
