"""Conversion between ROS 2 and this bus: odometry to an estimate, and a plan to a force for each thruster.

It reads no clock: the caller passes ``now_us``, the host's monotonic clock.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from ltv_mpc.messages import Array, Estimate, Plan
from ltv_mpc.safety.health import plan_end_ns
from ltv_mpc.safety.input_monitor import Period
from ltv_mpc.validation import rejection_reason
from ltv_mpc.vehicle.parameters import PLAN_TIMEOUT_S
from services.edges.ros2 import cdr
from services.edges.ros2.odometry import OdometryError, estimate_of

WINDOW_US = 30_000_000


class StampedClock:
    """Clock of the odometry's stamps, from the least delayed message of the last 30 s.

        time = monotonic + max (stamp - arrival)

    It is slow by the delay of that message: a fraction of a millisecond on one host.
    """

    def __init__(self) -> None:
        self._best: deque[tuple[int, int]] = deque()  # arrival (us), stamp - arrival (ns); decreasing

    def update(self, stamp_ns: int, now_us: int) -> None:
        """Add a message that arrived at ``now_us`` with this stamp."""
        offset_ns = stamp_ns - now_us * 1000
        while self._best and self._best[-1][1] <= offset_ns:
            self._best.pop()
        self._best.append((now_us, offset_ns))
        while self._best[0][0] < now_us - WINDOW_US:
            self._best.popleft()

    def read(self, now_us: int) -> int | None:
        """Return the time (ns) at ``now_us``; None before the first message."""
        return now_us * 1000 + self._best[0][1] if self._best else None


class Edge:
    """Converter with counts: ``accepted`` odometry became an estimate, ``rejected`` odometry did not."""

    def __init__(self) -> None:
        self._clock = StampedClock()
        self._plan: Plan | None = None
        self._period = Period()  # of the plans
        self.accepted = 0
        self.rejected = 0
        self.reason = ""  # of the last rejection

    def odometry(self, payload: bytes, now_us: int) -> Estimate | None:
        """Return the estimate of an odometry message, or None if it is rejected."""
        try:
            estimate = estimate_of(cdr.odometry(payload))
        except (cdr.CdrError, OdometryError) as error:
            self._reject(str(error))
            return None
        if (reason := rejection_reason(estimate)) is not None:
            self._reject(reason)
            return None
        self.accepted += 1
        self._clock.update(estimate.t_ns, now_us)
        return estimate

    def follow(self, plan: Plan) -> None:
        """Set the plan to execute."""
        if self._plan is None or plan.cycle_t_ns > self._plan.cycle_t_ns:
            self._period.add(plan.cycle_t_ns)
        self._plan = plan

    def thrust_N(self, now_us: int) -> Array | None:
        """Return the plan's thrust (N), port, starboard, vertical: 0 past its end, None without a plan.

        The plan ends as at any actuators, with the ``plan_timeout_s`` of a vehicle file that does not set it.
        """
        now_ns = self._clock.read(now_us)
        if self._plan is None or now_ns is None:
            return None
        if now_ns > plan_end_ns(self._plan.t_ns, self._period.median_ns, PLAN_TIMEOUT_S):
            return np.zeros(3)
        return self._plan.thrust_at(now_ns)

    def _reject(self, reason: str) -> None:
        self.rejected += 1
        self.reason = reason
