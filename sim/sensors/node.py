"""All sensors of the vehicle as one node: truth in, measurements out, each sensor on its own grid of time.

A sensor's sample times are whole multiples of its period, whatever the truth's are; the truth is interpolated to them.
The first truth only opens the first interval, which is closed on both sides.
A message is kept until it arrives, its sensor's latency after it is valid, and is published at the first truth that is
not before that: with no latency at the truth that closes its interval. What is published at one truth is in the order
of validity; of one validity, in the order of the list of sensors. What has not arrived when the run ends is lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from heapq import heapify, heappush, heapreplace
from typing import NamedTuple, Protocol

from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.messages import (
    AdcpPing,
    BottomTrack,
    CompassHeading,
    Estimate,
    GnssFix,
    ImuSample,
    LblRange,
    Message,
    PressureDepth,
    TdcpFix,
    Truth,
    UsblFix,
)
from ltv_mpc.node import Due, Inbox, OnMessage
from sim.scenario import Scenario
from sim.sensors.adcp import Instrument, Profiler
from sim.sensors.bottom_track import BottomTracker
from sim.sensors.compass import MagneticCompass
from sim.sensors.gnss import GnssReceiver
from sim.sensors.imu import InertialUnit
from sim.sensors.lbl import AcousticTransceiver, arrival_ns
from sim.sensors.perfect import PerfectState
from sim.sensors.pressure import PressureGauge
from sim.sensors.tdcp import CarrierPhaseReceiver
from sim.sensors.usbl import ShipTransceiver
from sim.sensors.vehicle_state import Motion, VehicleState, through
from sim.water import WaterColumn


class Sensor(Protocol):
    """Something that measures at an instant."""

    def sample(self, now: VehicleState) -> Sequence[Message]:
        """What it says, if anything."""
        ...


class _Mounted(NamedTuple):
    """A sensor that samples at k x ``period_ns``, which need not divide the truth's."""

    sensor: Sensor
    period_ns: int
    latency_ns: int


class _OnTheWay(NamedTuple):
    """A message that has not been published yet."""

    t_ns: int  # of validity
    order: int  # of its sensor
    arrival_ns: int
    message: Message


