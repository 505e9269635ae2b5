"""What stays the same from cycle to cycle, as compiled code reads it.

A call from Python into compiled code costs about 0.3 us for each array and each field of a tuple that is handed over;
a cycle is some fifty microseconds. So weights, limits and vehicle travel as one flat array, and every kernel that is
called from Python takes it apart itself, which costs nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ltv_mpc.compiled import kernel
from ltv_mpc.control.config import Weights
from ltv_mpc.control.limits import ThrustLimits
from ltv_mpc.signals import Array
from ltv_mpc.vehicle.parameters import Coefficients, Vehicle


class Objective(NamedTuple):
    """Weights (``config.Weights``) and limits (``limits.ThrustLimits``)."""

    position: float  # per m2
    terminal_position: float  # per m2, at the last knot besides
    terminal_velocity: float  # s2/m2
    thrust: float  # of (F / scale)^2
    thrust_change: float
    low: Array  # (2,) N
    high: Array
    change: Array  # N between two knots
    scale: Array  # N: a thrust of 1 in the cost


class Constants(NamedTuple):
    """All that a cycle needs besides its inputs."""

    objective: Objective
    p: Coefficients
    vertical: Array  # (3,) least and most thrust (N) and slew (N/s) of the vertical thruster
    stage_s: float


def pack_objective(limits: ThrustLimits, weights: Weights) -> Array:
    """The flat array that ``objective`` takes apart."""
    cost = (
        weights.position_per_m2,
        weights.terminal_position_per_m2,
        weights.terminal_velocity_s2_per_m2,
        weights.thrust,
        weights.thrust_change,
    )
    return np.concatenate([cost, limits.low, limits.high, limits.change, limits.scale])


def pack(vehicle: Vehicle, weights: Weights, stage_s: float) -> Array:
    """The flat array that ``constants`` takes apart: a packed objective comes first."""
    vertical = vehicle.thruster.vertical
    rest = (vertical.min_N, vertical.max_N, vertical.slew_N_per_s, stage_s)
    return np.concatenate([pack_objective(ThrustLimits.of(vehicle, stage_s), weights), vehicle.coefficients(), rest])


@kernel
def objective(flat: Array) -> Objective:
    """The inverse of ``pack_objective``; the beginning of what ``pack`` makes serves as well."""
    return Objective(flat[0], flat[1], flat[2], flat[3], flat[4], flat[5:7], flat[7:9], flat[9:11], flat[11:13])


@kernel
def coefficients(flat: Array) -> Coefficients:
    """The inverse of ``np.array(vehicle.coefficients())``."""
    return Coefficients(
        flat[0], flat[1], flat[2], flat[3], flat[4], flat[5], flat[6], flat[7], flat[8], flat[9], flat[10], flat[11],
        flat[12], flat[13], flat[14], flat[15], flat[16], flat[17], flat[18],
    )  # fmt: skip


@kernel
def constants(flat: Array) -> Constants:
    """The inverse of ``pack``."""
    return Constants(objective(flat), coefficients(flat[13:32]), flat[32:35], flat[35])
