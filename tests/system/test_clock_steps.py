"""Hold of the foreign craft while its clock is set: the drift from the point, and what the controller reports."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest

from ltv_mpc.control.config import ControllerConfig
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.messages import ClockStep, Message, Plan
from ltv_mpc.node import ReceivedMessage
from ltv_mpc.references import Point
from ltv_mpc.vehicle.parameters import Vehicle
from services.bus.mailbox import Frame
from services.bus.message_validation import MessageValidator
from services.bus.time_shift import shifted
from services.bus.topics import BY_KEY
from services.bus.wire import Header, encode
from services.runtime.clock import VehicleClock
from services.runtime.clock_sync import ClockSync
from tests.stepping import step
from tests.system.foreign_plant import STEP_NS, Actuators, Hull, Sender

HULL = Path(__file__).parent / "foreign_hull.toml"
EPOCH = 1
DELAY_US = 20_000
"""From the start of a cycle to the plan's arrival."""
STEP_US = 30_000_000
UNTIL_US = 55_000_000
HELD_US = 20_000_000


class Craft:
    """The foreign craft at a point in a current of 0.2 m/s, its clock set by ``step_s`` after 30 s."""

    def __init__(self, step_s: float, *, reports: bool) -> None:
        self.hull = Hull(heading_rad=2.2, current_mps=(0.12, -0.16))
        self.actuators, self.sender, self.validator = Actuators(), Sender(), MessageValidator()
        self.node = ControllerNode(Vehicle.load(str(HULL)), Point(north_m=0.0, east_m=0.0), ControllerConfig())
        self.clock = VehicleClock()
        self.sync = ClockSync(self.clock, epoch=EPOCH)
        self.steps: list[ClockStep] = []
        self.health: list[tuple[int, str]] = []
        self.distance_m: list[tuple[int, float]] = []
        self._step_ns, self._reports = round(step_s * 1e9), reports
        self._inbox: list[ReceivedMessage] = []
        self._under_way: list[tuple[int, bytes]] = []
        self._sequence = 0

    def run(self) -> None:
        """Run to the end, in steps of 20 ms."""
        for m_us in range(0, UNTIL_US, STEP_NS // 1000):
            t_ns = 1_790_000_000_000_000_000 + m_us * 1000 + (self._step_ns if m_us >= STEP_US else 0)
            while self._under_way and self._under_way[0][0] <= m_us:
                self.actuators.offer(msgpack.unpackb(self._under_way.pop(0)[1]), t_ns)
                self._report(t_ns, m_us)
            if m_us % 100_000 == 0:
                self._receive("estimate", self.hull.estimate(t_ns), m_us)
                self._report(t_ns, m_us)
            if m_us % 300_000 == 0 and self.sync.active:
                self._cycle(m_us)
            self.hull.step(self.actuators.step(t_ns))
            self.distance_m.append((m_us, float(np.hypot(self.hull.x[0], self.hull.x[1]))))

    def _report(self, t_ns: int, m_us: int) -> None:
        if self._reports:
            self._receive("applied", self.actuators.report(t_ns, self.hull.thrust_N), m_us)

    def _receive(self, key: str, fields: dict[str, Any], m_us: int) -> None:
        message, header = self.validator.validate(Frame(BY_KEY[key], key, self.sender.pack(key, fields), m_us))
        rejected = self.sync.check_stamp(message, header.epoch, m_us)
        for clock_step in self.sync.take_steps():
            self.steps.append(clock_step)
            self._put(clock_step, 0, 0, m_us)
        if not rejected:
            message = shifted(message, self.sync.shift_ns(header.epoch, m_us))
            self._put(message, header.epoch, header.sequence, m_us)

    def _put(self, message: Message, epoch: int, sequence: int, m_us: int) -> None:
        received_ns = self.clock.read(m_us)
        if received_ns is not None:
            self._inbox.append(ReceivedMessage(message, epoch, sequence, received_ns))

    def _cycle(self, m_us: int) -> None:
        if self._sequence == 0:
            command = {"command_id": 1, "action": "arm"}
            self._receive("command", command, m_us)
        t_ns = self.clock.read(m_us)
        assert t_ns is not None
        inbox, self._inbox = self._inbox, []
        (plan,) = [message for message in step(self.node, t_ns, inbox) if isinstance(message, Plan)]
        self.health.append((m_us, plan.health.value))
        payload = encode(shifted(plan, self.sync.published_shift_ns), Header(epoch=EPOCH, sequence=self._sequence))
        self.sync.on_plan_sent(self._sequence, m_us)
        self._sequence += 1
        self._under_way.append((m_us + DELAY_US, payload))

    def farthest_m(self, since_us: int) -> float:
        """Return the largest distance from the point since then."""
        return max(distance for m_us, distance in self.distance_m if m_us >= since_us)

    def seconds_of(self, health: str) -> float:
        """Return the time spent in a health."""
        return 0.3 * sum(each == health for m_us, each in self.health if m_us >= STEP_US)


@pytest.mark.parametrize("step_s", [-86_400.0, -5.0, -1.0, -0.05, 0.05, 1.0, 5.0, 86_400.0])
def test_two_way_a_step_of_the_clock_costs_less_than_a_third_of_a_metre(step_s: float) -> None:
    craft = Craft(step_s, reports=True)
    craft.run()
    assert craft.farthest_m(HELD_US) < 0.3
    (clock_step,) = craft.steps
    assert clock_step.certain
    assert clock_step.step_ns == pytest.approx(step_s * 1e9, abs=50_000_000)
    assert craft.seconds_of("failsafe") == craft.seconds_of("hold") == 0.0
    assert craft.seconds_of("degraded") <= 1.0
    assert craft.farthest_m(UNTIL_US - 5_000_000) < 0.1


@pytest.mark.parametrize("step_s", [-86_400.0, -5.0, -1.0, -0.05, 0.05, 1.0, 5.0, 86_400.0])
def test_one_way_a_step_of_the_clock_costs_less_than_a_metre(step_s: float) -> None:
    craft = Craft(step_s, reports=False)
    craft.run()
    assert craft.farthest_m(HELD_US) < 1.0
    doubtful = -10.0 < step_s < -0.25
    assert [clock_step.certain for clock_step in craft.steps] == ([] if step_s == -0.05 else [not doubtful])
    assert craft.seconds_of("failsafe") == craft.seconds_of("hold") == 0.0
    assert craft.seconds_of("degraded") == pytest.approx(10.5 if doubtful else 0.3, abs=0.8)
