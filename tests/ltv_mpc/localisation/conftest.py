"""Descents for these tests, independent of ``sim``: motion in closed form, sensors by their equations."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from ltv_mpc.frames import earth_rate, rotation, rotation_exp, rotation_log
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.filter.error_state_filter import ErrorStateFilter
from ltv_mpc.localisation.filter.state import Belief, Layout
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.water.current_model import write_prior
from ltv_mpc.messages import AdcpPing, Array, CompassHeading, GnssFix, ImuSample, Message, PressureDepth, TdcpFix
from ltv_mpc.node import ReceivedMessage
from tests.stepping import as_sent

DT_NS = 10_000_000


@dataclass(frozen=True)
class Dive:
    """Truth at every inertial sample, (T, ...), and the sensors' messages in order."""

    t_ns: Array
    position: Array
    velocity: Array
    R: Array
    gyro_bias: Array
    accelerometer_bias: Array
    compass_bias: Array
    water: Array  # (K, 2) at 0, 1, 2, ... m
    messages: list[Message]

    def at(self, t_ns: int) -> int:
        """Return the index of a time of the inertial grid."""
        return int((t_ns - self.t_ns[0]) // DT_NS)


def markov(rng: np.random.Generator, sd: float, tau: float, steps: int, h: float) -> Array:
    """Return a first-order Gauss-Markov sequence, (steps,)."""
    a = math.exp(-h / tau)
    b = np.empty(steps)
    b[0] = sd * rng.standard_normal()
    noise = sd * math.sqrt(1 - a * a) * rng.standard_normal(steps)
    for k in range(1, steps):
        b[k] = a * b[k - 1] + noise[k]
    return b


def dive(suite: SensorConfig, seed: int, *, surface_s: float = 1.0, duration_s: float = 200.0) -> Dive:
    """Simulate a descent at 0.2 m/s with a turn of 90 deg, after ``surface_s``, in 4 cm/s of Gauss-Markov water."""
    depth_rate = 0.2
    rng = np.random.default_rng(seed)
    dt = DT_NS * 1e-9
    first = -round(surface_s / dt)
    t_ns = np.arange(first, round(duration_s / dt) + 1) * DT_NS
    t = t_ns * 1e-9
    T = len(t)

    # velocity over ground: two slow sinusoids and a mean; sinking from t = 0; position is its exact integral
    amplitude, phase = 0.05 * rng.standard_normal((2, 2)), rng.uniform(0, 2 * math.pi, (2, 2))
    omega = 2 * math.pi / np.array([41.0, 97.0])
    mean = 0.05 * rng.standard_normal(2)
    velocity, position = np.zeros((T, 3)), np.zeros((T, 3))
    for a in range(2):
        velocity[:, a] = mean[a] + sum(amplitude[a, i] * np.cos(omega[i] * t + phase[a, i]) for i in range(2))
        position[:, a] = mean[a] * t + sum(
            amplitude[a, i] / omega[i] * np.sin(omega[i] * t + phase[a, i]) for i in range(2)
        )
    sinking = np.maximum(t, 0.0)
    velocity[:, 2] = depth_rate * (1 - np.exp(-sinking / 2))
    position[:, 2] = depth_rate * (sinking - 2 * (1 - np.exp(-sinking / 2)))

    # attitude: 1.5 deg rms of roll and pitch at 4 s, and a turn of 90 deg after submerging
    tilt = math.radians(1.5) * math.sqrt(2)
    roll = tilt * np.sin(2 * math.pi * t / 4.0 + rng.uniform(0, 6))
    pitch = tilt * np.sin(2 * math.pi * t / 4.3 + rng.uniform(0, 6))
    heading = rng.uniform(-3, 3) + math.radians(90) / (1 + np.exp(-(t - 30) / 5))
    R = np.array([rotation(*angles) for angles in zip(roll, pitch, heading, strict=True)])

    imu = suite.imu
    gyro_bias = np.stack([markov(rng, imu.gyro_bias_sd_radps, imu.gyro_bias_tau_s, T, dt) for _ in range(3)], 1)
    accelerometer_bias = np.stack(
        [markov(rng, imu.accelerometer_bias_sd_mps2, imu.accelerometer_bias_tau_s, T, dt) for _ in range(3)], 1
    )
    compass_bias = markov(rng, suite.compass.bias_sd_rad, suite.compass.bias_tau_s, T, dt)
    W = earth_rate(suite.latitude_rad) if imu.senses_earth_rate else np.zeros(3)
    water = np.stack([markov(rng, 0.04, 8.0, 75, 1.0) for _ in range(2)], 1)

    adcp = suite.adcp
    beam_bias = adcp.beam_bias_sd_mps * rng.standard_normal(4)
    near_bias = adcp.near_bias_sd_mps * rng.standard_normal(4)
    mounting = rotation_exp(adcp.mounting_known_to_rad * rng.standard_normal(3))
    sa, ca = math.sin(adcp.beam_angle_rad), math.cos(adcp.beam_angle_rad)
    beams = np.array([[sa, 0, ca], [-sa, 0, ca], [0, sa, ca], [0, -sa, ca]]) @ mounting.T
    lever = np.array(adcp.lever_arm_m)
    ranges = adcp.blanking_m + adcp.cell_m * (1 + np.arange(int((adcp.range_m - adcp.blanking_m) / adcp.cell_m)))
    beam_error = beam_bias[:, None] + near_bias[:, None] * np.exp(-ranges / adcp.near_bias_length_m)

    rate, force = np.zeros((T, 3)), np.zeros((T, 3))
    E, half = rotation_exp(-W * dt), rotation_exp(-0.5 * W * dt)
    rate[1:] = [rotation_log(turn) / dt for turn in (E @ R[:-1]).transpose(0, 2, 1) @ R[1:]]
    middle = half @ R[:-1] @ np.array([rotation_exp(0.5 * dt * w) for w in rate[1:]])
    a = np.diff(velocity, axis=0) / dt + 2 * np.cross(W, velocity[:-1]) - np.array([0, 0, 9.80665])
    force[1:] = np.einsum("kij,ki->kj", middle, a)
    w_true = rate
    rate = rate + gyro_bias + imu.angle_random_walk_rad_per_rts / math.sqrt(dt) * rng.standard_normal((T, 3))
    force = (
        force + accelerometer_bias + imu.velocity_random_walk_mps_per_rts / math.sqrt(dt) * rng.standard_normal((T, 3))
    )

    # (time, order at one instant, message)
    messages: list[tuple[int, int, Message]] = [
        (at_ns, 0, ImuSample(t_ns=at_ns, interval_ns=DT_NS, angular_rate_radps=w, specific_force_mps2=f))
        for at_ns, w, f in zip(
            t_ns[1:].tolist(), map(tuple, rate[1:].tolist()), map(tuple, force[1:].tolist()), strict=True
        )
    ]

    def times(period_ns: int, last_ns: int) -> range:
        return range(-(-int(t_ns[0]) // period_ns) * period_ns, last_ns + 1, period_ns)

    def index(at_ns: int) -> int:
        return int((at_ns - t_ns[0]) // DT_NS)

    end_ns = int(t_ns[-1])
    for at_ns in times(suite.gnss.period_ns, 0):
        p, v = position[index(at_ns)], velocity[index(at_ns)]
        n = rng.standard_normal(4)
        messages.append(
            (
                at_ns,
                1,
                GnssFix(
                    t_ns=at_ns,
                    north_m=float(p[0] + suite.gnss.position_sd_m * n[0]),
                    east_m=float(p[1] + suite.gnss.position_sd_m * n[1]),
                    velocity_north_mps=float(v[0] + suite.gnss.velocity_sd_mps * n[2]),
                    velocity_east_mps=float(v[1] + suite.gnss.velocity_sd_mps * n[3]),
                ),
            )
        )
        before_ns = at_ns - suite.tdcp.period_ns
        if before_ns >= t_ns[0]:
            step = position[index(at_ns)] - position[index(before_ns)]
            n = suite.tdcp.displacement_sd_m * rng.standard_normal(2)
            messages.append(
                (
                    at_ns,
                    2,
                    TdcpFix(
                        t_ns=at_ns, from_t_ns=before_ns, north_m=float(step[0] + n[0]), east_m=float(step[1] + n[1])
                    ),
                )
            )
    for at_ns in times(suite.pressure.period_ns, end_ns):
        z = position[index(at_ns), 2] + suite.pressure.depth_sd_m * rng.standard_normal()
        messages.append((at_ns, 4, PressureDepth(t_ns=at_ns, depth_m=float(z))))
    for at_ns in times(suite.compass.period_ns, end_ns):
        k = index(at_ns)
        psi = heading[k] + compass_bias[k] + suite.compass.heading_sd_rad * rng.standard_normal()
        messages.append((at_ns, 5, CompassHeading(t_ns=at_ns, heading_rad=float(math.remainder(psi, 2 * math.pi)))))
    depths = np.arange(len(water))
    for at_ns in times(adcp.period_ns, end_ns):
        k = index(at_ns)
        s = (at_ns - t_ns[k]) / DT_NS
        k2 = min(k + 1, T - 1)
        p, v = (1 - s) * position[k] + s * position[k2], (1 - s) * velocity[k] + s * velocity[k2]
        w = w_true[k2]
        attitude = rotation_exp(-W * s * dt) @ R[k] @ rotation_exp(w * s * dt)
        z = np.empty((4, len(ranges)))
        for i in range(4):
            below = p[2] + (attitude @ lever)[2] + ranges * (attitude @ beams[i])[2]
            c = np.stack([np.interp(below, depths, water[:, 0]), np.interp(below, depths, water[:, 1]), 0 * below], 1)
            z[i] = (c - v - attitude @ np.cross(w - attitude.T @ W, lever)) @ (attitude @ beams[i])
        z += beam_error + adcp.beam_noise_sd_mps * rng.standard_normal(z.shape)
        wild = rng.uniform(size=z.shape) < adcp.outlier_share
        z[wild] += adcp.outlier_mps * rng.choice([-1.0, 1.0], size=int(wild.sum()))
        z[rng.uniform(size=4) < adcp.missing_share] = np.nan
        messages.append((at_ns, 3, AdcpPing(t_ns=at_ns, range_m=ranges, beam_velocity_mps=z)))
    messages.sort(key=lambda m: m[:2])
    return Dive(
        t_ns=t_ns,
        position=position,
        velocity=velocity,
        R=R,
        gyro_bias=gyro_bias,
        accelerometer_bias=accelerometer_bias,
        compass_bias=compass_bias,
        water=water,
        messages=[m for _, _, m in messages],
    )


@dataclass(frozen=True)
class Yoyo:
    """Filters after a yo-yo dive, the true water (G, 2), and position and velocity at the end."""

    filters: list[ErrorStateFilter]
    water: Array
    position: Array
    velocity: Array


def yoyo(
    suite: SensorConfig, configs: list[EstimatorConfig], seed: int, depths_m: tuple[float, ...], **settings
) -> Yoyo:
    """Level, heading roughly known, 0.5 m/s up or down between ``depths_m``, from a rough velocity fix at the first.

    20 inertial samples a second, so that many seeds cost little. ``settings``: ``saved`` is the filters' prior of the
    water, ``heard(filter)`` is called before each measurement is used.
    """
    saved, heard = settings.get("saved"), settings.get("heard", lambda _: None)
    rng = np.random.default_rng(seed)
    step_ns, dt = 50_000_000, 0.05
    nodes = Layout.of(suite, configs[0]).nodes
    z = configs[0].cell_m * np.arange(nodes)
    water = settings.get("water")
    if water is None:
        water = np.stack([markov(rng, 0.04, 8.0, nodes, configs[0].cell_m) for _ in range(2)], 1)
        water = water + 0.1 * rng.standard_normal(2)
    adcp, imu = suite.adcp, suite.imu
    heading, heading_sd, velocity_sd, bias_sd = 1.0, math.radians(2), 0.005, 0.05 * imu.accelerometer_bias_sd_mps2
    beam_bias = adcp.beam_bias_sd_mps * rng.standard_normal(4)
    near_bias = adcp.near_bias_sd_mps * rng.standard_normal(4)
    wrong, compass_bias = heading_sd * rng.standard_normal(), suite.compass.bias_sd_rad * rng.standard_normal()
    bias = np.array([*(bias_sd * rng.standard_normal(2)), 0.0])
    velocity = np.array([*(velocity_sd * rng.standard_normal(2)), 0.0])
    position = np.array([0.0, 0.0, depths_m[0]])
    R = rotation(0, 0, heading)

    filters = []
    for config in configs:
        layout = Layout.of(suite, config)
        belief = Belief.blank(layout, 0)
        belief.x[2], belief.R = depths_m[0], rotation(0, 0, heading - wrong)
        variance = np.zeros(layout.size)
        variance[2:5] = 1e-4, velocity_sd**2, velocity_sd**2
        variance[8], variance[12:14] = heading_sd**2, bias_sd**2
        variance[layout.beam_bias], variance[layout.near_bias] = adcp.beam_bias_sd_mps**2, adcp.near_bias_sd_mps**2
        variance[layout.compass_bias] = suite.compass.bias_sd_rad**2
        belief.P = np.diag(variance)
        write_prior(belief, config, saved)
        filters.append(ErrorStateFilter(suite, config, belief))

    s, c = math.sin(adcp.beam_angle_rad), math.cos(adcp.beam_angle_rad)
    beams = np.array([[s, 0, c], [-s, 0, c], [0, s, c], [0, -s, c]]) @ R.T
    ranges = adcp.blanking_m + adcp.cell_m * np.arange(1, int((adcp.range_m - adcp.blanking_m) / adcp.cell_m))
    error = beam_bias[:, None] + near_bias[:, None] * np.exp(-ranges / adcp.near_bias_length_m)
    k = 0
    for above, below in itertools.pairwise(depths_m):
        down = math.copysign(0.5, below - above)
        velocity[2] = down
        for filter_ in filters:
            filter_.belief.x[5] = down
        for _ in range(round(abs(below - above) / 0.5 / dt)):
            k += 1
            acceleration = 0.01 * np.array([math.cos(0.02 * k), math.sin(0.013 * k), 0.0])
            white = imu.velocity_random_walk_mps_per_rts / math.sqrt(dt) * rng.standard_normal(3)
            force = R.T @ (acceleration - np.array([0, 0, 9.80665])) + bias + white
            position = position + dt * velocity + 0.5 * dt * dt * acceleration
            velocity = velocity + dt * acceleration
            sample = ImuSample(
                t_ns=k * step_ns,
                interval_ns=step_ns,
                angular_rate_radps=(0.0, 0.0, 0.0),
                specific_force_mps2=tuple(force.tolist()),
            )
            for filter_ in filters:
                filter_.advance(sample.t_ns, sample)
            messages: list[Message] = []
            if k % 4 == 0:
                depth = position[2] + suite.pressure.depth_sd_m * rng.standard_normal()
                messages.append(PressureDepth(t_ns=sample.t_ns, depth_m=float(depth)))
            if k % 20 == 0:
                psi = heading + compass_bias + suite.compass.heading_sd_rad * rng.standard_normal()
                messages.append(CompassHeading(t_ns=sample.t_ns, heading_rad=float(psi)))
            if k % 7 == 0:
                at = position[2] + ranges * c
                flow = (
                    np.stack([np.interp(at, z, water[:, 0]), np.interp(at, z, water[:, 1]), 0 * at]) - velocity[:, None]
                )
                noise = adcp.beam_noise_sd_mps * rng.standard_normal((4, len(ranges)))
                messages.append(
                    AdcpPing(t_ns=sample.t_ns, range_m=ranges, beam_velocity_mps=beams @ flow + error + noise)
                )
            for message in messages:
                for filter_ in filters:
                    heard(filter_)
                    filter_.correct(message)
    for filter_ in filters:
        filter_.propagate_covariance()
    return Yoyo(filters, water, position, velocity)


def inbox(signal: Message) -> list[ReceivedMessage]:
    """Return the inbox of one message without latency."""
    return [ReceivedMessage(message=as_sent(signal), epoch=1, sequence=0, received_t_ns=signal.t_ns)]


@pytest.fixture(scope="session")
def make_dive() -> Callable[..., Dive]:
    return dive


@pytest.fixture(scope="session")
def make_yoyo() -> Callable[..., Yoyo]:
    return yoyo


@pytest.fixture(scope="session")
def inbox_of() -> Callable[[Message], list[ReceivedMessage]]:
    return inbox
