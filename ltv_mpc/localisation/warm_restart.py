"""Warm restart: a filter continues from a checkpoint over a time without measurements.

Estimate  Up to the last estimate, if one is known, the filter was at work; only its covariance is saved less often.
          Position, velocity and heading are those of the estimate. Their errors are propagated from the checkpoint,
              p := p + v t,  the others unchanged;  a variance is raised to that of the estimate if that is larger.
          Without an estimate the gap begins at the checkpoint.
Gap       of T, up to the first inertial sample. The motion is unknown: velocity and rate of turn are random walks,
          q_v = (0.1 m/s)^2/s and q_r = (0.1 rad/s)^2/s, which is more than thrusters can do:
              p := p + T v,  P_pp += q_v T^3/3,  P_pv += q_v T^2/2,  P_vv += q_v T
              heading := heading + T (r_0 + r_1) / 2,  P += q_r T^3/12     the rate of turn is known at both ends
          So a velocity measured after the gap also determines the displacement within it.
Level     from the accelerometers over 0.2 s as at the surface (``alignment.py``), with a = 0.1 m/s2 of motion:
              phi = T_l (R (b_a + n) + a);  b_a is the checkpoint's, so phi is correlated with all that b_a is
Biases    decay and grow as first-order Gauss-Markov processes over the whole time since the checkpoint; the water is a
          random walk.
Source    Bar-Shalom, Li & Kirubarajan 2001, section 6.2.2 (white noise acceleration), Groves 2013, section 5.6.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence

import numpy as np

from ltv_mpc.frames import GRAVITY_MPS2, roll_pitch_heading, rotation
from ltv_mpc.localisation import current_model
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.alignment import LEVELLING_NS, levelling_samples, mean_specific_force
from ltv_mpc.localisation.filter.state import ACCELEROMETER_BIAS, ATTITUDE, GYRO_BIAS, POSITION, VELOCITY, Belief
from ltv_mpc.localisation.imu_dropout import TURN_WALK, add_velocity_walk
from ltv_mpc.localisation.reinitialisation import ACCELERATION_SD_MPS2
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.sensor import Measurement
from ltv_mpc.messages import Array, Estimate, ImuSample

MAX_ESTIMATE_LEAD_NS = 30_000_000_000
"""Maximum time from the checkpoint to an estimate of the same filter."""

_MAX_MESSAGES = 6000


class WarmRestart:
    """Collector of messages until the belief can be levelled, with the interface of ``Alignment``."""

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
        samples = levelling_samples(self._messages)
        return "" if samples and samples[-1].t_ns - samples[0].t_ns >= LEVELLING_NS else "imu"

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
        """Return the belief at the first sample's time, and the messages to be applied to it."""
        samples = levelling_samples(self._messages)
        if self.waiting_for:
            raise RuntimeError(f"cannot restart: waiting for {self.waiting_for}")
        start_ns = samples[0].t_ns
        belief = self._belief.copy()
        heading, turn_radps = self._advance_to_estimate(belief)
        gap_s = (start_ns - belief.t_ns) * 1e-9
        _propagate_gap(belief, gap_s)
        turn_after = samples[0].angular_rate_radps[2] - float(belief.x[GYRO_BIAS.stop - 1])
        heading += gap_s * 0.5 * (turn_radps + turn_after)
        belief.P[DOWN, DOWN] += TURN_WALK * gap_s**3 / 12.0
        self._propagate_slow_states(belief, (start_ns - self._belief.t_ns) * 1e-9)
        self._level(belief, samples, heading)
        belief.t_ns = start_ns
        return belief, [m for m in self._messages if m.t_ns > start_ns or (m.t_ns == start_ns and m is not samples[0])]

    def _advance_to_estimate(self, belief: Belief) -> tuple[float, float]:
        """Move the belief to the last estimate's time; return its heading (rad) and rate of turn (rad/s)."""
        estimate = self._estimate
        if estimate is None:
            return roll_pitch_heading(belief.R)[2], 0.0
        x, P = belief.x, belief.P
        _propagate_position(P, (estimate.t_ns - belief.t_ns) * 1e-9)
        x[POSITION] = estimate.north_m, estimate.east_m, estimate.depth_m if estimate.depth_m is not None else x[2]
        x[VELOCITY] = estimate.velocity_north_mps, estimate.velocity_east_mps, estimate.velocity_down_mps or 0.0
        if estimate.covariance is not None:
            reported = np.diagonal(estimate.covariance)[:5]
            indices = np.array([POSITION.start, POSITION.start + 1, VELOCITY.start, VELOCITY.start + 1, DOWN])
            P[indices, indices] = np.maximum(P[indices, indices], reported)
        belief.t_ns = estimate.t_ns
        return estimate.heading_rad, estimate.yaw_rate_radps

    def _level(self, belief: Belief, samples: Sequence[ImuSample], heading: float) -> None:
        """Set roll and pitch from the samples, and the given heading, at the end of the first sample."""
        imu, P = self._sensor_config.imu, belief.P
        force, seconds = mean_specific_force(samples[1:])
        f = force - belief.x[ACCELEROMETER_BIAS]
        pitch = math.atan2(f[0], math.hypot(f[1], f[2]))
        belief.R = rotation(math.atan2(-f[1], -f[2]), pitch, heading)
        # phi_n, phi_e = T_l R db_a + noise; phi_d as it was
        T_l = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]) / GRAVITY_MPS2
        J = T_l @ belief.R
        rows = J @ P[ACCELEROMETER_BIAS, :]
        noise = imu.velocity_random_walk_mps_per_rts**2 / seconds + ACCELERATION_SD_MPS2**2
        level = J @ P[ACCELEROMETER_BIAS, ACCELEROMETER_BIAS] @ J.T + noise * T_l @ T_l.T
        P[LEVEL, :] = rows
        P[:, LEVEL] = rows.T
        P[LEVEL, LEVEL] = 0.5 * (level + level.T)

    def _propagate_slow_states(self, belief: Belief, seconds: float) -> None:
        """Propagate biases and water over the time since the checkpoint."""
        imu, compass = self._sensor_config.imu, self._sensor_config.compass
        for states, sd, tau_s in (
            (GYRO_BIAS, imu.gyro_bias_sd_radps, imu.gyro_bias_tau_s),
            (ACCELEROMETER_BIAS, imu.accelerometer_bias_sd_mps2, imu.accelerometer_bias_tau_s),
            (belief.layout.compass_bias, compass.bias_sd_rad, compass.bias_tau_s),
        ):
            belief.propagate_bias(states, sd, tau_s, seconds)
        current_model.add_random_walk(belief, self._config, seconds)


LEVEL = slice(ATTITUDE.start, ATTITUDE.stop - 1)
DOWN = ATTITUDE.stop - 1
"""Indices of the errors in attitude: two of the level, and that of the heading."""


def _propagate_position(P: Array, seconds: float) -> None:
    """Propagate the covariance of the position: dp := dp + t dv."""
    P[POSITION, :] += seconds * P[VELOCITY, :]
    P[:, POSITION] += seconds * P[:, VELOCITY]


def _propagate_gap(belief: Belief, seconds: float) -> None:
    """Propagate position and velocity over a gap."""
    belief.x[POSITION] += seconds * belief.x[VELOCITY]
    _propagate_position(belief.P, seconds)
    add_velocity_walk(belief.P, seconds)
