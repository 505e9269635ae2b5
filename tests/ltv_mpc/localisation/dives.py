"""Descents for these tests, independent of ``sim``: motion in closed form, sensors by their equations."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import numpy as np
from msgspec.structs import replace as changed

from ltv_mpc.frames import earth_rate, roll_pitch_heading, rotation, rotation_exp, rotation_log, wrap_angle
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.adcp import beam_directions
from ltv_mpc.messages import (
    AdcpPing,
    Array,
    CompassHeading,
    Estimate,
    EstimatorState,
    GnssFix,
    ImuSample,
    LocalisationReport,
    Message,
    PressureDepth,
    TdcpFix,
)
from ltv_mpc.node import ReceivedMessage
from tests.stepping import as_sent

PAPER, REALISTIC = SensorConfig.load("paper"), SensorConfig.load("realistic")
CONFIG = EstimatorConfig()
S = 1_000_000_000
DT_NS = 10_000_000
M = TypeVar("M", bound=Message)


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


@cache
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
    s, c = math.sin(adcp.beam_angle_rad), math.cos(adcp.beam_angle_rad)
    beams = np.array([[s, 0, c], [-s, 0, c], [0, s, c], [0, -s, c]]) @ mounting.T
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

    messages: list[tuple[int, int, Message]] = []  # with time, and order at one instant
    for k in range(1, T):
        w, f = tuple(rate[k].tolist()), tuple(force[k].tolist())
        sample = ImuSample(t_ns=int(t_ns[k]), interval_ns=DT_NS, angular_rate_radps=w, specific_force_mps2=f)
        messages.append((sample.t_ns, 0, sample))

    def times(period_ns: int, last_ns: int) -> range:
        return range(-(-int(t_ns[0]) // period_ns) * period_ns, last_ns + 1, period_ns)

    def index(at_ns: int) -> int:
        return int((at_ns - t_ns[0]) // DT_NS)

    end_ns = int(t_ns[-1])
    for at_ns in times(suite.gnss.period_ns, 0):
        sd = np.repeat([suite.gnss.position_sd_m, suite.gnss.velocity_sd_mps], 2)
        here = np.concatenate([position[index(at_ns), :2], velocity[index(at_ns), :2]])
        n, e, vn, ve = (here + sd * rng.standard_normal(4)).tolist()
        fix = GnssFix(t_ns=at_ns, north_m=n, east_m=e, velocity_north_mps=vn, velocity_east_mps=ve)
        messages.append((at_ns, 1, fix))
        before_ns = at_ns - suite.tdcp.period_ns
        if before_ns >= t_ns[0]:
            step = position[index(at_ns), :2] - position[index(before_ns), :2]
            n, e = (step + suite.tdcp.displacement_sd_m * rng.standard_normal(2)).tolist()
            messages.append((at_ns, 2, TdcpFix(t_ns=at_ns, from_t_ns=before_ns, north_m=n, east_m=e)))
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
        s, k2 = (at_ns - t_ns[k]) / DT_NS, min(k + 1, T - 1)
        p, v = (1 - s) * position[k] + s * position[k2], (1 - s) * velocity[k] + s * velocity[k2]
        attitude = rotation_exp(-W * s * dt) @ R[k] @ rotation_exp(w_true[k2] * s * dt)
        u = beams @ attitude.T
        below = p[2] + (attitude @ lever)[2] + np.outer(u[:, 2], ranges)
        swing = attitude @ np.cross(w_true[k2] - attitude.T @ W, lever)
        z = sum(u[:, a : a + 1] * np.interp(below, depths, water[:, a]) for a in range(2)) - (u @ (v + swing))[:, None]
        z += beam_error + adcp.beam_noise_sd_mps * rng.standard_normal(z.shape)
        wild = rng.uniform(size=z.shape) < adcp.outlier_share
        z[wild] += adcp.outlier_mps * rng.choice([-1.0, 1.0], size=int(wild.sum()))
        z[rng.uniform(size=4) < adcp.missing_share] = np.nan
        messages.append((at_ns, 3, AdcpPing(t_ns=at_ns, range_m=ranges, beam_velocity_mps=z)))
    messages.sort(key=lambda m: m[:2])
    bodies = position, velocity, R, gyro_bias, accelerometer_bias
    return Dive(t_ns, *bodies, compass_bias, water, [m for _, _, m in messages])


def with_water(of: Dive, extra: Callable[[float, Array], Array]) -> list[Message]:
    """Return the messages as if the water moved by ``extra(t_s, depth_m)`` more, north and east alike."""
    beams, out = beam_directions(PAPER.adcp.beam_angle_rad), []
    for message in of.messages:
        if isinstance(message, AdcpPing):
            k = of.at(message.t_ns)
            u = beams @ of.R[k].T
            depth = of.position[k, 2] + np.outer(u[:, 2], message.range_m)
            more = (u[:, :1] + u[:, 1:2]) * extra(message.t_ns * 1e-9, depth)
            message = changed(message, beam_velocity_mps=message.beam_velocity_mps + more)
        out.append(message)
    return out


def inbox(message: Message) -> list[ReceivedMessage]:
    """Return the inbox of one message without latency."""
    return [ReceivedMessage(message=as_sent(message), epoch=1, sequence=0, received_t_ns=message.t_ns)]


class Run:
    """Estimator after messages without latency, and its output; it may continue from a checkpoint."""

    def __init__(
        self,
        messages: Iterable[Message],
        sensors: SensorConfig = REALISTIC,
        config: EstimatorConfig = CONFIG,
        *,
        estimator: Estimator | None = None,
        state: EstimatorState | None = None,
    ) -> None:
        self.estimator = estimator or Estimator(sensors, config)
        self.steps: list[tuple[Message, list[Message]]] = []
        self._first = [] if state is None else [ReceivedMessage(state, 1, 0, state.t_ns)]
        self.feed(messages)

    def feed(self, messages: Iterable[Message]) -> None:
        """Continue with further messages."""
        for message in messages:
            self.steps.append((message, self.estimator.step(message.t_ns, [*self._first, *inbox(message)])))
            self._first = []

    def continued(self, messages: Iterable[Message]) -> Run:
        """Return another run that has begun as this one, which is left as it is."""
        other = copy.copy(self)
        other.estimator, other.steps = copy.deepcopy(self.estimator), list(self.steps)
        other.feed(messages)
        return other

    def of(self, kind: type[M]) -> list[M]:
        """Return the output of one type."""
        return [message for _, output in self.steps for message in output if isinstance(message, kind)]

    @property
    def estimates(self) -> dict[int, Estimate]:
        """Estimates by time. None is published twice, or after a later one."""
        by_time = {estimate.t_ns: estimate for estimate in self.of(Estimate)}
        assert sorted(by_time) == [estimate.t_ns for estimate in self.of(Estimate)]
        return by_time

    @property
    def reports(self) -> dict[int, LocalisationReport]:
        """Reports by time."""
        return {report.t_ns: report for report in self.of(LocalisationReport)}


def error_of(estimate: Estimate, of: Dive) -> Array:
    """Return the errors of position and velocity, north and east, and of the heading, (5,)."""
    k = of.at(estimate.t_ns)
    found = estimate.north_m, estimate.east_m, estimate.velocity_north_mps, estimate.velocity_east_mps
    heading = wrap_angle(estimate.heading_rad - roll_pitch_heading(of.R[k])[2])
    return np.array([*np.subtract(found, [*of.position[k, :2], *of.velocity[k, :2]]), heading])


def normalised(estimate: Estimate, of: Dive, count: int = 5) -> float:
    """Return the normalised squared error of the first ``count`` quantities of ``error_of``."""
    d = error_of(estimate, of)[:count]
    return float(d @ np.linalg.solve(estimate.covariance[:count, :count], d))
