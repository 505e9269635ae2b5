"""Runner on a real router on loopback: no step skipped, no message lost, each record before its step's outputs."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from itertools import pairwise

import msgspec
import numpy as np
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
    Obstacle,
    Obstacles,
    Plan,
    PlanOrigin,
    PressureDepth,
    RejectedFrame,
    Solve,
    SolveStatus,
    StepRecord,
    Truth,
)
from ltv_mpc.node import Cycle, Grid, Inbox, Node, OnMessage
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
from tests.stepping import as_sent

TICK_NS = 10_000_000
ZERO = (0.0, 0.0, 0.0)
PATIENCE_S = 20.0


class Plant:
    name = "plant"
    schedule = Grid(TICK_NS)
    reads: tuple[type[Message], ...] = (Plan,)
    writes: tuple[type[Message], ...] = (Truth, Applied)

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:
        assert all(type(arrival.message) is Plan for arrival in inbox)
        truth = Truth(
            t_ns=t_ns,
            position_m=ZERO,
            velocity_mps=ZERO,
            attitude_rad=ZERO,
            water_velocity_mps=ZERO,
            yaw_rate_radps=0.0,
            current_mps=(0.0, 0.0),
            thrust_N=ZERO,
        )
        return [truth]


class Sensors:
    name = "sensors"
    schedule = OnMessage((Truth,))
    reads: tuple[type[Message], ...] = (Truth,)
    writes: tuple[type[Message], ...] = (Estimate,)

    def __init__(self) -> None:
        self.last_t_ns: int | None = None

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:
        """Publish at every tenth step only."""
        assert [type(arrival.message) for arrival in inbox] == [Truth]
        self.last_t_ns = t_ns
        return [Estimate.at_rest(north_m=t_ns * 1e-9)] if t_ns % (10 * TICK_NS) == 0 else []


class Controller:
    name = "controller"
    schedule = Cycle(300_000_000)
    reads: tuple[type[Message], ...] = (Estimate, Applied, CycleTiming)
    writes: tuple[type[Message], ...] = (Plan,)

    def __init__(self) -> None:
        self.inboxes: list[list[Message]] = []

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:
        self.inboxes.append([arrival.message for arrival in inbox])
        return [
            Plan(
                cycle_t_ns=t_ns,
                t_ns=np.array([t_ns, t_ns + 300_000_000]),
                thrust_N=np.zeros((2, 3)),
                states=np.zeros((2, 6)),
                origin=PlanOrigin.SOLVED,
                solve=Solve(status=SolveStatus.SOLVED),
            )
        ]


class Commanded(Controller):
    reads: tuple[type[Message], ...] = (*Controller.reads, Command)


class Listener:
    """Node that keeps what a test publishes."""

    name = "estimator"
    schedule = OnMessage((ImuSamples, PressureDepth, CompassHeading))
    reads: tuple[type[Message], ...] = (ImuSamples, PressureDepth, CompassHeading)
    writes: tuple[type[Message], ...] = ()

    def __init__(self, error: Exception | None = None) -> None:
        self.heard: list[Message] = []
        self._error = error

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:
        assert t_ns == inbox[-1].message.t_ns  # type: ignore[attr-defined]
        self.heard += [arrival.message for arrival in inbox]
        if self._error is not None:
            raise self._error
        return []


@pytest.fixture(scope="module")
def router(free_port: int) -> Iterator[str]:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    with open_session(BusOptions(listen=(endpoint,)), stop=StopRequest(), say=print):
        yield endpoint


@pytest.fixture
def bus(router: str, request: pytest.FixtureRequest) -> BusOptions:
    return BusOptions(connect=(router,), namespace=f"test/{request.node.name}")


@contextmanager
def listening(bus: BusOptions) -> Iterator[tuple[Session, Mailbox]]:
    with open_session(bus, stop=StopRequest(), say=print) as session:
        box = Mailbox()
        session.subscribe("**", None, box)
        yield session, box


@contextmanager
def running(bus: BusOptions, *runners: Runner) -> Iterator[None]:
    """Run each in a thread; stop and join them at the end."""
    threads = [threading.Thread(target=runner.serve, args=(bus,)) for runner in runners]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        for runner, thread in zip(runners, threads, strict=True):
            runner.stop.request()
            thread.join(PATIENCE_S)
        assert not any(thread.is_alive() for thread in threads)


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.002)


def read(frames: Sequence[Frame]) -> list[tuple[Frame, Message, Header]]:
    messages = []
    for frame in frames:
        assert frame.topic is not None
        messages.append((frame, *decode(frame.topic.message_type, frame.payload)))
    return messages


def drained(box: Mailbox, into: list[Frame]) -> list[Frame]:
    while (frame := box.take(0.0)) is not None:
        into.append(frame)
    return into


def finished(frames: Sequence[Frame], nodes: int) -> bool:
    return sum(s.finished for _, s, _ in read(frames) if isinstance(s, NodeStatus)) == nodes


def run(
    bus: BusOptions,
    nodes: Sequence[tuple[Node, int]],
    *,
    end_ns: int,
    speed: float,
    heard: Callable[[], bool] = lambda: True,
) -> list[Frame]:
    """Return all frames of a run of ``nodes``, each with its compute delay; the first is the clock master.

    They are told to stop when the first has done its last step and ``heard`` says that the others have heard of it.
    """
    frames: list[Frame] = []
    others = tuple(node.name for node, _ in nodes[1:])
    clock_master = ClockMasterSettings(start_ns=-100_000_000, end_ns=end_ns, speed=speed, expects=others)
    runners = [
        Runner(
            node,
            clock=ClockOptions(master=clock_master if i == 0 else None),
            compute_delay_ns=delay_ns,
        )
        for i, (node, delay_ns) in enumerate(nodes)
    ]
    with listening(bus) as (_, box):
        with running(bus, *runners):
            until(lambda: runners[0].finished and heard())
        until(lambda: finished(drained(box, frames), len(nodes)))
    return frames


def test_a_run_skips_no_step_loses_no_message_and_tells_each_step_before_its_outputs(bus: BusOptions) -> None:
    sensors = Sensors()
    frames = run(
        bus,
        [(Plant(), 0), (sensors, 0), (Controller(), 0)],
        end_ns=2_000_000_000,
        speed=5,
        heard=lambda: sensors.last_t_ns == 2_000_000_000,
    )
    messages = read(frames)

    ticks = [s.t_ns for _, s, _ in messages if isinstance(s, Truth)]
    assert ticks == list(range(-100_000_000, 2_000_000_001, TICK_NS))

    # All that each process says it has published is here.
    heard = Counter(header.epoch for _, _, header in messages)
    promised = {h.epoch: s.published for _, s, h in messages if isinstance(s, NodeStatus) and s.finished}
    assert heard == promised

    # Records: numbered without a gap, each before the outputs of its step, each entry a frame that is here.
    seen = {(frame.key, header.epoch, header.sequence): crc(frame.payload) for frame, _, header in messages}
    steps: Counter[str] = Counter()
    recorded: set[tuple[str, int]] = set()
    for _, signal, _ in messages:
        match signal:
            case StepRecord():
                assert signal.step == steps[signal.node]
                steps[signal.node] += len(signal.steps)
                recorded |= {(signal.node, step.t_ns) for step in signal.steps}
                for entry in (entry for step in signal.steps for entry in step.inbox):
                    assert seen[(entry.key, entry.epoch, entry.sequence)] == entry.crc
            case Truth():
                assert ("plant", signal.t_ns) in recorded
            case Estimate():
                assert ("sensors", round(signal.north_m * 1e9)) in recorded
            case Plan():
                assert ("controller", signal.cycle_t_ns) in recorded
    assert steps["plant"] == steps["sensors"] == len(ticks)
    assert steps["controller"] == len(cycle_times(messages))


def cycle_times(messages: Sequence[tuple[Frame, Message, Header]]) -> list[int]:
    return [s.cycle_t_ns for _, s, _ in messages if isinstance(s, Plan)]


def test_a_cycle_sees_each_estimate_once_and_its_own_timing_in_the_next_inbox(bus: BusOptions) -> None:
    controller = Controller()
    frames = run(bus, [(Plant(), 0), (Sensors(), 0), (controller, 0)], end_ns=2_000_000_000, speed=5)
    timings = {s.t_ns: s for _, s, _ in read(frames) if isinstance(s, CycleTiming)}
    times = cycle_times(read(frames))
    for number, inbox in enumerate(controller.inboxes):
        own = [signal for signal in inbox if isinstance(signal, CycleTiming)]
        assert [s.t_ns for s in own] == times[number - 1 : number]
    taken = Counter(type(signal) for inbox in controller.inboxes for signal in inbox)[Estimate]
    published = Counter(type(signal) for _, signal, _ in read(frames))[Estimate]
    assert len(times) < taken <= published
    assert set(timings) == set(times)
    assert all(set(s.stage_us) == {"read", "publish"} for s in timings.values())


def test_a_slow_cycle_publishes_after_its_delay_and_the_next_one_waits_for_it(bus: BusOptions) -> None:
    """0.71 s of vehicle time, longer than the period of 0.3 s: one solve in flight."""
    delay_ns = 710_000_000
    controller = Controller()
    frames = run(bus, [(Plant(), 0), (controller, delay_ns)], end_ns=4_000_000_000, speed=4)
    messages = read(frames)
    timings = [s for _, s, _ in messages if isinstance(s, CycleTiming)]
    assert len(timings) >= 4
    for timing, following in pairwise(timings):
        assert timing.compute_ns >= delay_ns
        assert following.t_ns >= timing.t_ns + timing.compute_ns - 1_000_000
    ratios = [timing.compute_wall_ns / timing.compute_ns for timing in timings[2:]]  # the clock has come to its speed
    assert 0.8 / 4 < min(ratios) < 1.0  # on a busy machine the clock is slower, never faster


def test_arrival_across_keys_keeps_the_order_of_one_source(bus: BusOptions) -> None:
    node = Listener()
    runner = Runner(node)
    with listening(bus) as (session, box), running(bus, runner):
        until(lambda: any(isinstance(s, NodeStatus) for _, s, _ in read(drained(box, []))))
        out = Outbox(session, node="test", epoch=5, kinds=node.reads)
        for i in range(900):
            match i % 3:
                case 0:
                    out.publish(
                        as_sent(ImuSample(t_ns=i, interval_ns=1, angular_rate_radps=ZERO, specific_force_mps2=ZERO))
                    )
                case 1:
                    out.publish(PressureDepth(t_ns=i, depth_m=0.0))
                case _:
                    out.publish(CompassHeading(t_ns=i, heading_rad=0.0))
        until(lambda: len(node.heard) == 900)
    assert [signal.t_ns for signal in node.heard] == list(range(900))  # type: ignore[attr-defined]


def test_refused_frames_are_published_with_their_reason_and_the_node_never_sees_them(bus: BusOptions) -> None:
    node = Listener()
    runner = Runner(node)
    frames: list[Frame] = []
    with listening(bus) as (session, box), running(bus, runner):
        until(lambda: any(isinstance(s, NodeStatus) for _, s, _ in read(drained(box, []))))
        raw = session.publisher(BY_TYPE[PressureDepth].key)
        out = Outbox(session, node="test", epoch=5, kinds=(PressureDepth,))
        raw.put(b"\xc1")
        out.publish(PressureDepth(t_ns=0, depth_m=float("nan")))
        out.publish(PressureDepth(t_ns=1, depth_m=3.0))

        def refusals() -> list[RejectedFrame]:
            known = [f for f in drained(box, frames) if f.key.startswith("rejected/")]
            return [s for _, s, _ in read(known) if isinstance(s, RejectedFrame)]

        until(lambda: len(node.heard) == 1 and len(refusals()) == 2)
        assert [s.node for s in refusals()] == ["estimator", "estimator"]
        assert "depth_m" in refusals()[1].reason
    assert [signal.t_ns for signal in node.heard] == [1]  # type: ignore[attr-defined]


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_step_that_raises_has_its_record_published_before_the_process_ends(bus: BusOptions) -> None:
    """A replay can then raise it again."""
    runner = Runner(Listener(ArithmeticError("made up")))
    frames: list[Frame] = []
    with ExitStack() as stack:
        session, box = stack.enter_context(listening(bus))
        stack.enter_context(running(bus, runner))
        until(lambda: any(isinstance(s, NodeStatus) for _, s, _ in read(drained(box, []))))
        Outbox(session, node="test", epoch=5, kinds=(PressureDepth,)).publish(PressureDepth(t_ns=0, depth_m=1.0))
        until(lambda: finished(drained(box, frames), 1))
    steps = [step for _, s, _ in read(frames) if isinstance(s, StepRecord) for step in s.steps]
    assert [step.inbox[0].key for step in steps] == ["sensor/depth"]


def test_settings_are_published_at_the_start_and_again_at_the_first_step(bus: BusOptions) -> None:
    """A recorder that receives the first step has the settings, whenever it started."""
    settings = NodeSettings(node="estimator", files={"config/sensors.toml": "x = 1"}, made_by={"numpy": "2"})
    runner = Runner(Listener(), settings=settings)
    frames: list[Frame] = []

    def published() -> list[NodeSettings]:
        return [message for _, message, _ in read(drained(box, frames)) if isinstance(message, NodeSettings)]

    with ExitStack() as stack:
        session, box = stack.enter_context(listening(bus))
        stack.enter_context(running(bus, runner))
        until(lambda: len(published()) == 1)
        out = Outbox(session, node="test", epoch=5, kinds=(PressureDepth,))
        out.publish(PressureDepth(t_ns=0, depth_m=1.0))
        until(lambda: len(published()) == 2)
        out.publish(PressureDepth(t_ns=1, depth_m=1.0))
        until(lambda: any(isinstance(m, NodeStatus) and m.steps == 2 for _, m, _ in read(drained(box, frames))))
        assert [message.files for message in published()] == [settings.files] * 2
    assert {key for (_, key, *_), message, _ in read(frames) if isinstance(message, NodeSettings)} == {
        "settings/estimator"
    }


def test_messages_on_their_way_at_a_stop_request_are_taken(bus: BusOptions) -> None:
    class ToldToStop(Listener):
        def step(self, t_ns: int, inbox: Inbox) -> list[Message]:
            if not self.heard:  # the request, which wakes, then a message
                runner.stop.request()
                out.publish(PressureDepth(t_ns=1, depth_m=1.0))
            return super().step(t_ns, inbox)

    node = ToldToStop()
    runner = Runner(node)
    with listening(bus) as (session, box):
        out = Outbox(session, node="test", epoch=5, kinds=(PressureDepth,))
        with running(bus, runner):
            until(lambda: any(isinstance(s, NodeStatus) for _, s, _ in read(drained(box, []))))
            out.publish(PressureDepth(t_ns=0, depth_m=1.0))
            until(lambda: len(node.heard) == 2)


class Slow:
    """A cycle that lasts longer than its period; ``during`` is what happens in the first one."""

    name = "estimator"
    schedule = Cycle(10_000_000)
    reads: tuple[type[Message], ...] = (PressureDepth,)
    writes: tuple[type[Message], ...] = ()

    def __init__(self, during: Callable[[], None]) -> None:
        self.inboxes: list[list[int]] = []
        self._during = during

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:
        assert all(arrival.received_t_ns <= t_ns for arrival in inbox)
        self.inboxes.append([arrival.sequence for arrival in inbox])
        if len(self.inboxes) == 1:
            self._during()
        return []


def test_a_step_that_is_late_takes_all_that_has_arrived_before_it_starts(bus: BusOptions) -> None:
    def burst() -> None:
        out = Outbox(session, node="test", epoch=5, kinds=(PressureDepth,))
        for t_ns in range(50):
            out.publish(PressureDepth(t_ns=t_ns, depth_m=0.0))
        until(lambda: len(runner.mailbox) == 50)
        time.sleep(0.02)  # past the next cycle's time

    node = Slow(burst)
    clock_master = ClockMasterSettings(start_ns=0, end_ns=10**12, speed=1.0, expects=())
    runner = Runner(node, clock=ClockOptions(master=clock_master))
    with listening(bus) as (session, _), running(bus, runner):
        until(lambda: len(node.inboxes) > 2)
    assert node.inboxes[:3] == [[], list(range(50)), []]


class Flooded:
    """Node that keeps the times of its cycles."""

    name = "estimator"
    schedule = Cycle(100_000_000)
    reads: tuple[type[Message], ...] = (PressureDepth,)
    writes: tuple[type[Message], ...] = ()

    def __init__(self) -> None:
        self.times_ns: list[int] = []

    def step(self, t_ns: int, _inbox: Inbox) -> list[Message]:
        self.times_ns.append(t_ns)
        return []


def test_a_flood_does_not_keep_a_cycle_from_its_time(bus: BusOptions) -> None:
    """Invalid frames on an input: each is rejected, and the next one is already there."""
    node, topic = Flooded(), BY_TYPE[PressureDepth]
    runner = Runner(
        node,
        clock=ClockOptions(master=ClockMasterSettings(start_ns=0, end_ns=10**12, speed=1.0, expects=())),
    )
    take = runner.mailbox.take

    def never_empty(_timeout_s: float) -> Frame | None:
        return take(0.0) or Frame(topic, topic.key, b"rubbish", monotonic_us())

    runner.mailbox.take = never_empty  # type: ignore[method-assign]
    with running(bus, runner):
        until(lambda: len(node.times_ns) > 5)


def test_without_a_clock_estimates_give_the_time_and_earlier_commands_are_rejected(
    bus: BusOptions,
) -> None:
    """The other side stamps in Unix time and reports each received plan by its own clock."""
    offset_ns = 1_763_740_800_000_000_000
    runner = Runner(Commanded(), clock=ClockOptions(sync_to_inputs=True))
    frames: list[Frame] = []
    with listening(bus) as (session, box), running(bus, runner):
        until(lambda: any(isinstance(s, NodeStatus) for _, s, _ in read(drained(box, []))))
        out = Outbox(session, node="operator", epoch=5, kinds=(Estimate, Applied, Command))
        out.publish(Command(command_id=1, action=Action.ARM))
        until(lambda: any(isinstance(s, RejectedFrame) for _, s, _ in read(drained(box, frames))))

        def said(answers: bool) -> bool:
            now_ns = offset_ns + time.monotonic_ns()
            out.publish(msgspec.structs.replace(Estimate.at_rest(), t_ns=now_ns))
            plans = [(h, s) for _, s, h in read(drained(box, frames)) if isinstance(s, Plan)]
            if plans and answers:
                header, plan = plans[-1]
                out.publish(answer(header, plan, now_ns))
            time.sleep(0.05)
            mode = runner.clock_sync.offset(monotonic_us()).mode
            return mode == ("two-way" if answers else "one-way") and len(plans) >= 2

        until(lambda: said(answers=False))
        until(lambda: said(answers=True))
        reading = runner.clock_sync.offset(monotonic_us())
        assert reading.error_ns is not None
        assert abs(reading.offset_ns - offset_ns) <= reading.error_ns
    (rejected,) = (s for _, s, _ in read(frames) if isinstance(s, RejectedFrame))
    assert rejected.key == "command"
    assert "no estimate received yet" in rejected.reason
    for _, plan, header in read(frames):
        if isinstance(plan, Plan):
            assert -1e9 < plan.cycle_t_ns - (offset_ns + header.sent_monotonic_us * 1000) <= 0


def answer(header: Header, plan: Plan, t_ns: int) -> Applied:
    return Applied(
        t_ns=t_ns,
        thrust_N=ZERO,
        command_N=ZERO,
        command_slew_N_per_s=ZERO,
        plan_epoch=header.epoch,
        plan_sequence=header.sequence,
        plan_cycle_t_ns=plan.cycle_t_ns,
        plan_received_t_ns=t_ns,
        plan_late=False,
        plans_late=0,
        plans_rejected=0,
    )


def test_an_estimate_stamped_an_hour_off_is_rejected(bus: BusOptions) -> None:
    controller = Controller()
    runner = Runner(controller, clock=ClockOptions(sync_to_inputs=True))
    frames: list[Frame] = []
    with listening(bus) as (session, box), running(bus, runner):
        until(lambda: any(isinstance(s, NodeStatus) for _, s, _ in read(drained(box, []))))
        out = Outbox(session, node="operator", epoch=5, kinds=(Estimate,))

        def spoken(ahead_ns: int = 0) -> None:
            stamp = time.monotonic_ns() + ahead_ns
            out.publish(msgspec.structs.replace(Estimate.at_rest(), t_ns=stamp))
            time.sleep(0.05)

        def planned() -> int:
            return sum(isinstance(s, Plan) for _, s, _ in read(drained(box, frames)))

        until(lambda: not spoken() and planned() >= 1)
        spoken(3_600_000_000_000)
        until(lambda: not spoken() and planned() >= 3)
    assert [s.key for _, s, _ in read(frames) if isinstance(s, RejectedFrame)] == ["estimate"]
    stamps = [s.t_ns for inbox in controller.inboxes for s in inbox if isinstance(s, Estimate)]
    assert max(stamps) - min(stamps) < 600_000_000_000


class Avoiding(Controller):
    reads: tuple[type[Message], ...] = (*Controller.reads, Obstacles)


@pytest.mark.parametrize("sync_to_inputs", [False, True], ids=["clock", "stamps"])
def test_obstacles_from_the_future_are_rejected_with_the_reason(bus: BusOptions, sync_to_inputs: bool) -> None:
    """As with stamps in UTC, where vehicle time began at 0; those with vehicle time come in."""
    controller = Avoiding()
    master = None if sync_to_inputs else ClockMasterSettings(start_ns=1, end_ns=10**15, speed=1.0, expects=())
    options = ClockOptions(sync_to_inputs=sync_to_inputs, master=master)
    runner = Runner(controller, clock=options)
    start_ns, frames = time.monotonic_ns(), list[Frame]()
    with listening(bus) as (session, box), running(bus, runner):
        until(lambda: any(isinstance(s, NodeStatus) for _, s, _ in read(drained(box, []))))
        out = Outbox(session, node="operator", epoch=5, kinds=(Estimate,))
        receiver = Outbox(session, node="operator", epoch=6, kinds=(Obstacles,))

        def receive(t_ns: int) -> None:
            ship = Obstacle(
                id=7, t_ns=t_ns, north_m=0.0, east_m=9.0, velocity_north_mps=0.0, velocity_east_mps=0.0, radius_m=1.0
            )
            receiver.publish(Obstacles(t_ns=t_ns, obstacles=(ship,)))

        def planned() -> int:
            if sync_to_inputs:
                out.publish(msgspec.structs.replace(Estimate.at_rest(), t_ns=time.monotonic_ns() - start_ns))
            time.sleep(0.05)
            return sum(isinstance(s, Plan) for _, s, _ in read(drained(box, frames)))

        until(lambda: planned() >= 1)
        receive(0)
        receive(1_700_000_000_000_000_000)
        before = planned()
        until(lambda: planned() >= before + 2)
    (rejected,) = (s for _, s, _ in read(frames) if isinstance(s, RejectedFrame))
    assert rejected.key == "obstacles"
    assert rejected.reason.startswith("t_ns of an obstacle is ahead of the vehicle's time: obstacle 7, by ")
    assert sum(isinstance(s, Obstacles) for inbox in controller.inboxes for s in inbox) == 1


class Rare(Commanded):
    schedule = Cycle(3_600_000_000_000)


def test_a_command_does_not_wait_for_the_next_cycle(bus: BusOptions) -> None:
    clock_master = ClockMasterSettings(start_ns=1, end_ns=10**15, speed=1.0, expects=())
    controller = Rare()
    runner = Runner(controller, clock=ClockOptions(master=clock_master))
    frames: list[Frame] = []
    with listening(bus) as (session, box), running(bus, runner):
        until(lambda: any(isinstance(s, NodeStatus) and s.t_ns > 1 for _, s, _ in read(drained(box, []))))
        out = Outbox(session, node="operator", epoch=5, kinds=(Command,))
        out.publish(Command(command_id=1, action=Action.STOP))
        until(lambda: any(isinstance(s, Plan) for _, s, _ in read(drained(box, frames))))
    (record,) = (s for _, s, _ in read(frames) if isinstance(s, StepRecord))
    (step,) = record.steps
    assert step.cause == "command"
    assert [entry.key for entry in step.inbox] == ["command"]
    assert len(controller.inboxes) == 1
