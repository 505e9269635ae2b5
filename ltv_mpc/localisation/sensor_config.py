"""The sensors file: what is mounted, how often it measures and how well, read by simulation and estimator alike.

All standard deviations are 1 sigma. A bias is constant or drifts as first-order Gauss-Markov with its time constant;
its standard deviation is that of the ensemble: the simulation draws it per seed, the filter starts from it.
``latency_ns``: from a measurement's validity time to its arrival. ``lever_arm_m``: from the vehicle's origin, FRD.
"""

from __future__ import annotations

from typing import Annotated, Any, TypeAlias

import msgspec
from msgspec import Meta

from ltv_mpc import config
from ltv_mpc.errors import ConfigError

Period: TypeAlias = Annotated[int, Meta(ge=1_000_000, le=3_600_000_000_000)]
Sd: TypeAlias = Annotated[float, Meta(ge=0, le=1e3)]
PositiveSd: TypeAlias = Annotated[float, Meta(gt=0, le=1e3)]
Seconds: TypeAlias = Annotated[float, Meta(gt=0, le=1e9)]
Share: TypeAlias = Annotated[float, Meta(ge=0, le=0.5)]
Latency: TypeAlias = Annotated[int, Meta(ge=0, le=1_000_000_000)]
Coordinate: TypeAlias = Annotated[float, Meta(ge=-1e5, le=1e5)]
Place: TypeAlias = tuple[Coordinate, Coordinate, Annotated[float, Meta(ge=-10, le=12_000)]]
Offset: TypeAlias = Annotated[float, Meta(ge=-50, le=50)]
Lever: TypeAlias = tuple[Offset, Offset, Offset]
Angle: TypeAlias = Annotated[float, Meta(ge=-6.2832, le=6.2832)]
Angles: TypeAlias = tuple[Angle, Angle, Angle]


class _Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    pass


class Imu(_Table, frozen=True, kw_only=True):
    """Strapdown inertial unit."""

    period_ns: Period
    gyro_bias_sd_radps: Sd
    gyro_bias_tau_s: Seconds
    angle_random_walk_rad_per_rts: PositiveSd
    accelerometer_bias_sd_mps2: Sd
    accelerometer_bias_tau_s: Seconds
    velocity_random_walk_mps_per_rts: PositiveSd
    senses_earth_rate: bool


class Gnss(_Table, frozen=True, kw_only=True):
    """Satellite position and velocity, at the surface."""

    period_ns: Period
    position_sd_m: PositiveSd
    velocity_sd_mps: PositiveSd
    latency_ns: Latency = 0
    lever_arm_m: Lever = (0.0, 0.0, 0.0)


class Tdcp(_Table, frozen=True, kw_only=True):
    """Change of position from carrier phase, at the surface, between epochs one period apart."""

    period_ns: Period
    displacement_sd_m: PositiveSd
    latency_ns: Latency = 0


class Adcp(_Table, frozen=True, kw_only=True):
    """Four-beam Janus current profiler that looks down; beams ahead, astern, to starboard, to port of its own axes."""

    period_ns: Period
    beam_angle_rad: Annotated[float, Meta(gt=0, lt=1.2)]
    cell_m: Annotated[float, Meta(gt=0, le=100)]
    blanking_m: Annotated[float, Meta(ge=0, le=100)]
    range_m: Annotated[float, Meta(gt=0, le=2000)]
    beam_noise_sd_mps: PositiveSd
    beam_bias_sd_mps: Sd  # each beam, constant
    near_bias_sd_mps: Sd  # each beam, times exp(-range / near_bias_length_m)
    near_bias_length_m: Annotated[float, Meta(gt=0, le=100)]
    missing_share: Share
    outlier_share: Share
    outlier_mps: Sd
    mounting_sd_rad: Sd  # true misalignment, each axis
    mounting_known_to_rad: Sd  # what the calibration leaves unknown of it, each axis
    lever_arm_m: Lever
    mounting_rad: Angles = (0.0, 0.0, 0.0)  # roll, pitch, yaw of its axes in the body's, as meant
    latency_ns: Latency = 0


