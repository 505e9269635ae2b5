"""Descents for these tests: motion in closed form, measured by the simulated sensors."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import numpy as np
from msgspec.structs import replace as changed

from ltv_mpc.frames import roll_pitch_heading, rotation, wrap_angle
from ltv_mpc.localisation.config import EstimatorConfig
from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors.adcp import beam_directions
from ltv_mpc.messages import AdcpPing, Array, Estimate, EstimatorState, LocalisationReport, Message
from ltv_mpc.node import ReceivedMessage
from sim.scenario import Water
from sim.sensors import SIMULATED
from sim.sensors.simulated import Environment
from sim.sensors.vehicle_state import Motion, VehicleState, motion_between
from sim.water import make
from tests.sim.worlds import truth
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
    water: Array  # (K, 2) at 0, 1, 2, ... m
    messages: list[Message]

    def at(self, t_ns: int) -> int:
        """Return the index of a time of the inertial grid."""
        return int((t_ns - self.t_ns[0]) // DT_NS)


def path(rng: np.random.Generator, t: Array) -> tuple[Array, Array]:
    """Return position and velocity, (T, 3): two slow sinusoids and a mean, sinking at 0.2 m/s from t = 0 on."""
    amplitude, phase = 0.05 * rng.standard_normal((2, 2)), rng.uniform(0, 2 * math.pi, (2, 2))
    omega, mean = 2 * math.pi / np.array([41.0, 97.0]), 0.05 * rng.standard_normal(2)
    position, velocity = np.zeros((len(t), 3)), np.zeros((len(t), 3))
    for a in range(2):
        angle = t[:, None] * omega + phase[a]
        velocity[:, a] = mean[a] + np.cos(angle) @ amplitude[a]
        position[:, a] = mean[a] * t + np.sin(angle) @ (amplitude[a] / omega)
    sinking = np.maximum(t, 0.0)
    velocity[:, 2] = 0.2 * (1 - np.exp(-sinking / 2))
    position[:, 2] = 0.2 * (sinking - 2 * (1 - np.exp(-sinking / 2)))
    return position, velocity


def attitude(rng: np.random.Generator, t: Array) -> Array:
    """Return roll, pitch and heading, (T, 3): 1.5 deg rms at 4 s, and a turn of 90 deg after submerging."""
    tilt = math.radians(1.5) * math.sqrt(2)
    roll = tilt * np.sin(2 * math.pi * t / 4.0 + rng.uniform(0, 6))
    pitch = tilt * np.sin(2 * math.pi * t / 4.3 + rng.uniform(0, 6))
    return np.stack([roll, pitch, rng.uniform(-3, 3) + math.radians(90) / (1 + np.exp(-(t - 30) / 5))], axis=1)


@cache
def dive(
    suite: SensorConfig, seed: int, *, surface_s: float = 1.0, duration_s: float = 200.0, bottom_m: float | None = None
) -> Dive:
    """Simulate a descent in 4 cm/s of Gauss-Markov water, after ``surface_s``, with the simulated sensors."""
    rng = np.random.default_rng(seed)
    t_ns = np.arange(-round(surface_s * S) // DT_NS, round(duration_s * S) // DT_NS + 1) * DT_NS
    position, velocity = path(rng, t_ns * 1e-9)
    angles = attitude(rng, t_ns * 1e-9)
    R = np.array([rotation(*one) for one in angles])
    column = make(Water(), seed)
    environment = Environment(suite, seed, column, bottom_m)
    fitted = {name: getattr(suite, name) for name in SIMULATED if getattr(suite, name) is not None}
    devices = {name: SIMULATED[name](settings, environment) for name, settings in fitted.items()}
    unit, asking = devices.pop("imu"), devices.get("lbl")

    def motion(k: int) -> Motion:
        """Return the motion that ends with a sample, or that begins with the first one."""
        ends = []
        for i in (max(k, 1) - 1, max(k, 1)):
            p, v, a = (tuple(of[i].tolist()) for of in (position, velocity, angles))
            ends.append(truth(int(t_ns[i]), position_m=p, velocity_mps=v, attitude_rad=a))
        return motion_between(*ends)

    biases, messages = [], []
    for k, now_ns in enumerate(t_ns.tolist()):
        state = VehicleState(now_ns, tuple(position[k]), tuple(velocity[k].tolist()), R[k], np.zeros(3), 0.0)
        messages += [(now_ns, 0, sample) for sample in unit.sample(state)]
        biases.append([unit.gyro_bias_radps, unit.accelerometer_bias_mps2])
        for order, (name, device) in enumerate(devices.items(), 1):
            period_ns = fitted[name].period_ns
            last_ns = now_ns - (DT_NS if k else 1)
            for at in range((last_ns // period_ns + 1) * period_ns, now_ns + 1, period_ns):
                messages += [(at, order, m) for m in device.sample(motion(k).at(at))]
        if asking is not None:
            messages += [(m.t_ns, len(devices) + 1, m) for m in asking.answers(motion(k), now_ns)]
    messages.sort(key=lambda entry: entry[:2])
    water = column.over(np.arange(71.0), 0)
    return Dive(t_ns, position, velocity, R, *np.array(biases).transpose(1, 0, 2), water, [m for _, _, m in messages])


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
