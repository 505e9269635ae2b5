"""Error model of the bound, linearised about the truth: propagation of errors and measurement rows.

Errors  true minus assumed: position and velocity (NED), gyro and accelerometer bias (FRD), compass bias, beam and
        near-range bias of each beam, and current north and east at the grid points of the estimator; attitude error phi
        in NED with R_true = exp(phi^) R, mounting error mu in body axes with M_true = exp(mu^) M.
Propagation  continuous,  x' = F x + G n,  with specific force a = v' - g + 2 W x v (NED) and Earth rate W:
            p' = v,   v' = -a x phi - R b_a - 2 W x v - R n_a,   phi' = -W x phi - R b_g - R n_g,   b' = -b/tau + n_b
        discretised over dt by Van Loan:  exp([[-F, G S G^T], [0, F^T]] dt) = [[., Phi^-1 Q], [0, Phi^T]]
Rows    y = h . x + n, each divided by its standard deviation; information is h h^T.
Source  Groves 2013, chapter 14 (error equations in a local frame); Van Loan 1978, IEEE T-AC 23(3). This model shares
        only the sensor configuration, the [estimator] table and the frame conventions with the filter.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from ltv_mpc.currents import grid_depths
from ltv_mpc.frames import earth_rate, gravity, rotation, skew
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.adcp import beam_directions
from ltv_mpc.messages import Array

POSITION, VELOCITY, ATTITUDE = slice(0, 3), slice(3, 6), slice(6, 9)
GYRO_BIAS, ACCELEROMETER_BIAS, COMPASS_BIAS = slice(9, 12), slice(12, 15), slice(15, 16)
MOVING = 16
"""Number of errors that change in time: the first sixteen. The others are constant."""

EPOCH, START = slice(16, 19), slice(19, 22)
"""Position at the last satellite epoch and at t = 0."""
BEAM_BIAS, NEAR_BIAS, MOUNTING = slice(22, 26), slice(26, 30), slice(30, 33)
WATER = 33
"""Index of the first current: north at every grid point, then east."""

NAMES = {
    "vertical": [2, 5],
    "tilt": [6, 7],
    "heading": [8],
    "gyro_bias": [9, 10, 11],
    "accelerometer_bias": [12, 13, 14],
    "compass_bias": [15],
}
"""Errors that may be taken as known, for analyses with fewer dimensions."""

LEVELLING_S = 0.2
HEAVE_SD_MPS = 0.1
"""Initial alignment as in the estimator: averaging time of the accelerometers, sd of the vertical velocity (m/s)."""

_ANYWHERE = 1e-8
"""Information about initially unknown errors (1/m2, 1/rad2)."""

CALIBRATION_SPEED_MPS = 0.5
"""Speed at which the mounting of the ADCP is calibrated."""


class Trajectory(NamedTuple):
    """True motion at 10 Hz or faster, linear between samples."""

    t_s: Array  # (T,) increasing, 0 at the start of the descent
    position_m: Array  # (T, 3) NED
    velocity_mps: Array  # (T, 3) over ground, NED
    rotation: Array  # (T, 3, 3) body to world
    water_mps: Array  # (K, 2) north, east at the grid points of the estimator


class Instant(NamedTuple):
    """Point of a trajectory: position, velocity and rotation."""

    p: Array
    v: Array
    R: Array


def at(trajectory: Trajectory, t_s: float) -> Instant:
    """Return the point at a time, linear between samples and constant beyond them."""
    t = trajectory.t_s
    i = min(max(int(np.searchsorted(t, t_s)), 1), len(t) - 1)
    s = min(max((t_s - t[i - 1]) / (t[i] - t[i - 1]), 0.0), 1.0)
    p, v, R = ((1.0 - s) * a[i - 1] + s * a[i] for a in trajectory[1:4])
    return Instant(p, v, R)


class ErrorModel:
    """Error model of a sensor configuration. ``size`` is n; ``free`` (n,) marks the errors that exist."""

    def __init__(
        self,
        sensor_config: SensorConfig,
        config: EstimatorConfig,
        known: Collection[str] = (),
        calibration_s: float = 0.0,
    ) -> None:
        """Set up the model; ``known`` are keys of ``NAMES``, ``KeyError`` for another.

        ``calibration_s`` is the time (s) of a calibration that ends before the first fix.
        """
        self._sensor_config, self._config, self._calibration_s = sensor_config, config, calibration_s
        self._earth = earth_rate(sensor_config.latitude_rad) if sensor_config.imu.senses_earth_rate else np.zeros(3)
        self._depth_m = grid_depths(config.deepest_m, config.cell_m)
        self.nodes = len(self._depth_m)
        self.size = WATER + 2 * self.nodes
        imu, adcp = sensor_config.imu, sensor_config.adcp
        self._sd = np.zeros(self.size)
        for states, sd in (
            (GYRO_BIAS, imu.gyro_bias_sd_radps),
            (ACCELEROMETER_BIAS, imu.accelerometer_bias_sd_mps2),
            (COMPASS_BIAS, sensor_config.compass.bias_sd_rad),
            (BEAM_BIAS, adcp.beam_bias_sd_mps),
            (NEAR_BIAS, adcp.near_bias_sd_mps),
            (MOUNTING, adcp.mounting_known_to_rad),
        ):
            self._sd[states] = sd
        self.free = self._sd > 0
        self.free[:9] = True
        self.free[EPOCH] = self.free[START] = self.free[WATER:] = True
        for name in known:
            self.free[NAMES[name]] = False
        if not self.free[2]:
            self.free[[EPOCH.stop - 1, START.stop - 1]] = False
        self._beams = beam_directions(adcp.beam_angle_rad) @ rotation(*adcp.mounting_rad).T  # M e_k
        # A lost beam or a recognised outlier has no information: the information of a ping is reduced by their share.
        self._beam_weight = (1.0 - adcp.missing_share) * (1.0 - adcp.outlier_share) / adcp.beam_noise_sd_mps**2

    def prior(self) -> Array:
        """Return the prior information, (n, n); 0 about the clones, which do not exist yet."""
        J = np.zeros((self.size, self.size))
        drawn = np.flatnonzero(self._sd)
        J[drawn, drawn] = 1.0 / self._initial_sd()[drawn] ** 2
        i = np.arange(9)
        J[i, i] = _ANYWHERE
        J[5, 5] = 1.0 / HEAVE_SD_MPS**2
        z, c = self._depth_m, self._config
        P = c.current_mean_sd_mps**2 + c.current_sd_mps**2 * np.exp(
            -np.abs(np.subtract.outer(z, z)) / c.current_correlation_length_m
        )
        for start in (WATER, WATER + self.nodes):
            J[start : start + self.nodes, start : start + self.nodes] = np.linalg.inv(P)
        return J

    def _initial_sd(self) -> Array:
        """Return the sd of the biases and of the mounting at the first fix, (n,), after the calibration.

        In it each sensor is compared with an error-free reference for T seconds; r^2 is its white noise times its
        period. Constants: 1/P = 1/sd^2 + T/r^2. Gauss-Markov biases: P' = -2 P/tau + q - P^2/r^2, q = 2 sd^2/tau, so
        (P - P+) / (P - P-) = exp(-2 s T) (sd^2 - P+) / (sd^2 - P-),  P+- = r^2 (-1/tau +- s),  s^2 = 1/tau^2 + q/r^2.
        """
        T, sd = self._calibration_s, self._sd.copy()
        if T == 0.0:
            return sd
        imu, compass, adcp = self._sensor_config.imu, self._sensor_config.compass, self._sensor_config.adcp
        for states, r, tau in (
            (GYRO_BIAS, imu.angle_random_walk_rad_per_rts, imu.gyro_bias_tau_s),
            (ACCELEROMETER_BIAS, imu.velocity_random_walk_mps_per_rts, imu.accelerometer_bias_tau_s),
            (COMPASS_BIAS, compass.heading_sd_rad * math.sqrt(compass.period_ns * 1e-9), compass.bias_tau_s),
        ):
            before = self._sd[states] ** 2
            s = np.sqrt(1.0 / tau**2 + 2.0 * before / (tau * r**2))
            high, low = r**2 * (-1.0 / tau + s), r**2 * (-1.0 / tau - s)
            k = np.exp(-2.0 * s * T) * (before - high) / (before - low)
            sd[states] = np.sqrt((high - k * low) / (1.0 - k))
        noise = adcp.beam_noise_sd_mps * math.sqrt(adcp.period_ns * 1e-9 / T)
        for states, left in ((BEAM_BIAS, noise), (NEAR_BIAS, noise), (MOUNTING, noise / CALIBRATION_SPEED_MPS)):
            sd[states] *= left / np.hypot(left, sd[states])
        return sd

    def growth(self, a: Instant, b: Instant, dt: float) -> tuple[Array, Array]:
        """Return Phi and Q of the moving errors from ``a`` to ``b`` over ``dt`` (s), (16, 16) each."""
        imu, W = self._sensor_config.imu, self._earth
        R = 0.5 * (a.R + b.R)
        force = (b.v - a.v) / dt - gravity() + skew(W) @ (a.v + b.v)
        F, S = np.zeros((MOVING, MOVING)), np.zeros((MOVING, MOVING))
        F[POSITION, VELOCITY] = np.eye(3)
        F[VELOCITY, VELOCITY] = -2.0 * skew(W)
        F[VELOCITY, ATTITUDE] = -skew(force)
        F[VELOCITY, ACCELEROMETER_BIAS] = -R
        F[ATTITUDE, ATTITUDE] = -skew(W)
        F[ATTITUDE, GYRO_BIAS] = -R
        S[VELOCITY, VELOCITY] = imu.velocity_random_walk_mps_per_rts**2 * np.eye(3)
        S[ATTITUDE, ATTITUDE] = imu.angle_random_walk_rad_per_rts**2 * np.eye(3)
        for states, tau in (
            (GYRO_BIAS, imu.gyro_bias_tau_s),
            (ACCELEROMETER_BIAS, imu.accelerometer_bias_tau_s),
            (COMPASS_BIAS, self._sensor_config.compass.bias_tau_s),
        ):
            i = np.arange(states.start, states.stop)
            F[i, i] = -1.0 / tau
            S[i, i] = 2.0 * self._sd[states] ** 2 / tau
        E = expm(np.block([[-F, S], [np.zeros_like(F), F.T]]) * dt)
        Phi = E[MOVING:, MOVING:].T
        Q = Phi @ E[:MOVING, MOVING:]
        return Phi, 0.5 * (Q + Q.T)

    def _rows(self, count: int) -> Array:
        return np.zeros((count, self.size))

    def levelling(self, now: Instant) -> Array:
        """Return the rows of levelling without acceleration:  g z x phi - (R b_a)_h = n."""
        white = self._sensor_config.imu.velocity_random_walk_mps_per_rts**2 / LEVELLING_S
        h = self._rows(2)
        h[:, ATTITUDE] = skew(gravity())[:2]  # -(a x phi) with a = -g
        h[:, ACCELEROMETER_BIAS] = -now.R[:2]
        return h / math.sqrt(white + self._config.afloat_acceleration_sd_mps2**2)

    def gnss(self, now: Instant) -> Array:
        """Return the rows of a satellite fix: antenna position p + R l, and velocity."""
        h = self._rows(4)
        h[:2, POSITION] = h[2:, VELOCITY] = np.eye(3)[:2]
        h[:2, ATTITUDE] = -skew(now.R @ np.array(self._sensor_config.gnss.lever_arm_m))[:2]
        h[:2] /= self._sensor_config.gnss.position_sd_m
        h[2:] /= self._sensor_config.gnss.velocity_sd_mps
        return h

    def tdcp(self) -> Array:
        """Return the rows of TDCP: displacement p - p_epoch, without the lever arm of the antenna."""
        h = self._rows(2)
        h[:, POSITION], h[:, EPOCH] = np.eye(3)[:2], -np.eye(3)[:2]
        return h / self._sensor_config.tdcp.displacement_sd_m

    def pressure(self, now: Instant, readings: int) -> Array:
        """Return the row of the gauge's depth, [p + R l]_d, for ``readings`` readings since the last instant."""
        h = self._rows(1)
        h[0, 2] = 1.0
        h[0, ATTITUDE] = -skew(now.R @ np.array(self._sensor_config.pressure.lever_arm_m))[2]
        return h * math.sqrt(readings) / self._sensor_config.pressure.depth_sd_m

    def compass(self, now: Instant) -> Array:
        """Return the row of the compass: sideways (phi x f) over the horizontal length of forward axis f, plus bias."""
        f = now.R[:, 0]
        level = f[:2] @ f[:2]
        h = self._rows(1)
        h[0, ATTITUDE] = skew(f) @ [-f[1], f[0], 0.0] / level  # (phi x f) . s = phi . (f x s)
        h[0, COMPASS_BIAS] = 1.0
        return h / self._sensor_config.compass.heading_sd_rad

    def adcp(self, now: Instant, water: Array) -> Array:
        """Return the rows of one ping with ``water`` (K, 2) at the grid points.

        The cell of beam k at range r measures  u . (c(z) - v) + bias,  u = R M e_k,  z = p_d + [R (l + r M e_k)]_d.
        The effect of the angular rate at the lever arm is left out: 0.1 mm/s for a mounting error of 0.3 deg.
        """
        adcp, cell = self._sensor_config.adcp, self._config.cell_m
        lever, r = np.array(adcp.lever_arm_m), adcp.cell_ranges_m
        blocks = []
        for k, b in enumerate(self._beams):
            u = now.R @ b
            arm = (now.R @ lever)[None] + np.outer(r, u)  # (m, 3)
            depth = (now.p[2] + arm[:, 2]) / cell
            node = np.floor(depth).astype(int)
            inside = (node >= 0) & (node <= self.nodes - 2)
            arm, depth, node, ranges = arm[inside], depth[inside], node[inside], r[inside]
            m, share = len(node), (depth - node)[:, None]
            shear = (water[node + 1] - water[node]) / cell  # (m, 2)
            past = np.hstack([(1.0 - share) * water[node] + share * water[node + 1], np.zeros((m, 1))]) - now.v
            g = shear @ u[:2]
            h = self._rows(m)
            h[:, VELOCITY] = -u
            h[:, 2] = g
            # du = phi x u, dz = [phi x arm]_d;  in the body du = mu x b, dz = r [R (mu x b)]_d
            h[:, ATTITUDE] = past @ skew(u).T
            h[:, 6] += g * arm[:, 1]
            h[:, 7] -= g * arm[:, 0]
            h[:, MOUNTING] = (past @ now.R + np.outer(g * ranges, now.R[2])) @ skew(b).T
            h[:, BEAM_BIAS.start + k] = 1.0
            h[:, NEAR_BIAS.start + k] = np.exp(-ranges / adcp.near_bias_length_m)
            i = np.arange(m)
            for axis in range(2):
                first = WATER + axis * self.nodes + node
                h[i, first] = u[axis] * (1.0 - share[:, 0])
                h[i, first + 1] = u[axis] * share[:, 0]
            blocks.append(h)
        return np.vstack(blocks) * math.sqrt(self._beam_weight)
