"""Plan queue: the plans that were accepted or sent, which of them is in force, and the receipt of the newest one.

The plan in force is the newest of those that have started, until its end. A plan replaces those that begin with it or
later. Actuators, edges and the check of the actuators' reports each have a queue.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import cast

from ltv_mpc.messages import Applied, Array, Health, Plan, Triple
from ltv_mpc.safety.health import plan_end_ns, plan_timeout_ns
from ltv_mpc.safety.input_age import InputAge

MAX_PLANS = 128
"""Number of plans that are kept: reports about them may be delayed by many seconds."""


class PlanQueue:
    """Plans by their start."""

    def __init__(self, timeout_s: float) -> None:
        """Begin without a plan.

        Parameters
        ----------
        timeout_s : ``plan_timeout_s`` of the vehicle (s).
        """
        self.plans_late = 0
        """Number of plans that arrived after their start."""
        self.identity = 0, -1
        """Epoch and sequence of the newest plan; 0 and -1 before the first."""
        self._timeout_s = timeout_s
        self._plans: deque[Plan] = deque(maxlen=MAX_PLANS)
        self._age = InputAge()  # of the plans, by the start of the cycle
        self.is_late = False
        """The newest plan arrived after its start."""

    def add(self, plan: Plan, t_ns: int, identity: tuple[int, int] = (0, -1)) -> None:
        """Add a plan: it is in force from its first knot on, or at once if that is past.

        Parameters
        ----------
        plan : the plan.
        t_ns : time of its arrival (ns).
        identity : epoch and sequence of its header.
        """
        while self._plans and self._plans[-1].t_ns[0] >= plan.t_ns[0]:
            self._plans.pop()
        self._plans.append(plan)
        self._age.add(plan.cycle_t_ns, t_ns)
        self.identity, self.is_late = identity, bool(t_ns > plan.t_ns[0])
        self.plans_late += self.is_late

    def begun(self, t_ns: int) -> Iterator[Plan]:
        """Yield the plans that had started at a time, the newest first: the one in force, and those before it.

        Parameters
        ----------
        t_ns : time (ns).
        """
        return (plan for plan in reversed(self._plans) if plan.t_ns[0] <= t_ns)

    def holds(self, cycle_t_ns: int) -> bool:
        """Return True if a plan is known.

        Parameters
        ----------
        cycle_t_ns : start of its cycle (ns).
        """
        return any(plan.cycle_t_ns == cycle_t_ns for plan in self._plans)

    def thrust_N(self, t_ns: int | None) -> Array | None:
        """Return the thrust (3,) of the plan in force; None before the first one starts and past its end.

        Parameters
        ----------
        t_ns : time (ns); None if it is not known.
        """
        if t_ns is None:
            return None
        plan = next(self.begun(t_ns), None)
        return None if plan is None or t_ns > self.end_ns(plan) else plan.thrust_at(t_ns)

    def end_ns(self, plan: Plan) -> int:
        """Return the time (ns) until which a plan is followed if no other one follows.

        Parameters
        ----------
        plan : the plan.
        """
        return plan_end_ns(plan.t_ns, self._age.median_ns, self._timeout_s)

    def health(self, t_ns: int) -> Health:
        """Return the timeliness of the plans: degraded before the first one, and while two replacements are missing.

        Parameters
        ----------
        t_ns : current time (ns).
        """
        silent_ns = self._age.silent_ns(t_ns)
        if silent_ns is None:
            return Health.DEGRADED
        if t_ns > self.end_ns(self._plans[-1]):
            return Health.FAILSAFE
        return Health.NOMINAL if silent_ns <= plan_timeout_ns(self._age.median_ns) else Health.DEGRADED

    @property
    def newest(self) -> Plan | None:
        """Plan that was added last."""
        return self._plans[-1] if self._plans else None

    def applied(
        self,
        t_ns: int,
        thrust_N: Array,
        command_N: Array,
        *,
        slew_N_per_s: Triple = (0.0, 0.0, 0.0),
        rejected: int = 0,
        why: str = "",
    ) -> Applied:
        """Return the report of the actuators, with the receipt of the newest plan.

        Parameters
        ----------
        t_ns : current time (ns).
        thrust_N, command_N : (3,) delivered and commanded thrust (N).
        slew_N_per_s, rejected, why : other fields of the report.
        """
        epoch, sequence = self.identity
        newest = self.newest
        return Applied(
            t_ns=t_ns,
            thrust_N=cast(Triple, tuple(thrust_N.tolist())),
            command_N=cast(Triple, tuple(command_N.tolist())),
            command_slew_N_per_s=slew_N_per_s,
            plan_epoch=epoch,
            plan_sequence=sequence,
            plan_cycle_t_ns=0 if newest is None else newest.cycle_t_ns,
            plan_received_t_ns=self._age.arrived_ns,
            plan_late=self.is_late,
            plans_late=self.plans_late,
            plans_rejected=rejected,
            health=self.health(t_ns),
            why=why,
        )
