"""Order of steps and deliveries, on nodes small enough to derive the result by hand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from ltv_mpc.messages import (
    CycleTiming,
    Estimate,
    Message,
    Plan,
    PressureDepth,
    RejectedFrame,
    RunEvent,
    Truth,
)
from ltv_mpc.node import Cycle, Grid, Inbox, Node, OnMessage, ReceivedMessage, Schedule
from sim.scheduler import LockStep, Observation, Step
from tests.ltv_mpc.plans import plan_of
from tests.sim.worlds import MS, truth


def plan(cycle_t_ns: int, estimate_t_ns: int) -> Plan:
    return plan_of(cycle_t_ns, np.zeros((3, 3)), estimate_t_ns=estimate_t_ns)


Answer = Callable[[int, Inbox], list[Message]]


@dataclass
class Fake:
    """A node that answers with a function and keeps what it was handed."""

    name: str
    schedule: Schedule
    reads: tuple[type[Message], ...] = ()
    answer: Answer = lambda _t_ns, _inbox: []
    writes: tuple[type[Message], ...] = ()
    seen: list[tuple[int, list[tuple[type[Message], int, int]]]] = field(default_factory=list)

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:
        self.seen.append((t_ns, [(type(a.message), a.sequence, a.received_t_ns) for a in inbox]))
        return self.answer(t_ns, inbox)

    @property
    def times_ms(self) -> list[float]:
        return [t_ns / MS for t_ns, _ in self.seen]


def estimate(t_ns: int) -> Estimate:
    return replace(Estimate.at_rest(), t_ns=t_ns)


def event(t_ns: int, _: Inbox) -> list[Message]:
    return [RunEvent(t_ns=t_ns, node="first", kind="k", text="")]


def depths(t_ns: int, _: Inbox) -> list[Message]:
    return [PressureDepth(t_ns=t_ns, depth_m=0.0)]


def estimates(t_ns: int, _: Inbox) -> list[Message]:
    return [estimate(t_ns)]


@dataclass
class Log:
    """Writes down what an observer is told."""

    lines: list[tuple[Any, ...]] = field(default_factory=list)

    def stepped(self, step: Step) -> None:
        at_ns, node, number, t_ns, cause, inbox = step
        self.lines.append(("step", at_ns // MS, node, number, t_ns / MS, cause, len(inbox)))

    def published(self, node: str, message: ReceivedMessage) -> None:
        kind = type(message.message)
        self.lines.append(("out", message.received_t_ns // MS, node, kind, message.epoch, message.sequence))


def run(
    nodes: Sequence[Node], *, start_ns: int, end_ns: int, compute_delay_ns: int = 0, observe: Log | None = None
) -> None:
    LockStep(
        nodes,
        start_ns=start_ns,
        compute_delay_ns=compute_delay_ns,
        observation=Observation(observe, on_step=None if observe is None else observe.stepped),
    ).advance(end_ns)


def plant() -> Fake:
    return Fake("plant", Grid(10 * MS), (Plan,), lambda t_ns, _: [truth(t_ns)], (Truth,))


def sensors(answer: Answer = depths) -> Fake:
    return Fake("sensors", OnMessage((Truth,)), (Truth,), answer, (PressureDepth,))


def estimator(answer: Answer = estimates) -> Fake:
    return Fake("estimator", OnMessage((PressureDepth,)), (PressureDepth,), answer, (Estimate,))


def controller(period_ms: int = 300) -> Fake:
    newest = {"t_ns": 0}

    def answer(t_ns: int, inbox: Inbox) -> list[Message]:
        for arrival in inbox:
            if isinstance(arrival.message, Estimate):
                newest["t_ns"] = arrival.message.t_ns
        return [plan(t_ns, newest["t_ns"])]

    return Fake("controller", Cycle(period_ms * MS), (Estimate, CycleTiming), answer, (Plan,))


def test_a_grid_steps_at_multiples_of_its_period_with_start_and_end_included() -> None:
    node = plant()
    run([node], start_ns=-25 * MS, end_ns=30 * MS)
    assert node.times_ms == [-20, -10, 0, 10, 20, 30]


def test_at_one_instant_nodes_step_in_the_order_of_the_list() -> None:
    log = Log()
    run([plant(), sensors(), estimator(), controller(20)], start_ns=0, end_ns=20 * MS, observe=log)
    steps = [(line[1], line[2]) for line in log.lines if line[0] == "step"]
    table = ["plant", "sensors", "estimator", "controller"]
    assert steps == [(0, n) for n in table] + [(10, n) for n in table[:3]] + [(20, n) for n in table]


def test_the_observer_receives_a_step_before_its_outputs_with_its_cause() -> None:
    """A step on a message has the message's validity time and publishes on arrival."""
    log = Log()
    late = sensors(lambda t_ns, _: [PressureDepth(t_ns=t_ns - 3 * MS, depth_m=0.0)])
    run([plant(), late, estimator()], start_ns=0, end_ns=10 * MS, observe=log)
    assert log.lines == [
        line
        for k, at in enumerate((0, 10))
        for line in (
            ("step", at, "plant", k, at, "grid", 0),
            ("out", at, "plant", Truth, 1, k),
            ("step", at, "sensors", k, at, Truth, 1),
            ("out", at, "sensors", PressureDepth, 1, k),
            ("step", at, "estimator", k, at - 3, PressureDepth, 1),
            ("out", at, "estimator", Estimate, 1, k),
        )
    ]


