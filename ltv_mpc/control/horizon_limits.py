"""What holds over the horizon: box and slew of the two lateral thrusters, and soft limits of the motion.

A command at knot k (k = 1 .. N) obeys  min <= U[k] <= max  and  |U[k] - U[k-1]| <= slew h[k];  linear between knots, so
|dF/dt| <= slew everywhere, and at the junction of two plans too, since U[0] is the command in force there. These are
the thrusters' own, and never broken.

A state may be asked to stay within  |x[k]| <= most,  k = 1 .. N. The past can make that impossible, so it is bought
off: ``PENALTY`` for each unit beyond it. A penalty that grows with the first power is exact (Fletcher 1987, section
12.3; Kerrigan & Maciejowski 2000): once it is larger than the dual of the limit, the solution is that of the hard limit
wherever there is one.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ltv_mpc.control.scaling import state_scale
from ltv_mpc.jit import jit
from ltv_mpc.messages import Array
from ltv_mpc.vehicle.parameters import Vehicle

LIMITED_STATES = (2, 5)
"""States that can be limited: surge u through the water (m/s), yaw rate r (rad/s)."""

PENALTY = 100.0
"""Cost of a stage of 0.3 s in which a limited state is beyond its limit by what is 1 in the QP."""


def unlimited() -> Array:
    """(2,), of ``LIMITED_STATES``."""
    return np.full(len(LIMITED_STATES), np.inf)


@dataclass(frozen=True, slots=True)
class HorizonLimits:
    """Box (2,) each and the largest change over the first stage (2,), in N; limits of the motion; and what is of order
    one besides them.
    """

    low: Array
    high: Array
    max_change: Array
    state_scale: Array
    """(6,) a state of 1 in the QP: n, e (m), u, v (m/s), psi (rad), r (rad/s)."""
    max_state: Array = field(default_factory=unlimited)
    """(2,) of |x| for ``LIMITED_STATES``; infinite where there is no limit."""

    @classmethod
    def from_vehicle(cls, vehicle: Vehicle, stage_s: float, max_state: Array | None = None) -> HorizonLimits:
        """A vehicle's where the first stage lasts ``stage_s``; ``max_state`` of its motion is asked besides."""
        lateral = vehicle.thrusters[:2]
        return cls(
            np.array([t.min_N for t in lateral]),
            np.array([t.max_N for t in lateral]),
            np.array([t.slew_N_per_s for t in lateral]) * stage_s,
            state_scale(vehicle),
            unlimited() if max_state is None else max_state,
        )

    @property
    def limited(self) -> tuple[int, ...]:
        """States that have a limit."""
        return tuple(i for i, most in zip(LIMITED_STATES, self.max_state, strict=True) if np.isfinite(most))

    @property
    def scale(self) -> Array:
        """The larger of both sides of the box (2,): what a thrust of 1 means in the cost."""
        return np.maximum(self.high, -self.low)

    def box(self, start: Array, knots: Array) -> tuple[Array, Array]:
        """Lower and upper bound (N, 2) of U[1] .. U[N] from U[0] = ``start`` (2,): ``bounds`` at every knot (N+1,)."""
        reach = knots[1:, None] * self.max_change
        return np.minimum(self.low, start + reach), np.maximum(self.high, start - reach)

    def clip(self, commands: Array, knots: Array) -> Array:
        """``commands`` (N+1, 2) at ``knots`` (N+1,) moved, knot by knot from the first, to the nearest that obey box
        and slew exactly.
        """
        out = commands.copy()
        clip_to_limits(out, knots, self.low, self.high, self.max_change)
        return out


@jit
def command_bounds(start: float, reach: float, low: float, high: float) -> tuple[float, float]:
    """Lower and upper bound of one thruster's command at a knot to which it can change by ``reach`` from ``start``.

    A start outside the box (a limit that was just lowered) is brought in at the slew limit, so that the QP always has a
    solution. From a start inside, these are the box itself, however little of it is within reach: the slew rows hold
    the commands there already, and a box that is nowhere active costs the solver nothing.
    """
    return min(low, start + reach), max(high, start - reach)


@jit
def clip_to_limits(U: Array, t: Array, low: Array, high: Array, change: Array) -> None:
    """U (N+1, 2) at knots t (N+1,) in place: at each knot the slew from the knot before, then the box."""
    for k in range(1, U.shape[0]):
        for i in range(2):
            most_change = (t[k] - t[k - 1]) * change[i]
            least, most = command_bounds(U[0, i], t[k] * change[i], low[i], high[i])
            U[k, i] = min(max(U[k, i], U[k - 1, i] - most_change), U[k - 1, i] + most_change)
            U[k, i] = min(max(U[k, i], least), most)
