"""The actuators' own gate: which plan is in force, and the command that never leaves box or slew.

Target   T(t) = the newest accepted plan whose start has come, linear between its knots; after its last knot the
         lateral thrusts are zero and the vertical one is the vehicle's ``failsafe_vertical_N``
Command  y(t) (N), port, starboard, vertical:  y(t + dt) = y(t) + clip(T(t + dt) - y(t), -slew dt, slew dt)

So a plan that starts at the command in force is followed exactly, one that comes late is met at the slew limit, and the
end of the last plan is a ramp. A plan is refused where it leaves box or slew by itself, or comes out of order.

One commander at a time. A commander is known by its epoch, which each start of a controller draws anew. While plans of
one keep coming, those of every other are refused; who comes anew is accepted once two planned replacements of the one
in force are missing (``health.of_plans``: 2.5 of its periods, at least 0.5 s), or its last plan is at its end. So a
controller that died and was started again takes over with its first plan, and two that speak at once do not alternate.
"""

from __future__ import annotations

import enum
from bisect import bisect_right

import msgspec
import numpy as np

from ltv_mpc.safety.ages import Period
from ltv_mpc.safety.health import of_plans
from ltv_mpc.signals import Health, Plan, Triple
from ltv_mpc.vehicle.parameters import Vehicle

TOLERANCE_N = 1e-6
"""What rounding may add to a plan's box and to its change from knot to knot; the command itself has no such margin."""


COMMANDERS = 64
"""Of so many the last sequence is remembered: a frame of one that spoke before is not followed twice."""


class Verdict(enum.StrEnum):
    """What became of a plan."""

    ACCEPTED = "accepted"
    LATE = "late"  # accepted after its start time: a deadline miss
    OUT_OF_ORDER = "out_of_order"
    SECOND_COMMANDER = "second_commander"
    OUTSIDE_BOX = "outside_box"
    OUTSIDE_SLEW = "outside_slew"


class _Followed(msgspec.Struct, frozen=True):
    """A plan as plain numbers: commands are asked for a hundred times a second."""

    t_ns: list[int]
    thrust_N: list[list[float]]

    def target(self, t_ns: int, rest: Triple) -> Triple:
        times = self.t_ns
        if t_ns > times[-1]:
            return rest
        i = min(max(bisect_right(times, t_ns) - 1, 0), len(times) - 2)
        s = (t_ns - times[i]) / (times[i + 1] - times[i])
        a, b = self.thrust_N[i], self.thrust_N[i + 1]
        return a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]), a[2] + s * (b[2] - a[2])


class Gate:
    """Judges plans and turns them into commands. Time only goes forward; it starts, at zero, with the first command."""

    def __init__(self, vehicle: Vehicle) -> None:
        """Box, slew and what the vertical thruster does without a plan come from the vehicle."""
        self._low = np.array([t.min_N for t in vehicle.thrusters])
        self._high = np.array([t.max_N for t in vehicle.thrusters])
        self._slew = np.array([t.slew_N_per_s for t in vehicle.thrusters])
        self._limits = list(zip(self._low.tolist(), self._high.tolist(), self._slew.tolist(), strict=True))
        self._rest = (0.0, 0.0, vehicle.failsafe_vertical_N)
        self._last_sequence: dict[int, int] = {}  # by epoch, the one accepted last at the end
        self._epoch: int | None = None  # of the commander
        self._accepted_ns = 0
        self._period = Period()  # of its cycles
        self._plans: list[_Followed] = []  # the one in force and those that wait, by start time
        self._t_ns: int | None = None
        self._command: Triple = (0.0, 0.0, 0.0)
        self.plans_late = 0
        self.plans_refused = 0

    def offer(self, plan: Plan, epoch: int, sequence: int, t_ns: int) -> Verdict:
        """Judge a plan that arrived at ``t_ns``; if accepted it takes over at its start, or at once if that is past."""
        verdict = self._judge(plan, epoch, sequence, t_ns)
        if verdict is not Verdict.ACCEPTED:
            self.plans_refused += 1
            return verdict
        self._accepted(epoch, sequence, plan.cycle_t_ns, t_ns)
        followed = _Followed(plan.t_ns.tolist(), plan.thrust_N.tolist())
        start = followed.t_ns[0]
        # It replaces what was to start with it or after it; what starts before stays in force until then.
        self._plans = [p for p in self._plans if p.t_ns[0] < start] + [followed]
        if t_ns > start:
            self.plans_late += 1
            return Verdict.LATE
        return Verdict.ACCEPTED

    def health(self, t_ns: int) -> Health:
        """How well the plans keep up at ``t_ns``."""
        return of_plans(
            silent_ns=None if self._epoch is None else t_ns - self._accepted_ns,
            period_ns=self._period.median_ns,
            left_ns=self._plans[-1].t_ns[-1] - t_ns if self._plans else -1,
        )

    def _accepted(self, epoch: int, sequence: int, cycle_ns: int, t_ns: int) -> None:
        if epoch != self._epoch:
            self._epoch, self._period = epoch, Period()
        self._last_sequence.pop(epoch, None)
        self._last_sequence[epoch] = sequence
        if len(self._last_sequence) > COMMANDERS:
            del self._last_sequence[next(iter(self._last_sequence))]
        self._accepted_ns = t_ns
        self._period.stamped(cycle_ns)

    def _judge(self, plan: Plan, epoch: int, sequence: int, t_ns: int) -> Verdict:
        if sequence <= self._last_sequence.get(epoch, -1):
            return Verdict.OUT_OF_ORDER
        if self._epoch not in (None, epoch) and self.health(t_ns) is Health.NOMINAL:
            return Verdict.SECOND_COMMANDER
        thrust, seconds = plan.thrust_N, np.diff(plan.t_ns) * 1e-9
        # Written so that NaN is outside.
        if not ((thrust >= self._low - TOLERANCE_N) & (thrust <= self._high + TOLERANCE_N)).all():
            return Verdict.OUTSIDE_BOX
        if not (np.abs(np.diff(thrust, axis=0)) <= seconds[:, None] * self._slew + TOLERANCE_N).all():
            return Verdict.OUTSIDE_SLEW
        return Verdict.ACCEPTED

    def command_at(self, t_ns: int) -> Triple:
        """The command (N) at ``t_ns``, not before the time asked for last; linear from there to here."""
        if self._t_ns is None:
            self._t_ns = t_ns
        if t_ns < self._t_ns:
            raise ValueError(f"commands at {self._t_ns} ns are out already, {t_ns} ns is before")
        if t_ns == self._t_ns:
            return self._command
        plans = self._plans
        while len(plans) > 1 and plans[1].t_ns[0] <= t_ns:
            del plans[0]
        target = plans[0].target(t_ns, self._rest) if plans and plans[0].t_ns[0] <= t_ns else self._rest
        seconds = (t_ns - self._t_ns) * 1e-9
        y, limits = self._command, self._limits
        self._command = (
            _towards(y[0], target[0], seconds, limits[0]),
            _towards(y[1], target[1], seconds, limits[1]),
            _towards(y[2], target[2], seconds, limits[2]),
        )
        self._t_ns = t_ns
        return self._command


def _towards(y: float, target: float, seconds: float, limits: Triple) -> float:
    """y + clip(T - y, -slew dt, slew dt), with T in the box: comparisons, of which a call of max() costs three."""
    low, high, slew = limits
    change, reach = (low if target < low else high if target > high else target) - y, slew * seconds
    return y + (-reach if change < -reach else reach if change > reach else change)
