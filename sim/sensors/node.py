"""All sensors of the vehicle as one node: truth in, measurements out, each sensor on its own time grid.

A sensor samples at whole multiples of its period, independent of the times of the truths: the truth is interpolated.
The first truth only opens the first interval, which is closed on both sides.
A message is stored until it arrives, its sensor's latency after it is valid, and is published with the first truth that
is not before its arrival: without latency, with the truth that closes its interval. The messages of one truth are
published in order of validity; those of one validity in the order of ``SIMULATED``. Inertial samples are published
together, those of ``BLOCK_NS`` in one message. Messages that have not arrived when the run ends are lost.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from heapq import heapify, heapreplace
from typing import NamedTuple

from ltv_mpc.localisation.sensor_config import SensorConfig
from ltv_mpc.localisation.sensors import PUBLISHED
from ltv_mpc.localisation.sensors.settings import latency_ns
from ltv_mpc.messages import Estimate, ImuSample, ImuSamples, Message, Truth
from ltv_mpc.node import Inbox, OnMessage
from sim.scenario import Scenario
from sim.sensors import SIMULATED
from sim.sensors.perfect import PerfectState
from sim.sensors.simulated import Environment, InterrogatingSensor, SimulatedSensor
from sim.sensors.vehicle_state import Motion, motion_between
from sim.water import WaterColumn

BLOCK_NS = 50_000_000
"""Time of the inertial samples in one message, which ends at a multiple of it. The estimator's period is a multiple
too, so no estimate waits for the end of a block."""


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
            settings, message = getattr(sensor_config, name), PUBLISHED[name]
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
        self._samples: list[ImuSample] = []  # of the block that is not complete
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

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:  # noqa: ARG002
        """Return the messages that have arrived since the last truth, in order of validity."""
        messages: list[Message] = []
        for received in inbox:
            if isinstance(received.message, Truth) and (self._last is None or received.message.t_ns > self._last.t_ns):
                messages += self._measure(received.message)
        return messages if ImuSample not in map(type, messages) else self._gathered(messages)

    def _gathered(self, messages: Sequence[Message]) -> list[Message]:
        """Return the messages with the inertial samples of each ``BLOCK_NS`` in the place of the last of them."""
        published: list[Message] = []
        for message in messages:
            if not isinstance(message, ImuSample):
                published.append(message)
                continue
            self._samples.append(message)
            if -(-message.t_ns // BLOCK_NS) < -(-(message.t_ns + message.interval_ns) // BLOCK_NS):
                published.append(ImuSamples(samples=tuple(self._samples)))
                self._samples.clear()
        return published

    def _measure(self, truth: Truth) -> list[Message]:
        last, self._last = self._last, truth
        if last is None:
            periods = [mounted.period_ns for mounted in self._mounted]
            self._due = [(-(-truth.t_ns // period) * period, order) for order, period in enumerate(periods)]
            heapify(self._due)
            return []  # measurements that are due now follow with the next truth
        if self._interrogating or (self._due and self._due[0][0] <= truth.t_ns):
            self._motion = motion_between(last, truth, self._motion)
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
