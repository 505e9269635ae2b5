"""The actuators' own gate: which plan is in force, and the command that never leaves box or slew.

Target   T(t) = the newest accepted plan whose start has come, linear between its knots; after its last knot the
         lateral thrusts are zero and the vertical one is the vehicle's ``failsafe_vertical_N``
Command  y(t) (N), port, starboard, vertical:  y(t + dt) = y(t) + clip(T(t + dt) - y(t), -slew dt, slew dt)

So a plan that starts at the command in force is followed exactly, one that comes late is met at the slew limit, and the
end of the last plan is a ramp. A plan is refused where it leaves box or slew by itself, or comes out of order.

One commander at a time. A commander is known by its epoch, which each start of a controller draws anew. While plans of
one keep coming, those of every other are refused; who comes anew is accepted once two planned replacements of the one
in force are missing (``health.plan_health``: 2.5 of its periods, at least 0.5 s), or its last plan is at its end. So a
controller that died and was started again takes over with its first plan, and two that speak at once do not alternate.
"""

from __future__ import annotations

import enum
from bisect import bisect_left
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ltv_mpc.jit import copy_to, jit
from ltv_mpc.messages import Array, Health, Plan, Triple
from ltv_mpc.safety.health import plan_health
from ltv_mpc.safety.input_monitor import Period
from ltv_mpc.vehicle.parameters import Vehicle

TOLERANCE_N = 1e-6
"""What rounding may add to a plan's box and to its change from knot to knot; the command itself has no such margin."""


COMMANDERS = 64
"""Of so many the last sequence is remembered: a frame of one that spoke before is not followed twice."""


class PlanVerdict(enum.StrEnum):
    """What became of a plan."""

    ACCEPTED = "accepted"
    LATE = "late"  # accepted after its start time: a deadline miss
    OUT_OF_ORDER = "out_of_order"
    SECOND_COMMANDER = "second_commander"
    OUTSIDE_BOX = "outside_box"
    OUTSIDE_SLEW = "outside_slew"


class _Followed(NamedTuple):
    """A plan as compiled code reads it."""

    start_ns: int
    end_ns: int
    t_ns: npt.NDArray[np.int64]  # (M,)
    thrust_N: Array  # (M, 3)


_NONE = _Followed(0, -1, np.empty(0, dtype=np.int64), np.empty((0, 3)))


