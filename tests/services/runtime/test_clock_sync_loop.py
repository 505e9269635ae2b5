"""Closed loop with another side's clock, over links with jumping delays: effect on the tracking error."""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable
from dataclasses import dataclass, field

import msgspec
import numpy as np

from ltv_mpc import ControllerConfig, Vehicle, references
from ltv_mpc.control.node import ControllerNode
from ltv_mpc.messages import (
    Action,
    Applied,
    ClockMode,
    Command,
    CurrentProfile,
    CycleTiming,
    Estimate,
    Message,
    Plan,
    Truth,
)
from ltv_mpc.node import ReceivedMessage
from services.runtime.clock import VehicleClock
from services.runtime.clock_sync import ClockSync
from sim.plant import PERIOD_NS, Plant
from sim.scenario import Scenario
from sim.water import make

VEHICLE = Vehicle.load("paper")
UNIX_NS = 1_763_740_800_000_000_000
PPM = 50
EPOCH = 77
BEGIN_US = 3_600_000_000
UNTIL_S = 35
SETTLED_S = 20.0


@dataclass
class Link:
    """One-way link: each message has its own delay, a tenth is duplicated, overtaken messages are rejected."""

    delay_s: Callable[[], float]
    rng: random.Random
    queue: list[tuple[int, int, Message]] = field(default_factory=list)
    sent: int = 0
    newest: dict[type, int] = field(default_factory=dict)
    turned_away: int = 0

    def send(self, signal: Message, m_us: int) -> int:
        number = self.sent
        self.sent += 1
        for _ in range(1 + (self.rng.random() < 0.1)):
            heapq.heappush(self.queue, (m_us + round(1e6 * self.delay_s()), number, _Tied(signal)))
        return number

    def come(self, m_us: int) -> list[tuple[Message, int, int]]:
        arrived = []
        while self.queue and self.queue[0][0] <= m_us:
            at_us, number, tied = heapq.heappop(self.queue)
            if number <= self.newest.get(type(tied.signal), -1):
                self.turned_away += 1
                continue
            self.newest[type(tied.signal)] = number
            arrived.append((tied.signal, number, at_us))
        return arrived


@dataclass
class _Tied:
    signal: Message

    def __lt__(self, other: _Tied) -> bool:
        return False


@dataclass
class Flown:
    """Result of a closed loop."""

    off_m: np.ndarray
    clock_off_s: np.ndarray
    clock_error_s: np.ndarray
    turned_away: int
    plans_late: int
    mode: ClockMode


def fly(delay_s: Callable[[random.Random], float], *, reports: bool = True) -> Flown:
    """Go to a point 1 m away and hold it for 35 s, in a known current, with cycles that take no time."""
    rng = random.Random(4)
    scenario = Scenario.load("hover")
    start = msgspec.structs.replace(scenario.plant, north_m=1.0, heading_rad=1.0)
    scenario = msgspec.structs.replace(scenario, plant=start)
    plant = Plant(scenario, VEHICLE, make(scenario.water, 1))
    here, there = (Link(lambda: delay_s(rng), rng) for _ in range(2))
    clock = VehicleClock()
    foreign = ClockSync(clock, epoch=EPOCH)
    node = ControllerNode(VEHICLE, references.Point(north_m=0.0, east_m=0.0), ControllerConfig())
    inbox = [ReceivedMessage(Command(command_id=1, action=Action.ARM), 1, 0, 0)]
    due_ns: int | None = None
    off, wrong, error = [], [], []
    late = 0
    for t_ns in range(0, UNTIL_S * 10**9, PERIOD_NS):
        m_us = BEGIN_US + round(t_ns / (1000 * (1 + PPM * 1e-6)))
        plans = [
            ReceivedMessage(_shifted(plan, -UNIX_NS), EPOCH, number, t_ns - PERIOD_NS + 1)
            for plan, number, _ in there.come(m_us)
        ]
        for said in plant.step(t_ns, plans):
            if isinstance(said, Truth):
                off.append((t_ns * 1e-9, np.hypot(*said.position_m[:2])))
                if t_ns % 100_000_000 == 0:
                    here.send(_estimate(said), m_us)
            elif isinstance(said, Applied):
                late = said.plans_late
                if reports:
                    here.send(_shifted(said, UNIX_NS), m_us)
        for signal, number, at_us in here.come(m_us):
            assert foreign.check_stamp(signal, 5, at_us) == ""
            inbox.append(ReceivedMessage(signal, 5, number, clock.read(at_us) or signal.t_ns))
        now_ns = clock.read(m_us)
        if now_ns is not None and now_ns >= (due_ns or now_ns):
            due_ns = now_ns + 300_000_000
            (plan,) = (said for said in node.step(now_ns, inbox) if isinstance(said, Plan))
            timing = CycleTiming(t_ns=now_ns, compute_ns=0, compute_wall_ns=0, estimate_age_ns=0, stage_us={})
            inbox = [ReceivedMessage(timing, EPOCH, 0, now_ns)]
            foreign.on_plan_sent(there.send(plan, m_us), m_us)
            reading = foreign.offset(m_us)
            wrong.append((now_ns - UNIX_NS - t_ns) * 1e-9)
            error.append(np.nan if reading.error_ns is None else reading.error_ns * 1e-9)
    times, metres = np.array(off).T
    return Flown(
        metres[times > SETTLED_S],
        np.array(wrong),
        np.array(error),
        here.turned_away + there.turned_away,
        late,
        foreign.offset(m_us).mode,
    )