class Sensors:
    """Reads ``Truth``; writes the messages of every sensor there is, and ``Estimate`` where a perfect one is wanted."""

    name = "sensors"
    schedule = OnMessage((Truth,))
    reads: tuple[type[Message], ...] = (Truth,)

    def __init__(
        self,
        scenario: Scenario,
        suite: SensorConfig,
        water: WaterColumn,
        *,
        heard: frozenset[type[Message]] | None = None,
    ) -> None:
        """Each sensor draws from its own stream of the scenario's seed.

        So those whose messages are not among ``heard`` may be left out, and what the others say stays the same.
        """
        seed, bottom_m = scenario.run.seed, scenario.water.bottom_m
        writes: list[type[Message]] = []
        # In this order they speak at one instant: the IMU's interval is over before anyone measures at its end.
        self._mounted: list[_Mounted] = []

        def mount(kind: type[Message], period_ns: int, sensor: Sensor, latency_ns: int = 0) -> None:
            if heard is not None and kind not in heard:
                return
            writes.append(kind)
            self._mounted.append(_Mounted(sensor, period_ns, latency_ns))

        imu, gnss, tdcp, adcp = suite.imu, suite.gnss, suite.tdcp, suite.adcp
        instrument = Instrument(adcp, seed)
        mount(ImuSample, imu.period_ns, InertialUnit(imu, suite.latitude_rad, seed))
        mount(GnssFix, gnss.period_ns, GnssReceiver(gnss, seed), gnss.latency_ns)
        mount(TdcpFix, tdcp.period_ns, CarrierPhaseReceiver(tdcp, seed, gnss.lever_arm_m), tdcp.latency_ns)
        mount(AdcpPing, adcp.period_ns, Profiler(instrument, water, seed, bottom_m), adcp.latency_ns)
        if (bed := suite.bottom_track) is not None:
            mount(BottomTrack, bed.period_ns, BottomTracker(bed, instrument, bottom_m, seed), bed.latency_ns)
        mount(PressureDepth, suite.pressure.period_ns, PressureGauge(suite.pressure, seed), suite.pressure.latency_ns)
        mount(CompassHeading, suite.compass.period_ns, MagneticCompass(suite.compass, seed), suite.compass.latency_ns)
        if (usbl := suite.usbl) is not None:
            mount(UsblFix, usbl.period_ns, ShipTransceiver(usbl, seed), usbl.latency_ns)
        self._lbl: AcousticTransceiver | None = None
        if (lbl := suite.lbl) is not None:
            self._lbl = AcousticTransceiver(lbl, seed)
            mount(LblRange, lbl.period_ns, self._lbl)
        if scenario.run.perfect_state:
            estimator = scenario.estimator
            mount(Estimate, estimator.estimate_period_ns, PerfectState(estimator, water))
        self.writes: tuple[type[Message], ...] = tuple(writes)
        self._on_the_way: list[_OnTheWay] = []
        self._last: Truth | None = None
        self._motion: Motion | None = None  # the newest that was looked at
        self._due: list[tuple[int, int]] = []  # heap of each sensor's next sample: its time, the sensor's order

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """The sensors, in the order in which they speak at one instant."""
        return tuple(mounted.sensor for mounted in self._mounted)

    def steps(self, due: Sequence[Due]) -> list[list[Message]]:
        """What has arrived since the last truth, in order of validity.

        Where the inertial unit measures at every truth, its samples are made at once.
        """
        if len(due) == 1:  # as in a process, where looking for several costs more than it saves
            return [self._step(due[0][1])]
        truths = [arrival.message for _, inbox in due for arrival in inbox if isinstance(arrival.message, Truth)]
        imu = self._mounted[0].sensor if self._mounted else None
        if not (isinstance(imu, InertialUnit) and len(truths) == len(due) and self._is_measured_at(truths, imu)):
            return [self._step(inbox) for _, inbox in due]
        assert self._last is not None
        ends = [self._last, *truths]
        motions = through(ends, self._motion)
        samples = imu.samples([end.t_ns for end in ends], motions.rotation, [end.velocity_mps for end in ends])
        self._last, self._motion = truths[-1], motions[len(truths) - 1]
        self._due = [(t_ns, order) for t_ns, order in self._due if order]
        heapify(self._due)
        signals: list[list[Message]] = []
        for k, sample in enumerate(samples):
            t_ns = sample.t_ns
            if self._on_the_way or (self._due and self._due[0][0] <= t_ns):
                self._on_the_way.append(_OnTheWay(t_ns, 0, t_ns, sample))
                self._sample(motions[k], t_ns)
                signals.append(self._arrived(t_ns))
            else:
                signals.append([sample])
        heappush(self._due, (truths[-1].t_ns + self._mounted[0].period_ns, 0))
        return signals

    def _step(self, inbox: Inbox) -> list[Message]:
        signals: list[Message] = []
        for arrival in inbox:
            if isinstance(arrival.message, Truth) and (self._last is None or arrival.message.t_ns > self._last.t_ns):
                signals += self._measure(arrival.message)
        return signals

    def _is_measured_at(self, truths: Sequence[Truth], imu: InertialUnit) -> bool:
        """At each of them, and nowhere else, the inertial unit, the first of the sensors, is due."""
        period_ns, last = self._mounted[0].period_ns, self._last
        if last is None or self._lbl is not None or not imu.has_begun:
            return False
        first_ns = last.t_ns + period_ns
        stamps = [truth.t_ns for truth in truths]
        return (first_ns, 0) in self._due and stamps == [first_ns + k * period_ns for k in range(len(stamps))]

    def _measure(self, truth: Truth) -> list[Message]:
        last, self._last = self._last, truth
        if last is None:
            periods = [mounted.period_ns for mounted in self._mounted]
            self._due = [(-(-truth.t_ns // period) * period, order) for order, period in enumerate(periods)]
            heapify(self._due)
            return []  # whatever of it is due comes with the next truth
        if self._lbl is not None or (self._due and self._due[0][0] <= truth.t_ns):
            self._motion = through([last, truth], self._motion)[0]
            self._sample(self._motion, truth.t_ns)
        return self._arrived(truth.t_ns) if self._on_the_way else []

    def _sample(self, motion: Motion, until_ns: int) -> None:
        """Every sample up to ``until_ns``, in order of time, then of the sensors."""
        due, on_the_way = self._due, self._on_the_way
        while due and due[0][0] <= until_ns:
            t, order = due[0]
            sensor, period_ns, latency_ns = self._mounted[order]
            heapreplace(due, (t + period_ns, order))
            for said in sensor.sample(motion.at(t)):
                on_the_way.append(_OnTheWay(t, order, t + latency_ns, said))
        if self._lbl is not None:
            answers = self._lbl.answers(motion, until_ns)
            on_the_way += [_OnTheWay(x.t_ns, len(self._mounted), arrival_ns(x), x) for x in answers]

    def _arrived(self, until_ns: int) -> list[Message]:
        here = [message for message in self._on_the_way if message.arrival_ns <= until_ns]
        self._on_the_way = [message for message in self._on_the_way if message.arrival_ns > until_ns]
        if len(here) > 1:
            here.sort(key=lambda message: message[:2])
        return [message.message for message in here]
