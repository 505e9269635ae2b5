"""Stretches against lock step one step at a time: the same signals, in the same order, bit for bit."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import numpy as np
import pytest

from ltv_mpc.localisation.estimator import Estimator
from ltv_mpc.messages import (
    CycleTiming,
    Disturbance,
    Estimate,
    ImuSample,
    Message,
    Plan,
    PressureDepth,
    Rejected,
    RunEvent,
    Truth,
)
from ltv_mpc.node import Arrival, Cycle, Due, Grid, Inbox, Node, OnMessage, one_by_one
from services.bus import wire
from services.run import locked
from services.run.folder import RunFolder
from services.run.situation import Override, Situation, resolve
from sim.lockstep import LockStep
from sim.plant import Plant
from sim.sensors.node import Sensors
from sim.stretches import Stretches
from tests.sim.table import MS, Fake, plan

S = 1000 * MS


class Ears:
    """What is published, as bytes."""

    def __init__(self) -> None:
        self.said: list[tuple[str, int, int, type[Message], bytes]] = []

    def stepped(self, *_: object) -> None:
        pass

    def published(self, node: str, message: Arrival) -> None:
        header = wire.Header(epoch=message.epoch, sequence=message.sequence, sent_monotonic_us=0)
        payload = wire.encode(message.signal, header)
        self.said.append((node, message.received_t_ns, message.sequence, type(message.signal), payload))


def said_by(
    way: type[LockStep] | type[Stretches], nodes: Sequence[Node], start_ns: int, until: Sequence[int], delay_ns: int = 0
) -> list[tuple[str, int, int, type[Message], bytes]]:
    ears = Ears()
    lockstep = way(nodes, start_ns=start_ns, compute_delay_ns=delay_ns, observe=ears, refused=locked.refused)
    for until_ns in until:
        lockstep.advance(until_ns)
    return ears.said


# --- a descent -------------------------------------------------------------------------------------------------------


def descent(*settings: str, duration_s: float = 8.0) -> Situation:
    of_all = (f"run.duration_s={duration_s}", "run.seed=5", "run.surface_time_s=3.0")
    return resolve("descent", [Override("test", (*of_all, *settings))])


class Storm:
    """Pushes the vehicle for a while; stands where another process would."""

    name = "operator"
    schedule = Grid(300 * MS)
    reads: tuple[type[Message], ...] = ()
    writes: tuple[type[Message], ...] = (Disturbance,)

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:  # noqa: ARG002
        if t_ns not in (1500 * MS, 3900 * MS):
            return []
        return [Disturbance(until_t_ns=t_ns + 1234 * MS, force_N=(10.0, -5.0, 1.0), yaw_moment_Nm=2.0)]


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
def test_of_a_descent_every_signal_is_the_same_to_the_bit(settings: tuple[str, ...], storm: bool) -> None:
    situation = descent(*settings)
    scenario = situation.scenario

    def said(way: type[LockStep] | type[Stretches]) -> list[tuple[str, int, int, type[Message], bytes]]:
        nodes = locked.nodes(situation)
        until = [*range(scenario.start_ns, scenario.end_ns, 700 * MS), scenario.end_ns]
        delay_ns = round(scenario.run.compute_delay_s * 1e9)
        return said_by(way, [Storm(), *nodes] if storm else nodes, scenario.start_ns, until, delay_ns)

    one_by_one, at_once = said(LockStep), said(Stretches)
    assert {kind for *_, kind, _ in one_by_one} >= {Truth, ImuSample, Estimate, Plan, CycleTiming}
    assert at_once == one_by_one


@pytest.mark.parametrize("delay_s", [0.0, 0.71])
def test_who_wants_some_types_hears_of_these_and_of_how_many_others(delay_s: float) -> None:
    """Plans that are on their way when the run ends are neither told nor counted."""
    situation = descent(f"run.compute_delay_s={delay_s}", duration_s=4.0)

    def told(heard: frozenset[type[Message]] | None) -> tuple[list[tuple[str, int, int, type[Message], bytes]], int]:
        ears = Ears()
        stretches = Stretches(
            locked.nodes(situation),
            start_ns=situation.scenario.start_ns,
            compute_delay_ns=round(delay_s * 1e9),
            observe=ears,
            heard=heard,
            refused=locked.refused,
        )
        stretches.advance(situation.scenario.end_ns)
        return ears.said, stretches.untold

    wanted: frozenset[type[Message]] = frozenset({Truth, Estimate, Plan})
    everything, none = told(None)
    some, others = told(wanted)
    assert none == 0
    if not delay_s:
        assert some == [said for said in everything if said[3] in wanted]
        assert others == len(everything) - len(some)
    assert [said for said in some if said[3] in wanted] == [said for said in everything if said[3] in wanted]
    assert len(some) + others == len(everything)


def test_an_unrecorded_run_has_the_summary_of_a_recorded_one(tmp_path: Any) -> None:
    situation = descent("sensors=paper", duration_s=4.0)
    recorded, unrecorded = locked.run(situation, RunFolder(tmp_path)), locked.run(situation)
    of_both = [msgspec.structs.replace(s, messages=recorded.messages) for s in (recorded, unrecorded)]
    assert of_both[0] == of_both[1]


def test_at_once_is_what_steps_one_by_one_are_and_most_are_made_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the plant, the sensors and the estimator: how often each is asked, and how many single steps are left."""
    single: dict[str, int] = {}

    def counted(kind: type, method: str) -> None:
        inner = getattr(kind, method)

        def outer(self: Any, *given: Any) -> Any:
            single[kind.__name__] = single.get(kind.__name__, 0) + 1
            return inner(self, *given)

        monkeypatch.setattr(kind, method, outer)

    counted(Plant, "_go")
    counted(Sensors, "step")
    counted(Estimator, "step")
    situation = descent("sensors=paper", duration_s=4.0)
    scenario = situation.scenario
    nodes = locked.nodes(situation, unheard=False)
    said = said_by(Stretches, nodes, scenario.start_ns, [scenario.end_ns])
    ticks = sum(kind is Truth for *_, kind, _ in said)
    assert ticks == 701
    assert single["Plant"] < ticks / 5
    assert single["Sensors"] < ticks / 20
    assert single["Estimator"] < ticks / 2


