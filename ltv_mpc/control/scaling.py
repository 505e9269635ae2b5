"""Weights from the vehicle: what was found for the paper's vehicle, carried to any other by its scales.

A vehicle has a speed V, a time T and a length L = V T:

    V = top speed ahead               F = d V + D V^2,           F the sum of what both thrusters push ahead
    T = M_x V / F + sqrt(1 / r^2 + 2 I_z / N) + lag              surge, a turn by 1 rad, thruster
    r = turning rate on the spot      N = d_psi r + D_psi r^2,   N the weaker of both couples

M_x V / F is the time constant in which a full push reaches V; a turn by 1 rad takes 1 / r where drag rules and
sqrt(2 I_z / N) where inertia does. In units of T and L, with f = F / max, the cost of stages of length h is

    (T / h) w L^2 integral |p|^2 + (T / h) r_F integral |f|^2 + (h / T) s integral |f'|^2
    + w_N L^2 |p_N|^2 + m V^2 |p'_N|^2

Two vehicles that differ by scale alone behave alike, each in its own T and L, where the ratios between the terms are
the same:

    w = a / L^2,   w_N = b w T / h,   m = c w T^3 / h,   r_F = d,   s = e (T / h)^2

a .. e are such that the paper's vehicle has the weights that were found for it (``config.Weights``). With r_F the same
for all, and not w, the QP's costs are of the same size for all, which the fixed step sizes of OSQP want.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.control.config import ControllerConfig, ResolvedConfig, Weights
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.parameters import Coefficients, Vehicle
from ltv_mpc.vehicle.resistance import UNBRAKED_MPS, UNBRAKED_RADPS, steady_speed


class Scales(NamedTuple):
    """Of one vehicle: top speed V (m/s) and time T (s)."""

    speed_mps: float
    time_s: float

    @property
    def length_m(self) -> float:
        """L = V T."""
        return self.speed_mps * self.time_s


PAPER_SCALES = Scales(speed_mps=0.5, time_s=7.22042)
"""Of the vehicle that the weights were found for: ``characteristic_scales`` gives it, and a test holds that."""


def characteristic_scales(vehicle: Vehicle) -> Scales:
    """V and T of a vehicle: this file's head."""
    p = vehicle.coefficients()
    port, starboard = vehicle.thrusters[:2]
    push = port.max_N + starboard.max_N
    speed = min(steady_speed(push, p.linear_surge, p.quadratic_surge), UNBRAKED_MPS)
    couple = weaker_couple(vehicle, p)
    rate = min(steady_speed(couple, p.linear_yaw, p.quadratic_yaw), UNBRAKED_RADPS)
    turn = math.sqrt(1.0 / rate**2 + 2.0 * p.inertia_yaw / couple)
    return Scales(speed, p.mass_surge * speed / push + turn + max(p.lag_port, p.lag_starboard))


def time_ratio(vehicle: Vehicle) -> float:
    """T by that of the paper's vehicle."""
    return _rounded(characteristic_scales(vehicle).time_s / PAPER_SCALES.time_s)


def state_scale(vehicle: Vehicle) -> Array:
    """What a state of 1 means in the QP (6,): n, e (m), u, v (m/s), psi (rad), r (rad/s).

    1 m, 0.3 m/s, 1 rad and 0.3 rad/s for the paper's vehicle; lengths go with L, velocities with V, rates with 1 / T.
    """
    of = characteristic_scales(vehicle)
    length, speed = of.length_m / PAPER_SCALES.length_m, of.speed_mps / PAPER_SCALES.speed_mps
    scale = (length, length, 0.3 * speed, 0.3 * speed, 1.0, 0.3 * PAPER_SCALES.time_s / of.time_s)
    return np.array([_rounded(s) for s in scale])


def weaker_couple(vehicle: Vehicle, p: Coefficients) -> float:
    """N (N m): one thruster full ahead, the other full astern, to the side on which that turns less.

    Of a vehicle that turns to one side only, a twentieth of what turns it there.
    """
    port, starboard = vehicle.thrusters[:2]
    to_starboard = port.max_N * p.arm_port - starboard.min_N * p.arm_starboard
    to_port = starboard.max_N * p.arm_starboard - port.min_N * p.arm_port
    return max(min(to_starboard, to_port), 0.05 * max(to_starboard, to_port))


def default_weights(vehicle: Vehicle) -> Weights:
    """The weights of a vehicle: those of the paper's, scaled; to three digits: more would pretend."""
    found, of = Weights(), characteristic_scales(vehicle)
    length, time = of.length_m / PAPER_SCALES.length_m, of.time_s / PAPER_SCALES.time_s
    # h is the same for all: T / h goes as T
    return Weights(
        position_per_m2=_rounded(found.position_per_m2 / length**2),
        terminal_position_per_m2=_rounded(found.terminal_position_per_m2 * time / length**2),
        terminal_velocity_s2_per_m2=_rounded(found.terminal_velocity_s2_per_m2 * time**3 / length**2),
        thrust=found.thrust,
        thrust_change=_rounded(found.thrust_change * time**2),
    )


def resolve_weights(config: ControllerConfig, vehicle: Vehicle) -> ResolvedConfig:
    """Return ``config`` with every weight given: those that it names, and for the others the vehicle's defaults."""
    if isinstance(config, ResolvedConfig):
        return config
    given = {name: value for name, value in msgspec.structs.asdict(config.weights).items() if value is not None}
    weights = msgspec.structs.replace(default_weights(vehicle), **given)
    rest = {field: getattr(config, field) for field in config.__struct_fields__ if field != "weights"}
    return ResolvedConfig(**rest, weights=weights)


def _rounded(weight: float) -> float:
    return float(f"{weight:.3g}")
