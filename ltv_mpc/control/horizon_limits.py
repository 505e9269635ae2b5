"""Limits over the horizon: box and slew of the two lateral thrusters, and soft limits of the motion.

A command at knot k (k = 1 .. N) obeys  min <= U[k] <= max  and  |U[k] - U[k-1]| <= slew h[k].  Commands are linear
between knots, so |dF/dt| <= slew everywhere, and also at the junction of two plans, because U[0] is the command in
force there. The slew limit is never violated. The box is violated only while a command that starts outside it returns
at the slew limit (``command_bounds``).

A state may be required to stay within  low <= x[k] <= high,  k = 1 .. N. The past can make that impossible, so the
limit is soft: an excess costs a penalty for each unit. A penalty proportional to the excess is exact (Fletcher 1987,
section 12.3; Kerrigan & Maciejowski 2000): once it is larger than the dual of the limit, the solution is that of the
hard limit wherever there is one. The duals grow with the distance of the target, so the penalty does too
(``limits.excess_penalty``).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ltv_mpc.control.scaling import state_scale
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.parameters import Vehicle

LIMITED_STATES = (2, 5)
"""States that can be limited: surge velocity u through the water (m/s), yaw rate r (rad/s)."""

MIN_PENALTY = 100.0
"""Least cost of an excess that is 1 in the QP, over one stage of 0.3 s."""


def unlimited() -> Array:
    """Return infinite lower and upper limits (2, 2) of ``LIMITED_STATES``."""
    return np.array([[-np.inf], [np.inf]]) * np.ones(len(LIMITED_STATES))


@dataclass(frozen=True, slots=True)
class HorizonLimits:
    """Limits of thrusters and motion, and the scales of the QP that follow from the vehicle."""

    low: Array
    """(2,) smallest thrust of port and starboard (N)."""
    high: Array
    """(2,) largest thrust (N)."""
    max_change: Array
    """(2,) largest change of thrust over the first stage (N): slew limit times its length."""
    state_scale: Array
    """(6,) state that is 1 in the QP: n, e (m), u, v (m/s), psi (rad), r (rad/s)."""
    state_bounds: Array = field(default_factory=unlimited)
    """(2, 2) lower and upper limits of ``LIMITED_STATES``; infinite where there is none."""

    @classmethod
    def from_vehicle(cls, vehicle: Vehicle, stage_s: float, state_bounds: Array | None = None) -> HorizonLimits:
        """Return the limits of a vehicle.

        Parameters
        ----------
        vehicle : gives box, slew and scales.
        stage_s : length of the first stage.
        state_bounds : (2, 2) lower and upper limits of the motion; default: none.

        Returns
        -------
        The limits.
        """
        lateral = vehicle.thrusters[:2]
        return cls(
            np.array([t.min_N for t in lateral]),
            np.array([t.max_N for t in lateral]),
            np.array([t.slew_N_per_s for t in lateral]) * stage_s,
            state_scale(vehicle),
            unlimited() if state_bounds is None else state_bounds,
        )

    @property
    def thrust_scale(self) -> Array:
        """Thrust that is 1 in the cost (2,): the larger side of the box (N)."""
        return np.maximum(self.high, -self.low)

    def box(self, start: Array, knots: Array) -> tuple[Array, Array]:
        """Return the bounds of the commands at the knots 1 .. N: ``command_bounds`` at each.

        Parameters
        ----------
        start : (2,) command in force at knot 0 (N).
        knots : (N+1,) in first stages.

        Returns
        -------
        Lower and upper bounds, (N, 2) each (N).
        """
        reach = knots[1:, None] * self.max_change
        return np.minimum(self.low, start + reach), np.maximum(self.high, start - reach)


@jit
def command_bounds(start: float, reach: float, low: float, high: float) -> tuple[float, float]:
    """Return the bounds of one thruster's command at a knot.

    A start outside the box (a limit that was just lowered) returns into it at the slew limit, so that the QP always has
    a solution. From a start inside, the bounds are the box itself, however little of it is within reach: the slew rows
    bound the commands already, and a box that is active nowhere costs the solver nothing.

    Parameters
    ----------
    start : command in force at knot 0 (N).
    reach : largest change from there to the knot (N).
    low, high : box (N).

    Returns
    -------
    Lower and upper bound (N).
    """
    return min(low, start + reach), max(high, start - reach)


@jit
def clip_to_limits(U: Array, t: Array, low: Array, high: Array, max_change: Array) -> None:
    """Clip commands in place, knot by knot: first to the slew from the knot before, then to the box.

    Parameters
    ----------
    U : (N+1, 2) commands (N); the first stays, the others are overwritten.
    t : (N+1,) knots in first stages.
    low, high : (2,) box (N).
    max_change : (2,) largest change over the first stage (N).
    """
    for k in range(1, U.shape[0]):
        for i in range(2):
            change = (t[k] - t[k - 1]) * max_change[i]
            lower, upper = command_bounds(U[0, i], t[k] * max_change[i], low[i], high[i])
            U[k, i] = min(max(U[k, i], U[k - 1, i] - change), U[k - 1, i] + change)
            U[k, i] = min(max(U[k, i], lower), upper)