def test_several_messages_at_once_are_stepped_one_by_one_in_order_of_arrival() -> None:
    two = sensors(lambda t_ns, _: [PressureDepth(t_ns=t_ns - early, depth_m=0.0) for early in (2 * MS, 0)])
    reader = estimator(lambda _t_ns, _inbox: [])
    run([plant(), two, reader], start_ns=0, end_ns=0)
    assert reader.seen == [(-2 * MS, [(PressureDepth, 0, 0)]), (0, [(PressureDepth, 1, 0)])]


def test_messages_that_cause_no_step_wait_and_precede_the_one_that_does() -> None:
    first = Fake("first", Grid(10 * MS), (), event, (RunEvent,))
    source = Fake("plant", Grid(20 * MS), (), lambda t_ns, _: [truth(t_ns)], (Truth,))
    reader = Fake("reader", OnMessage((Truth,)), (Truth, RunEvent))
    run([first, source, reader], start_ns=0, end_ns=20 * MS)
    assert [kinds for _, kinds in reader.seen] == [
        [(RunEvent, 0, 0), (Truth, 0, 0)],
        [(RunEvent, 1, 10 * MS), (RunEvent, 2, 20 * MS), (Truth, 1, 20 * MS)],
    ]


def test_without_delay_a_plan_made_at_t_is_in_the_plants_next_step() -> None:
    node = plant()
    run([node, controller()], start_ns=0, end_ns=20 * MS)
    assert [kinds for _, kinds in node.seen] == [[], [(Plan, 0, 0)], []]


@pytest.mark.parametrize(
    ("delay_ms", "cycles_ms"),
    [(0, [0, 300, 600, 900]), (200, [0, 300, 600, 900]), (300, [0, 300, 600, 900]), (400, [0, 400, 800])],
)
def test_a_cycle_starts_at_its_period_or_when_the_last_one_ends_if_that_is_later(
    delay_ms: int, cycles_ms: list[int]
) -> None:
    node = controller()
    run([node], start_ns=0, end_ns=1000 * MS, compute_delay_ns=delay_ms * MS)
    assert node.times_ms == cycles_ms


