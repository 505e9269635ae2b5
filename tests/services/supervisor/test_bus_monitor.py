"""Bus monitor: newest messages, signs of work, kill requests, and the state that a restarted process continues from."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from ltv_mpc.messages import (
    Applied,
    Clock,
    ClockState,
    ControllerState,
    Estimate,
    EstimatorState,
    Kill,
    Message,
    NodeStatus,
    Plan,
    RunEvent,
)
from services.bus.topics import BY_TYPE, STATES, Topic, topic_at
from services.bus.wire import Header, decode, encode
from services.supervisor.bus_monitor import BusMonitor
from tests.services.bus.messages import CONTROLLER_STATE, ESTIMATOR_STATE, EXAMPLES


class Ether:
    """Session that passes messages to its subscribers."""

    def __init__(self) -> None:
        self._receivers: dict[str, Callable[[Topic | None, str, bytes], None]] = {}

    def subscribe(self, key: str, _topic: Topic | None, receiver: Any) -> None:
        self._receivers[key.removesuffix("/**").removesuffix("/*")] = receiver.offer

    def put(self, message: Message, *, epoch: int = 1, sequence: int = 0, node: str = "") -> None:
        key = BY_TYPE[type(message)].key + (f"/{node}" if node else "")
        self.deliver(key, encode(message, Header(epoch=epoch, sequence=sequence)))

    def deliver(self, key: str, payload: bytes) -> None:
        receive = self._receivers.get(key) or self._receivers[key.rpartition("/")[0]]
        receive(topic_at(key), key, payload)


PLAN, APPLIED, STATUS, CLOCK = (
    next(one for one in EXAMPLES if isinstance(one, kind)) for kind in (Plan, Applied, NodeStatus, Clock)
)


@pytest.fixture
def ether() -> Ether:
    return Ether()


@pytest.fixture
def watch(ether: Ether) -> BusMonitor:
    return BusMonitor(ether, ["controller", "estimator", "recorder"])  # type: ignore[arg-type]


def following(sequence: int, epoch: int = 5) -> Applied:
    return replace(APPLIED, plan_epoch=epoch, plan_sequence=sequence)


def plan(cycle_t_ns: int) -> Plan:
    return replace(PLAN, cycle_t_ns=cycle_t_ns)


def handed(node: str, watch: BusMonitor) -> ControllerState | EstimatorState:
    return decode(STATES[node], watch.restore_state(node))[0]


def test_a_newer_message_replaces_the_one_before_and_a_damaged_frame_hides_it(ether: Ether, watch: BusMonitor) -> None:
    for steps in (1, 2):
        ether.put(replace(STATUS, node="recorder", steps=steps), sequence=steps, node="recorder")
        newest = watch.newest(NodeStatus, "recorder")
        assert newest is not None
        assert newest.steps == steps
        assert watch.newest(NodeStatus, "recorder") is newest  # decoded once
    ether.deliver("status/recorder", b"\xc1")
    assert watch.newest(NodeStatus, "recorder") is None


def test_each_kill_request_and_event_is_returned_once(ether: Ether, watch: BusMonitor) -> None:
    ether.put(Kill(node="estimator"))
    ether.deliver(BY_TYPE[Kill].key, b"\xc1")
    ether.put(RunEvent(t_ns=0, node="plant", kind="fault", text="x"), node="plant")
    found = [(type(notice), getattr(notice, "node", "")) for notice in watch.notices()]
    assert found == [(Kill, "estimator"), (RunEvent, "plant")]
    assert list(watch.notices()) == []


def test_the_plan_in_force_is_the_one_that_the_actuators_report(ether: Ether, watch: BusMonitor) -> None:
    assert watch.plan_in_force() is None
    for sequence in range(4):
        ether.put(plan(sequence * 300), epoch=5, sequence=sequence)
    ether.put(plan(9999), epoch=6, sequence=2)  # of another, refused
    for none in (following(-1, epoch=0), following(7)):
        ether.put(none)
        assert watch.plan_in_force() is None
    ether.put(following(2))
    found = watch.plan_in_force()
    assert found is not None
    assert found.cycle_t_ns == 600
    np.testing.assert_array_equal(found.thrust_N, PLAN.thrust_N)


def test_a_new_process_receives_its_checkpoint_the_newest_estimate_and_the_plan(ether, watch) -> None:
    assert {watch.restore_state(node) for node in ("controller", "estimator", "recorder", "router")} == {b""}
    ether.put(plan(0), epoch=5)
    ether.put(following(0))
    ether.put(CONTROLLER_STATE)
    ether.put(ESTIMATOR_STATE)
    ether.put(Estimate.at_rest(north_m=4.0))
    for node, own in (("controller", ControllerState), ("estimator", EstimatorState)):
        state = handed(node, watch)
        assert isinstance(state, own)
        assert state.estimate is not None
        assert state.estimate.north_m == 4.0
    assert handed("controller", watch).plan.cycle_t_ns == 0


def test_while_the_clock_runs_a_process_shows_by_its_outputs_that_it_works(ether: Ether, watch: BusMonitor) -> None:
    def epoch_of(node: str) -> int | None:
        activity = watch.last_activity(node)
        return None if activity is None else activity.epoch

    ether.put(STATUS, epoch=3, node="estimator")
    assert (epoch_of("estimator"), epoch_of("controller")) == (3, None)
    ether.put(replace(CLOCK, state=ClockState.RUNNING))
    assert epoch_of("estimator") is None  # a word alone is no estimate
    ether.put(Estimate.at_rest(), epoch=4)
    ether.put(following(0, epoch=9))  # a plan that the actuators have taken
    before = watch.last_activity("router")
    ether.put(STATUS, epoch=8, node="recorder")
    assert (epoch_of("estimator"), epoch_of("controller"), epoch_of("recorder")) == (4, 9, 8)
    after = watch.last_activity("router")  # anything came through it
    assert before is not None
    assert after is not None
    assert after.arrived_s > before.arrived_s
