"""Time windows of many steps against single steps: the same messages and steps in the same order, bit for bit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import numpy as np
import pytest

from ltv_mpc.messages import (
    CycleTiming,
    Disturbance,
    Estimate,
    ImuSample,
    Message,
    Plan,
    PressureDepth,
    RejectedFrame,
    RunEvent,
    Truth,
)
from ltv_mpc.node import Cycle, Due, Grid, Inbox, Node, OnMessage, ReceivedMessage
from ltv_mpc.validation import rejection_reason
from services.bus import wire
from services.run.folder import RunFolder
from services.run.nodes import make_nodes
from services.run.run_config import Override, RunConfig, resolve
from services.tools import lockstep_run
from sim.plant import Plant
from sim.scheduler import Delivery, LockStep, Observation, Step
from sim.sensors.node import Sensors
from tests.sim.table import MS, Fake, plan
from tests.stepping import OneByOne

S = 1000 * MS


class Ears:
    """Observer that keeps published messages, as bytes, and steps."""

    def __init__(self) -> None:
        self.said: list[tuple[str, int, int, type[Message], bytes]] = []
        self.steps: list[tuple[Any, ...]] = []
        self.order: list[str] = []

    def stepped(self, step: Step) -> None:
        self.steps.append((*step[:5], [(type(a.message), a.sequence, a.received_t_ns) for a in step.inbox]))
        self.order.append(step.node)

    def published(self, node: str, message: ReceivedMessage) -> None:
        header = wire.Header(epoch=message.epoch, sequence=message.sequence, sent_monotonic_us=0)
        payload = wire.encode(message.message, header)
        self.said.append((node, message.received_t_ns, message.sequence, type(message.message), payload))
        self.order.append(type(message.message).__name__)

    def __eq__(self, other: object) -> bool:
        assert isinstance(other, Ears)
        return (self.said, self.steps, self.order) == (other.said, other.steps, other.order)


class Through:
    """Transport that carries each message as published, so that every window is one step."""

    def carry(self, writer: str, reader: str, message: ReceivedMessage) -> Sequence[Delivery]:  # noqa: ARG002
        return [Delivery(message.received_t_ns, message)]

    def receive(self, reader: str, delivery: Delivery) -> ReceivedMessage | str:  # noqa: ARG002
        return rejection_reason(delivery.message.message) or delivery.message


def ears_of(
    nodes: Sequence[Node], start_ns: int, until: Sequence[int], delay_ns: int = 0, *, singly: bool = False
) -> Ears:
    ears = Ears()
    lockstep = LockStep(
        nodes,
        start_ns=start_ns,
        compute_delay_ns=delay_ns,
        observation=Observation(ears, on_step=ears.stepped),
        make_rejection=lockstep_run.rejected_message,
        transport=Through() if singly else None,
    )
    for until_ns in until:
        lockstep.advance(until_ns)
    assert lockstep.published == len(ears.said)
    assert sum(lockstep.steps.values()) == len(ears.steps)
    return ears


# --- a descent -------------------------------------------------------------------------------------------------------


def descent(*settings: str, duration_s: float = 8.0) -> RunConfig:
    of_all = (f"run.duration_s={duration_s}", "run.seed=5", "run.surface_time_s=3.0")
    return resolve("descent", [Override("test", (*of_all, *settings))])


class Storm(OneByOne):
    """Pushes the vehicle for a while; stands where another process would."""

    name = "operator"
    schedule = Grid(300 * MS)
    reads: tuple[type[Message], ...] = ()
    writes: tuple[type[Message], ...] = (Disturbance,)

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:  # noqa: ARG002
        if t_ns not in (1500 * MS, 3900 * MS):
            return []
        return [Disturbance(end_t_ns=t_ns + 1234 * MS, force_N=(10.0, -5.0, 1.0), yaw_moment_Nm=2.0)]


@pytest.mark.parametrize(
    ("settings", "storm"),
    [
        (("sensors=paper",), False),
        (("sensors=realistic", "run.compute_delay_s=0.25"), False),
        (("sensors=realistic", "run.compute_delay_s=0.71", "water.change_mps_per_rts=0.01"), True),
        (("run.perfect_state=true", "water.change_mps_per_rts=0.01"), True),
        (("sensors=paper", "water.feature.kind=front", "water.feature.at_s=4.0", "water.feature.width_s=1.0"), False),
    ],
)
def test_of_a_descent_every_step_and_message_is_the_same_to_the_bit(settings: tuple[str, ...], storm: bool) -> None:
    run_config = descent(*settings)
    scenario = run_config.scenario

    def ears(*, singly: bool) -> Ears:
        nodes = make_nodes(run_config)
        until = [*range(scenario.start_ns, scenario.end_ns, 700 * MS), scenario.end_ns]
        delay_ns = round(scenario.run.compute_delay_s * 1e9)
        nodes = [Storm(), *nodes] if storm else nodes
        return ears_of(nodes, scenario.start_ns, until, delay_ns, singly=singly)

    singly, at_once = ears(singly=True), ears(singly=False)
    assert {kind for *_, kind, _ in singly.said} >= {Truth, ImuSample, Estimate, Plan, CycleTiming}
    assert at_once == singly


@pytest.mark.parametrize("delay_s", [0.0, 0.71])
def test_who_wants_some_types_hears_of_these_and_all_are_counted(delay_s: float) -> None:
    """Plans that are on their way when the run ends are neither told nor counted."""
    run_config = descent(f"run.compute_delay_s={delay_s}", duration_s=4.0)

    def told(heard: frozenset[type[Message]] | None) -> tuple[list[tuple[str, int, int, type[Message], bytes]], int]:
        ears = Ears()
        lockstep = LockStep(
            make_nodes(run_config),
            start_ns=run_config.scenario.start_ns,
            compute_delay_ns=round(delay_s * 1e9),
            observation=Observation(ears, types=heard),
            make_rejection=lockstep_run.rejected_message,
        )
        lockstep.advance(run_config.scenario.end_ns)
        return ears.said, lockstep.published

    wanted: frozenset[type[Message]] = frozenset({Truth, Estimate, Plan})
    everything, number = told(None)
    some, of_all = told(wanted)
    assert some == [said for said in everything if said[3] in wanted]
    assert number == of_all == len(everything) > len(some)


def test_an_unrecorded_run_has_the_summary_of_a_recorded_one(tmp_path: Any) -> None:
    run_config = descent("sensors=paper", duration_s=4.0)
    recorded, unrecorded = lockstep_run.run(run_config, RunFolder(tmp_path)), lockstep_run.run(run_config)
    of_both = [msgspec.structs.replace(s, messages=recorded.messages) for s in (recorded, unrecorded)]
    assert of_both[0] == of_both[1]


def test_at_once_is_what_steps_one_by_one_are_and_most_are_made_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the plant and the sensors: how often each is asked, and how many single steps are left."""
    single: dict[str, int] = {}

    def counted(kind: type, method: str) -> None:
        inner = getattr(kind, method)

        def outer(self: Any, *given: Any) -> Any:
            single[kind.__name__] = single.get(kind.__name__, 0) + 1
            return inner(self, *given)

        monkeypatch.setattr(kind, method, outer)

    counted(Plant, "_step")
    counted(Sensors, "_step")
    run_config = descent("sensors=paper", duration_s=4.0)
    scenario = run_config.scenario
    nodes = make_nodes(run_config, publish_unread_topics=False)
    said = ears_of(nodes, scenario.start_ns, [scenario.end_ns]).said
    ticks = sum(kind is Truth for *_, kind, _ in said)
    assert ticks == 701
    assert single["Plant"] < ticks / 5
    assert single["Sensors"] < ticks / 20


