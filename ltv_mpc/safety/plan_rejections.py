"""Health of the controller by what the actuators report of its plans: rejections, and that none arrives."""

from __future__ import annotations

from collections import deque

from ltv_mpc.messages import Applied, Health
from ltv_mpc.safety.health import NOMINAL, HealthState, plan_timeout_ns

REJECTED_PLANS = "the actuators reject plans"
NO_PLANS = "no plan arrives at the actuators: the thrusters are at rest"

MIN_REJECTIONS = 2
"""Rejections within the window from which the health is degraded: a link that reorders two plans costs one."""


class PlanRejections:
    """Rejections of plans by the actuators, of this controller or of a second one, and the end of the last plan.

    The health is degraded from the second rejection within ``plan_timeout_ns`` on, until that time has passed without
    another one. It is also degraded while the actuators report that their last plan has ended.
    """

    def __init__(self, plan_period_ns: int) -> None:
        """Begin without a report.

        Parameters
        ----------
        plan_period_ns : period of the plans (ns).
        """
        self._window_ns = plan_timeout_ns(plan_period_ns)
        self._count: int | None = None  # in the newest report
        self._ended = False  # the last plan, by the newest report
        self._seen_ns: deque[int] = deque(maxlen=MIN_REJECTIONS)  # arrival of the reports of the last rejections

    def add(self, applied: Applied, received_ns: int) -> None:
        """Add a report; rejections before the first one, or before a restart of the actuators, do not count.

        Parameters
        ----------
        applied : report, newer than the last.
        received_ns : its arrival, vehicle time (ns).
        """
        count = applied.plans_rejected
        if self._count is not None:
            self._seen_ns.extend([received_ns] * min(count - self._count, MIN_REJECTIONS))
        self._count, self._ended = count, applied.health is Health.FAILSAFE

    def health(self, t_ns: int) -> HealthState:
        """Return the health by the newest report and the last rejections.

        Parameters
        ----------
        t_ns : now, vehicle time (ns).
        """
        if self._ended:
            return HealthState(Health.DEGRADED, NO_PLANS)
        seen = self._seen_ns
        if len(seen) < MIN_REJECTIONS or t_ns - seen[-1] > self._window_ns or seen[-1] - seen[0] > self._window_ns:
            return NOMINAL
        return HealthState(Health.DEGRADED, REJECTED_PLANS)
