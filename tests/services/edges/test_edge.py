"""Interface of edges: time base, thrust of a plan, losses, counts of refusals."""

from __future__ import annotations

from collections.abc import Iterable

import msgspec
import numpy as np
import pytest

from ltv_mpc.messages import Estimate, Health
from ltv_mpc.safety.plan_queue import PlanQueue
from services.bus.roles import reads, writes
from services.bus.topics import BY_TYPE, expression
from services.cli.app import run
from services.edges.edge import Edge, LossCounter, Outgoing, Output, Received, Refused, StampedClock
from services.edges.mavlink.edge import MavlinkEdge
from services.edges.ros2.edge import Ros2Edge
from tests.services.edges.plans import SECOND_NS, plan


def test_the_time_is_that_of_the_least_delayed_of_the_last_messages() -> None:
    clock = StampedClock()
    assert clock.read(0) is None
    for k, delay_us in enumerate((400, 100, 900)):
        clock.update(5 * SECOND_NS + k * 1_000_000, k * 1_000 + delay_us)
    assert clock.read(10_000) == 5 * SECOND_NS + 10_000_000 - 100_000
    clock.update(36 * SECOND_NS, 31_000_000 + 5_000)  # the others are older than 30 s
    assert clock.read(31_005_000) == 36 * SECOND_NS


def test_an_answer_is_half_a_round_trip_old_and_a_slow_one_does_not_count() -> None:
    clock = StampedClock()
    clock.exchange(5 * SECOND_NS, 1_000_000, 1_040_000)  # 40 ms for both ways
    assert clock.read(1_040_000) == 5 * SECOND_NS + 20_000_000
    clock.exchange(9 * SECOND_NS, 2_000_000, 2_090_000)  # more than twice as slow
    clock.exchange(9 * SECOND_NS, 3_000_000, 2_900_000)  # an answer before its request
    clock.exchange(9 * SECOND_NS, -(2**62), 3_000_000)  # a request that nobody sent
    assert clock.read(2_040_000) == 6 * SECOND_NS + 20_000_000