# --- rules, on nodes small enough ------------------------------------------------------------------------------------


class Many(Fake):
    """Keeps how many steps it is given at once."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.bulks: list[int] = []

    def steps(self, due: Sequence[Due]) -> list[list[Message]]:
        self.bulks.append(len(due))
        return super().steps(due)


def event(name: str) -> Callable[[int, Inbox], list[Message]]:
    return lambda t_ns, _: [RunEvent(t_ns=t_ns, node=name, kind="k", text="")]


def depth(t_ns: int, inbox: Inbox) -> list[Message]:
    """Two measurements, of which the second is wrong at every third instant, and then what causes no step."""
    wrong = t_ns % (30 * MS) == 0
    measured = [1.0, np.nan if wrong else 2.0]
    return [*(PressureDepth(t_ns=t_ns, depth_m=depth_m) for depth_m in measured), *event("second")(t_ns, inbox)]


def first(t_ns: int, inbox: Inbox) -> list[Message]:
    """Return a motion with an event, and at times a wrong measurement."""
    wrong: list[Message] = [PressureDepth(t_ns=t_ns, depth_m=np.nan)] if t_ns % (20 * MS) == 0 else []
    return event("first")(t_ns, inbox) + wrong


def estimate(t_ns: int, _: Inbox) -> list[Message]:
    return [Estimate.at_rest(north_m=t_ns * 1e-9)]


def plans(t_ns: int, _: Inbox) -> list[Message]:
    """Return a plan at two of three cycles."""
    return [plan(t_ns, t_ns)] if t_ns % (210 * MS) else []


def table() -> list[Many]:
    """Two on grids, two on messages, two that cycle at other periods, and messages of each kind between them."""
    return [
        Many("first", Grid(10 * MS), (Plan,), first, (RunEvent, PressureDepth)),
        Many("second", Grid(25 * MS), (), depth, (PressureDepth, RunEvent)),
        Many("third", OnMessage((PressureDepth,)), (PressureDepth, RunEvent), estimate, (Estimate,)),
        Many("last", OnMessage((Estimate,)), (Estimate, RunEvent)),
        Many("controller", Cycle(70 * MS), (Estimate, RunEvent, RejectedFrame, CycleTiming), plans, (Plan,)),
        Many("other", Cycle(70 * MS), (Estimate, Plan, PressureDepth, CycleTiming)),
    ]


def cycling_first() -> list[Many]:
    """Return the nodes with cycles before the nodes that they read."""
    *others, controller, other = table()
    return [controller, *others[:2], other, *others[2:]]


def answering() -> list[Many]:
    """One on a grid writes what one before it and itself read; it wants the newest estimate."""
    answer = Many(
        "answer", Grid(30 * MS), (Estimate, RunEvent, PressureDepth), event("answer"), (RunEvent, PressureDepth)
    )
    return [*table()[:4], answer, *table()[4:]]


def echoing() -> list[Many]:
    """One on messages is heard by those before it, on a grid and on messages."""
    nodes = table()
    nodes[3] = Many("last", OnMessage((Estimate,)), (Estimate, RunEvent), event("last"), (RunEvent,))
    listener = Many("listener", OnMessage((RunEvent,)), (RunEvent, Estimate), estimate, (Estimate,))
    nodes[1] = Many("second", Grid(25 * MS), (RunEvent,), depth, (PressureDepth, RunEvent))
    return [listener, *nodes[:3], *nodes[4:]]


def refused() -> list[Many]:
    """Two that do not cycle are told of what they were refused."""
    nodes = table()
    nodes[2] = Many(
        "third", OnMessage((PressureDepth,)), (PressureDepth, RunEvent, RejectedFrame), estimate, (Estimate,)
    )
    nodes[3] = Many("last", Grid(20 * MS), (PressureDepth, RejectedFrame))
    return nodes


@pytest.mark.parametrize("delay_ms", [0, 30, 90])
@pytest.mark.parametrize("pieces_ms", [(1000,), (0, 1, 69, 70, 333, 1000)])
@pytest.mark.parametrize(
    ("make", "at_once"), [(table, True), (cycling_first, True), (answering, True), (echoing, False), (refused, False)]
)
def test_each_step_is_given_what_it_is_given_one_step_at_a_time(
    make: Callable[[], list[Many]], at_once: bool, delay_ms: int, pieces_ms: tuple[int, ...]
) -> None:
    slow, fast = make(), make()
    until = [ms * MS for ms in pieces_ms]
    one = ears_of(slow, -35 * MS, until, delay_ms * MS, singly=True)
    other = ears_of(fast, -35 * MS, until, delay_ms * MS)
    assert [node.seen for node in fast] == [node.seen for node in slow]
    assert other == one
    assert any(kind is RejectedFrame for *_, kind, _ in one.said)
    assert {bulk for node in slow for bulk in node.bulks} == {1}
    assert (max(bulk for node in fast for bulk in node.bulks) > 2) is at_once
