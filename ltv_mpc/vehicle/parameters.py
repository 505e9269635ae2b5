"""The numbers of a vehicle, as its TOML file holds them, and as the compiled code reads them."""

from __future__ import annotations

from typing import Annotated, NamedTuple, TypeAlias

import msgspec
from msgspec import Meta

from ltv_mpc import config

PositiveMass: TypeAlias = Annotated[float, Meta(gt=0, le=1e7)]
NotNegative: TypeAlias = Annotated[float, Meta(ge=0, le=1e7)]


class Translation(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Surge, sway or heave: total mass (added mass included) and damping, X = -(linear + quadratic |v|) v."""

    mass_kg: PositiveMass
    linear_damping_kgps: NotNegative
    quadratic_damping_kgpm: NotNegative


class Rotation(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Yaw: total inertia (added inertia included) and damping, N = -(linear + quadratic |r|) r."""

    inertia_kgm2: PositiveMass
    linear_damping_Nms: NotNegative
    quadratic_damping_kgm2: NotNegative


class Thruster(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One thruster. ``arm_m`` is its distance from the centre line, 0 for the vertical one."""

    arm_m: Annotated[float, Meta(ge=0, le=100)]
    min_N: Annotated[float, Meta(ge=-1e6, le=0)]
    max_N: Annotated[float, Meta(gt=0, le=1e6)]
    slew_N_per_s: Annotated[float, Meta(gt=0, le=1e6)]
    lag_s: Annotated[float, Meta(ge=0, le=60)]
    propeller_diameter_m: Annotated[float, Meta(gt=0, le=10)]
    max_rps: Annotated[float, Meta(gt=0, le=1000)]


class Thrusters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Port and starboard push ahead at ``arm_m`` left and right of the centre line; vertical, if any, pushes down."""

    port: Thruster
    starboard: Thruster
    vertical: Thruster | None = None


NO_THRUSTER = Thruster(
    arm_m=0.0, min_N=0.0, max_N=0.0, slew_N_per_s=1.0, lag_s=0.0, propeller_diameter_m=1.0, max_rps=1.0
)
"""The place of the vertical thruster in every thrust array, of a vehicle that has none: its box is zero."""


class Coefficients(NamedTuple):
    """The vehicle as compiled code reads it: plain floats, SI."""

    mass_surge: float
    mass_sway: float
    mass_heave: float
    inertia_yaw: float
    linear_surge: float
    linear_sway: float
    linear_heave: float
    linear_yaw: float
    quadratic_surge: float
    quadratic_sway: float
    quadratic_heave: float
    quadratic_yaw: float
    dry_mass: float
    net_buoyancy: float  # N, positive up
    arm_port: float
    arm_starboard: float
    lag_port: float
    lag_starboard: float
    lag_vertical: float


class Vehicle(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """An underactuated vehicle with two stern thrusters, and a vertical one if it dives.

    A surface craft leaves [thruster.vertical] and [heave] out, and floats: its vertical thrust is zero always.
    """

    name: str
    description: str
    dry_mass_kg: PositiveMass
    net_buoyancy_N: Annotated[float, Meta(ge=-1e6, le=1e6)] = 0.0  # buoyancy minus weight, positive: it rises
    water_density_kgpm3: Annotated[float, Meta(ge=900, le=1100)]
    failsafe_vertical_N: Annotated[float, Meta(ge=-1e6, le=1e6)] = 0.0
    surge: Translation
    sway: Translation
    heave: Translation | None = None
    yaw: Rotation
    thruster: Thrusters

    def __post_init__(self) -> None:
        """Refuse what contradicts itself."""
        if (self.thruster.vertical is None) != (self.heave is None):
            there, missing = ("[heave]", "[thruster.vertical]")[:: 1 if self.heave else -1]
            raise ValueError(
                f"{missing} is missing beside {there}: a vehicle that dives has both, a surface craft none"
            )
        if self.heave is None and self.net_buoyancy_N != 0.0:
            raise ValueError(
                f"net_buoyancy_N = {self.net_buoyancy_N}: must be 0 or left out without [heave]: a surface craft floats"
            )
        vertical = self.thrusters[2]
        if not vertical.min_N <= self.failsafe_vertical_N <= vertical.max_N:
            raise ValueError(
                f"failsafe_vertical_N = {self.failsafe_vertical_N}: must be within the vertical thruster's "
                f"min_N = {vertical.min_N} and max_N = {vertical.max_N}"
            )
        if self.thruster.port.arm_m + self.thruster.starboard.arm_m <= 0.0:
            raise ValueError("[thruster.port] and [thruster.starboard] arm_m: both are 0, so nothing turns the vehicle")

    @classmethod
    def load(cls, name: str) -> Vehicle:
        """A shipped vehicle by name (``"paper"``), or a TOML file by path. Raises ``ConfigError``."""
        return config.load(name, cls, what="vehicle", package="ltv_mpc.vehicle.files")

    @property
    def thrusters(self) -> tuple[Thruster, Thruster, Thruster]:
        """Port, starboard, vertical: the order of every thrust array; ``NO_THRUSTER`` for a vertical not there."""
        return self.thruster.port, self.thruster.starboard, self.thruster.vertical or NO_THRUSTER

    @property
    def dives(self) -> bool:
        """Whether it has a vertical thruster; else it is a surface craft."""
        return self.heave is not None

    def coefficients(self) -> Coefficients:
        """For compiled code. A surface craft neither sinks nor rises: no thrust, no net buoyancy, its own mass."""
        heave = self.heave or Translation(mass_kg=self.dry_mass_kg, linear_damping_kgps=0.0, quadratic_damping_kgpm=0.0)
        return Coefficients(
            mass_surge=self.surge.mass_kg,
            mass_sway=self.sway.mass_kg,
            mass_heave=heave.mass_kg,
            inertia_yaw=self.yaw.inertia_kgm2,
            linear_surge=self.surge.linear_damping_kgps,
            linear_sway=self.sway.linear_damping_kgps,
            linear_heave=heave.linear_damping_kgps,
            linear_yaw=self.yaw.linear_damping_Nms,
            quadratic_surge=self.surge.quadratic_damping_kgpm,
            quadratic_sway=self.sway.quadratic_damping_kgpm,
            quadratic_heave=heave.quadratic_damping_kgpm,
            quadratic_yaw=self.yaw.quadratic_damping_kgm2,
            dry_mass=self.dry_mass_kg,
            net_buoyancy=self.net_buoyancy_N,
            arm_port=self.thruster.port.arm_m,
            arm_starboard=self.thruster.starboard.arm_m,
            lag_port=self.thruster.port.lag_s,
            lag_starboard=self.thruster.starboard.lag_s,
            lag_vertical=self.thrusters[2].lag_s,
        )