def _shifted(signal: Message, by_ns: int) -> Message:
    """Return the message in the other clock's time."""
    match signal:
        case Plan():
            return msgspec.structs.replace(signal, t_ns=signal.t_ns + by_ns, cycle_t_ns=signal.cycle_t_ns + by_ns)
        case Applied() if signal.plan_sequence >= 0:
            return msgspec.structs.replace(
                signal,
                t_ns=signal.t_ns + by_ns,
                plan_cycle_t_ns=signal.plan_cycle_t_ns + by_ns,
                plan_received_t_ns=signal.plan_received_t_ns + by_ns,
            )
        case Applied():
            return msgspec.structs.replace(signal, t_ns=signal.t_ns + by_ns)
    raise NotImplementedError(type(signal))


def _estimate(truth: Truth) -> Estimate:
    north, east = truth.current_mps
    return Estimate(
        t_ns=UNIX_NS + truth.t_ns,
        north_m=truth.position_m[0],
        east_m=truth.position_m[1],
        heading_rad=truth.attitude_rad[2],
        yaw_rate_radps=truth.yaw_rate_radps,
        velocity_north_mps=truth.velocity_mps[0],
        velocity_east_mps=truth.velocity_mps[1],
        current=CurrentProfile(depth_m=np.zeros(1), north_mps=np.array([north]), east_mps=np.array([east])),
    )


def test_delays_that_jump_by_half_a_second_are_survived_with_the_clocks_error_stated():
    perfect = fly(lambda _: 0.0)
    jumping = fly(lambda rng: rng.uniform(0.0, 0.5))
    blind = fly(lambda rng: rng.uniform(0.0, 0.5), reports=False)
    for flown in (jumping, blind):
        assert flown.turned_away > 100  # many did overtake each other
        assert flown.off_m.mean() <= 1.3 * perfect.off_m.mean()
        assert flown.off_m.max() <= 1.5 * perfect.off_m.max()
    known = np.isfinite(jumping.clock_error_s)
    assert known[20:].all()
    assert (np.abs(jumping.clock_off_s[known]) <= jumping.clock_error_s[known] + PERIOD_NS * 1e-9).all()
    assert jumping.clock_error_s[20:].max() < 0.03  # half the smallest round trip of 30 s
    assert jumping.plans_late <= 0.05 * len(jumping.clock_off_s)  # what delay is to be expected was learned
    assert jumping.mode == ClockMode.TWO_WAY
    assert blind.mode == ClockMode.ONE_WAY
    assert np.isnan(blind.clock_error_s).all()  # nobody can tell; here it was behind by the smallest delay
    assert blind.clock_off_s[20:].min() > -0.03
    assert blind.clock_off_s[20:].max() < 0.001
