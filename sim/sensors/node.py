"""All sensors of the vehicle as one node: truth in, measurements out, each sensor on its own time grid.

A sensor samples at whole multiples of its period, independent of the times of the truths: the truth is interpolated.
The first truth only opens the first interval, which is closed on both sides.
A message is stored until it arrives, its sensor's latency after it is valid, and is published with the first truth that
is not before its arrival: without latency, with the truth that closes its interval. The messages of one truth are
published in order of validity; those of one validity in the order of ``SIMULATED``. Messages that have not arrived when
the run ends are lost.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from heapq import heapify, heappush, heapreplace
from typing import NamedTuple

from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import BY_NAME
from ltv_mpc.localisation.sensors.settings import latency_ns
from ltv_mpc.messages import Estimate, Message, Truth
from ltv_mpc.node import Due, Inbox, OnMessage
from sim.scenario import Scenario
from sim.sensors import SIMULATED
from sim.sensors.imu import InertialUnit
from sim.sensors.perfect import PerfectState
from sim.sensors.simulated import Environment, InterrogatingSensor, SimulatedSensor
from sim.sensors.vehicle_state import Motion, motions_between
from sim.water import WaterColumn


class _Mounted(NamedTuple):
    """A sensor that samples at k x ``period_ns``, which need not divide the period of the truth."""

    sensor: SimulatedSensor
    period_ns: int
    latency_ns: int


class _UnderWay(NamedTuple):
    """A message that has not been published yet."""

    t_ns: int  # of validity
    order: int  # of its sensor
    arrival_ns: int
    message: Message


class Sensors:
    """Node that reads ``Truth`` and writes the messages of every sensor, or ``Estimate`` for a perfect state."""

    name = "sensors"
    schedule = OnMessage((Truth,))
    reads: tuple[type[Message], ...] = (Truth,)

    def __init__(
        self,
        scenario: Scenario,
        sensor_config: SensorConfig,
        water: WaterColumn,
        *,
        needed: frozenset[type[Message]] | None = None,
    ) -> None:
        """Create the sensors whose messages are in ``needed``; None: all.

        Each sensor draws from its own stream of the scenario's seed, so a missing sensor does not change the others.
        """
        environment = Environment(sensor_config, scenario.run.seed, water, scenario.water.bottom_m)
        writes: list[type[Message]] = []
        self._mounted: list[_Mounted] = []
        self._by_name: dict[str, SimulatedSensor] = {}
        for name, make in SIMULATED.items():
            settings, message = getattr(sensor_config, name), BY_NAME[name].message
            if settings is not None and (needed is None or message in needed):
                sensor = self._by_name[name] = make(settings, environment)
                self._mounted.append(_Mounted(sensor, settings.period_ns, latency_ns(settings) or 0))
                writes.append(message)
        if scenario.run.perfect_state and (needed is None or Estimate in needed):
            estimator = scenario.estimator
            perfect = PerfectState(estimator, water, scenario.water.bottom_m)
            self._mounted.append(_Mounted(perfect, estimator.estimate_period_ns, 0))
            writes.append(Estimate)
        self.writes: tuple[type[Message], ...] = tuple(writes)
        self._interrogating = [x for x in self._by_name.values() if isinstance(x, InterrogatingSensor)]
        self._under_way: list[_UnderWay] = []
        self._last: Truth | None = None
        self._motion: Motion | None = None  # the newest that was computed
        self._due: list[tuple[int, int]] = []  # heap of each sensor's next sample: its time, the sensor's order

    @property
    def by_name(self) -> Mapping[str, SimulatedSensor]:
        """Sensors by their name in the registry, in the order in which they publish at one instant."""
        return self._by_name

    @property
    def sensors(self) -> tuple[SimulatedSensor, ...]:
        """All sensors, that of a perfect state included, in the order in which they publish at one instant."""
        return tuple(mounted.sensor for mounted in self._mounted)

    def steps(self, due: Sequence[Due]) -> list[list[Message]]:
        """Return the messages that have arrived since the last truth, in order of validity.

        If the inertial unit measures at every truth, its samples are computed at once.
        """
        if len(due) == 1:  # a search for batches would cost more than it saves
            return [self._step(due[0][1])]
        truths = [received.message for _, inbox in due for received in inbox if isinstance(received.message, Truth)]
        imu = self._mounted[0].sensor if self._mounted else None
        if not (isinstance(imu, InertialUnit) and len(truths) == len(due) and self._is_measured_at(truths, imu)):
            return [self._step(inbox) for _, inbox in due]
        assert self._last is not None
        ends = [self._last, *truths]
        motions = motions_between(ends, self._motion)
        samples = imu.samples([end.t_ns for end in ends], motions.rotation, [end.velocity_mps for end in ends])
        self._last, self._motion = truths[-1], motions[len(truths) - 1]
        self._due = [(t_ns, order) for t_ns, order in self._due if order]
        heapify(self._due)
        messages: list[list[Message]] = []
        for k, sample in enumerate(samples):
            t_ns = sample.t_ns
            if self._under_way or (self._due and self._due[0][0] <= t_ns):
                self._under_way.append(_UnderWay(t_ns, 0, t_ns, sample))
                self._sample(motions[k], t_ns)
                messages.append(self._arrived(t_ns))
            else:
                messages.append([sample])
        heappush(self._due, (truths[-1].t_ns + self._mounted[0].period_ns, 0))
        return messages

    def _step(self, inbox: Inbox) -> list[Message]:
        messages: list[Message] = []
        for received in inbox:
            if isinstance(received.message, Truth) and (self._last is None or received.message.t_ns > self._last.t_ns):
                messages += self._measure(received.message)
        return messages

    def _is_measured_at(self, truths: Sequence[Truth], imu: InertialUnit) -> bool:
        """Return True if the inertial unit, the first of the sensors, is due at each truth and at no other time."""
        period_ns, last = self._mounted[0].period_ns, self._last
        if last is None or self._interrogating or not imu.has_begun:
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
            return []  # measurements that are due now follow with the next truth
        if self._interrogating or (self._due and self._due[0][0] <= truth.t_ns):
            self._motion = motions_between([last, truth], self._motion)[0]
            self._sample(self._motion, truth.t_ns)
        return self._arrived(truth.t_ns) if self._under_way else []

    def _sample(self, motion: Motion, until_ns: int) -> None:
        """Take every sample up to ``until_ns``, in order of time, then of the sensors."""
        due, under_way = self._due, self._under_way
        while due and due[0][0] <= until_ns:
            t, order = due[0]
            sensor, period_ns, latency = self._mounted[order]
            heapreplace(due, (t + period_ns, order))
            for message in sensor.sample(motion.at(t)):
                under_way.append(_UnderWay(t, order, t + latency, message))
        for order, interrogating in enumerate(self._interrogating, len(self._mounted)):
            answers = interrogating.answers(motion, until_ns)
            under_way += [_UnderWay(x.t_ns, order, interrogating.arrival_ns(x), x) for x in answers]

    def _arrived(self, until_ns: int) -> list[Message]:
        """Return the messages that have arrived by ``until_ns``, and forget them."""
        here = [x for x in self._under_way if x.arrival_ns <= until_ns]
        self._under_way = [x for x in self._under_way if x.arrival_ns > until_ns]
        if len(here) > 1:
            here.sort(key=lambda x: x[:2])
        return [x.message for x in here]
