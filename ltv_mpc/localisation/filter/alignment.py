"""How the filter starts, afloat: from the first satellite fix, compass heading, depth, and 0.2 s of inertial samples.

Time    t0 is that of the satellite fix; what was measured after it is applied in its order once the belief stands.
        A fix may arrive late: what came before it is kept.
Level   f = R^T (a - g) + b_a + n, averaged over the samples, each turned back to t0 by the gyros; a is taken as 0:
            roll = atan2(-f_y, -f_z),  pitch = atan2(f_x, hypot(f_y, f_z))
        so the tilt is wrong by  phi = T (R (b_a + n) + a),  T x = [x_e, -x_n, 0] / g.  Tilt error and accelerometer
        bias start correlated, P_phi,b = T R sd_b^2: only so does the filter know that they cancel until it turns.
Heading psi = z: wrong by -(compass bias + noise), and correlated with that bias.
Place   Antenna and gauge are not at the origin: p = z - q, v = z - s as in ``sensors/lever_arm.py``; so position and
        velocity are also wrong by q^ phi and s^ phi - R l^ db_g, correlated with attitude and gyro bias.
Others  Sound speed, mounting and biases: what the sensors file says is unknown of them. Mounting as meant.
Source  Groves 2013, section 5.6 (levelling); the correlations follow from the two equations above.
"""

from __future__ import annotations

import bisect
import math

import numpy as np

from ltv_mpc.currents import WaterPrior
from ltv_mpc.frames import GRAVITY_MPS2, rotation, rotation_exp
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
from ltv_mpc.localisation.water import current_model
from ltv_mpc.messages import Array, CompassHeading, GnssFix, ImuSample, PressureDepth

LEVELLING_NS = 200_000_000
"""Samples over this time: 0.7 mm/s2 of white noise, less than a tenth of the bias."""

PATIENCE_NS = 5_000_000_000
"""A satellite fix older than this is let go while the other sensors have not come."""

_MOST_HEARD = 6000
"""Messages kept: 5 s of an inertial unit at 1 kHz, and the others; a bound for when there is none."""

HEAVE_SD_MPS = 0.1
"""Vertical velocity afloat."""