# --- rules, on nodes small enough ------------------------------------------------------------------------------------


class Many(Fake):
    """The same, at once."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self.bulks: list[int] = []

    def steps(self, due: Sequence[Due]) -> list[list[Message]]:
        self.bulks.append(len(due))
        return one_by_one(self, due)


def event(name: str) -> Callable[[int, Inbox], list[Message]]:
    return lambda t_ns, _: [RunEvent(t_ns=t_ns, node=name, kind="k", text="")]


def depth(t_ns: int, inbox: Inbox) -> list[Message]:
    """Two measurements, of which the second is wrong at every third instant, and then what causes no step."""
    wrong = t_ns % (30 * MS) == 0
    measured = [1.0, np.nan if wrong else 2.0]
    return [*(PressureDepth(t_ns=t_ns, depth_m=depth_m) for depth_m in measured), *event("second")(t_ns, inbox)]


def first(t_ns: int, inbox: Inbox) -> list[Message]:
    """An event, and at times a wrong measurement."""
    wrong: list[Message] = [PressureDepth(t_ns=t_ns, depth_m=np.nan)] if t_ns % (20 * MS) == 0 else []
    return event("first")(t_ns, inbox) + wrong


def estimate(t_ns: int, _: Inbox) -> list[Message]:
    return [Estimate.at_rest(north_m=t_ns * 1e-9)]


def table(fake: type[Fake]) -> list[Fake]:
    """Two on grids, two on messages, two that cycle at other periods, and messages of each kind between them."""
    return [
        fake("first", Grid(10 * MS), (Plan,), first, (RunEvent, PressureDepth)),
        fake("second", Grid(25 * MS), (), depth, (PressureDepth, RunEvent)),
        fake("third", OnMessage((PressureDepth,)), (PressureDepth, RunEvent), estimate, (Estimate,)),
        fake("last", OnMessage((Estimate,)), (Estimate, RunEvent)),
        Fake("controller", Cycle(70 * MS), (Estimate, RunEvent, Rejected, CycleTiming), plans, (Plan,)),
        Fake("other", Cycle(70 * MS), (Estimate, Plan, PressureDepth, CycleTiming)),
    ]


def plans(t_ns: int, _: Inbox) -> list[Message]:
    """At two of three cycles."""
    return [plan(t_ns, t_ns)] if t_ns % (210 * MS) else []


@pytest.mark.parametrize("delay_ms", [0, 30, 90])
@pytest.mark.parametrize("pieces_ms", [(1000,), (0, 1, 69, 70, 333, 1000)])
def test_each_step_is_given_what_lock_step_gives_it(delay_ms: int, pieces_ms: tuple[int, ...]) -> None:
    slow, fast = table(Fake), table(Many)
    until = [ms * MS for ms in pieces_ms]
    one = said_by(LockStep, slow, -35 * MS, until, delay_ms * MS)
    other = said_by(Stretches, fast, -35 * MS, until, delay_ms * MS)
    assert [node.seen for node in fast] == [node.seen for node in slow]
    assert other == one
    assert any(kind is Rejected for *_, kind, _ in one)
    assert max(bulk for node in fast[:4] for bulk in node.bulks) > 2  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("nodes", "why"),
    [
        ([Fake("c", Cycle(MS)), Fake("g", Grid(MS))], "cycle come last"),
        ([Fake("a", Grid(MS), (Truth,)), Fake("b", Grid(MS), writes=(Truth,))], "a reads Truth"),
        ([Fake("a", Grid(MS), (Truth,), writes=(Truth,))], "a reads Truth"),
        ([Fake("a", Grid(MS), (Rejected,))], "a reads Rejected"),
        ([Fake("a", Grid(MS), (Estimate,))], "a reads Estimate"),
    ],
)
def test_what_cannot_be_done_by_stretches_is_refused(nodes: list[Fake], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        Stretches(nodes, start_ns=0)