class BottomTracking(_Table, frozen=True, kw_only=True):
    """The profiler's pings at the sea bed: its beams, mounting and lever arm, noise of their own."""

    period_ns: Period
    range_m: Annotated[float, Meta(gt=0, le=2000)]  # of the bottom, along the vertical
    beam_noise_sd_mps: PositiveSd
    missing_share: Share
    outlier_share: Share
    outlier_mps: Sd
    latency_ns: Latency = 0


class Pressure(_Table, frozen=True, kw_only=True):
    """Pressure gauge."""

    period_ns: Period
    depth_sd_m: PositiveSd
    latency_ns: Latency = 0
    lever_arm_m: Lever = (0.0, 0.0, 0.0)


class Compass(_Table, frozen=True, kw_only=True):
    """Magnetic compass."""

    period_ns: Period
    heading_sd_rad: PositiveSd
    bias_sd_rad: Sd
    bias_tau_s: Seconds
    latency_ns: Latency = 0


class Lbl(_Table, frozen=True, kw_only=True):
    """Long baseline: two-way ranges to transponders on the sea bed, all of them interrogated at once."""

    period_ns: Period
    transponders_m: Annotated[tuple[Place, ...], Meta(min_length=1, max_length=16)]  # north, east, depth
    sound_speed_mps: Annotated[float, Meta(ge=1300, le=1700)]  # that ranges are reckoned with
    sound_speed_sd_mps: Annotated[float, Meta(ge=0, le=50)]  # by which the truth differs, constant
    range_sd_m: PositiveSd
    missing_share: Share
    outlier_share: Share
    outlier_m: Sd  # a path by way of surface or bottom is longer by up to this
    lever_arm_m: Lever = (0.0, 0.0, 0.0)


class Usbl(_Table, frozen=True, kw_only=True):
    """Ultra-short baseline: a ship measures where the vehicle is, and tells it."""

    period_ns: Period
    latency_ns: Latency
    ship_m: tuple[Coordinate, Coordinate]  # north, east
    position_sd_m: PositiveSd
    bearing_sd_rad: Sd  # times the slant range: what is added to the standard deviation, in quadrature
    missing_share: Share
    outlier_share: Share
    outlier_m: Sd
    lever_arm_m: Lever = (0.0, 0.0, 0.0)


class SensorConfig(_Table, frozen=True, kw_only=True):
    """All sensors of a vehicle."""

    name: str
    description: str
    latitude_rad: Annotated[float, Meta(ge=-1.5708, le=1.5708)]
    imu: Imu
    gnss: Gnss
    tdcp: Tdcp
    adcp: Adcp
    pressure: Pressure
    compass: Compass
    bottom_track: BottomTracking | None = None
    lbl: Lbl | None = None
    usbl: Usbl | None = None

    @classmethod
    def load(cls, name: str) -> SensorConfig:
        """A shipped suite by name (``"paper"``, ``"realistic"``), or a TOML file by path. Raises ``ConfigError``.

        A file may name a shipped suite as its ``base``: its own keys then stand on top of that one's, table by table.
        """
        path = config.find(name, what="sensors", package=_PACKAGE)
        table = config.read_toml(path, what="sensors")
        source = config.source_of(path, what="sensors", name=name)
        if "base" in table:
            table = _upon(table, source)
        return config.parse(table, cls, source=source)


_PACKAGE = "ltv_mpc.localisation.files"


def _upon(own: dict[str, Any], source: str) -> dict[str, Any]:
    """The file's keys on top of its base's."""
    base = own.pop("base")
    if not isinstance(base, str) or config.is_path(base):
        raise ConfigError(source, "base", "must be the name of a shipped suite", value=base)
    try:
        below = config.find(base, what="base", package=_PACKAGE)
    except ConfigError as error:
        raise ConfigError(source, "base", error.problem, value=base) from None
    merged = config.read_toml(below, what="sensors")
    for key, value in own.items():
        table = merged.get(key)
        merged[key] = {**table, **value} if isinstance(table, dict) and isinstance(value, dict) else value
    return merged
