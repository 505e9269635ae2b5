"""Problem data that stay the same from cycle to cycle: weights, limits and vehicle, packed for compiled code.

This file packs the controller's constants into a flat array, as ``linearisation.py`` does the numbers of a cycle. A
call from Python into compiled code costs about 0.15 us for each array and 0.4 us for each number of a tuple;
``Constants`` has 34 fields, and a cycle makes nine such calls. By name they cost 13 % of a cycle with OSQP, above the
limit of 5 % (docs/notes/kernel-arguments.md). So they are passed as one flat array (``packed``), and each kernel that
is called from Python unpacks it, which costs nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.control.config import Weights
from ltv_mpc.control.horizon_limits import HorizonLimits
from ltv_mpc.control.scaling import time_ratio
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.dynamics import coefficients
from ltv_mpc.vehicle.parameters import Coefficients, Vehicle

COMMANDS, CHANGES = 8, 10
"""Places of the commands and of their changes among the numbers of a stage (``ocp/assembly.py``)."""

W = len(Weights.__struct_fields__)
"""Numbers of a packed objective in front of its limits: the weights, in the order of ``Weights`` and ``Objective``."""

KNOTS = W + 19
"""Place of the first knot in a packed objective; their number is in front of it."""


class Objective(NamedTuple):
    """Weights of the cost (``config.Weights``), limits (``HorizonLimits``), scales and knots of the QP."""

    position: float  # per m2
    terminal_position: float  # per m2, at the last knot, in addition
    terminal_velocity: float  # s2/m2
    thrust: float  # of (F / thrust_scale)^2
    thrust_change: float  # of (change of F / thrust_scale)^2
    heading: float  # per rad2; 0: the heading is free
    low: Array  # (2,) smallest thrust of port and starboard (N)
    high: Array  # (2,) largest thrust (N)
    max_change: Array  # (2,) largest change of thrust over the first stage (N)
    thrust_scale: Array  # (2,) thrust that is 1 in the cost (N)
    state_scale: Array  # (6,) state that is 1 in the QP
    low_state: Array  # (2,) lower limits of ``horizon_limits.LIMITED_STATES``, -inf where there is none
    high_state: Array  # (2,) upper limits, inf where there is none
    t: Array  # (N+1,) knots in first stages: shooting_grid.py


class Constants(NamedTuple):
    """All that a cycle needs beside its inputs."""

    objective: Objective
    p: Coefficients  # of the vehicle
    vertical: Array  # (3,) vertical thruster: smallest and largest thrust (N), slew limit (N/s)
    stage_s: float  # length of the first stage
    time_ratio: float  # the vehicle's time scale over that of the paper's vehicle: scaling.py


def pack_objective(knots: Array, limits: HorizonLimits, weights: Weights) -> Array:
    """Pack weights, limits and knots into one flat array; ``unpack_objective`` is the inverse.

    Parameters
    ----------
    knots : (N+1,) times of the knots in first stages (shooting_grid.py).
    limits : limits of thrusters and motion.
    weights : weights of the cost.

    Returns
    -------
    (KNOTS + N+1,) packed objective.
    """
    cost = msgspec.structs.astuple(weights)
    bounds = (limits.low, limits.high, limits.max_change, limits.thrust_scale)
    return np.concatenate([cost, *bounds, limits.state_scale, *limits.state_bounds, [len(knots)], knots])


def pack_constants(
    vehicle: Vehicle, weights: Weights, knots: Array, stage_s: float, state_bounds: Array | None = None
) -> Array:
    """Pack all constants of a controller into one flat array; ``unpack_constants`` is the inverse.

    Parameters
    ----------
    vehicle : gives limits, coefficients and scales.
    weights : weights of the cost.
    knots : (N+1,) times of the knots in first stages.
    stage_s : length of the first stage.
    state_bounds : (2, 2) lower and upper limits of ``horizon_limits.LIMITED_STATES``; default: none.

    Returns
    -------
    (KNOTS + N+1 + 26,) packed constants; they begin with a packed objective.
    """
    vertical = vehicle.thrusters[2]
    rest = (vertical.min_N, vertical.max_N, vertical.slew_N_per_s, stage_s, time_ratio(vehicle))
    packed = pack_objective(knots, HorizonLimits.from_vehicle(vehicle, stage_s, state_bounds), weights)
    return np.concatenate([packed, vehicle.coefficients(), rest])


def coefficients_of(packed: Array) -> Array:
    """Return the view (21,) of the vehicle's coefficients in packed constants."""
    begin = KNOTS + int(packed[KNOTS - 1])
    return packed[begin : begin + 21]


def bow_first(packed: Array) -> bool:
    """Return True if packed constants have a lower limit of surge that lets the vehicle not go astern.

    Parameters
    ----------
    packed : packed constants.
    """
    return bool(packed[W + 14] >= 0.0)


@jit
def unpack_objective(packed: Array) -> Objective:
    """Return the objective at the beginning of a packed objective or of packed constants."""
    end, rest = KNOTS + int(packed[KNOTS - 1]), packed[W:]
    return Objective(
        packed[0], packed[1], packed[2], packed[3], packed[4], packed[5],
        rest[0:2], rest[2:4], rest[4:6], rest[6:8], rest[8:14], rest[14:16], rest[16:18], packed[KNOTS:end],
    )  # fmt: skip


@jit
def unpack_constants(packed: Array) -> Constants:
    """Return the constants that ``pack_constants`` packed."""
    rest = packed[KNOTS + int(packed[KNOTS - 1]) :]
    return Constants(unpack_objective(packed), coefficients(rest[:21]), rest[21:24], rest[24], rest[25])


@jit
def stage_length(t: Array, k: int) -> float:
    """Return the length of the stage that ends at knot k = 1 .. N, in first stages.

    Parameters
    ----------
    t : (N+1,) knots in first stages.
    k : knot.

    Returns
    -------
    g_k = t_k - t_(k-1).
    """
    return float(t[k] - t[k - 1])
