"""The sensors file: what is mounted, how often it measures and how well, read by simulation and estimator alike.

All standard deviations are 1 sigma. A bias is constant or drifts as first-order Gauss-Markov with its time constant;
its standard deviation is that of the ensemble: the simulation draws it per seed, the filter starts from it.
"""

from __future__ import annotations

from typing import Annotated, TypeAlias

import msgspec
from msgspec import Meta

from ltv_mpc import config
from ltv_mpc.signals import Triple

Period: TypeAlias = Annotated[int, Meta(ge=1_000_000, le=3_600_000_000_000)]
Sd: TypeAlias = Annotated[float, Meta(ge=0, le=1e3)]
PositiveSd: TypeAlias = Annotated[float, Meta(gt=0, le=1e3)]
Seconds: TypeAlias = Annotated[float, Meta(gt=0, le=1e9)]
Share: TypeAlias = Annotated[float, Meta(ge=0, le=0.5)]


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


class Tdcp(_Table, frozen=True, kw_only=True):
    """Change of position from carrier phase, at the surface, between epochs one period apart."""

    period_ns: Period
    displacement_sd_m: PositiveSd


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
    lever_arm_m: Triple  # from the vehicle's origin, FRD


class Pressure(_Table, frozen=True, kw_only=True):
    """Pressure gauge."""

    period_ns: Period
    depth_sd_m: PositiveSd


class Compass(_Table, frozen=True, kw_only=True):
    """Magnetic compass."""

    period_ns: Period
    heading_sd_rad: PositiveSd
    bias_sd_rad: Sd
    bias_tau_s: Seconds


class Suite(_Table, frozen=True, kw_only=True):
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

    @classmethod
    def load(cls, name: str) -> Suite:
        """A shipped suite by name (``"paper"``, ``"realistic"``), or a TOML file by path. Raises ``ConfigError``."""
        return config.load(name, cls, what="sensors", package="ltv_mpc.localisation.files")