class PlanGate:
    """Judges plans and turns them into commands. Time only goes forward; it starts, at zero, with the first command."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Box, slew and what the vertical thruster does without a plan come from the vehicle."""
        self._low = np.array([t.min_N for t in vehicle.thrusters])
        self._high = np.array([t.max_N for t in vehicle.thrusters])
        self._slew = np.array([t.slew_N_per_s for t in vehicle.thrusters])
        self._limits = np.stack([self._low, self._high, self._slew])
        self._rest = np.array([0.0, 0.0, vehicle.failsafe_vertical_N])
        self._last_sequence: dict[int, int] = {}  # by epoch, the one accepted last at the end
        self._epoch: int | None = None  # of the commander
        self._accepted_ns = 0
        self._period = Period()  # of its cycles
        self._plans: list[_Followed] = []  # the one in force and those that wait, by start time
        self._t_ns: int | None = None
        self._command: Triple = (0.0, 0.0, 0.0)
        self.plans_late = 0
        self.plans_rejected = 0

    def offer(self, plan: Plan, epoch: int, sequence: int, t_ns: int) -> PlanVerdict:
        """Judge a plan that arrived at ``t_ns``; if accepted it takes over at its start, or at once if that is past."""
        verdict = self._judge(plan, epoch, sequence, t_ns)
        if verdict is not PlanVerdict.ACCEPTED:
            self.plans_rejected += 1
            return verdict
        self._accepted(epoch, sequence, plan.cycle_t_ns, t_ns)
        start_ns, end_ns = int(plan.t_ns[0]), int(plan.t_ns[-1])
        followed = _Followed(start_ns, end_ns, plan.t_ns.astype(np.int64), plan.thrust_N.astype(np.float64, order="C"))
        # It replaces what was to start with it or after it; what starts before stays in force until then.
        self._plans = [p for p in self._plans if p.start_ns < start_ns] + [followed]
        if t_ns > start_ns:
            self.plans_late += 1
            return PlanVerdict.LATE
        return PlanVerdict.ACCEPTED

    def health(self, t_ns: int) -> Health:
        """How well the plans keep up at ``t_ns``."""
        return plan_health(
            silent_ns=None if self._epoch is None else t_ns - self._accepted_ns,
            period_ns=self._period.median_ns,
            left_ns=self._plans[-1].end_ns - t_ns if self._plans else -1,
        )

    def _accepted(self, epoch: int, sequence: int, cycle_ns: int, t_ns: int) -> None:
        if epoch != self._epoch:
            self._epoch, self._period = epoch, Period()
        self._last_sequence.pop(epoch, None)
        self._last_sequence[epoch] = sequence
        if len(self._last_sequence) > COMMANDERS:
            del self._last_sequence[next(iter(self._last_sequence))]
        self._accepted_ns = t_ns
        self._period.add(cycle_ns)

    def _judge(self, plan: Plan, epoch: int, sequence: int, t_ns: int) -> PlanVerdict:
        if sequence <= self._last_sequence.get(epoch, -1):
            return PlanVerdict.OUT_OF_ORDER
        if self._epoch not in (None, epoch) and self.health(t_ns) is Health.NOMINAL:
            return PlanVerdict.SECOND_COMMANDER
        thrust, seconds = plan.thrust_N, (plan.t_ns[1:] - plan.t_ns[:-1]) * 1e-9
        # Written so that NaN is outside.
        if not ((thrust >= self._low - TOLERANCE_N) & (thrust <= self._high + TOLERANCE_N)).all():
            return PlanVerdict.OUTSIDE_BOX
        if not (np.abs(thrust[1:] - thrust[:-1]) <= seconds[:, None] * self._slew + TOLERANCE_N).all():
            return PlanVerdict.OUTSIDE_SLEW
        return PlanVerdict.ACCEPTED

    def command_at(self, t_ns: int) -> Triple:
        """The command (N) at ``t_ns``, not before the time asked for last; linear from there to here."""
        if t_ns != self._t_ns:
            self.commands_at([t_ns])
        return self._command

    def commands_at(self, times_ns: Sequence[int]) -> Array:
        """The commands (N) at these times, (K, 3), as if each were asked for in turn."""
        if self._t_ns is None:
            self._t_ns = times_ns[0]
        if times_ns[0] < self._t_ns:
            raise ValueError(f"commands at {self._t_ns} ns are out already, {times_ns[0]} ns is before")
        plans, times, y = self._plans, np.array(times_ns), np.array(self._command)
        commands = np.empty((len(times), 3))
        done = 0
        while done < len(times):
            while len(plans) > 1 and plans[1].start_ns <= times_ns[done]:
                del plans[0]
            until = bisect_left(times_ns, plans[1].start_ns, done) if len(plans) > 1 else len(times)
            plan = plans[0] if plans else _NONE
            here = commands[done:until]
            _follow(y, self._t_ns, times[done:until], plan.t_ns, plan.thrust_N, self._rest, self._limits, here)
            self._t_ns, done = times_ns[until - 1], until
        port, starboard, vertical = y.tolist()
        self._command = port, starboard, vertical
        return commands


@jit
def _follow(
    y: Array,
    from_ns: int,
    times_ns: npt.NDArray[np.int64],
    knots_ns: npt.NDArray[np.int64],
    thrust: Array,
    rest: Array,
    limits: Array,
    commands: Array,
) -> None:
    """y (3,) goes from ``from_ns`` on towards one plan, or to rest before and after it, and is written at each time.

    ``limits`` (3, 3): low, high and slew of each thruster.
    """
    M = len(knots_ns)
    T = np.empty(3)
    for k in range(len(times_ns)):
        t_ns = times_ns[k]
        if M > 0 and knots_ns[0] <= t_ns <= knots_ns[M - 1]:
            i = min(max(np.searchsorted(knots_ns, t_ns, side="right") - 1, 0), M - 2)
            s = (t_ns - knots_ns[i]) / (knots_ns[i + 1] - knots_ns[i])
            for j in range(3):
                T[j] = thrust[i, j] + s * (thrust[i + 1, j] - thrust[i, j])
        else:
            copy_to(T, rest)
        seconds = (t_ns - from_ns) * 1e-9
        for j in range(3):
            # y + clip(T - y, -slew dt, slew dt), with T in the box
            change, reach = min(max(T[j], limits[0, j]), limits[1, j]) - y[j], limits[2, j] * seconds
            y[j] += min(max(change, -reach), reach)
            commands[k, j] = y[j]
        from_ns = t_ns
