"""Which commands are in force when: everything that was sent, as one piecewise linear function of time.

A plan takes over from the one before at its own start; after the last knot the commands go to zero at the slew limit,
which is what the actuators do when nobody speaks to them. Dead time is compensated by rolling the vehicle through the
commands that were really sent, in their order; Autoware and Nav2 both first got this wrong. Where the actuators report
another command than that (a plan came late, or this controller is new), theirs is the truth: from there they go towards
the plan at the slew limit.
"""

from __future__ import annotations

import numpy as np

from ltv_mpc.jit import jit
from ltv_mpc.messages import Array, Plan, Times, Triple
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

    def add(self, plan: Plan) -> None:
        """``plan`` was sent: it is in force from its first knot on."""
        self._t, self._thrust = supersede(self._t, self._thrust, plan.t_ns, plan.thrust_N, self._slew, self._rest)

    @property
    def knots(self) -> tuple[Times, Array]:
        """Times (M,) and commands (M, 3): linear between, constant beyond."""
        return self._t, self._thrust

    def correct(self, t_ns: int, command_N: Triple) -> None:
        """The actuators say what was in force at ``t_ns``."""
        port, starboard, vertical = command_N
        if _apart(self._t, self._thrust, t_ns, port, starboard, vertical) <= AGREES_N:
            return
        times, commands = [t_ns], [np.array(command_N)]
        target = self.at(np.array(times, dtype=np.int64))[0]
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


@jit
def supersede(
    t: Times, thrust: Array, plan_t: Times, plan_thrust: Array, slew: Array, rest: Array
) -> tuple[Times, Array]:
    """Knots t (M,), thrust (M, 3) until the plan begins, then the plan, then its way to rest at the slew limit."""
    first = np.searchsorted(t, plan_t[0] - KEPT_NS, side="right")
    until = np.searchsorted(t, plan_t[0], side="left")
    end = len(plan_t) - 1
    # One knot where each thruster comes to rest, in their order.
    seconds = np.abs(plan_thrust[end] - rest) / slew
    corners, count, latest = np.empty(3), 0, 0.0
    while True:
        soonest = np.inf
        for j in range(3):
            if latest < seconds[j] < soonest:
                soonest = seconds[j]
        if soonest == np.inf:
            break
        corners[count] = latest = soonest
        count += 1
    kept, ahead = max(until - first, 0), len(plan_t)
    out_t = np.empty(kept + ahead + count, dtype=np.int64)
    out = np.empty((len(out_t), 3))
    for i in range(kept):
        out_t[i] = t[first + i]
        for j in range(3):
            out[i, j] = thrust[first + i, j]
    for i in range(ahead):
        out_t[kept + i] = plan_t[i]
        for j in range(3):
            out[kept + i, j] = plan_thrust[i, j]
    for i in range(count):
        at = kept + ahead + i
        out_t[at] = plan_t[end] + np.int64(np.ceil(corners[i] * 1e9))
        for j in range(3):
            left = 1.0 - min(corners[i] / seconds[j], 1.0) if seconds[j] > 0.0 else 1.0
            out[at, j] = rest[j] + left * (plan_thrust[end, j] - rest[j])
    return out_t, out


@jit
def command_at(t: Times, thrust: Array, at: int, i: int) -> float:
    """Thruster i's command at one time, by knots t (M,), thrust (M, 3): zero where nothing was sent."""
    if len(t) == 0:
        return 0.0
    k = np.searchsorted(t, at, side="right")
    if k == 0:
        return float(thrust[0, i])
    if k == len(t):
        return float(thrust[k - 1, i])
    # Differences of times are exact in float64 and keep their nanoseconds.
    part = float(at - t[k - 1]) / float(t[k] - t[k - 1])
    return float(thrust[k - 1, i] + part * (thrust[k, i] - thrust[k - 1, i]))


@jit
def _apart(t: Times, thrust: Array, at: int, port: float, starboard: float, vertical: float) -> float:
    """By how much these differ from the commands at one time, by knots as in ``command_at``: the largest of three."""
    return max(
        abs(command_at(t, thrust, at, 0) - port),
        abs(command_at(t, thrust, at, 1) - starboard),
        abs(command_at(t, thrust, at, 2) - vertical),
    )
