"""Runner on a real router on loopback: no step skipped, no message lost, each record before its step's outputs."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import NamedTuple, TypeVar

import pytest

from ltv_mpc.messages import (
    Action,
    Applied,
    Command,
    CompassHeading,
    CycleTiming,
    Estimate,
    ImuSample,
    ImuSamples,
    Message,
    NodeSettings,
    NodeStatus,
    Plan,
    PressureDepth,
    RejectedFrame,
    StepRecord,
    Truth,
)
from ltv_mpc.node import Cycle, Grid, Inbox, OnMessage, Schedule
from services.bus.mailbox import Frame, Mailbox
from services.bus.options import BusOptions
from services.bus.outbox import Outbox
from services.bus.session import Session, open_session
from services.bus.topics import BY_TYPE
from services.bus.wire import Header, crc, decode
from services.runtime.clock import monotonic_us
from services.runtime.clock_master import ClockMasterSettings
from services.runtime.process_time import ClockOptions
from services.runtime.runner import Runner
from services.runtime.stopping import StopRequest
from tests.services.edges.plans import plan
from tests.stepping import as_sent
from tests.waiting import until

TICK_NS = 10_000_000
ZERO = (0.0, 0.0, 0.0)
PATIENCE_S = 20.0
M = TypeVar("M", bound=Message)
Kinds = tuple[type[Message], ...]
Step = Callable[[int, list[Message]], list[Message]]


class FakeNode:
    """Node that keeps its inboxes and does what a test says."""

    def __init__(
        self, name: str, schedule: Schedule, reads: Kinds, writes: Kinds = (), step: Step = lambda _, __: []
    ) -> None:
        self.name, self.schedule, self.reads, self.writes = name, schedule, reads, writes
        self.inboxes: list[list[Message]] = []
        self._step = step

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:
        self.inboxes.append([arrival.message for arrival in inbox])
        return self._step(t_ns, self.inboxes[-1])

    @property
    def heard(self) -> list[Message]:
        return [message for inbox in self.inboxes for message in inbox]


def plant() -> FakeNode:
    def step(t_ns: int, inbox: list[Message]) -> list[Message]:
        assert all(type(message) is Plan for message in inbox)
        three = dict.fromkeys(("position_m", "velocity_mps", "attitude_rad", "water_velocity_mps", "thrust_N"), ZERO)
        return [Truth(t_ns=t_ns, yaw_rate_radps=0.0, current_mps=(0.0, 0.0), **three)]

    return FakeNode("plant", Grid(TICK_NS), (Plan,), (Truth, Applied), step)


def sensors() -> FakeNode:
    """Return a node that publishes at every tenth step only."""

    def step(t_ns: int, inbox: list[Message]) -> list[Message]:
        assert [type(message) for message in inbox] == [Truth]
        return [Estimate.at_rest(north_m=t_ns * 1e-9)] if t_ns % (10 * TICK_NS) == 0 else []

    return FakeNode("sensors", OnMessage((Truth,)), (Truth,), (Estimate,), step)


def controller(*more: type[Message], period_ns: int = 300_000_000) -> FakeNode:
    def step(t_ns: int, _: list[Message]) -> list[Message]:
        return [plan(t_ns)]

    return FakeNode("controller", Cycle(period_ns), (Estimate, Applied, CycleTiming, *more), (Plan,), step)


def listener(step: Step = lambda _, __: []) -> FakeNode:
    """Return a node that keeps what a test publishes."""
    kinds = ImuSamples, PressureDepth, CompassHeading
    return FakeNode("estimator", OnMessage(kinds), kinds, step=step)


def depth(t_ns: int) -> PressureDepth:
    return PressureDepth(t_ns=t_ns, depth_m=1.0)


def master(*expects: str, start_ns: int = 0, end_ns: int = 10**15, speed: float = 1.0) -> ClockOptions:
    settings = ClockMasterSettings(start_ns=start_ns, end_ns=end_ns, speed=speed, expects=expects)
    return ClockOptions(master=settings)


@pytest.fixture(scope="module")
def router(free_port: int) -> Iterator[str]:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    with open_session(BusOptions(listen=(endpoint,)), stop=StopRequest(), say=print):
        yield endpoint


@pytest.fixture
def bus(router: str, request: pytest.FixtureRequest) -> BusOptions:
    return BusOptions(connect=(router,), namespace=f"test/{request.node.name}")


class Heard(NamedTuple):
    """Message on the bus."""

    frame: Frame
    message: Message
    header: Header


class Beside:
    """Session beside the runners, which receives everything."""

    def __init__(self, session: Session) -> None:
        self.session, self.box = session, Mailbox()
        self._heard: list[Heard] = []
        session.subscribe("**", None, self.box)

    @property
    def heard(self) -> list[Heard]:
        while (frame := self.box.take(0.0)) is not None:
            assert frame.topic is not None
            self._heard.append(Heard(frame, *decode(frame.topic.message_type, frame.payload)))
        return self._heard

    def of(self, kind: type[M]) -> list[M]:
        return [message for _, message, _ in self.heard if isinstance(message, kind)]

    def finished(self) -> int:
        return sum(status.finished for status in self.of(NodeStatus))

    def out(self, *kinds: type[Message], epoch: int = 5) -> Outbox:
        return Outbox(self.session, node="operator", epoch=epoch, kinds=kinds)


@contextmanager
def running(bus: BusOptions, *runners: Runner) -> Iterator[Beside]:
    """Run each in a thread, from its first status until the end of the block; then stop and join them."""
    with open_session(bus, stop=StopRequest(), say=print) as session:
        beside = Beside(session)
        threads = [threading.Thread(target=runner.serve, args=(bus,)) for runner in runners]
        for thread in threads:
            thread.start()
        try:
            until(lambda: len({status.node for status in beside.of(NodeStatus)}) == len(runners))
            yield beside
        finally:
            for runner, thread in zip(runners, threads, strict=True):
                runner.stop.request()
                thread.join(PATIENCE_S)
            assert not any(thread.is_alive() for thread in threads)
        until(lambda: beside.finished() == len(runners))


def run(
    bus: BusOptions,
    *nodes: FakeNode,
    end_ns: int,
    speed: float,
    delay_ns: int = 0,
    heard: Callable[[], bool] = lambda: True,
) -> Beside:
    """Return what a run of ``nodes`` says, the last one with a compute delay; the first is the clock master.

    They are told to stop when the first has done its last step and ``heard`` says that the others have heard of it.
    """
    options = master(*(node.name for node in nodes[1:]), start_ns=-100_000_000, end_ns=end_ns, speed=speed)
    runners = [
        Runner(
            node,
            clock=options if node is nodes[0] else ClockOptions(),
            compute_delay_ns=delay_ns if node is nodes[-1] else 0,
        )
        for node in nodes
    ]
    with running(bus, *runners) as beside:
        until(lambda: runners[0].finished and heard())
    return beside


def test_a_run_skips_no_step_loses_no_message_and_tells_each_step_before_its_outputs(bus: BusOptions) -> None:
    watching, planning, end_ns = sensors(), controller(), 2_000_000_000
    said = run(
        bus, plant(), watching, planning, end_ns=end_ns, speed=5, heard=lambda: watching.heard[-1].t_ns == end_ns
    )
    ticks = [truth.t_ns for truth in said.of(Truth)]
    assert ticks == list(range(-100_000_000, 2_000_000_001, TICK_NS))

    # All that each process says it has published is here.
    published = {header.epoch: s.published for _, s, header in said.heard if isinstance(s, NodeStatus) and s.finished}
    assert Counter(header.epoch for _, _, header in said.heard) == published

    # Records: numbered without a gap, each before the outputs of its step, each entry a frame that is here.
    seen = {(frame.key, header.epoch, header.sequence): crc(frame.payload) for frame, _, header in said.heard}
    steps: Counter[str] = Counter()
    recorded: set[tuple[str, int]] = set()
    for _, message, _ in said.heard:
        match message:
            case StepRecord():
                assert message.step == steps[message.node]
                steps[message.node] += len(message.steps)
                recorded |= {(message.node, step.t_ns) for step in message.steps}
                for entry in (entry for step in message.steps for entry in step.inbox):
                    assert seen[(entry.key, entry.epoch, entry.sequence)] == entry.crc
            case Truth():
                assert ("plant", message.t_ns) in recorded
            case Estimate():
                assert ("sensors", round(message.north_m * 1e9)) in recorded
            case Plan():
                assert ("controller", message.cycle_t_ns) in recorded
    times = [plan.cycle_t_ns for plan in said.of(Plan)]
    assert steps == {"plant": len(ticks), "sensors": len(ticks), "controller": len(times)}

    # A cycle sees each estimate once, and its own timing in the next inbox.
    for number, inbox in enumerate(planning.inboxes):
        assert [s.t_ns for s in inbox if isinstance(s, CycleTiming)] == times[number - 1 : number]
    taken = sum(isinstance(message, Estimate) for message in planning.heard)
    assert len(times) < taken <= len(said.of(Estimate))
    assert [timing.t_ns for timing in said.of(CycleTiming)] == times
    assert all(set(timing.stage_us) == {"read", "publish"} for timing in said.of(CycleTiming))


def test_a_slow_cycle_publishes_after_its_delay_and_the_next_one_waits_for_it(bus: BusOptions) -> None:
    """0.71 s of vehicle time, longer than the period of 0.3 s: one solve in flight."""
    delay_ns = 710_000_000
    said = run(bus, plant(), controller(), end_ns=4_000_000_000, speed=4, delay_ns=delay_ns)
    timings = said.of(CycleTiming)
    assert len(timings) >= 4
    for timing, following in pairwise(timings):
        assert timing.compute_ns >= delay_ns
        assert following.t_ns >= timing.t_ns + timing.compute_ns - 1_000_000
    ratios = [
        timing.compute_wall_ns / timing.compute_ns for timing in timings[2:-1]
    ]  # from the clock's speed to the end
    assert 0.8 / 4 < min(ratios) < 1.0  # on a busy machine the clock is slower, never faster


def test_arrival_across_keys_keeps_the_order_of_one_source(bus: BusOptions) -> None:
    node = listener()
    with running(bus, Runner(node)) as beside:
        out = beside.out(*node.reads)
        for i in range(0, 900, 3):
            sample = ImuSample(t_ns=i, interval_ns=1, angular_rate_radps=ZERO, specific_force_mps2=ZERO)
            for message in (as_sent(sample), depth(i + 1), CompassHeading(t_ns=i + 2, heading_rad=0.0)):
                out.publish(message)
        until(lambda: len(node.heard) == 900)
    assert [message.t_ns for message in node.heard] == list(range(900))  # type: ignore[attr-defined]


def test_refused_frames_are_published_with_their_reason_and_the_node_never_sees_them(bus: BusOptions) -> None:
    node = listener()
    with running(bus, Runner(node)) as beside:
        out = beside.out(PressureDepth)
        beside.session.publisher(BY_TYPE[PressureDepth].key).put(b"\xc1")
        beside.box = Mailbox()  # it cannot be decoded here either
        beside.session.subscribe("rejected/*", None, beside.box)
        out.publish(PressureDepth(t_ns=0, depth_m=float("nan")))
        out.publish(depth(1))
        until(lambda: len(node.heard) == 1 and any("depth_m" in one.reason for one in beside.of(RejectedFrame)))
        assert {frame.node for frame in beside.of(RejectedFrame)} == {"estimator"}
        beside.session.subscribe("status/*", None, beside.box)
    assert node.heard[0].t_ns == 1  # type: ignore[attr-defined]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_step_that_raises_has_its_record_published_before_the_process_ends(bus: BusOptions) -> None:
    """A replay can then raise it again."""

    def broken(_: int, __: list[Message]) -> list[Message]:
        raise ArithmeticError("made up")

    with running(bus, Runner(listener(broken))) as beside:
        beside.out(PressureDepth).publish(depth(0))
        until(lambda: beside.finished() == 1)
    assert [step.inbox[0].key for record in beside.of(StepRecord) for step in record.steps] == ["sensor/depth"]


def test_settings_are_published_at_the_start_and_again_at_the_first_step(bus: BusOptions) -> None:
    """A recorder that receives the first step has the settings, whenever it started."""
    settings = NodeSettings(node="estimator", files={"config/sensors.toml": "x = 1"}, made_by={"numpy": "2"})
    with running(bus, Runner(listener(), settings=settings)) as beside:
        until(lambda: beside.of(NodeSettings))
        beside.out(PressureDepth).publish(depth(0))
        until(lambda: sum(status.steps for status in beside.of(NodeStatus)) >= 3)  # long before the period has passed
        assert [message.files for message in beside.of(NodeSettings)] == [settings.files] * 2
    keys = {frame.key for frame, message, _ in beside.heard if isinstance(message, NodeSettings)}
    assert keys == {"settings/estimator"}


def test_messages_on_their_way_at_a_stop_request_are_taken(bus: BusOptions) -> None:
    def stop(t_ns: int, _: list[Message]) -> list[Message]:
        if t_ns == 0:  # the request, which wakes, then a message
            runner.stop.request()
            out.publish(depth(1))
        return []

    node = listener(stop)
    runner = Runner(node)
    with running(bus, runner) as beside:
        out = beside.out(PressureDepth)
        out.publish(depth(0))
        until(lambda: len(node.heard) == 2)


def test_a_step_that_is_late_takes_all_that_has_arrived_before_it_starts(bus: BusOptions) -> None:
    def burst(_: int, __: list[Message]) -> list[Message]:
        """Last longer than the period, the first time."""
        if len(node.inboxes) == 1:
            until(lambda: len(outs) == 1)
            for number in range(50):
                outs[0].publish(depth(number))
            until(lambda: len(runner.mailbox) == 50)
            time.sleep(0.02)  # past the next cycle's time
        return []

    outs: list[Outbox] = []
    node = FakeNode("estimator", Cycle(TICK_NS), (PressureDepth,), step=burst)
    runner = Runner(node, clock=master())
    with running(bus, runner) as beside:
        outs.append(beside.out(PressureDepth))
        until(lambda: len(node.inboxes) > 2)
    assert [[message.t_ns for message in inbox] for inbox in node.inboxes[:3]] == [[], list(range(50)), []]  # type: ignore[attr-defined]


def test_a_flood_does_not_keep_a_cycle_from_its_time(bus: BusOptions) -> None:
    """Invalid frames on an input: each is rejected, and the next one is already there."""
    node, topic = FakeNode("estimator", Cycle(100_000_000), (PressureDepth,)), BY_TYPE[PressureDepth]
    runner = Runner(node, clock=master())
    take = runner.mailbox.take

    def never_empty(_timeout_s: float) -> Frame | None:
        time.sleep(0.001)  # those beside must keep up with the answers
        return take(0.0) or Frame(topic, topic.key, b"rubbish", monotonic_us())

    runner.mailbox.take = never_empty  # type: ignore[method-assign]
    with running(bus, runner):
        until(lambda: len(node.inboxes) > 5)


def test_a_command_does_not_wait_for_the_next_cycle(bus: BusOptions) -> None:
    node = controller(Command, period_ns=3_600_000_000_000)
    with running(bus, Runner(node, clock=master(start_ns=1))) as beside:
        until(lambda: beside.of(NodeStatus)[-1].t_ns > 1)
        beside.out(Command).publish(Command(command_id=1, action=Action.STOP))
        until(lambda: beside.of(Plan))
    (step,) = (step for record in beside.of(StepRecord) for step in record.steps)
    assert (step.cause, [entry.key for entry in step.inbox]) == ("command", ["command"])
    assert len(node.inboxes) == 1
