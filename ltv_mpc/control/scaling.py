"""Scaling: the weights of any vehicle, from those tuned for the paper's vehicle.

A vehicle has characteristic scales of speed V, time T and length L = V T:

    V = top speed ahead               F = d V + D V^2,           F the largest total thrust ahead
    T = M_x V / F + sqrt(1 / r^2 + 2 I_z / N) + lag              surge, a turn by 1 rad, thruster
    r = turning rate on the spot      N = d_psi r + D_psi r^2,   N the weaker of both turning couples

M_x V / F is the time constant with which full thrust reaches V. A turn by 1 rad takes 1 / r where drag dominates and
sqrt(2 I_z / N) where inertia does. In units of T and L, with f = F / max, the cost of stages of length h is

    (T / h) w L^2 integral |p|^2 + (T / h) r_F integral |f|^2 + (h / T) s integral |f'|^2
    + w_N L^2 |p_N|^2 + m V^2 |p'_N|^2

Two vehicles that differ only by scale behave alike, each in its own T and L, if the ratios between the terms are the
same:

    w = a / L^2,   w_N = b w T / h,   m = c w T^3 / h,   r_F = d,   s = e (T / h)^2

a .. e give the paper's vehicle the weights that were tuned for it (``config.Weights``). r_F is the same for all
vehicles, rather than w: then the QP's costs have the same size for all, as the fixed step sizes of OSQP require.

A vehicle whose loop lacks margins (``margins.py``) gets a slower one. The time in which thrust corrects an error grows
with (r_F / w)^(1/4), so a slowness of k divides w, and the weight of a heading, by k^4. The weights at the end stay, so
that the plan still ends at its target: divided as well, they let the weight of thrust pull the vehicle downstream.

A plan depends on the ratios between the weights only. So weights that are given are divided by a common factor if those
of the target would be too large for the penalties of fence, corridor and speed limits, and for the solvers.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.control.config import HEADING_PER_RAD2, Effort, Weights
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.parameters import Vehicle
from ltv_mpc.vehicle.resistance import UNBRAKED_MPS, UNBRAKED_RADPS, steady_speed


class Scales(NamedTuple):
    """Characteristic scales of one vehicle: top speed V (m/s) and time T (s)."""

    speed_mps: float
    time_s: float

    @property
    def length_m(self) -> float:
        """Length scale L = V T (m)."""
        return self.speed_mps * self.time_s


PAPER_SCALES = Scales(speed_mps=0.5, time_s=7.22042)
"""Scales of the vehicle that the weights were tuned for: the result of ``characteristic_scales``, as a test checks."""


THRUST_WEIGHT_FACTOR: dict[Effort, float] = {"low": 10.0 / 3.0, "normal": 1.0, "high": 0.1}
"""Factor of an effort on the weights of thrust and of its change."""


MAX_POSITION, MAX_TERMINAL_POSITION = 2.0, 100.0
"""Largest weights of the target, for the paper's vehicle. No default is larger, of any shipped vehicle."""

ROUNDING = 1e-9
"""Excess of these that does not count, so that weights which were divided are not divided again."""


def characteristic_scales(vehicle: Vehicle) -> Scales:
    """Return V and T of a vehicle, as at the head of this file."""
    p = vehicle.coefficients()
    push, couple = vehicle.pushes_N[0], weaker_couple(vehicle)
    speed = min(steady_speed(push, p.linear_surge, p.quadratic_surge), UNBRAKED_MPS)
    rate = min(steady_speed(couple, p.linear_yaw, p.quadratic_yaw), UNBRAKED_RADPS)
    turn = math.sqrt(1.0 / rate**2 + 2.0 * p.inertia_yaw / couple)
    return Scales(speed, p.mass_surge * speed / push + turn + max(p.lag_port, p.lag_starboard))


def time_ratio(vehicle: Vehicle) -> float:
    """Return T over that of the paper's vehicle."""
    return _rounded(characteristic_scales(vehicle).time_s / PAPER_SCALES.time_s)


def state_scale(vehicle: Vehicle) -> Array:
    """Return the state that is 1 in the QP (6,): n, e (m), u, v (m/s), psi (rad), r (rad/s).

    It is 1 m, 0.3 m/s, 1 rad and 0.3 rad/s for the paper's vehicle. Lengths are proportional to L, velocities to V,
    rates to 1 / T.
    """
    own = characteristic_scales(vehicle)
    length, speed = own.length_m / PAPER_SCALES.length_m, own.speed_mps / PAPER_SCALES.speed_mps
    scale = (length, length, 0.3 * speed, 0.3 * speed, 1.0, 0.3 * PAPER_SCALES.time_s / own.time_s)
    return np.array([_rounded(s) for s in scale])


def thrust_scale(vehicle: Vehicle) -> Array:
    """Return the thrust of port and starboard that is 1 in the cost (2,): the larger side of the box (N)."""
    return np.array([max(t.max_N, -t.min_N) for t in vehicle.thrusters[:2]])


def weaker_couple(vehicle: Vehicle) -> float:
    """Return the weaker turning couple N: one thruster full ahead, the other full astern, to the weaker side.

    Parameters
    ----------
    vehicle : gives limits and arms of the thrusters.

    Returns
    -------
    N (N m), positive. For a vehicle that turns to one side only, a twentieth of the couple to that side.
    """
    return max(min(vehicle.couples_Nm), 0.05 * max(vehicle.couples_Nm))


def default_weights(vehicle: Vehicle, effort: Effort = "normal", slowness: float = 1.0) -> Weights:
    """Return the default weights of a vehicle: those of the paper's vehicle, scaled, with three significant digits.

    Parameters
    ----------
    vehicle : gives the scales.
    effort : selects the weights of thrust and of its change.
    slowness : factor by which the loop is slower, as described at the head of this file.
    """
    factor = THRUST_WEIGHT_FACTOR[effort]
    tuned, own = Weights(), characteristic_scales(vehicle)
    length, time = own.length_m / PAPER_SCALES.length_m, own.time_s / PAPER_SCALES.time_s
    # h is the same for all vehicles, so T / h is proportional to T
    return Weights(
        position_per_m2=_rounded(tuned.position_per_m2 / length**2 / slowness**4),
        terminal_position_per_m2=_rounded(tuned.terminal_position_per_m2 * time / length**2),
        terminal_velocity_s2_per_m2=_rounded(tuned.terminal_velocity_s2_per_m2 * time**3 / length**2),
        thrust=_rounded(factor * tuned.thrust),
        thrust_change=_rounded(factor * tuned.thrust_change * time**2),
        heading_per_rad2=0.0 if slowness == 1.0 else _rounded(HEADING_PER_RAD2 / slowness**4),
    )


def bounded(weights: Weights, vehicle: Vehicle) -> Weights:
    """Return weights of the same ratios, of which those of the target are not too large.

    Parameters
    ----------
    weights : default or given ones; no default is too large.
    vehicle : gives the scale of length.
    """
    largest = max(weights.position_per_m2 / MAX_POSITION, weights.terminal_position_per_m2 / MAX_TERMINAL_POSITION)
    factor = largest * float(state_scale(vehicle)[0]) ** 2
    if factor < 1.0 + ROUNDING:
        return weights
    with_heading = weights.at_heading(True)  # its default is one of the weights
    return Weights(**{name: value / factor for name, value in msgspec.structs.asdict(with_heading).items()})


def _rounded(weight: float) -> float:
    """Round to three significant digits."""
    return float(f"{weight:.3g}")
