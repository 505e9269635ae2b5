"""All sensors of the vehicle as one node: truth in, measurements out, each sensor on its own grid of time.

A sensor's sample times are whole multiples of its period, whatever the truth's are; the truth is interpolated to them.
The first truth only opens the first interval, which is closed on both sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from ltv_mpc.localisation.suite import Suite
from ltv_mpc.node import Inbox, OnMessage, Phases
from ltv_mpc.signals import (
    AdcpPing,
    CompassHeading,
    Estimate,
    GnssFix,
    ImuSample,
    PressureDepth,
    Signal,
    TdcpFix,
    Truth,
)
from sim.scenario import Scenario
from sim.sensors.adcp import Profiler
from sim.sensors.compass import MagneticCompass
from sim.sensors.gnss import Receiver
from sim.sensors.imu import InertialUnit
from sim.sensors.instant import Instant, Motion
from sim.sensors.perfect import PerfectState
from sim.sensors.pressure import Gauge
from sim.sensors.tdcp import CarrierPhase
from sim.water import WaterColumn


class Sensor(Protocol):
    """Something that measures at an instant."""

    def sample(self, now: Instant) -> Sequence[Signal]:
        """What it says, if anything."""
        ...


class Sensors:
    """Reads ``Truth``; writes every sensor's messages, and ``Estimate`` where the scenario asks for a perfect one."""

    name = "sensors"
    schedule = OnMessage((Truth,))
    reads: tuple[type[Signal], ...] = (Truth,)

    def __init__(self, scenario: Scenario, suite: Suite, water: WaterColumn) -> None:
        """Each sensor draws from its own stream of the scenario's seed."""
        seed = scenario.run.seed
        self.writes: tuple[type[Signal], ...] = (ImuSample, GnssFix, TdcpFix, AdcpPing, PressureDepth, CompassHeading)
        # In this order they speak at one instant: the IMU's interval is over before anyone measures at its end.
        self._sensors: list[tuple[Phases, Sensor]] = [
            (Phases(suite.imu.period_ns), InertialUnit(suite.imu, suite.latitude_rad, seed)),
            (Phases(suite.gnss.period_ns), Receiver(suite.gnss, seed)),
            (Phases(suite.tdcp.period_ns), CarrierPhase(suite.tdcp, seed)),
            (Phases(suite.adcp.period_ns), Profiler(suite.adcp, water, seed)),
            (Phases(suite.pressure.period_ns), Gauge(suite.pressure, seed)),
            (Phases(suite.compass.period_ns), MagneticCompass(suite.compass, seed)),
        ]
        if scenario.run.perfect_state:
            self.writes = (*self.writes, Estimate)
            estimator = scenario.estimator
            self._sensors.append((Phases(estimator.estimate_period_ns), PerfectState(estimator, water)))
        self._last: Truth | None = None
        self._sampled_ns = 0

    def step(self, t_ns: int, inbox: Inbox) -> list[Signal]:  # noqa: ARG002  (each truth carries its own)
        """What was measured since the last truth, in order of time."""
        signals: list[Signal] = []
        for arrival in inbox:
            if isinstance(arrival.signal, Truth) and (self._last is None or arrival.signal.t_ns > self._last.t_ns):
                signals += self._measure(arrival.signal)
        return signals

    def _measure(self, truth: Truth) -> list[Signal]:
        last, self._last = self._last, truth
        if last is None:
            self._sampled_ns = truth.t_ns - 1
            return []
        motion, after_ns, self._sampled_ns = Motion(last, truth), self._sampled_ns, truth.t_ns
        due = [
            (t, order, sensor)
            for order, (phases, sensor) in enumerate(self._sensors)
            for t in phases.between(after_ns, truth.t_ns)
        ]
        due.sort(key=lambda entry: entry[:2])
        signals: list[Signal] = []
        for t, _, sensor in due:
            signals += sensor.sample(motion.at(t))
        return signals
