"""State that a restarted process continues from: the plan in force, which need not be the newest."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import numpy as np

from ltv_mpc.messages import (
    Applied,
    Clock,
    ClockState,
    ControllerState,
    Estimate,
    EstimatorState,
    Message,
    NodeStatus,
    Plan,
)
from services.bus.topics import BY_TYPE, STATES, Topic, topic_at
from services.bus.wire import Header, decode, encode
from services.supervisor.bus_monitor import Activity, BusMonitor
from services.supervisor.failure_handler import restore_state
from tests.services.bus.messages import CONTROLLER_STATE, ESTIMATOR_STATE, EXAMPLES


class Ether:
    """Session that passes messages to its subscribers."""

    def __init__(self) -> None:
        self._inlets: dict[str, Callable[[Topic | None, str, bytes], None]] = {}

    def subscribe(self, key: str, _topic: Topic | None, inlet: BusMonitor) -> None:
        self._inlets[key.removesuffix("/**").removesuffix("/*")] = inlet.offer  # type: ignore[attr-defined]

    def put(self, signal: Message, *, epoch: int = 1, sequence: int = 0, node: str = "") -> None:
        key = BY_TYPE[type(signal)].key + (f"/{node}" if node else "")
        self._inlets[key](topic_at(key), key, encode(signal, Header(epoch=epoch, sequence=sequence)))


PLAN = next(e for e in EXAMPLES if isinstance(e, Plan))
APPLIED = next(e for e in EXAMPLES if isinstance(e, Applied))
STATUS = next(e for e in EXAMPLES if isinstance(e, NodeStatus))
CLOCK = next(e for e in EXAMPLES if isinstance(e, Clock))


def heard() -> tuple[Ether, BusMonitor]:
    ether = Ether()
    return ether, BusMonitor(ether, ["controller", "estimator", "recorder"])  # type: ignore[arg-type]


def following(sequence: int, epoch: int = 5) -> Applied:
    return msgspec.structs.replace(APPLIED, plan_epoch=epoch, plan_sequence=sequence)


def plan(cycle_t_ns: int) -> Plan:
    return msgspec.structs.replace(PLAN, cycle_t_ns=cycle_t_ns)


def handed(node: str, watch: BusMonitor) -> ControllerState | EstimatorState:
    return decode(STATES[node], restore_state(node, watch))[0]


def test_the_plan_in_force_is_the_one_that_the_actuators_report() -> None:
    ether, watch = heard()
    for sequence in range(4):
        ether.put(plan(sequence * 300), epoch=5, sequence=sequence)
    ether.put(plan(9999), epoch=6, sequence=2)  # of another, refused
    ether.put(following(2))
    found = watch.plan_in_force()
    assert found is not None
    assert found.cycle_t_ns == 600
    np.testing.assert_array_equal(found.thrust_N, PLAN.thrust_N)


def test_no_plan_is_in_force_before_one_is_accepted_or_if_it_was_not_received() -> None:
    ether, watch = heard()
    assert watch.plan_in_force() is None
    ether.put(plan(0), epoch=5)
    ether.put(following(-1, epoch=0))
    assert watch.plan_in_force() is None
    ether.put(following(7))
    assert watch.plan_in_force() is None


def test_a_new_process_receives_its_checkpoint_the_newest_estimate_and_the_plan() -> None:
    ether, watch = heard()
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


def test_without_a_published_state_the_restored_state_is_empty() -> None:
    _, watch = heard()
    assert restore_state("controller", watch) == restore_state("estimator", watch) == b""
    assert restore_state("recorder", watch) == restore_state("router", watch) == b""


def test_while_the_clock_runs_a_process_shows_by_its_outputs_that_it_works() -> None:
    ether, watch = heard()
    ether.put(STATUS, epoch=3, node="estimator")
    assert epoch_of(watch.last_activity("estimator")) == 3
    assert watch.last_activity("controller") is None
    ether.put(msgspec.structs.replace(CLOCK, state=ClockState.RUNNING))
    assert watch.last_activity("estimator") is None  # a word alone is no estimate
    ether.put(Estimate.at_rest(), epoch=4)
    ether.put(following(0, epoch=9))
    assert epoch_of(watch.last_activity("estimator")) == 4
    assert epoch_of(watch.last_activity("controller")) == 9  # a plan that the actuators have taken
    ether.put(STATUS, epoch=8, node="recorder")
    assert epoch_of(watch.last_activity("recorder")) == 8


def test_a_router_works_if_anything_comes_through_it() -> None:
    ether, watch = heard()
    before = watch.last_activity("router")
    ether.put(STATUS, node="recorder")
    after = watch.last_activity("router")
    assert before is not None
    assert after is not None
    assert after.arrived_s > before.arrived_s


def epoch_of(sign: Activity | None) -> int:
    assert sign is not None
    return sign.epoch
