"""Commands in force by time: everything that was sent, as one piecewise linear function.

A plan takes over from the one before at its own start. After its end the commands ramp to rest at the slew limit, as
the actuators do without a new plan (``plan_gate.py``): the lateral ones to zero, the vertical one to
``failsafe_vertical_N``. The prediction of the state at the start of a new plan uses these commands. The actuators may
report another command (a plan came late, or this controller is new): then the report is taken as true, and from there
the commands approach the plan at the slew limit.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from ltv_mpc.jit import jit, linear_at
from ltv_mpc.messages import Array, Plan, Times, Triple
from ltv_mpc.safety.health import plan_end_ns
from ltv_mpc.vehicle.parameters import Vehicle

HISTORY_NS, HISTORY_LAGS = 10_000_000_000, 8.0
"""Shortest history while estimates arrive, in ns and in lags of a thruster. Without reports the delivered thrust
follows from it, and e^-8 of an error at its begin is left.
"""

MAX_HISTORY_NS = 60_000_000_000
"""Length of the history while they do not: it reaches back to the estimate in use, at most this far."""

BEFORE_ESTIMATE_NS = 1_000_000_000
"""Time before the estimate in use from which commands are kept: a report of the actuators may be older than it."""

TOLERANCE_N = 0.01
"""Largest difference between two commands that counts as rounding."""

CATCH_UP_STEP_NS = 10_000_000
"""Time step in which the reported command approaches the plan."""


Commands: TypeAlias = tuple[Times, Array]
"""Commands by time: knots (M,), vehicle time (ns); thrusts (M, 3) of port, starboard and vertical (N). They are linear
between the knots, constant beyond them, and zero if there are no knots.
"""


class SentCommands:
    """Commands that the actuators follow, by time."""

    def __init__(self, vehicle: Vehicle, period_ns: int = 0) -> None:
        """Begin before the first plan.

        Parameters
        ----------
        vehicle : its slew limits, its failsafe thrust and its ``plan_timeout_s`` are used.
        period_ns : period of the plans (ns).
        """
        self._slew = np.array([t.slew_N_per_s for t in vehicle.thrusters])
        self._rest = np.array([0.0, 0.0, vehicle.failsafe_vertical_N])
        self._history_ns = max(HISTORY_NS, round(HISTORY_LAGS * 1e9 * max(t.lag_s for t in vehicle.thrusters)))
        self._period_ns, self._timeout_s = period_ns, vehicle.plan_timeout_s
        self.knots: Commands = (np.empty(0, dtype=np.int64), np.empty((0, 3)))
        """Commands from ``HISTORY_NS`` ago on, or from the estimate of the last plan on if that is older."""

    def add(self, plan: Plan, *, before_N: Triple = (0.0, 0.0, 0.0)) -> None:
        """Add a plan that was sent.

        Parameters
        ----------
        plan : is in force from its first knot on.
        before_N : commands until then, if it is the first plan (N); by default the thrusters are at rest.
        """
        (t, thrust), start_ns = self.knots, int(plan.t_ns[0])
        if len(t) == 0:
            t, thrust = np.array([start_ns - 1]), np.array([before_N])
        estimate_ns = max(plan.estimate_t_ns - BEFORE_ESTIMATE_NS, start_ns - MAX_HISTORY_NS)
        past = slice(t.searchsorted(min(start_ns - self._history_ns, estimate_ns), "right"), t.searchsorted(start_ns))
        end_ns = plan_end_ns(plan.t_ns, self._period_ns, self._timeout_s)
        k = int(plan.t_ns.searchsorted(end_ns))
        last_N, before_ns = plan.thrust_N[k], int(plan.t_ns[k - 1])
        if k > 0:
            part = (end_ns - before_ns) / (int(plan.t_ns[k]) - before_ns)
            last_N = plan.thrust_N[k - 1] + part * (last_N - plan.thrust_N[k - 1])
        # One knot where each thruster comes to rest, in the order of time; two in one nanosecond share it.
        way_N = last_N - self._rest
        own_ns = np.ceil(np.abs(way_N) / self._slew * 1e9)
        ramp_ns = np.array(sorted({0.0, *own_ns.tolist()}))
        left = 1.0 - np.minimum(ramp_ns[:, None] / np.maximum(own_ns, 1.0), 1.0)
        self.knots = (
            np.concatenate([t[past], plan.t_ns[:k], end_ns + ramp_ns.astype(np.int64)]),
            np.concatenate([thrust[past], plan.thrust_N[:k], self._rest + left * way_N]),
        )

    @property
    def oldest(self) -> tuple[int, Array]:
        """Time (ns) and commands (3,) of the oldest knot (N); zero if nothing was sent."""
        t, thrust = self.knots
        return (int(t[0]), thrust[0]) if len(t) else (0, np.zeros(3))

    def correct(self, t_ns: int, command_N: Triple) -> None:
        """Correct the commands by a report of the actuators.

        Parameters
        ----------
        t_ns : time of the report, vehicle time (ns).
        command_N : commands of port, starboard and vertical in force at ``t_ns`` (N).
        """
        t, thrust = self.knots
        times, commands = [t_ns], [np.array(command_N)]
        target = self.at(np.array(times, dtype=np.int64))[0]
        if np.abs(target - commands[0]).max() <= TOLERANCE_N:
            return
        while np.abs(target - commands[-1]).max() > TOLERANCE_N and times[-1] < t_ns + HISTORY_NS:
            times.append(times[-1] + CATCH_UP_STEP_NS)
            target = self.at(np.array(times[-1:], dtype=np.int64))[0]
            reach = self._slew * CATCH_UP_STEP_NS * 1e-9
            commands.append(commands[-1] + np.clip(target - commands[-1], -reach, reach))
        before, after = t < t_ns, t > times[-1]
        self.knots = (
            np.concatenate([t[before], np.array(times, dtype=np.int64), t[after]]),
            np.concatenate([thrust[before], np.array(commands), thrust[after]]),
        )

    def at(self, t_ns: Times) -> Array:
        """Return the commands in force.

        Parameters
        ----------
        t_ns : (M,) vehicle times (ns).

        Returns
        -------
        (M, 3) commands of port, starboard and vertical (N); zero if nothing was sent.
        """
        return commands_at(*self.knots, t_ns)


@jit
def commands_at(t: Times, thrust: Array, at: Times) -> Array:
    """Return the commands (K, 3) at several times.

    Parameters
    ----------
    t, thrust : (M,), (M, 3) commands by time (ns, N).
    at : (K,) times (ns).
    """
    out = np.empty((len(at), 3))
    for k in range(len(at)):
        for i in range(3):
            out[k, i] = linear_at(t, thrust[:, i], at[k])
    return out
