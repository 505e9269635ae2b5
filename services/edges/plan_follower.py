"""Plan in force at an instant: the newest of those that have started, until its end."""

from __future__ import annotations

from collections import deque

from ltv_mpc.messages import Array, Authority, Health, Plan
from ltv_mpc.safety.health import plan_end_ns, plan_health
from ltv_mpc.safety.input_age import InputAge
from ltv_mpc.vehicle.parameters import PLAN_TIMEOUT_S


class PlanFollower:
    """Thrust of the plan in force at an instant, and the receipt of the newest one."""

    def __init__(self) -> None:
        self._plans: deque[Plan] = deque(maxlen=8)  # in force, then those that begin later
        self._period = InputAge()  # of the plans
        self.identity = 0, -1
        """Epoch and sequence of the newest plan; 0 and -1 before the first."""
        self.received_t_ns = 0
        """Vehicle time of its arrival; 0 before the first."""
        self.is_late = False
        """It arrived after its first knot."""
        self.late = 0
        """Number of late plans."""

    def follow(self, plan: Plan, t_ns: int | None = None, identity: tuple[int, int] = (0, -1)) -> None:
        """Take a plan that arrived at vehicle time ``t_ns`` (None: unknown), of an epoch and a sequence."""
        if not self._plans or plan.cycle_t_ns > self.cycle_t_ns:
            self._period.add(plan.cycle_t_ns)
        begins_ns = int(plan.t_ns[0])
        while self._plans and self._plans[-1].t_ns[0] >= begins_ns:
            self._plans.pop()
        self._plans.append(plan)
        self.identity, self.received_t_ns = identity if t_ns is not None else (0, -1), t_ns or 0
        self.is_late = self.received_t_ns > begins_ns
        self.late += self.is_late

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

    def _end_ns(self, plan: Plan) -> int:
        return plan_end_ns(plan.t_ns, self._period.median_ns, PLAN_TIMEOUT_S)

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