@pytest.mark.parametrize("stamp_ns", [-10 * SECOND_NS, 2_147_483_647 * SECOND_NS, 2**63, 8 * SECOND_NS])
def test_a_single_wrong_stamp_is_refused_and_does_not_move_the_clock(stamp_ns: int) -> None:
    clock = StampedClock()
    clock.update(5 * SECOND_NS, 0)
    for k in range(1, 50):
        with pytest.raises(Refused, match="stamp"):
            clock.update(stamp_ns + k * SECOND_NS // 10, k * 100_000)
        clock.update(5 * SECOND_NS + k * SECOND_NS // 10, k * 100_000)
    assert clock.read(5_000_000) == 10 * SECOND_NS


def test_a_clock_that_was_set_forward_is_followed_after_a_second() -> None:
    clock = StampedClock()
    clock.update(5 * SECOND_NS, 0)
    for at_us in (100_000, 600_000, 1_000_000):
        with pytest.raises(Refused, match="95 s ahead"):
            clock.update(100 * SECOND_NS + at_us * 1000, at_us)
    clock.update(101 * SECOND_NS + 100_000_000, 1_100_000)
    assert clock.read(2_000_000) == 102 * SECOND_NS


def test_a_plan_is_executed_by_vehicle_time_and_not_beyond_its_end() -> None:
    plans = PlanQueue(5.0)
    assert plans.thrust_N(7) is None
    plans.add(plan(7 * SECOND_NS), 0)
    assert plans.thrust_N(None) is None
    for at_s, thrust in ((7.5, (5.0, -10.0, 2.5)), (8.5, (10.0, -20.0, 5.0))):
        np.testing.assert_allclose(plans.thrust_N(round(at_s * SECOND_NS)), thrust)
    assert plans.thrust_N(round(9.1 * SECOND_NS)) is None
    plans = PlanQueue(5.0)
    plans.add(msgspec.structs.replace(plan(0), t_ns=SECOND_NS * np.arange(15), thrust_N=np.full((15, 3), 10.0)), 0)
    assert plans.thrust_N(4_999_000_000) is not None
    assert plans.thrust_N(5_001_000_000) is None


def test_a_plan_is_in_force_until_the_next_one_begins() -> None:
    plans = PlanQueue(5.0)
    plans.add(plan(0), 100_000_000, (5, 1))
    assert (plans.is_late, plans.plans_late, plans.identity) == (True, 1, (5, 1))
    later = plan(SECOND_NS + 500_000_000)
    plans.add(later, SECOND_NS, (5, 2))
    assert (plans.is_late, plans.plans_late) == (False, 1)
    assert plans.applied(SECOND_NS, np.zeros(3), np.zeros(3)).plan_received_t_ns == SECOND_NS
    np.testing.assert_allclose(plans.thrust_N(SECOND_NS + 400_000_000), (10.0, -20.0, 5.0))
    np.testing.assert_allclose(plans.thrust_N(SECOND_NS + 500_000_000), (0.0, 0.0, 0.0))
    plans.add(msgspec.structs.replace(later, thrust_N=later.thrust_N + 1.0), SECOND_NS, (5, 3))  # replaces it
    np.testing.assert_allclose(plans.thrust_N(SECOND_NS + 500_000_000), (1.0, 1.0, 1.0))
    assert plans.health(2 * SECOND_NS) is Health.NOMINAL
    assert plans.health(4 * SECOND_NS) is Health.FAILSAFE


@pytest.mark.parametrize(
    ("numbers", "lost", "new"),
    [
        ((3, 4, 5), 0, (True, True, True)),
        ((3, 6, 7), 2, (True, True, True)),
        ((3, 6, 4), 1, (True, True, True)),  # late, and so not lost
        ((3, 4, 4, 3), 0, (True, True, False, False)),  # duplicates
        ((254, 255, 1), 1, (True, True, True)),  # begins again at 0
    ],
)
def test_lost_late_and_duplicate_frames_are_told_apart(numbers, lost, new) -> None:
    counter = LossCounter(256)
    assert tuple(counter.add("sender", number) for number in numbers) == new
    assert counter.lost == lost


def test_numbers_that_jump_about_take_no_memory_without_end() -> None:
    counter = LossCounter()
    for number in range(1000, 0, -1):
        counter.add("sender", 10_000 * number)
        counter.add("sender", 10_000 * number + 999)
    assert sum(map(len, counter._missing.values())) <= 1000
    assert counter.lost == 1000 * 998
    counter = LossCounter()
    for number in (70_000, 70_001, 1, 2, 4):  # it starts again
        counter.add("sender", number)
    assert counter.lost == 1


@pytest.mark.parametrize("edge", [MavlinkEdge, Ros2Edge])
def test_the_role_of_an_edge_may_do_what_the_edge_does(edge: type[Edge]) -> None:
    assert {BY_TYPE[kind].key for kind in edge.writes} <= set(writes(edge.name))
    assert {expression(BY_TYPE[kind]) for kind in edge.reads} <= set(reads(edge.name))


class Text(Edge):
    name = "text"
    reads = ()
    writes = (Estimate,)

    def convert(self, frame: Received) -> Iterable[Output]:
        try:
            north, *_ = map(float, frame.payload.split())
        except ValueError:
            raise Refused(f"no number: {frame.payload!r}") from None
        return [msgspec.structs.replace(Estimate.at_rest(north_m=north), t_ns=SECOND_NS)]

    def step(self, now_us: int) -> Iterable[Output]:  # noqa: ARG002
        return ()

    def release(self, now_us: int) -> Iterable[Outgoing]:  # noqa: ARG002
        return ()


def test_a_frame_becomes_messages_or_is_refused_and_both_are_counted() -> None:
    edge = Text(epoch=1)
    (estimate,) = edge.receive(Received("", b"3.5 4", b"", 1_000))
    assert isinstance(estimate, Estimate)
    assert estimate.north_m == 3.5
    assert edge.clock.read(1_000) == SECOND_NS
    for payload in (b"", b"x", b"y", b"1e9", b"nan"):  # 1e9 m is beyond the bounds of the message
        assert edge.receive(Received("", payload, b"", 0)) == []
    assert (edge.accepted, edge.refused) == (1, 5)
    assert edge.refused_by_reason["no number"] == 3
    assert "north_m" in edge.reason
    for number in range(1000):  # a sender may choose them: they take no memory without end
        edge.refuse(Refused(f"kind {chr(0x100 + number)}: x"))
    assert edge.refused == 1005
    assert len(edge.refused_by_reason) <= 101


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("ros2 --topic odometry=odom", "must be NAME=/TOPIC"),
        ("ros2 --topic odometry=/odom/**", "must be NAME=/TOPIC"),
        ("ros2 --topic odom=/odom", "NAME one of odometry, pose"),
        ("ros2 --topic port=/t --topic starboard=/t", "used for several rows"),
        ("ros2 --array port,left", "must be names of port"),
        ("ros2 --scale 0", "must be a number other than 0"),
        ("ros2 --middleware fastdds", "must be one of ros2dds, rmw_zenoh"),
        ("ros2 --ros-namespace a//b", "must be names joined by /"),
        ("mavlink --autopilot serial:/dev/x", "must be udpin:HOST:PORT"),
        ("mavlink --autopilot udpin:127.0.0.1:0", "must be udpin:HOST:PORT"),
        ("mavlink --vehicle surface", "has no pwm_us and pwm_N"),
        ("mavlink --signing-key /nowhere", "no such file"),
        ("mavlink --signing-key {file}", "must be 32"),
        ("mavlink --connect udpin:127.0.0.1:14550", "must be PROTOCOL/ADDRESS"),
        ("mavlink --sd 1,2,3", "must be four numbers"),
        ("mavlink --sd 1,0,0.1,0.1", "must be four numbers"),
    ],
)
def test_bad_options_of_an_edge_are_refused(line: str, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(line.format(file=__file__).split()) == 2
    assert says in capsys.readouterr().err
