"""One descent of the full loop in lock step with an event, and what a user feels of it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import msgspec
import numpy as np

from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.messages import (
    Estimate,
    EstimatorState,
    FilterStatus,
    GnssFix,
    LocalisationReport,
    Message,
    Truth,
)
from ltv_mpc.node import Due, Node, ReceivedMessage
from services.run.nodes import make_nodes
from services.run.run_config import Override, resolve
from services.tools import lockstep_run
from services.tools.faults import lockstep_runs
from sim.faults.message_faults import MessageFaultInterval
from sim.faults.sensor_faults import FaultySensors, SensorFault
from sim.scheduler import LockStep, Observation
from sim.sensors.imu import InertialUnit
from sim.sensors.node import Sensors

S = 1_000_000_000
BEGINS_S = 30.0
"""Start of events: at 6 m of depth, with observed water and settled errors."""
DURATION_S = 80.0
THREE_SIGMA = 11.83
"""Chi-square of two degrees of freedom that 0.27 % exceed."""
SEEN_SD_MPS = 0.03
"""Largest standard deviation of a measured cell; the prior's is 0.11 m/s."""

settings: tuple[str, ...] = ()
"""Settings on top of those of every descent: a switch may replace them."""


def as_given(suite: SensorConfig) -> SensorConfig:
    """Return the sensors file that the estimator is given: the true one. A switch may replace this function."""
    return suite


@dataclass(frozen=True, kw_only=True)
class Descent:
    """Descent with an event. It is a function of the seed, ``Event.run``: call it."""

    settings: tuple[str, ...] = ()
    sensors: str = "realistic"
    broken: tuple[SensorFault, ...] = ()
    harmed: tuple[MessageFaultInterval, ...] = ()
    gyro_radps: float = 0.0  # a fault of the gyro about the body's x axis, from ``BEGINS_S`` on
    restarted: bool = False  # the estimator's process is replaced at ``BEGINS_S``
    twice: tuple[type[Message], ...] = ()  # types that the sensors publish twice
    gnss_velocity_mps: float = 0.0  # error of the last satellite fix's velocity, north
    duration_s: float = DURATION_S
    surface_s: float = 10.0

    def __call__(self, seed: int) -> dict[str, float]:
        """Make the run and return its measures."""
        assignments = (
            f'sensors="{self.sensors}"', f"run.seed={seed}", f"run.duration_s={self.duration_s}",
            f"run.surface_time_s={self.surface_s}", *self.settings, *settings,
        )  # fmt: skip
        run_config = resolve("descent", [Override("ablation", assignments)])
        scenario = run_config.scenario
        plant, sensors, _, controller = make_nodes(run_config, publish_unread_topics=False)

        def estimator() -> Estimator:
            return Estimator(as_given(run_config.sensor_config), scenario.estimator, run_config.prior)

        timed = TimedNode(estimator, BEGINS_S * S if self.restarted else math.inf)
        watch = Watch(sensors, self.gyro_radps, run_config.water)
        if self.gnss_velocity_mps or self.twice:
            sensors = Changed(sensors, self.twice, self.gnss_velocity_mps)
        if self.broken:
            sensors = FaultySensors(sensors, self.broken)
        nodes = [plant, sensors, timed, controller]
        lockstep = LockStep(
            nodes,
            start_ns=scenario.start_ns,
            observation=Observation(watch, types=watch.message_types),
            latest=lockstep_run.LATEST,
            make_rejection=lockstep_run.rejected_message,
            transport=lockstep_runs.Bus(self.harmed) if self.harmed else None,
        )
        crashed = 0.0
        try:
            lockstep.advance(scenario.end_ns)
        except (ArithmeticError, ValueError, np.linalg.LinAlgError):  # an estimator that ends the run is a result
            crashed = 1.0
        vehicle_s = (scenario.end_ns - scenario.start_ns) * 1e-9
        return {**watch.measures(), "crashed": crashed, "estimator ms per s": 1e3 * timed.seconds / vehicle_s}


