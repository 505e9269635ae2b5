"""How the filter starts, afloat: from the first satellite fix, compass heading, depth, and 0.2 s of inertial samples.

Time    t0 is that of the satellite fix; what came after it is applied again in its order once the belief stands.
Level   f = R^T (a - g) + b_a + n, averaged over the samples, each turned back to t0 by the gyros; a is taken as 0:
            roll = atan2(-f_y, -f_z),  pitch = atan2(f_x, hypot(f_y, f_z))
        so the tilt is wrong by  phi = T (R (b_a + n) + a),  T x = [x_e, -x_n, 0] / g.  Tilt error and accelerometer
        bias start correlated, P_phi,b = T R sd_b^2: only so does the filter know that they cancel until it turns.
Heading psi = z: wrong by -(compass bias + noise), and correlated with that bias.
Source  Groves 2013, section 5.6 (levelling); the correlations follow from the two equations above.
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc.frames import GRAVITY_MPS2, rotation, rotation_exp
from ltv_mpc.localisation import water_column
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter import Aiding
from ltv_mpc.localisation.state import ACCELEROMETER_BIAS, ATTITUDE, GYRO_BIAS, POSITION, VELOCITY, Belief, Layout
from ltv_mpc.localisation.suite import Suite
from ltv_mpc.signals import Array, CompassHeading, GnssFix, ImuSample, PressureDepth

LEVELLING_NS = 200_000_000
"""Samples over this time: 0.7 mm/s2 of white noise, less than a tenth of the bias."""

PATIENCE_NS = 5_000_000_000
"""A satellite fix older than this is let go while the other sensors have not come."""

HEAVE_SD_MPS = 0.1
"""Vertical velocity afloat."""


class Alignment:
    """Gathers messages until a belief can be made of them."""

    def __init__(self, suite: Suite, config: EstimatorConfig) -> None:
        self._suite = suite
        self._config = config
        self._fix: GnssFix | None = None
        self._heading: CompassHeading | None = None
        self._depth: PressureDepth | None = None
        self._samples: list[ImuSample] = []
        self._since: list[ImuSample | Aiding] = []  # newer than the fix, in order of arrival

    @property
    def waiting_for(self) -> str:
        """In words; empty when a belief can be made."""
        missing = [
            name
            for name, have in (("gnss", self._fix), ("compass", self._heading), ("pressure", self._depth))
            if have is None
        ]
        if not missing and (not self._samples or self._samples[-1].t_ns - self._samples[0].t_ns < LEVELLING_NS):
            missing.append("imu")
        return ", ".join(missing)

    def take(self, message: ImuSample | Aiding) -> None:
        """One message, in order of time."""
        if isinstance(message, GnssFix):
            self._restart(message)
            return
        if self._fix is not None and message.t_ns - self._fix.t_ns > PATIENCE_NS:
            self._restart(None)
        # The first heading and depth make the belief, so they must not correct it as well.
        if isinstance(message, CompassHeading) and self._unset(self._heading):
            self._heading = message
        elif isinstance(message, PressureDepth) and self._unset(self._depth):
            self._depth = message
        elif self._fix is not None and message.t_ns > self._fix.t_ns:
            self._since.append(message)
            if isinstance(message, ImuSample):
                self._samples.append(message)

    def _unset(self, have: CompassHeading | PressureDepth | None) -> bool:
        """Nothing there yet, or something older than could be had at the fix."""
        return have is None or self._fix is None or have.t_ns < self._fix.t_ns

    def _restart(self, fix: GnssFix | None) -> None:
        self._fix = fix
        self._samples = []
        self._since = []

    def _specific_force(self) -> tuple[Array, float]:
        """Mean at t0 in the body's axes of then (m/s2), (3,), and the variance of its white noise per axis."""
        total = np.zeros(3)
        turned = np.eye(3)  # body of now to body of t0
        seconds = 0.0
        for sample in self._samples:
            dt = sample.interval_ns * 1e-9
            turn = np.array(sample.angular_rate_radps) * dt
            total += dt * (turned @ rotation_exp(0.5 * turn) @ np.array(sample.specific_force_mps2))
            turned = turned @ rotation_exp(turn)
            seconds += dt
        return total / seconds, self._suite.imu.velocity_random_walk_mps_per_rts**2 / seconds

    def belief(self) -> tuple[Belief, list[ImuSample | Aiding]]:
        """The belief at t0, and what is to be applied to it since. ``RuntimeError`` while something is missing."""
        fix, heading, depth = self._fix, self._heading, self._depth
        if fix is None or heading is None or depth is None:
            raise RuntimeError(f"cannot align: waiting for {self.waiting_for}")
        suite = self._suite
        layout = Layout.of(suite, self._config)
        belief = Belief.blank(layout, fix.t_ns)
        x, P = belief.x, belief.P

        x[POSITION] = fix.north_m, fix.east_m, depth.depth_m
        P[POSITION, POSITION] = np.diag([suite.gnss.position_sd_m**2] * 2 + [suite.pressure.depth_sd_m**2])
        x[VELOCITY] = fix.velocity_north_mps, fix.velocity_east_mps, 0.0
        P[VELOCITY, VELOCITY] = np.diag([suite.gnss.velocity_sd_mps**2] * 2 + [HEAVE_SD_MPS**2])

        f, white = self._specific_force()
        pitch = math.atan2(f[0], math.hypot(f[1], f[2]))
        belief.R = rotation(math.atan2(-f[1], -f[2]), pitch, heading.heading_rad)

        T = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]) / GRAVITY_MPS2
        bias = suite.imu.accelerometer_bias_sd_mps2**2
        other = white + self._config.afloat_acceleration_sd_mps2**2
        P[ATTITUDE, ATTITUDE] = (bias + other) * T @ T.T
        P[ATTITUDE, ACCELEROMETER_BIAS] = bias * T @ belief.R
        P[ACCELEROMETER_BIAS, ATTITUDE] = P[ATTITUDE, ACCELEROMETER_BIAS].T
        P[ACCELEROMETER_BIAS, ACCELEROMETER_BIAS] = bias * np.eye(3)
        P[GYRO_BIAS, GYRO_BIAS] = suite.imu.gyro_bias_sd_radps**2 * np.eye(3)

        down = ATTITUDE.stop - 1
        compass_bias = suite.compass.bias_sd_rad**2
        P[down, down] = suite.compass.heading_sd_rad**2 + compass_bias
        P[layout.compass_bias, layout.compass_bias] = compass_bias
        P[down, layout.compass_bias] = -compass_bias
        P[layout.compass_bias, down] = -compass_bias

        for states, sd in (
            (layout.beam_bias, suite.adcp.beam_bias_sd_mps),
            (layout.near_bias, suite.adcp.near_bias_sd_mps),
            (layout.mounting, suite.adcp.mounting_known_to_rad),
        ):
            P[states, states] = sd**2 * np.eye(states.stop - states.start)
        water_column.write_prior(belief, self._config)
        belief.clone_position()
        return belief, self._since
