"""Sources of the estimates: those of one source are used, and a restarted or second source is handled.

The choice is that of ``safety/source_selector.py``. An estimate is believed if it is in order, newer than the one
before it, at most 1.5 s old at its arrival, not stamped in the future, and accepted by the estimate gate. Let s be the
root sum of squares of the standard deviations of both estimates, and dt the time between them. A candidate agrees with
the controller's prediction from the last accepted estimate if

    |p - p_predicted|      <=  3 s + 0.3 m/s x dt + 0.1 m
    |psi - psi_predicted|  <=  3 s + 0.1 rad/s x dt + 0.05 rad

An estimate without covariance counts with 0.5 m and 0.1 rad. Two estimates of a candidate are consistent if the vehicle
can have moved from one to the other (``EstimateGate.jumps``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from ltv_mpc.bounded import remember
from ltv_mpc.control.controller import Controller
from ltv_mpc.messages import Estimate, Health
from ltv_mpc.node import DEFAULT_SOURCE, ReceivedMessage
from ltv_mpc.safety.estimate_filter import standard_deviation
from ltv_mpc.safety.health import MAX_STAMP_AHEAD_NS, NOMINAL, HealthState
from ltv_mpc.safety.input_age import InputMonitor
from ltv_mpc.safety.source_selector import MAX_SILENCE_NS, Judgement, Source, SourceSelector

SIGMAS = 3.0
UNKNOWN_SD_M, UNKNOWN_SD_RAD = 0.5, 0.1
"""Standard deviations of an estimate without covariance: two sources of a vehicle that is controlled by them."""
DRIFT_MPS, DRIFT_RADPS = 0.3, 0.1
"""Growth of the error of a prediction: an unknown current, and an unknown yaw rate."""
ROUNDING_M, ROUNDING_RAD = 0.1, 0.05


class EstimateSources:
    """Newest estimate of the active source."""

    def __init__(self, controller: Controller, order: Sequence[str] = ()) -> None:
        """Begin without a source.

        Parameters
        ----------
        controller : its estimate gate and its prediction judge the estimates.
        order : names of the sources, the preferred one first.
        """
        self.newest: Estimate | None = None
        """Newest estimate of the active source, also if it is implausible; of any source before one is active."""
        self.monitor = InputMonitor()
        """Order and age of the estimates of the active source."""
        self.selector = SourceSelector(order)
        self._controller = controller
        self._candidates: dict[Source, Estimate] = {}  # newest estimate by source

    def receive(self, received: ReceivedMessage, estimate: Estimate) -> bool:
        """Take in an estimate. Return True if another source has become active with it.

        Parameters
        ----------
        received, estimate : inbox entry, and its message.
        """
        source, t_ns, active = Source(received.source, received.epoch), received.received_t_ns, self.selector.active
        if active in (None, source):
            if self._use(received, estimate):
                self.selector.believe(source, t_ns)
            return False
        if not self.selector.offer(source, t_ns, self._judge(source, t_ns, estimate)):
            return False
        self._candidates.clear()
        self.monitor.restart()
        self._controller.restart_estimates()
        self._use(received, estimate)
        return True

    def health(self, t_ns: int) -> HealthState:
        """Return the health by a second source that publishes beside the active one.

        Parameters
        ----------
        t_ns : current time (ns).
        """
        active, second = self.selector.active, self.selector.second(t_ns)
        if active is None or second is None:
            return NOMINAL
        key = "estimate" if active.name == DEFAULT_SOURCE else f"estimate/{active.name}"
        why = f"second source on {key}: epoch {second.epoch} is rejected, epoch {active.epoch} is used"
        return HealthState(Health.DEGRADED, why)

    def _use(self, received: ReceivedMessage, estimate: Estimate) -> bool:
        """Use an estimate of the active source if it is the newest. Return True if it is believed."""
        before_ns = None if self.newest is None else self.newest.t_ns
        if not self.monitor.accepts(received, estimate.t_ns):
            return False
        self.newest = estimate
        accepted = not self._controller.estimate_gate.check(estimate)
        return accepted and estimate.t_ns != before_ns and received.received_t_ns - estimate.t_ns <= MAX_SILENCE_NS

    def _judge(self, source: Source, t_ns: int, estimate: Estimate) -> Judgement:
        """Judge an estimate of a source that is not active."""
        gate, before = self._controller.estimate_gate, self._candidates.pop(source, None)
        if (
            gate.out_of_bounds(estimate)
            or not -MAX_STAMP_AHEAD_NS <= t_ns - estimate.t_ns <= MAX_SILENCE_NS
            or (before is not None and estimate.t_ns <= before.t_ns)
        ):
            return Judgement(believed=False, consistent=False, agrees=False)
        remember(self._candidates, source, estimate)
        consistent = before is None or not gate.jumps(before, estimate)
        return Judgement(believed=True, consistent=consistent, agrees=self._agrees(estimate))

    def _agrees(self, estimate: Estimate) -> bool:
        """Return True if an estimate agrees with the prediction from the last accepted one."""
        last = self._controller.estimate_gate.accepted
        if last is None:
            return True
        dt = (estimate.t_ns - last.t_ns) * 1e-9
        if dt > 0.0:
            north_m, east_m, _, _, heading_rad, _ = self._controller.predict(last, estimate.t_ns)
        else:  # its clock is behind that of the last source
            north_m, east_m = last.north_m + last.velocity_north_mps * dt, last.east_m + last.velocity_east_mps * dt
            heading_rad = last.heading_rad + last.yaw_rate_radps * dt
        off_m = math.hypot(estimate.north_m - north_m, estimate.east_m - east_m)
        off_rad = abs(math.remainder(estimate.heading_rad - heading_rad, math.tau))
        sd_m = math.hypot(*(standard_deviation(e, (0, 1), UNKNOWN_SD_M) for e in (last, estimate)))
        sd_rad = math.hypot(*(standard_deviation(e, (4,), UNKNOWN_SD_RAD) for e in (last, estimate)))
        return (
            off_m <= SIGMAS * sd_m + DRIFT_MPS * abs(dt) + ROUNDING_M
            and off_rad <= SIGMAS * sd_rad + DRIFT_RADPS * abs(dt) + ROUNDING_RAD
        )