class TimedNode:
    """Estimator that measures the processor time of its steps; it is replaced by a new one at ``restart_ns``."""

    def __init__(self, make: Callable[[], Estimator], restart_ns: float) -> None:
        self._make, self._restart_ns = make, restart_ns
        self._node = make()
        self.newest: dict[type[Message], Any] = {}
        self.name, self.schedule = self._node.name, self._node.schedule
        self.reads, self.writes = self._node.reads, self._node.writes
        self.seconds = 0.0

    def steps(self, due: Sequence[Due]) -> list[list[Message]]:
        """Step the estimator; from the time of the restart on, a new one."""
        before = [step for step in due if step[0] < self._restart_ns]
        out = self._taken(before) if before else []
        after = list(due[len(before) :])
        if after and math.isfinite(self._restart_ns):
            self._restart_ns, self._node = math.inf, self._make()
            t_ns, inbox = after[0]
            after[0] = (t_ns, [*(ReceivedMessage(state, 1, 0, t_ns) for state in self.states()), *inbox])
        return [*out, *(self._taken(after) if after else [])]

    def _taken(self, due: Sequence[Due]) -> list[list[Message]]:
        began = time.thread_time()
        out = self._node.steps(due)
        self.seconds += time.thread_time() - began
        self.newest.update({type(message): message for messages in out for message in messages})
        return out

    def states(self) -> list[EstimatorState]:
        """Return the state that a supervisor hands to the new process, or nothing."""
        state = self.newest.get(EstimatorState)
        return [] if state is None else [msgspec.structs.replace(state, estimate=self.newest.get(Estimate))]


class Changed:
    """Sensors with faults: some publish everything twice, and the satellite fix at -1 s has a wrong velocity."""

    def __init__(self, sensors: Node, twice: tuple[type[Message], ...], error_mps: float) -> None:
        self._sensors, self._twice, self._error_mps = sensors, twice, error_mps
        self.name, self.schedule = sensors.name, sensors.schedule
        self.reads, self.writes = sensors.reads, sensors.writes

    def steps(self, due: Sequence[Due]) -> list[list[Message]]:
        """Step the sensors."""
        return [self._changed(messages) for messages in self._sensors.steps(due)]

    def _changed(self, messages: Sequence[Message]) -> list[Message]:
        wrong = [self._wrong(message) for message in messages]
        return [again for message in wrong for again in [message] * (2 if isinstance(message, self._twice) else 1)]

    def _wrong(self, message: Message) -> Message:
        if isinstance(message, GnssFix) and message.t_ns == -S:
            return msgspec.structs.replace(message, velocity_north_mps=message.velocity_north_mps + self._error_mps)
        return message


