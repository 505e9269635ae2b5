"""Sources of the estimates: the messages of one source are used, and a restarted or second source is handled.

The choice is that of ``safety/source_selector.py``. An estimate is believed if it is in order, not stamped in the
future and accepted by the estimate gate. With s the root sum of squares of the standard deviations of both estimates,
and dt the time since the last accepted one, a candidate agrees with the controller's prediction if

    |p - p_predicted|      <=  3 s + 0.3 m/s x dt + 0.1 m
    |psi - psi_predicted|  <=  3 s + 0.1 rad/s x dt + 0.05 rad

Where nothing has been believed for 10 s, the candidate's last two estimates must agree with each other instead.
"""

from __future__ import annotations

import math

from ltv_mpc.control.controller import Controller
from ltv_mpc.messages import Estimate
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.safety.estimate_gate import UNKNOWN_SD_M, UNKNOWN_SD_RAD, standard_deviation
from ltv_mpc.safety.input_monitor import MAX_STAMP_AHEAD_NS, InputMonitor
from ltv_mpc.safety.source_selector import MAX_CANDIDATES, SourceSelector

SIGMAS = 3.0
DRIFT_MPS, DRIFT_RADPS = 0.3, 0.1
"""Growth of the error of a prediction: an unknown current, and an unknown yaw rate."""
ROUNDING_M, ROUNDING_RAD = 0.1, 0.05

PREDICTION_NS = 10_000_000_000
"""Time without a believed estimate after which the prediction does not count."""


class EstimateSources:
    """Newest estimate of the active source."""

    def __init__(self, controller: Controller) -> None:
        """Begin without a source.

        Parameters
        ----------
        controller : its estimate gate and its prediction judge the estimates.
        """
        self.newest: Estimate | None = None
        """Newest estimate of the active source, also if it is implausible; the first one before there is a source."""
        self.monitor = InputMonitor()
        """Order and age of the estimates of the active source."""
        self.selector = SourceSelector()
        self._controller = controller
        self._candidates: dict[int, Estimate] = {}  # newest estimate by source

    def receive(self, received: ReceivedMessage, estimate: Estimate) -> bool:
        """Take in an estimate. Return True if the active source has changed with it.

        Parameters
        ----------
        received, estimate : inbox entry, and its message.
        """
        source, t_ns, active = received.epoch, received.received_t_ns, self.selector.active
        if active in (None, source):
            believed = self._is_believed(received, estimate)
            self.selector.receive(source, t_ns, believed=believed, agrees=True)
            return False
        believed, agrees = self._judge(received, estimate)
        if not self.selector.receive(source, t_ns, believed=believed, agrees=agrees):
            return False
        self._candidates.clear()
        self.monitor.restart()
        self._controller.restart_estimates()
        self._is_believed(received, estimate)
        return True

    def _is_believed(self, received: ReceivedMessage, estimate: Estimate) -> bool:
        """Check an estimate of the active source, and use it if it is the newest."""
        if not self.monitor.receive(
            epoch=received.epoch,
            sequence=received.sequence,
            stamp_ns=estimate.t_ns,
            received_ns=received.received_t_ns,
        ):
            return False
        self.newest = estimate
        return not self._controller.estimate_gate.check(estimate)

    def _judge(self, received: ReceivedMessage, estimate: Estimate) -> tuple[bool, bool]:
        """Return whether a candidate's estimate is believed, and whether it agrees."""
        source, t_ns, gate = received.epoch, received.received_t_ns, self._controller.estimate_gate
        before = self._candidates.pop(source, None)
        believed = (
            not gate.out_of_bounds(estimate)
            and estimate.t_ns <= t_ns + MAX_STAMP_AHEAD_NS
            and (before is None or estimate.t_ns > before.t_ns)
        )
        if not believed:
            return False, False
        self._candidates[source] = estimate
        if len(self._candidates) > MAX_CANDIDATES:
            del self._candidates[next(iter(self._candidates))]
        silent_ns, last = self.selector.silent_ns(t_ns), gate.accepted
        if last is None or silent_ns is None or silent_ns > PREDICTION_NS:
            return True, before is None or not gate.jumps(before, estimate)
        return True, estimate.t_ns > last.t_ns and self._agrees(last, estimate)

    def _agrees(self, last: Estimate, estimate: Estimate) -> bool:
        """Return True if an estimate agrees with the prediction from the last accepted one."""
        predicted = self._controller.predict(last, estimate.t_ns)
        dt = (estimate.t_ns - last.t_ns) * 1e-9
        off_m = math.hypot(estimate.north_m - predicted[0], estimate.east_m - predicted[1])
        off_rad = abs(math.remainder(estimate.heading_rad - predicted[4], math.tau))
        sd_m = math.hypot(*(standard_deviation(e, (0, 1), UNKNOWN_SD_M) for e in (last, estimate)))
        sd_rad = math.hypot(*(standard_deviation(e, (4,), UNKNOWN_SD_RAD) for e in (last, estimate)))
        return (
            off_m <= SIGMAS * sd_m + DRIFT_MPS * dt + ROUNDING_M
            and off_rad <= SIGMAS * sd_rad + DRIFT_RADPS * dt + ROUNDING_RAD
        )
