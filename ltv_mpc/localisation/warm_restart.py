"""Warm restart: a filter continues from a checkpoint over a time without measurements.

Estimate  Up to the last estimate, if one is known, the filter was at work; only its covariance is saved less often.
          Position, velocity and heading are those of the estimate. Their errors are propagated from the checkpoint,
              p := p + v t,  the others unchanged;  a variance is raised to that of the estimate if that is larger.
          Without an estimate the gap begins at the checkpoint.
Gap       up to the first inertial sample: it is crossed as any other dropout of the inertial unit
          (``imu_dropout.py``), with the rate of turn of the estimate before it.
"""

from __future__ import annotations

import bisect

import numpy as np

from ltv_mpc.frames import roll_pitch_heading, rotation
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.filter.state import ATTITUDE, GYRO_BIAS, POSITION, VELOCITY, Belief
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.sensor import Measurement
from ltv_mpc.messages import Estimate, ImuSample

MAX_ESTIMATE_LEAD_NS = 30_000_000_000
"""Maximum time from the checkpoint to an estimate of the same filter."""

_MAX_MESSAGES = 6000

_SAMPLES = 2
"""The first inertial sample ends the gap, the next one levels the filter."""


class WarmRestart:
    """Collector of messages until the gap can be crossed, with the interface of ``Alignment``."""

    def __init__(
        self, sensor_config: SensorConfig, config: EstimatorConfig, belief: Belief, estimate: Estimate | None
    ) -> None:
        """Create a warm restart that has received no messages yet.

        Parameters
        ----------
        sensor_config : settings of the sensors.
        config : settings of the filter.
        belief : that of the checkpoint.
        estimate : the last estimate that is known; None: only the checkpoint is.
        """
        self._sensor_config, self._config = sensor_config, config
        self._belief = belief
        newer_ns = -1 if estimate is None else estimate.t_ns - belief.t_ns
        self._estimate = estimate if 0 <= newer_ns <= MAX_ESTIMATE_LEAD_NS else None
        self._since_ns = belief.t_ns if self._estimate is None else self._estimate.t_ns
        self._messages: list[ImuSample | Measurement] = []  # by time, then arrival

    @property
    def waiting_for(self) -> str:
        """Sensors that are missing, as text; empty when the belief can be computed."""
        return "" if len(self._samples()) == _SAMPLES else "imu"

    def _samples(self) -> list[ImuSample]:
        return [message for message in self._messages if isinstance(message, ImuSample)][:_SAMPLES]

    def take(self, message: ImuSample | Measurement) -> None:
        """Store a message. Messages come in order of arrival.

        Parameters
        ----------
        message : inertial sample or measurement.
        """
        if message.t_ns > self._since_ns:
            bisect.insort(self._messages, message, key=lambda m: m.t_ns)
            del self._messages[:-_MAX_MESSAGES]

    def belief(self) -> tuple[Belief, list[ImuSample | Measurement]]:
        """Return the belief after the gap, and the messages to be applied to it."""
        samples = self._samples()
        if self.waiting_for:
            raise RuntimeError(f"cannot restart: waiting for {self.waiting_for}")
        belief, turn_radps = self._at_estimate()
        rate = 0.0, 0.0, turn_radps + float(belief.x[GYRO_BIAS.stop - 1])
        filter_ = ErrorStateFilter(self._sensor_config, self._config, belief, angular_rate_radps=rate)
        for sample in samples:
            filter_.advance(sample.t_ns, sample)
        t_ns = samples[-1].t_ns
        since = [m for m in self._messages if m.t_ns >= t_ns and not any(m is sample for sample in samples)]
        return filter_.propagated_belief(), since

    def _at_estimate(self) -> tuple[Belief, float]:
        """Return the belief at the last estimate's time, and its rate of turn (rad/s)."""
        belief, estimate = self._belief.copy(), self._estimate
        if estimate is None:
            return belief, 0.0
        x, P = belief.x, belief.P
        seconds, down = (estimate.t_ns - belief.t_ns) * 1e-9, ATTITUDE.stop - 1
        P[POSITION, :] += seconds * P[VELOCITY, :]
        P[:, POSITION] += seconds * P[:, VELOCITY]
        x[POSITION] = estimate.north_m, estimate.east_m, estimate.depth_m if estimate.depth_m is not None else x[2]
        x[VELOCITY] = estimate.velocity_north_mps, estimate.velocity_east_mps, estimate.velocity_down_mps or 0.0
        belief.R = rotation(*roll_pitch_heading(belief.R)[:2], estimate.heading_rad)
        if estimate.covariance is not None:
            reported = np.diagonal(estimate.covariance)[:5]
            indices = np.array([POSITION.start, POSITION.start + 1, VELOCITY.start, VELOCITY.start + 1, down])
            P[indices, indices] = np.maximum(P[indices, indices], reported)
        belief.t_ns = estimate.t_ns
        return belief, estimate.yaw_rate_radps
