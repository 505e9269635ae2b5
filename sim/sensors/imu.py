"""Strapdown inertial unit: the increments between two instants, as means over their interval, with its errors.

Inertial attitude over dt, with the Earth's rate W (NED; zero if the unit does not sense it):
    w = log(R1^T exp(W dt) R2) / dt                                   mean angular rate, body
    R_mid = exp(-W dt/2) R1 exp(w dt/2)
    f = R_mid^T ((v2 - v1) / dt - g + 2 W x (v1 + v2) / 2)            mean specific force, body
This is the inverse of the strapdown R2 = exp(-W dt) R1 exp(w dt), v2 = v1 + dt (R_mid f + g - 2 W x v): a perfect
sample takes that integration from one truth to the next, so a filter's error is the sensors' and not the integration's.
Errors: w_m = w + b_g + N(0, ARW^2 / dt), f_m = f + b_a + N(0, VRW^2 / dt), with biases that drift.
Source  Groves 2013, sections 5.4 (navigation equations in a local frame) and 4.4 (errors).
"""

from __future__ import annotations

import math

import numpy as np

from ltv_mpc import so3
from ltv_mpc.frames import GRAVITY_MPS2, earth_rate
from ltv_mpc.jit import jit
from ltv_mpc.localisation.sensors.imu import Imu
from ltv_mpc.messages import Array, ImuSample, Triple
from sim.random_streams import Stream, generator
from sim.sensors.simulated import GaussMarkovBias
from sim.sensors.vehicle_state import VehicleState


class InertialUnit:
    """Inertial unit. Its first instant only starts the first interval."""

    def __init__(self, settings: Imu, latitude_rad: float, seed: int) -> None:
        """Draw the first biases from the unit's own stream."""
        self._draws = generator(seed, Stream.IMU)
        self._bias = GaussMarkovBias(
            np.repeat([settings.gyro_bias_sd_radps, settings.accelerometer_bias_sd_mps2], 3),
            np.repeat([settings.gyro_bias_tau_s, settings.accelerometer_bias_tau_s], 3),
            6,
            self._draws,
        )
        self._walks = np.repeat([settings.angle_random_walk_rad_per_rts, settings.velocity_random_walk_mps_per_rts], 3)
        self._earth_rate = earth_rate(latitude_rad) if settings.senses_earth_rate else np.zeros(3)
        self._last: VehicleState | None = None

    @property
    def gyro_bias_radps(self) -> Array:
        """True bias of the last sample, (3,)."""
        return self._bias.value[:3].copy()

    @property
    def accelerometer_bias_mps2(self) -> Array:
        """True bias of the last sample, (3,)."""
        return self._bias.value[3:].copy()

    def sample(self, now: VehicleState) -> list[ImuSample]:
        """Return the mean over the interval that ends now."""
        before, self._last = self._last, now
        if before is None:
            return []
        interval_ns = now.t_ns - before.t_ns
        dt = interval_ns * 1e-9
        white = self._walks / math.sqrt(dt) * self._draws.standard_normal(6)
        e0, e1, e2, e3, e4, e5 = (white + self._bias.advance(dt)).tolist()
        w, f = increments(before.rotation, before.velocity_mps, now.rotation, now.velocity_mps, self._earth_rate, dt)
        w, f = (w[0] + e0, w[1] + e1, w[2] + e2), (f[0] + e3, f[1] + e4, f[2] + e5)
        return [ImuSample(t_ns=now.t_ns, interval_ns=interval_ns, angular_rate_radps=w, specific_force_mps2=f)]


@jit
def increments(R1: Array, v1: Triple, R2: Array, v2: Triple, W: Array, dt: float) -> tuple[Triple, Triple]:
    """Return the error-free mean angular rate (rad/s) and specific force (m/s2) between two instants, body axes."""
    first, inertial = so3.read(R1), so3.multiply(so3.exp(dt * W[0], dt * W[1], dt * W[2]), so3.read(R2))
    turn = so3.log(so3.multiply(so3.transpose(first), inertial))
    w = turn[0] / dt, turn[1] / dt, turn[2] / dt
    R_mid = so3.strapdown(first, (W[0], W[1], W[2]), w, 0.5 * dt)
    x, y, z = 0.5 * (v1[0] + v2[0]), 0.5 * (v1[1] + v2[1]), 0.5 * (v1[2] + v2[2])
    a0 = (v2[0] - v1[0]) / dt + 2.0 * (W[1] * z - W[2] * y)
    a1 = (v2[1] - v1[1]) / dt + 2.0 * (W[2] * x - W[0] * z)
    a2 = (v2[2] - v1[2]) / dt + 2.0 * (W[0] * y - W[1] * x) - GRAVITY_MPS2
    f = (
        R_mid[0] * a0 + R_mid[3] * a1 + R_mid[6] * a2,
        R_mid[1] * a0 + R_mid[4] * a1 + R_mid[7] * a2,
        R_mid[2] * a0 + R_mid[5] * a1 + R_mid[8] * a2,
    )
    return w, f
