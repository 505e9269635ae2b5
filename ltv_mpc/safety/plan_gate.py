"""Plan gate of the actuators: select the plan in force and compute a command that never leaves box or slew limit.

Target   T(t) = the newest accepted plan that has started, linear between its knots; after its end the lateral
         thrusts are zero and the vertical one is the vehicle's ``failsafe_vertical_N``; zero before the first plan
End      of a plan: its last knot, but at most max(``plan_timeout_s`` of the vehicle, 2.5 periods) after its first one
Command  y(t) (N), port, starboard, vertical:  y(t + dt) = y(t) + clip(T(t + dt) - y(t), -slew dt, slew dt)

A plan that starts at the command in force is followed exactly. The command approaches a late plan at the slew limit,
and the end of the last plan is a ramp. The horizon says how far the controller looks ahead, not how long the vehicle
may move after the controller has died. A plan is rejected if it violates box or slew limit itself, is out of order, or
has ended before it arrives: with wrong stamps it would otherwise stop a vehicle that has a sound plan.

One commander at a time. A commander is identified by its epoch, which each start of a controller draws at random.
While plans of one commander keep coming, those of all others are rejected. A new commander is accepted once two planned
replacements of the plan in force are missing (``PlanQueue.health``: 2.5 periods, at least 0.5 s), or the plan is at its
end. So a restarted controller takes over with its first plan, and two controllers that send at once do not
alternate.
"""

from __future__ import annotations

import enum

import numpy as np

from ltv_mpc.bounded import remember
from ltv_mpc.messages import Health, Plan, Triple
from ltv_mpc.safety.input_age import InputAge
from ltv_mpc.safety.plan_queue import PlanQueue
from ltv_mpc.vehicle.parameters import Vehicle

TOLERANCE_N = 1e-6
"""Tolerance for rounding in a plan's thrusts and in their change between knots; the command itself has no tolerance."""


class PlanVerdict(enum.StrEnum):
    """Result of the checks on a plan."""

    ACCEPTED = "accepted"
    LATE = "late"  # accepted after its start time: a deadline miss
    OUT_OF_ORDER = "out_of_order"
    SECOND_COMMANDER = "second_commander"
    ENDED = "ended"  # its end has passed
    OUTSIDE_BOX = "outside_box"
    OUTSIDE_SLEW = "outside_slew"


class PlanGate(PlanQueue):
    """Checks plans and computes the commands of the thrusters.

    Time only increases. It starts with the first command, which is zero.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        super().__init__(vehicle.plan_timeout_s)
        self._limits = [(t.min_N, t.max_N, t.slew_N_per_s) for t in vehicle.thrusters]
        self._rest = 0.0, 0.0, vehicle.failsafe_vertical_N
        self._commander: int | None = None  # epoch of the controller whose plans are followed
        self._last_sequence: dict[int, int] = {}  # accepted, by epoch: an old frame is not followed again
        self._t_ns: int | None = None
        self._command = 0.0, 0.0, 0.0
        self.plans_rejected = 0
        """Number of plans rejected."""

    def offer(self, plan: Plan, epoch: int, sequence: int, t_ns: int) -> PlanVerdict:
        """Check a plan. An accepted plan takes over at its start, or at once if that is past.

        Parameters
        ----------
        plan : the plan.
        epoch, sequence : its header.
        t_ns : time of its arrival (ns).
        """
        verdict = self._check(plan, epoch, sequence, t_ns)
        if verdict is not PlanVerdict.ACCEPTED:
            self.plans_rejected += 1
            return verdict
        if epoch != self._commander:
            self._commander, self._age = epoch, InputAge()
        remember(self._last_sequence, epoch, sequence)
        self.add(plan, t_ns, (epoch, sequence))
        return PlanVerdict.LATE if self.is_late else PlanVerdict.ACCEPTED

    def _check(self, plan: Plan, epoch: int, sequence: int, t_ns: int) -> PlanVerdict:
        if sequence <= self._last_sequence.get(epoch, -1):
            return PlanVerdict.OUT_OF_ORDER
        if self._commander not in (None, epoch) and self.health(t_ns) is Health.NOMINAL:
            return PlanVerdict.SECOND_COMMANDER
        if self.end_ns(plan) < t_ns:
            return PlanVerdict.ENDED
        thrust, seconds = plan.thrust_N, (plan.t_ns[1:] - plan.t_ns[:-1]) * 1e-9
        low, high, slew = np.array(self._limits).T
        # written so that NaN is outside
        if not ((thrust >= low - TOLERANCE_N) & (thrust <= high + TOLERANCE_N)).all():
            return PlanVerdict.OUTSIDE_BOX
        if not (np.abs(thrust[1:] - thrust[:-1]) <= seconds[:, None] * slew + TOLERANCE_N).all():
            return PlanVerdict.OUTSIDE_SLEW
        return PlanVerdict.ACCEPTED

    def command_at(self, t_ns: int) -> Triple:
        """Return the command (N): port, starboard, vertical. It is linear from the last requested time to ``t_ns``.

        Parameters
        ----------
        t_ns : time (ns).

        Raises
        ------
        ValueError
            If the time is before the last requested one.
        """
        last_ns = t_ns if self._t_ns is None else self._t_ns
        if t_ns < last_ns:
            raise ValueError(f"t_ns = {t_ns} is before {last_ns}, the time of the last command")
        targets: Triple | list[float] = (0.0, 0.0, 0.0)  # no plan has started yet
        if (plan := next(self.begun(t_ns), None)) is not None:
            targets = plan.thrust_at(t_ns).tolist() if t_ns <= self.end_ns(plan) else self._rest
        seconds = (t_ns - last_ns) * 1e-9
        port, starboard, vertical = (
            y + min(max(min(max(target, low), high) - y, -slew * seconds), slew * seconds)
            for y, target, (low, high, slew) in zip(self._command, targets, self._limits, strict=True)
        )
        self._command, self._t_ns = (port, starboard, vertical), t_ns
        return port, starboard, vertical
