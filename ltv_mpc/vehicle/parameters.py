"""Vehicle parameters, as in the TOML file and as in the compiled code.

The thrust of a propeller by revolutions and inflow is in ``propulsion.py``, the equations of motion are in
``dynamics.py``.
"""

from __future__ import annotations

import itertools
import math
from typing import Annotated, NamedTuple, TypeAlias

import msgspec
from msgspec import Meta

from ltv_mpc import config
from ltv_mpc.vehicle.reference_point import ORIGIN, ReferencePoint

Positive: TypeAlias = Annotated[float, Meta(gt=0, le=1e7)]
NonNegative: TypeAlias = Annotated[float, Meta(ge=0, le=1e7)]

PLAN_TIMEOUT_S = 5.0
"""Time for which a plan is followed without a new one, if the vehicle file does not say otherwise (s)."""


class Translation(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Surge, sway or heave: total mass (added mass included) and damping, X = -(linear + quadratic |v|) v."""

    mass_kg: Positive
    linear_damping_kgps: NonNegative
    quadratic_damping_kgpm: NonNegative


class Rotation(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Yaw: total inertia (added inertia included) and damping, N = -(linear + quadratic |r|) r."""

    inertia_kgm2: Positive
    linear_damping_Nms: NonNegative
    quadratic_damping_kgm2: NonNegative


class Thruster(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Limits and dynamics of one thruster. A positive thrust pushes the vehicle ahead, that of the vertical one down.

    ``arm_m`` is the distance from the centre line, never negative: the model adds the sign of the side. It has no
    effect for the vertical thruster.
    """

    arm_m: Annotated[float, Meta(ge=0, le=100)]
    min_N: Annotated[float, Meta(ge=-1e6, le=0)]
    max_N: Annotated[float, Meta(gt=0, le=1e6)]
    slew_N_per_s: Annotated[float, Meta(gt=0, le=1e6)]
    lag_s: Annotated[float, Meta(ge=0, le=60)]
    propeller_diameter_m: Annotated[float, Meta(gt=0, le=10)]
    max_rps: Annotated[float, Meta(gt=0, le=1000)]
    # torque of the propeller for its energy, K_Q = first - second x advance ratio (propulsion.py); not set: unknown
    torque_coefficient: Annotated[float, Meta(gt=0, le=1)] | None = None
    torque_inflow_coefficient: Annotated[float, Meta(ge=0, le=1)] | None = None
    # PWM (us) of a thrust (N, bollard pull), for the edge to MAVLink; falling thrusts: it turns the other way
    pwm_us: tuple[Annotated[float, Meta(ge=800, le=2200)], ...] = ()
    pwm_N: tuple[Annotated[float, Meta(ge=-1e6, le=1e6)], ...] = ()

    def __post_init__(self) -> None:
        """Reject one torque coefficient without the other, and a table of PWM that has no inverse."""
        rows = len(self.pwm_us)
        if rows != len(self.pwm_N) or rows == 1:
            raise ValueError("pwm_us and pwm_N: must be of the same length, at least 2")
        if any(b <= a for a, b in itertools.pairwise(self.pwm_us)):
            raise ValueError("pwm_us: must increase")
        steps = [b - a for a, b in itertools.pairwise(self.pwm_N)]
        if rows and not (all(step >= 0 for step in steps) or all(step <= 0 for step in steps)):
            raise ValueError("pwm_N: must rise, or fall, from row to row")
        if rows and not min(self.pwm_N) < 0.0 < max(self.pwm_N):
            raise ValueError("pwm_N: must have thrusts of both signs")
        if (self.torque_coefficient is None) != (self.torque_inflow_coefficient is None):
            raise ValueError("torque_coefficient and torque_inflow_coefficient: give both, or leave both out")


class Thrusters(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Tables [thruster.port], [thruster.starboard] and, for a vehicle that dives, [thruster.vertical]."""

    port: Thruster
    starboard: Thruster
    vertical: Thruster | None = None


class Hull(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Size of the hull with all that sticks out of it, seen from above, for fences."""

    length_m: Annotated[float, Meta(gt=0, le=100)]
    beam_m: Annotated[float, Meta(gt=0, le=100)]

    @property
    def radius_m(self) -> float:
        """Radius of the circle around the hull: its middle counts as the vehicle's origin."""
        return 0.5 * math.hypot(self.length_m, self.beam_m)


NO_THRUSTER = Thruster(
    arm_m=0.0, min_N=0.0, max_N=0.0, slew_N_per_s=1.0, lag_s=0.0, propeller_diameter_m=1.0, max_rps=1.0
)
"""Placeholder for the vertical thruster of a surface craft, with limits of zero. With it every thrust array has three
entries.
"""


class Coefficients(NamedTuple):
    """Coefficients of the equations of motion for compiled code, as plain floats.

    Masses in kg, inertia in kg m2, linear damping in kg/s (yaw: N m s), quadratic damping in kg/m (yaw: kg m2), arms in
    m, lags in s.
    """

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
    added_munk: float  # kg, added to M_x - M_y of the Munk moment: 0 unless one was learned
    yaw_moment: float  # N m, steady: 0 unless one was learned


class Vehicle(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Underactuated vehicle with two stern thrusters, and a vertical one if it dives.

    A surface craft omits [thruster.vertical] and [heave], and floats: its vertical thrust is always zero.
    """

    name: str
    description: str
    dry_mass_kg: Positive
    net_buoyancy_N: Annotated[float, Meta(ge=-1e6, le=1e6)] = 0.0  # buoyancy minus weight; positive: the vehicle rises
    water_density_kgpm3: Annotated[float, Meta(ge=900, le=1100)]
    failsafe_vertical_N: Annotated[float, Meta(ge=-1e6, le=1e6)] = 0.0  # thrust in failsafe; positive pushes down
    # longest time for which the actuators follow a plan without a new one, whatever the length of the plan
    plan_timeout_s: Annotated[float, Meta(ge=0.5, le=60)] = PLAN_TIMEOUT_S
    identified: bool = False  # masses, damping and thrust are within 10 % of the true ones, for the model monitor
    surge: Translation
    sway: Translation
    heave: Translation | None = None
    yaw: Rotation
    thruster: Thrusters
    reference_point: ReferencePoint = ORIGIN  # whose position and velocity the estimates give
    hull: Hull | None = None  # a fence needs it

    def __post_init__(self) -> None:
        """Reject parameters that contradict each other."""
        if (self.thruster.vertical is None) != (self.heave is None):
            parts = ("[heave]", "[thruster.vertical]")
            missing, present = parts if self.heave is None else parts[::-1]
            raise ValueError(
                f"{missing} is missing but {present} is present: "
                "give both for a vehicle that dives, neither for a surface craft"
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
            raise ValueError(
                "[thruster.port] and [thruster.starboard] arm_m: both are 0, so no thruster can turn the vehicle"
            )

    @classmethod
    def load(cls, name: str) -> Vehicle:
        """Return a shipped vehicle by name (``"paper"``), or read a TOML file by path. Raises ``ConfigError``.

        Parameters
        ----------
        name : name of a shipped vehicle, or path of a TOML file.
        """
        return config.load(name, cls, what="vehicle", package="ltv_mpc.vehicle.files")

    @property
    def thrusters(self) -> tuple[Thruster, Thruster, Thruster]:
        """Entries of ``thruster`` in the order of every thrust array: port, starboard, vertical or ``NO_THRUSTER``."""
        return self.thruster.port, self.thruster.starboard, self.thruster.vertical or NO_THRUSTER

    @property
    def can_dive(self) -> bool:
        """True if the vehicle can dive, with a vertical thruster; False for a surface craft."""
        return self.heave is not None

    @property
    def pushes_N(self) -> tuple[float, float]:
        """Largest total thrust of the stern thrusters ahead and astern (N); neither is negative."""
        port, starboard = self.thruster.port, self.thruster.starboard
        return port.max_N + starboard.max_N, -(port.min_N + starboard.min_N)

    @property
    def couples_Nm(self) -> tuple[float, float]:
        """Largest yaw moment to starboard and to port (N m), with one thruster astern; neither is negative."""
        port, starboard = self.thruster.port, self.thruster.starboard
        to_starboard = port.max_N * port.arm_m - starboard.min_N * starboard.arm_m
        return to_starboard, starboard.max_N * starboard.arm_m - port.min_N * port.arm_m

    def at_origin(self) -> Vehicle:
        """Return the vehicle for estimates of its origin: without the reference point of its own navigation."""
        return msgspec.structs.replace(self, reference_point=ORIGIN)

    def coefficients(self) -> Coefficients:
        """Return the coefficients for compiled code. A surface craft has its dry mass and no damping in heave."""
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
            added_munk=0.0,
            yaw_moment=0.0,
        )