@dataclass
class Watch:
    """An observer of lock step that holds estimates against the truth at every whole second from 0 on."""

    sensors: Node
    gyro_radps: float
    water: Any
    status: list[tuple[int, FilterStatus]] = field(default_factory=list)
    restarts: int = 0
    truth: dict[int, Truth] = field(default_factory=dict)
    estimate: dict[int, Estimate] = field(default_factory=dict)

    message_types = frozenset({Truth, Estimate, LocalisationReport})

    def published(self, node: str, message: ReceivedMessage) -> None:  # noqa: ARG002  (the type says who)
        """Keep what is of a whole second."""
        match message.message:
            case Truth() as truth if truth.t_ns % S == 0 and truth.t_ns >= 0:
                self.truth[truth.t_ns] = truth
                if truth.t_ns >= BEGINS_S * S and self.gyro_radps:
                    fail_gyro(self.sensors, self.gyro_radps)
                    self.gyro_radps = 0.0
            case Estimate() as estimate if estimate.t_ns % S == 0 and estimate.t_ns >= 0:
                self.estimate[estimate.t_ns] = estimate
            case LocalisationReport() as report:
                self.status.append((report.t_ns, report.status))
                self.restarts = report.restarts
            case _:
                pass

    def measures(self) -> dict[str, float]:
        """Return every measure of the run."""
        times = sorted(self.truth)
        p = np.array([self.truth[t].position_m[:2] for t in times])
        v = np.array([self.truth[t].velocity_mps[:2] for t in times])
        estimates = latest(times, self.estimate)
        e = np.array([[s.north_m, s.east_m] for s in estimates])
        ev = np.array([[s.velocity_north_mps, s.velocity_east_mps] for s in estimates])
        heading = np.array([math.remainder(s.heading_rad - self.truth[t].attitude_rad[2], 2 * math.pi)
                            for s, t in zip(estimates, times, strict=True)])  # fmt: skip
        true = np.hypot(*(p - p[0]).T)
        drift = np.hypot(*((e - e[0]) - (p - p[0])).T)
        after = np.array(times) >= BEGINS_S * S
        fresh = np.array([s.t_ns == t for s, t in zip(estimates, times, strict=True)])
        well = np.array([self.nominal(t) for t in times])
        squares = np.array([normalised(s, q, w) for s, q, w in zip(estimates, p, v, strict=True)])
        outside = ~(squares.max(axis=1) <= THREE_SIGMA)  # written so that NaN is outside
        noticed = [t for t, is_well in zip(times, well, strict=True) if t >= BEGINS_S * S and not is_well]
        cells = [self.cells(s, t) for s, t, is_well in zip(estimates, times, well, strict=True) if is_well]
        seen = sum(count for count, _ in cells)
        return {
            "true rms m": rms(true),
            "true 95 % m": float(np.quantile(true, 0.95)),
            "drift end m": float(drift[-1]),
            "drift after m": float(drift[after].max()),
            "velocity rms m/s": rms(np.hypot(*(ev - v)[after & fresh].T)),
            "heading rms deg": math.degrees(rms(heading)),
            **consistency(heading[after & fresh], [s for s, use in zip(estimates, after & fresh, strict=True) if use]),
            "position nees": float(np.mean(squares[after, 0])) / 2.0,
            "velocity nees": float(np.mean(squares[after, 1])) / 2.0,
            "outside": float((outside & after).sum() / after.sum()),
            "silent": float((outside & well & after).sum() / after.sum()),
            "cells silent": sum(wrong for _, wrong in cells) / seen if seen else 0.0,
            "delay s": noticed[0] / S - BEGINS_S if noticed else math.nan,
            "missed": float(not noticed),
            "alarms before": float((~well & ~after).sum() / max(1, (~after).sum())),
            "not nominal after": float((~well & after).sum() / after.sum()),
            "reinitialised": float(self.restarts),
            "no estimate": float((~fresh).mean()),
        }

    def nominal(self, t_ns: int) -> bool:
        """Return whether the newest report says that the filter is well."""
        newest = [status for reported_ns, status in self.status if reported_ns <= t_ns]
        return not newest or newest[-1] is FilterStatus.NOMINAL

    def cells(self, estimate: Estimate, t_ns: int) -> tuple[int, int]:
        """Count the cells of water that have been measured, and those of them that are more than 3 sigma off."""
        profile = estimate.current
        if profile is None or t_ns % (10 * S):
            return 0, 0
        sd = np.asarray(profile.sd_mps)
        seen = sd < SEEN_SD_MPS
        truth = self.water.over(np.asarray(profile.depth_m), t_ns)
        off = np.stack([profile.north_mps, profile.east_mps], axis=1) - np.asarray(truth)[:, :2]
        return int(2 * seen.sum()), int((np.abs(off[seen]) > 3.0 * sd[seen, None]).sum())


def fail_gyro(sensors: Node, rate_radps: float) -> None:
    """Add a constant to the bias of the gyro about the body's x axis."""
    assert isinstance(sensors, Sensors)
    unit = next(unit for unit in sensors.sensors if isinstance(unit, InertialUnit))
    unit._bias.value[0] += rate_radps


def latest(times: Sequence[int], estimates: dict[int, Estimate]) -> list[Estimate]:
    """Return at each time the newest estimate: the one before where there is none of that time."""
    newest = estimates[min(estimates)]
    out = []
    for t in times:
        newest = estimates.get(t, newest)
        out.append(newest)
    return out


def normalised(estimate: Estimate, position_m: np.ndarray, velocity_mps: np.ndarray) -> tuple[float, float]:
    """Return the squared errors of horizontal position and velocity, normalised by the covariance (mean: 2)."""
    P = estimate.covariance
    if P is None:
        return 0.0, 0.0
    dp = np.array([estimate.north_m, estimate.east_m]) - position_m
    dv = np.array([estimate.velocity_north_mps, estimate.velocity_east_mps]) - velocity_mps
    position, velocity = (float(d @ np.linalg.solve(C, d)) for d, C in ((dp, P[:2, :2]), (dv, P[2:4, 2:4])))
    return position, velocity


def consistency(error_rad: np.ndarray, estimates: Sequence[Estimate]) -> dict[str, float]:
    """Return how the heading's errors (K,) compare with the reported standard deviations; NaN of no estimate."""
    sd_rad = np.array([math.nan if s.covariance is None else math.sqrt(s.covariance[4, 4]) for s in estimates])
    ratio = error_rad / sd_rad
    return {
        "heading nees, end": float(ratio[-1] ** 2) if len(ratio) else math.nan,
        "heading outside 2 sigma": float(np.mean(np.abs(ratio) > 2.0)) if len(ratio) else math.nan,
        "heading sd, end deg": math.degrees(float(sd_rad[-1])) if len(ratio) else math.nan,
    }


def rms(values: np.ndarray) -> float:
    """Return the root of the mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else math.nan