def test_a_plan_arrives_one_delay_after_its_cycle_and_the_next_cycle_receives_its_timing_without_a_pause() -> None:
    reader, node = plant(), controller()
    run([reader, node], start_ns=0, end_ns=730 * MS, compute_delay_ns=710 * MS)
    assert {t_ns // MS: kinds for t_ns, kinds in reader.seen if kinds} == {710: [(Plan, 0, 710 * MS)]}
    assert node.seen == [(0, []), (710 * MS, [(CycleTiming, 0, 710 * MS)])]


def test_a_cycles_timing_is_the_set_delay_exactly_with_nothing_measured() -> None:
    told: list[CycleTiming] = []

    class Ear(Log):
        def published(self, node: str, message: ReceivedMessage) -> None:  # noqa: ARG002
            if isinstance(message.message, CycleTiming):
                told.append(message.message)

    source = Fake("estimator", Grid(350 * MS), (), estimates, (Estimate,))
    run([source, controller()], start_ns=0, end_ns=1000 * MS, compute_delay_ns=400 * MS, observe=Ear())
    assert [(t.t_ns // MS, t.estimate_age_ns // MS) for t in told] == [(0, 0), (400, 50)]
    assert {(t.compute_ns // MS, t.compute_wall_ns, len(t.stage_us)) for t in told} == {(400, 0, 0)}


def test_a_cycle_that_makes_no_plan_takes_no_time_and_tells_no_timing() -> None:
    node = Fake("controller", Cycle(300 * MS), (CycleTiming,))
    run([node], start_ns=-100 * MS, end_ns=700 * MS, compute_delay_ns=500 * MS)
    assert node.seen == [(0, []), (300 * MS, []), (600 * MS, [])]


def test_a_cycle_is_handed_each_message_since_the_last_one_in_order() -> None:
    source = Fake(
        "estimator",
        Grid(100 * MS),
        (),
        lambda t_ns, inbox: [estimate(t_ns), *event(t_ns, inbox)],
        (Estimate, RunEvent),
    )
    node = Fake("controller", Cycle(300 * MS), (Estimate, RunEvent))
    run([source, node], start_ns=0, end_ns=300 * MS)
    assert node.seen[1][1] == [(kind, k, 100 * k * MS) for k in (1, 2, 3) for kind in (Estimate, RunEvent)]


def test_an_inadmissible_signal_reaches_no_node_and_is_told_in_the_reader_s_name() -> None:
    source = Fake(
        "sensors", Grid(10 * MS), (), lambda t_ns, _: [PressureDepth(t_ns=t_ns, depth_m=float("nan"))], (PressureDepth,)
    )
    readers = [Fake(name, Grid(10 * MS), (PressureDepth,)) for name in ("estimator", "controller")]
    log = Log()
    run([source, *readers], start_ns=0, end_ns=0, observe=log)
    assert [reader.seen for reader in readers] == [[(0, [])]] * 2
    told = [line[2] for line in log.lines if line[0] == "out" and line[3] is RejectedFrame]
    assert told == ["estimator", "controller"]


def test_advancing_in_pieces_is_the_same_as_at_once() -> None:
    def lines(pieces_ms: list[int]) -> list[tuple[Any, ...]]:
        log = Log()
        nodes = [plant(), controller(30)]
        run = LockStep(
            nodes,
            start_ns=0,
            compute_delay_ns=45 * MS,
            observation=Observation(log, on_step=log.stepped),
        )
        for piece_ms in pieces_ms:
            run.advance(piece_ms * MS)
        return log.lines

    assert lines([1, 45, 46, 50, 200]) == lines([200])


def test_an_observer_of_some_types_is_told_of_these_and_all_messages_are_counted() -> None:
    """Plans that are on their way at the end are neither told nor counted."""

    def told(types: frozenset[type[Message]] | None) -> tuple[list[tuple[Any, ...]], int]:
        log, nodes = Log(), [plant(), controller(30)]
        run = LockStep(nodes, start_ns=0, compute_delay_ns=45 * MS, observation=Observation(log, types))
        run.advance(200 * MS)
        return log.lines, run.published

    everything, of_all = told(None)
    plans, number = told(frozenset({Plan}))
    assert plans == [line for line in everything if line[3] is Plan]
    assert number == of_all == len(everything) > len(plans) == 4


def test_a_message_of_a_type_that_a_node_does_not_declare_is_an_error() -> None:
    node = Fake("plant", Grid(10 * MS), (), lambda t_ns, _: [truth(t_ns)])
    with pytest.raises(ValueError, match="plant publishes Truth, which is not among its writes"):
        run([node], start_ns=0, end_ns=0)


def test_what_happened_before_a_step_that_raises_is_told_and_that_step_too() -> None:
    log = Log()
    failing = sensors(lambda t_ns, _: [] if t_ns < 20 * MS else [1 / 0])
    with pytest.raises(ZeroDivisionError):
        run([plant(), failing], start_ns=0, end_ns=20 * MS, observe=log)
    assert [line[1:3] for line in log.lines if line[0] == "step"][-2:] == [(20, "plant"), (20, "sensors")]
    assert [line[1] for line in log.lines if line[0] == "out"] == [0, 10, 20]
