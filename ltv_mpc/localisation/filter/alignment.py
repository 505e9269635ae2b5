"""Initial alignment at the surface, from the first satellite fix, compass heading, depth, and 0.2 s of IMU samples.

Time    t0 is the time of the satellite fix. Measurements after it are applied in order once the belief exists.
        A fix may arrive late: earlier messages are kept until then.
Level   f = R^T (a - g) + b_a + n, averaged over the samples, each rotated back to t0 by the gyros; a is taken as 0:
            roll = atan2(-f_y, -f_z),  pitch = atan2(f_x, hypot(f_y, f_z))
        The tilt error is  phi = T (R (b_a + n) + a),  T x = [x_e, -x_n, 0] / g.  Tilt error and accelerometer bias
        are correlated from the start, P_phi,b = T R sd_b^2: they cancel until the vehicle turns.
Heading psi = z. Its error is -(compass bias + noise), correlated with that bias.
Position and velocity  The antenna and the pressure gauge are not at the origin: p = z - q, v = z - s as in
        ``sensors/lever_arm.py``. So position and velocity also have the errors q^ phi and s^ phi - R l^ db_g,
        correlated with attitude and gyro bias.
Others  Sound speed, mounting and biases have the nominal values and standard deviations of the sensor configuration.
Source  Groves 2013, section 5.6 (levelling); the correlations follow from the equations above.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Sequence
from typing import TypeVar

import numpy as np

from ltv_mpc.currents import WaterPrior
from ltv_mpc.frames import GRAVITY_MPS2, rotation, rotation_exp
from ltv_mpc.localisation import current_model
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.state import (
    ACCELEROMETER_BIAS,
    ATTITUDE,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
    Belief,
    Layout,
)
from ltv_mpc.localisation.out_of_sequence import is_duplicate
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import lever_arm
from ltv_mpc.localisation.sensors.sensor import Measurement
from ltv_mpc.messages import Array, CompassHeading, GnssFix, ImuSample, PressureDepth

LEVELLING_NS = 200_000_000
"""Averaging time of the levelling. It leaves 0.7 mm/s2 of white noise, less than a tenth of the bias."""

FIX_TIMEOUT_NS = 5_000_000_000
"""Largest age of a satellite fix while the other sensors are missing. An older fix is discarded."""

_MAX_MESSAGES = 6000
"""Number of messages kept: 5 s of an IMU at 1 kHz and the other sensors. It bounds memory if there is no IMU."""

HEAVE_SD_MPS = 0.1
"""Standard deviation of the vertical velocity at the surface (m/s)."""


_Reading = TypeVar("_Reading", CompassHeading, PressureDepth)


def mean_specific_force(samples: Sequence[ImuSample]) -> tuple[Array, float]:
    """Return the mean specific force of samples (m/s2), (3,), in the body axes before the first, and their time (s).

    Parameters
    ----------
    samples : inertial samples that follow each other.
    """
    total, C, seconds = np.zeros(3), np.eye(3), 0.0  # C: present body axes to those before the first sample
    for sample in samples:
        dt = sample.interval_ns * 1e-9
        turn = np.array(sample.angular_rate_radps) * dt
        total += dt * (C @ rotation_exp(0.5 * turn) @ np.array(sample.specific_force_mps2))
        C = C @ rotation_exp(turn)
        seconds += dt
    return total / seconds, seconds


class Alignment:
    """Initial alignment: collects messages until they determine a first belief."""

    def __init__(self, sensor_config: SensorConfig, config: EstimatorConfig, prior: WaterPrior | None = None) -> None:
        self._sensor_config = sensor_config
        self._config = config
        self._prior = prior
        self._fix: GnssFix | None = None
        # Of the last FIX_TIMEOUT_NS of inertial samples, by time, then arrival
        self._messages: list[ImuSample | Measurement] = []

    @property
    def waiting_for(self) -> str:
        """Names of the missing sensors, separated by commas; empty if alignment is possible."""
        have = {"gnss": self._fix, "compass": self._best(CompassHeading), "pressure": self._best(PressureDepth)}
        missing = [name for name, message in have.items() if message is None]
        if not missing:
            samples = self._samples()
            if not samples or samples[-1].t_ns - samples[0].t_ns < LEVELLING_NS:
                missing.append("imu")
        return ", ".join(missing)

    def take(self, message: ImuSample | Measurement) -> None:
        """Add a message, in order of arrival. Duplicates are ignored.

        Parameters
        ----------
        message : IMU sample or measurement, with its measurement time.
        """
        place = bisect.bisect_right(self._messages, message.t_ns, key=lambda m: m.t_ns)
        first = bisect.bisect_left(self._messages, message.t_ns, key=lambda m: m.t_ns)
        if any(is_duplicate(earlier, message) for earlier in self._messages[first:place]):
            return
        self._messages.insert(place, message)
        del self._messages[:-_MAX_MESSAGES]
        if isinstance(message, ImuSample):
            oldest_ns = message.t_ns - FIX_TIMEOUT_NS
            del self._messages[: bisect.bisect_left(self._messages, oldest_ns, key=lambda m: m.t_ns)]
            if self._fix is not None and self._fix.t_ns < oldest_ns:
                self._fix = None
        # A receiver with a period shorter than the levelling must not restart it with each fix.
        if isinstance(message, GnssFix) and (self._fix is None or message.t_ns > self._fix.t_ns + LEVELLING_NS):
            self._fix = message

    def _best(self, kind: type[_Reading]) -> _Reading | None:
        """Return the first message of a type at or after the fix, else the last before it; without a fix any."""
        zero_ns = 0 if self._fix is None else self._fix.t_ns
        messages = [message for message in self._messages if isinstance(message, kind)]
        return min(messages, key=lambda m: (m.t_ns < zero_ns, abs(m.t_ns - zero_ns)), default=None)

    def _samples(self) -> list[ImuSample]:
        """Return the samples for levelling: those of the first ``LEVELLING_NS`` after the fix."""
        samples = [m for m in self._after_fix() if isinstance(m, ImuSample)]
        return [m for m in samples if m.t_ns <= samples[0].t_ns + LEVELLING_NS]

    def _after_fix(self) -> list[ImuSample | Measurement]:
        """Return the messages after the fix, in order, without those that determine the belief itself."""
        if self._fix is None:
            return []
        first = bisect.bisect_right(self._messages, self._fix.t_ns, key=lambda m: m.t_ns)
        makes = self._best(CompassHeading), self._best(PressureDepth)
        return [m for m in self._messages[first:] if not any(m is one for one in makes)]

    def belief(self) -> tuple[Belief, list[ImuSample | Measurement]]:
        """Return the belief at t0 and the later messages, which the caller applies to it in order.

        Raises
        ------
        RuntimeError
            If a sensor is still missing (``waiting_for``).
        """
        fix, heading, depth = self._fix, self._best(CompassHeading), self._best(PressureDepth)
        if fix is None or heading is None or depth is None:
            raise RuntimeError(f"cannot align: waiting for {self.waiting_for}")
        sensor_config = self._sensor_config
        layout = Layout.of(sensor_config, self._config)
        belief = Belief.blank(layout, fix.t_ns)
        P = belief.P

        f, seconds = mean_specific_force(self._samples())
        white = sensor_config.imu.velocity_random_walk_mps_per_rts**2 / seconds
        pitch = math.atan2(f[0], math.hypot(f[1], f[2]))
        belief.R = rotation(math.atan2(-f[1], -f[2]), pitch, heading.heading_rad)

        T = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]) / GRAVITY_MPS2
        bias = sensor_config.imu.accelerometer_bias_sd_mps2**2
        other = white + self._config.afloat_acceleration_sd_mps2**2
        P[ATTITUDE, ATTITUDE] = (bias + other) * T @ T.T
        P[ATTITUDE, ACCELEROMETER_BIAS] = bias * T @ belief.R
        P[ACCELEROMETER_BIAS, ATTITUDE] = P[ATTITUDE, ACCELEROMETER_BIAS].T
        P[ACCELEROMETER_BIAS, ACCELEROMETER_BIAS] = bias * np.eye(3)
        P[GYRO_BIAS, GYRO_BIAS] = sensor_config.imu.gyro_bias_sd_radps**2 * np.eye(3)

        down = ATTITUDE.stop - 1
        compass_bias = sensor_config.compass.bias_sd_rad**2
        P[down, down] = sensor_config.compass.heading_sd_rad**2 + compass_bias
        P[layout.compass_bias, layout.compass_bias] = compass_bias
        P[down, layout.compass_bias] = -compass_bias
        P[layout.compass_bias, down] = -compass_bias

        lbl = sensor_config.lbl
        speed_sd = 0.0 if lbl is None else lbl.sound_speed_sd_mps / lbl.sound_speed_mps
        for states, sd in (
            (layout.beam_bias, sensor_config.adcp.beam_bias_sd_mps),
            (layout.near_bias, sensor_config.adcp.near_bias_sd_mps),
            (layout.mounting, sensor_config.adcp.mounting_known_to_rad),
            (layout.sound_speed, speed_sd),
        ):
            P[states, states] = sd**2 * np.eye(states.stop - states.start)
        belief.mounting = rotation(*sensor_config.adcp.mounting_rad)
        self._place(belief, fix, depth)
        current_model.write_prior(belief, self._config, self._prior)
        belief.clone_position(sensor_config.gnss.lever_arm_m)
        return belief, self._after_fix()

    def _place(self, belief: Belief, fix: GnssFix, depth: PressureDepth) -> None:
        """Set position and velocity of the origin with their covariance; attitude and gyro bias are already set."""
        sensor_config, x, P = self._sensor_config, belief.x, belief.P
        antenna = lever_arm.point(belief, sensor_config.gnss.lever_arm_m)
        gauge = lever_arm.point(belief, sensor_config.pressure.lever_arm_m)
        swing = lever_arm.swing(belief, sensor_config.gnss.lever_arm_m, self._samples()[0].angular_rate_radps)
        x[POSITION] = fix.north_m, fix.east_m, depth.depth_m
        x[POSITION] -= [*antenna.offset[:2], gauge.offset[2]]
        x[VELOCITY] = fix.velocity_north_mps, fix.velocity_east_mps, 0.0
        x[3:5] -= swing.velocity[:2]
        # [dp, dv] = -noise - J [phi, db_g]; the heave is not measured
        J = np.zeros((6, 6))
        J[:2, :3], J[2, :3] = antenna.by_attitude[:2], gauge.by_attitude[2]
        J[3:5, :3], J[3:5, 3:] = swing.by_attitude[:2], swing.by_gyro_bias[:2]
        own, angular = slice(POSITION.start, VELOCITY.stop), slice(ATTITUDE.start, GYRO_BIAS.stop)
        sd = [sensor_config.gnss.position_sd_m] * 2 + [sensor_config.pressure.depth_sd_m]
        sd += [sensor_config.gnss.velocity_sd_mps] * 2 + [HEAVE_SD_MPS]
        rows = -J @ P[angular, :]
        P[own, :] = rows
        P[:, own] = rows.T
        lever_error = J @ P[angular, angular] @ J.T
        P[own, own] = np.diag(np.square(sd)) + 0.5 * (lever_error + lever_error.T)
