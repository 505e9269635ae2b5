"""Constants of a controller for compiled code: weights, limits, scales, knots and vehicle.

A call from Python into compiled code costs about 0.15 us for each array of a named tuple and 0.4 us for each number
(docs/notes/kernel-arguments.md). So weights and coefficients are arrays.
"""

from __future__ import annotations

from typing import NamedTuple

import msgspec
import numpy as np

from ltv_mpc.control.config import STAGE_NS, Weights
from ltv_mpc.control.scaling import state_scale, thrust_scale, time_ratio
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.parameters import Vehicle

STAGE_S = STAGE_NS * 1e-9
"""Length of the first stage (s)."""

COMMANDS, CHANGES = 8, 10
"""Places of the commands and of their changes among the numbers of a stage (``ocp/assembly.py``)."""

POSITION, TERMINAL_POSITION, TERMINAL_VELOCITY, THRUST, THRUST_CHANGE, HEADING = range(6)
"""Places of the weights in ``Constants.weights``: the order of ``config.Weights``."""

LIMITED_STATES = (2, 5)
"""States that can be limited: surge velocity u through the water (m/s), yaw rate r (rad/s)."""

UNLIMITED = np.array([[-np.inf, -np.inf], [np.inf, np.inf]])
"""Lower and upper limits of ``LIMITED_STATES`` where there is none."""


class Constants(NamedTuple):
    """All that a cycle needs beside its inputs."""

    weights: Array  # (6,) of the cost: config.Weights
    low: Array  # (2,) smallest thrust of port and starboard (N)
    high: Array  # (2,) largest thrust (N)
    max_change: Array  # (2,) largest change of thrust over the first stage (N)
    thrust_scale: Array  # (2,) thrust that is 1 in the cost (N)
    state_scale: Array  # (6,) state that is 1 in the QP: n, e (m), u, v (m/s), psi (rad), r (rad/s)
    low_state: Array  # (2,) lower limits of ``LIMITED_STATES``, -inf where there is none
    high_state: Array  # (2,) upper limits, inf where there is none
    t: Array  # (N+1,) knots in first stages: shooting_grid.py
    p: Array  # (21,) coefficients of the vehicle
    vertical: Array  # (3,) vertical thruster: smallest and largest thrust (N), slew limit (N/s)
    time_ratio: float  # the vehicle's time scale over that of the paper's vehicle: scaling.py

    @classmethod
    def of(cls, vehicle: Vehicle, weights: Weights, knots: Array, state_bounds: Array = UNLIMITED) -> Constants:
        """Return the constants of a controller.

        Parameters
        ----------
        vehicle : gives limits, coefficients and scales.
        weights : of the cost.
        knots : (N+1,) in first stages.
        state_bounds : (2, 2) lower and upper limits of ``LIMITED_STATES``.
        """
        low, high, slew = np.array([(t.min_N, t.max_N, t.slew_N_per_s) for t in vehicle.thrusters]).T
        return cls(
            weights=np.array(msgspec.structs.astuple(weights)),
            low=low[:2].copy(),
            high=high[:2].copy(),
            max_change=slew[:2] * STAGE_S,
            thrust_scale=thrust_scale(vehicle),
            state_scale=state_scale(vehicle),
            low_state=state_bounds[0],
            high_state=state_bounds[1],
            t=knots,
            p=np.array(vehicle.coefficients()),
            vertical=np.array([low[2], high[2], slew[2]]),
            time_ratio=time_ratio(vehicle),
        )
