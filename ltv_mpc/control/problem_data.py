"""What stays the same from cycle to cycle, as compiled code reads it.

A call from Python into compiled code costs about 0.3 us for each array and each field of a tuple that is handed over;
a cycle is some fifty microseconds. So weights, limits and vehicle travel as one flat array, and every kernel that is
called from Python takes it apart itself, which costs nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ltv_mpc.control.config import Weights
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.scaling import time_ratio
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.dynamics import coefficients
from ltv_mpc.vehicle.parameters import Coefficients, Vehicle


class Objective(NamedTuple):
    """Weights (``config.Weights``) and limits (``limits.HorizonLimits``)."""

    position: float  # per m2
    terminal_position: float  # per m2, at the last knot besides
    terminal_velocity: float  # s2/m2
    thrust: float  # of (F / scale)^2
    thrust_change: float
    low: Array  # (2,) N
    high: Array
    max_change: Array  # N over the first stage
    scale: Array  # N: a thrust of 1 in the cost
    state_scale: Array  # (6,) a state of 1 in the QP
    max_state: Array  # (2,) of ``limits.LIMITED_STATES``
    t: Array  # (N+1,) knots in first stages: shooting_grid.py


class Constants(NamedTuple):
    """All that a cycle needs besides its inputs."""

    objective: Objective
    p: Coefficients
    vertical: Array  # (3,) least and most thrust (N) and slew (N/s) of the vertical thruster
    stage_s: float  # of the first stage
    time_ratio: float  # the vehicle's time by that of the paper's: scaling.py


def pack_objective(knots: Array, limits: HorizonLimits, weights: Weights) -> Array:
    """The flat array that ``objective`` takes apart; ``knots`` (N+1,) as in ``shooting_grid.py``."""
    cost = (
        weights.position_per_m2,
        weights.terminal_position_per_m2,
        weights.terminal_velocity_s2_per_m2,
        weights.thrust,
        weights.thrust_change,
    )
    bounds = (limits.low, limits.high, limits.max_change, limits.scale)
    return np.concatenate([cost, *bounds, limits.state_scale, limits.max_state, [len(knots)], knots])


def pack_constants(
    vehicle: Vehicle, weights: Weights, knots: Array, stage_s: float, max_state: Array | None = None
) -> Array:
    """The flat array that ``constants`` takes apart: a packed objective comes first. The first stage lasts stage_s;
    ``max_state`` (2,) of ``limits.LIMITED_STATES``.
    """
    vertical = vehicle.thrusters[2]
    rest = (vertical.min_N, vertical.max_N, vertical.slew_N_per_s, stage_s, time_ratio(vehicle))
    ours = pack_objective(knots, HorizonLimits.from_vehicle(vehicle, stage_s, max_state), weights)
    return np.concatenate([ours, vehicle.coefficients(), rest])


@jit
def unpack_objective(flat: Array) -> Objective:
    """The inverse of ``pack_objective``; the beginning of what ``pack`` makes serves as well."""
    end = 22 + int(flat[21])
    return Objective(
        flat[0], flat[1], flat[2], flat[3], flat[4],
        flat[5:7], flat[7:9], flat[9:11], flat[11:13], flat[13:19], flat[19:21], flat[22:end],
    )  # fmt: skip


@jit
def stage_length(o: Objective, k: int) -> float:
    """Of the stage that ends at knot k = 1 .. N, in first stages."""
    return float(o.t[k] - o.t[k - 1])


@jit
def limited_state_count(o: Objective) -> int:
    """How many states have a limit."""
    return int(np.isfinite(o.max_state).sum())


@jit
def state_scale(i: int, o: Objective) -> float:
    """What state i = 0 .. 7 of 1 means in the QP: a delivered thrust is scaled as its command."""
    return float(o.state_scale[i] if i < 6 else o.scale[i - 6])


@jit
def unpack_constants(flat: Array) -> Constants:
    """The inverse of ``pack``."""
    rest = flat[22 + int(flat[21]) :]
    return Constants(unpack_objective(flat), coefficients(rest[:19]), rest[19:22], rest[22], rest[23])
