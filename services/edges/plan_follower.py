"""Plan in force at an instant, and the report of what acts: the thrusts that an edge has the thrusters deliver.

The plan in force is the newest of those that have started, until its end. Thrust is delivered, from rest, of the
commands u since the last report, which are zero while the edge has released the thrusters:

    F_i += (1 - exp(-dt / lag_i)) (u_i - F_i)

The controller then plans from what acts, and learns nothing while the commands are not those of its plans.
"""

from __future__ import annotations

from collections import deque
from typing import cast

import numpy as np

from ltv_mpc.messages import Applied, Array, Authority, Health, Plan, Triple
from ltv_mpc.safety.health import plan_end_ns, plan_health
from ltv_mpc.safety.input_age import InputAge
from ltv_mpc.vehicle.parameters import PLAN_TIMEOUT_S, Vehicle

PERIOD_NS = 100_000_000


class PlanFollower:
    """Thrust of the plan in force at an instant, and the receipt of the newest one."""

    def __init__(self) -> None:
        self._plans: deque[Plan] = deque(maxlen=8)  # in force, then those that begin later
        self._period = InputAge()  # of the plans
        self.identity = 0, -1
        """Epoch and sequence of the newest plan; 0 and -1 before the first."""
        self.received_t_ns = 0
        """Vehicle time of its arrival; 0 before the first."""
        self.late = 0
        """Number of plans that arrived after their first knot."""

    def follow(self, plan: Plan, t_ns: int | None = None, identity: tuple[int, int] = (0, -1)) -> None:
        """Take a plan that arrived at vehicle time ``t_ns`` (None: unknown), of an epoch and a sequence."""
        if not self._plans or plan.cycle_t_ns > self.cycle_t_ns:
            self._period.add(plan.cycle_t_ns)
        begins_ns = int(plan.t_ns[0])
        while self._plans and self._plans[-1].t_ns[0] >= begins_ns:
            self._plans.pop()
        self._plans.append(plan)
        self.identity, self.received_t_ns = identity if t_ns is not None else (0, -1), t_ns or 0
        self.late += self.received_t_ns > begins_ns

    def thrust_N(self, t_ns: int | None) -> Array | None:
        """Return the thrust (3,) in N at vehicle time ``t_ns``; None without a plan or a time, and past the plan's end.

        The plan ends as at any actuators, with the ``plan_timeout_s`` of a vehicle file that does not set it.
        """
        if not self._plans or t_ns is None:
            return None
        while len(self._plans) > 1 and self._plans[1].t_ns[0] <= t_ns:
            self._plans.popleft()
        plan = self._plans[0]
        return None if t_ns > self._end_ns(plan) else plan.thrust_at(t_ns)

    def health(self, t_ns: int) -> Health:
        """Return the timeliness of the plans at vehicle time ``t_ns``; nothing is late before the first one."""
        if not self._plans:
            return Health.NOMINAL
        left_ns, silent_ns = self._end_ns(self._plans[-1]) - t_ns, t_ns - self.received_t_ns
        return plan_health(silent_ns=silent_ns, period_ns=self._period.median_ns, left_ns=left_ns)

    @property
    def has_plan(self) -> bool:
        """True after the first plan."""
        return bool(self._plans)

    @property
    def cycle_t_ns(self) -> int:
        """Start of the cycle of the newest plan; 0 before the first."""
        return self._plans[-1].cycle_t_ns if self._plans else 0

    @property
    def authority(self) -> Authority:
        """Source of the commands of the newest plan."""
        return self._plans[-1].authority if self._plans else Authority.DISARMED

    def _end_ns(self, plan: Plan) -> int:
        return plan_end_ns(plan.t_ns, self._period.median_ns, PLAN_TIMEOUT_S)


class AppliedReporter:
    """Reports of the commands of an edge, every 0.1 s."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._lag_s = np.array([max(thruster.lag_s, 1e-9) for thruster in vehicle.thrusters])
        self._thrust_N, self._command_N = np.zeros(3), np.zeros(3)
        self._t_ns = self._reported_ns = 0
        self._released = True

    def report(self, plans: PlanFollower, command_N: Array | None, t_ns: int | None, why: str = "") -> list[Applied]:
        """Take the command from ``t_ns`` on, None for released thrusters, and why. Return the report if it is due.

        It is due at once when the thrusters are released.
        """
        if t_ns is None:
            return []
        seconds = max(t_ns - self._t_ns, 0) * 1e-9
        self._thrust_N += (1.0 - np.exp(-seconds / self._lag_s)) * (self._command_N - self._thrust_N)
        self._command_N, self._t_ns = np.zeros(3) if command_N is None else np.asarray(command_N, dtype=float), t_ns
        released, self._released = self._released, command_N is None
        if 0 <= t_ns - self._reported_ns < PERIOD_NS and released >= self._released:
            return []
        self._reported_ns = t_ns
        epoch, sequence = plans.identity
        return [
            Applied(
                t_ns=t_ns,
                thrust_N=cast(Triple, tuple(self._thrust_N.tolist())),
                command_N=cast(Triple, tuple(self._command_N.tolist())),
                command_slew_N_per_s=(0.0, 0.0, 0.0),
                plan_epoch=epoch,
                plan_sequence=sequence,
                plan_cycle_t_ns=plans.cycle_t_ns,
                plan_received_t_ns=plans.received_t_ns,
                plans_late=plans.late,
                plans_rejected=0,
                health=plans.health(t_ns),
                why=why,
            )
        ]
