"""Which commands are in force when: everything that was sent, as one piecewise linear function of time.

A plan takes over from the one before at its own start; after the last knot the commands go to zero at the slew limit,
which is what the actuators do when nobody speaks to them. Dead time is compensated by rolling the vehicle through the
commands that were really sent, in their order; Autoware and Nav2 both first got this wrong. Where the actuators report
another command than that (a plan came late, or this controller is new), theirs is the truth: from there they go towards
the plan at the slew limit.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.signals import Array, Plan, Times, Triple
from ltv_mpc.vehicle.parameters import Vehicle

KEPT_NS = 10_000_000_000
"""How far back the commands are remembered: longer than any estimate is late."""

AGREES_N = 0.01
"""Two commands that differ by less are the same: what is left of rounding."""

CATCH_UP_NS = 10_000_000
"""Steps in which the actuators' way to the plan is followed."""


class SentCommands:
    """The commands that the actuators follow, by time: port, starboard, vertical."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._slew = np.array([t.slew_N_per_s for t in vehicle.thrusters])
        self._rest = np.array([0.0, 0.0, vehicle.failsafe_vertical_N])
        self._t: Times = np.empty(0, dtype=np.int64)
        self._thrust: Array = np.empty((0, 3))

    def sent(self, plan: Plan) -> None:
        """``plan`` was sent: it is in force from its first knot on."""
        start = int(plan.t_ns[0])
        old = (self._t < start) & (self._t > start - KEPT_NS)
        end_t, end_thrust = self._ramp_down(int(plan.t_ns[-1]), plan.thrust_N[-1])
        self._t = np.concatenate([self._t[old], plan.t_ns, end_t])
        self._thrust = np.concatenate([self._thrust[old], plan.thrust_N, end_thrust])

    def reported(self, t_ns: int, command_N: Triple) -> None:
        """The actuators say what was in force at ``t_ns``."""
        now = np.array([t_ns], dtype=np.int64)
        command = np.array(command_N)
        if np.abs(self.at(now)[0] - command).max() <= AGREES_N:
            return
        times, commands = [t_ns], [command]
        target = self.at(now)[0]
        while np.abs(target - commands[-1]).max() > AGREES_N and times[-1] < t_ns + KEPT_NS:
            times.append(times[-1] + CATCH_UP_NS)
            target = self.at(np.array(times[-1:], dtype=np.int64))[0]
            reach = self._slew * CATCH_UP_NS * 1e-9
            commands.append(commands[-1] + np.clip(target - commands[-1], -reach, reach))
        before, after = self._t < t_ns, self._t > times[-1]
        self._t = np.concatenate([self._t[before], np.array(times, dtype=np.int64), self._t[after]])
        self._thrust = np.concatenate([self._thrust[before], np.array(commands), self._thrust[after]])

    def at(self, t_ns: Times) -> Array:
        """Commands (M, 3) at times t_ns (M,): zero where nothing was sent, before the first knot what that says."""
        if not len(self._t):
            return np.zeros((len(t_ns), 3))
        # Times relative to the first knot are exact in float64 and keep their nanoseconds.
        x, xp = (t_ns - self._t[0]).astype(np.float64), (self._t - self._t[0]).astype(np.float64)
        return np.stack([np.interp(x, xp, self._thrust[:, i]) for i in range(3)], axis=1)

    def between(self, from_ns: int, until_ns: int) -> Times:
        """The knots with from_ns < t < until_ns, and both ends: commands are linear between neighbours."""
        inner = self._t[(self._t > from_ns) & (self._t < until_ns)]
        return np.concatenate([[from_ns], inner, [until_ns]]).astype(np.int64)

    def _ramp_down(self, end_ns: int, thrust: Array) -> tuple[Times, Array]:
        """Knots from the end of a plan to rest, one where each thruster gets there."""
        seconds = np.abs(thrust - self._rest) / self._slew
        corners = np.unique(seconds[seconds > 0])
        if not len(corners):
            return np.empty(0, dtype=np.int64), np.empty((0, 3))
        left = 1.0 - np.minimum(corners[:, None] / np.where(seconds > 0, seconds, 1.0), 1.0)
        return end_ns + np.ceil(corners * 1e9).astype(np.int64), self._rest + left * (thrust - self._rest)