class Alignment:
    """Gathers messages until a belief can be made of them."""

    def __init__(self, suite: SensorConfig, config: EstimatorConfig, prior: WaterPrior | None = None) -> None:
        self._suite = suite
        self._config = config
        self._prior = prior
        self._fix: GnssFix | None = None
        self._heading: CompassHeading | None = None
        self._depth: PressureDepth | None = None
        self._heard: list[
            ImuSample | Measurement
        ] = []  # of the last PATIENCE_NS of inertial samples, by time, then arrival

    @property
    def waiting_for(self) -> str:
        """In words; empty when a belief can be made."""
        missing = [
            name
            for name, have in (("gnss", self._fix), ("compass", self._heading), ("pressure", self._depth))
            if have is None
        ]
        if not missing:
            samples = self._samples()
            if not samples or samples[-1].t_ns - samples[0].t_ns < LEVELLING_NS:
                missing.append("imu")
        return ", ".join(missing)

    def take(self, message: ImuSample | Measurement) -> None:
        """One message, in order of arrival."""
        place = bisect.bisect_right(self._heard, message.t_ns, key=lambda m: m.t_ns)
        first = bisect.bisect_left(self._heard, message.t_ns, key=lambda m: m.t_ns)
        if any(is_duplicate(earlier, message) for earlier in self._heard[first:place]):
            return
        self._heard.insert(place, message)
        del self._heard[:-_MOST_HEARD]
        if isinstance(message, ImuSample):
            oldest_ns = message.t_ns - PATIENCE_NS
            del self._heard[: bisect.bisect_left(self._heard, oldest_ns, key=lambda m: m.t_ns)]
            if self._fix is not None and self._fix.t_ns < oldest_ns:
                self._fix = None
        # A receiver that is faster than the levelling must not start it again each time.
        if isinstance(message, GnssFix) and (self._fix is None or message.t_ns > self._fix.t_ns + LEVELLING_NS):
            self._fix = message
            for earlier in self._heard:
                self._choose(earlier)
        self._choose(message)

    def _choose(self, message: ImuSample | Measurement) -> None:
        if isinstance(message, CompassHeading) and (self._heading is None or self._suits(message, self._heading)):
            self._heading = message
        elif isinstance(message, PressureDepth) and (self._depth is None or self._suits(message, self._depth)):
            self._depth = message

    def _suits(self, message: CompassHeading | PressureDepth, have: CompassHeading | PressureDepth) -> bool:
        """Better than what there is: the first from the fix on, else the last before it; without a fix the newest."""
        if self._fix is None:
            return message.t_ns > have.t_ns
        new_ns, old_ns = message.t_ns - self._fix.t_ns, have.t_ns - self._fix.t_ns
        return (new_ns < 0, abs(new_ns)) < (old_ns < 0, abs(old_ns))

    def _samples(self) -> list[ImuSample]:
        """Those that level it: the first after the fix, however many there are by now."""
        samples = [m for m in self._since() if isinstance(m, ImuSample)]
        return [m for m in samples if m.t_ns <= samples[0].t_ns + LEVELLING_NS]

    def _since(self) -> list[ImuSample | Measurement]:
        """Measured after the fix, in order; without what makes the belief, which must not correct it as well."""
        if self._fix is None:
            return []
        first = bisect.bisect_right(self._heard, self._fix.t_ns, key=lambda m: m.t_ns)
        makes = {(type(m), m.t_ns) for m in (self._heading, self._depth) if m is not None}
        return [m for m in self._heard[first:] if (type(m), m.t_ns) not in makes]

    def _specific_force(self) -> tuple[Array, float]:
        """Mean at t0 in the body's axes of then (m/s2), (3,), and the variance of its white noise per axis."""
        total = np.zeros(3)
        turned = np.eye(3)  # body of now to body of t0
        seconds = 0.0
        for sample in self._samples():
            dt = sample.interval_ns * 1e-9
            turn = np.array(sample.angular_rate_radps) * dt
            total += dt * (turned @ rotation_exp(0.5 * turn) @ np.array(sample.specific_force_mps2))
            turned = turned @ rotation_exp(turn)
            seconds += dt
        return total / seconds, self._suite.imu.velocity_random_walk_mps_per_rts**2 / seconds

    def belief(self) -> tuple[Belief, list[ImuSample | Measurement]]:
        """The belief at t0, and what is to be applied to it since. ``RuntimeError`` while something is missing."""
        fix, heading, depth = self._fix, self._heading, self._depth
        if fix is None or heading is None or depth is None:
            raise RuntimeError(f"cannot align: waiting for {self.waiting_for}")
        suite = self._suite
        layout = Layout.of(suite, self._config)
        belief = Belief.blank(layout, fix.t_ns)
        P = belief.P

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

        speed_sd = 0.0 if suite.lbl is None else suite.lbl.sound_speed_sd_mps / suite.lbl.sound_speed_mps
        for states, sd in (
            (layout.beam_bias, suite.adcp.beam_bias_sd_mps),
            (layout.near_bias, suite.adcp.near_bias_sd_mps),
            (layout.mounting, suite.adcp.mounting_known_to_rad),
            (layout.sound_speed, speed_sd),
        ):
            P[states, states] = sd**2 * np.eye(states.stop - states.start)
        belief.mounting = rotation(*suite.adcp.mounting_rad)
        self._place(belief, fix, depth)
        current_model.write_prior(belief, self._config, self._prior)
        belief.clone_position(suite.gnss.lever_arm_m)
        return belief, self._since()

    def _place(self, belief: Belief, fix: GnssFix, depth: PressureDepth) -> None:
        """Position and velocity of the origin; attitude and gyro bias stand already."""
        suite, x, P = self._suite, belief.x, belief.P
        antenna = lever_arm.point(belief, suite.gnss.lever_arm_m)
        gauge = lever_arm.point(belief, suite.pressure.lever_arm_m)
        swing = lever_arm.swing(belief, suite.gnss.lever_arm_m, self._samples()[0].angular_rate_radps)
        x[POSITION] = fix.north_m, fix.east_m, depth.depth_m
        x[POSITION] -= [*antenna.offset[:2], gauge.offset[2]]
        x[VELOCITY] = fix.velocity_north_mps, fix.velocity_east_mps, 0.0
        x[3:5] -= swing.velocity[:2]
        # [dp, dv] = -noise - J [phi, db_g]; of the heave nothing is known either way
        J = np.zeros((6, 6))
        J[:2, :3], J[2, :3] = antenna.by_attitude[:2], gauge.by_attitude[2]
        J[3:5, :3], J[3:5, 3:] = swing.by_attitude[:2], swing.by_gyro_bias[:2]
        own, turning = slice(POSITION.start, VELOCITY.stop), slice(ATTITUDE.start, GYRO_BIAS.stop)
        sd = [suite.gnss.position_sd_m] * 2 + [suite.pressure.depth_sd_m]
        sd += [suite.gnss.velocity_sd_mps] * 2 + [HEAVE_SD_MPS]
        rows = -J @ P[turning, :]
        P[own, :] = rows
        P[:, own] = rows.T
        lever_error = J @ P[turning, turning] @ J.T
        P[own, own] = np.diag(np.square(sd)) + 0.5 * (lever_error + lever_error.T)
