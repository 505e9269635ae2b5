"""Message faults, message by message and through a lock step."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks.faults.effects import Interval
from benchmarks.faults.message_faults import MessageFault, MessageFaultInterval, MessageFaults
from ltv_mpc.messages import Estimate, ImuSample, ImuSamples, Message, PressureDepth, RejectedFrame
from ltv_mpc.node import Grid, Inbox, OnMessage, ReceivedMessage
from ltv_mpc.validation import rejection_reason
from sim.scheduler import Delivery, LockStep
from tests.stepping import as_sent

MS, S = 1_000_000, 1_000_000_000
INTERVAL = Interval(S, 2 * S)
PERIOD_NS = 100 * MS


def depth(t_ns: int) -> PressureDepth:
    return PressureDepth(t_ns=t_ns, depth_m=1e-9 * t_ns)


def by_validation(_: str, delivery: Delivery) -> ReceivedMessage | str:
    if delivery.payload is not None:
        return "damaged"
    return rejection_reason(delivery.message.message) or delivery.message


def message_faults(harm: MessageFault, size: float = 1.0, kind: type[Message] = PressureDepth) -> MessageFaults:
    return MessageFaults(
        [MessageFaultInterval((kind,), harm, INTERVAL, size, seed=4)],
        encode=lambda _: bytes(range(60)),
        receive=by_validation,
    )


def through(way: MessageFaults, *, until_ns: int = 3 * S) -> list[Delivery]:
    """Return all deliveries of ten messages a second."""
    times = range(0, until_ns, PERIOD_NS)
    return [
        d for i, t in enumerate(times) for d in way.carry("sensors", "estimator", ReceivedMessage(depth(t), 1, i, t))
    ]


def sequences(deliveries: list[Delivery]) -> list[int]:
    return [d.message.sequence for d in deliveries]


@pytest.mark.parametrize("harm", MessageFault)
def test_outside_its_spell_and_on_other_keys_every_message_arrives_as_it_was_sent(harm):
    way = message_faults(harm, kind=ImuSamples)
    assert [(d.at_ns, d.message.message.t_ns, d.payload) for d in through(way)] == [
        (t, t, None) for t in range(0, 3 * S, PERIOD_NS)
    ]
    outside = [d for d in through(message_faults(harm)) if d.message.sequence < 10 or d.message.sequence > 20]
    assert [(d.at_ns, d.message.message.t_ns, d.payload) for d in outside] == [
        (t, t, None) for t in [*range(0, S, PERIOD_NS), *range(2 * S + PERIOD_NS, 3 * S, PERIOD_NS)]
    ]


def test_a_share_of_the_messages_is_lost():
    way = message_faults(MessageFault.LOSS, 0.5)
    came = sequences(through(way))
    assert 0 < way.harmed[0] < 10
    assert len(came) == 30 - way.harmed[0]
    assert sequences(through(message_faults(MessageFault.LOSS, 1.0))) == [*range(10), *range(20, 30)]


def test_a_delayed_message_arrives_later_and_is_the_same():
    came = through(message_faults(MessageFault.DELAY, 0.25))
    assert [d.at_ns - d.message.message.t_ns for d in came] == [0] * 10 + [250 * MS] * 10 + [0] * 10


def test_a_reordered_message_comes_right_after_its_successor():
    way = message_faults(MessageFault.REORDER, 1.0)
    assert sequences(through(way))[10:20] == [11, 10, 13, 12, 15, 14, 17, 16, 19, 18]
    assert way.harmed == [5]


def test_a_duplicate_comes_twice():
    way = message_faults(MessageFault.DUPLICATE, 1.0)
    assert sequences(through(way))[10:16] == [10, 10, 11, 11, 12, 12]
    assert way.harmed == [10]


def test_damage_flips_a_few_bits_of_the_bytes():
    for delivery in through(message_faults(MessageFault.CORRUPTION, 1.0))[10:20]:
        flipped = sum((a ^ b).bit_count() for a, b in zip(delivery.payload, range(60), strict=True))
        assert 1 <= flipped <= 8


@pytest.mark.parametrize(
    "signal",
    [
        depth(S),
        Estimate.at_rest(depth_m=3.0),
        as_sent(
            ImuSample(t_ns=S, interval_ns=5, angular_rate_radps=(0.1, 0.2, 0.3), specific_force_mps2=(0.0, 0.0, -9.8))
        ),
    ],
)
def test_what_is_no_number_is_refused_for_it_in_whatever_field(signal):
    way = message_faults(MessageFault.NOT_A_NUMBER, kind=type(signal))
    for sequence in range(20):
        (came,) = way.carry("a", "b", ReceivedMessage(signal, 1, sequence, S))
        assert "must be from" in rejection_reason(came.message.message)
        assert rejection_reason(signal) is None


def test_a_stale_publisher_repeats_itself_with_new_numbers():
    came = through(message_faults(MessageFault.STALE))
    assert sequences(came) == list(range(30))
    assert [d.message.message.t_ns for d in came[10:20]] == [S] * 10


def test_a_jumped_clock_moves_the_stamps_and_nothing_else():
    came = through(message_faults(MessageFault.CLOCK_JUMP, -3600.0))
    assert [d.message.message.t_ns - d.at_ns for d in came[10:20]] == [-3600 * S] * 10
    assert [d.message.message.depth_m for d in came] == pytest.approx(np.arange(30) * 0.1)


class Speaker:
    name = "sensors"
    schedule = Grid(PERIOD_NS)
    reads: tuple[type[Message], ...] = ()
    writes: tuple[type[Message], ...] = (PressureDepth,)

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:  # noqa: ARG002
        return [depth(t_ns)]


class Listener:
    name = "estimator"
    schedule = OnMessage((PressureDepth,))
    reads: tuple[type[Message], ...] = (PressureDepth, RejectedFrame)
    writes: tuple[type[Message], ...] = ()

    def __init__(self) -> None:
        self.heard: list[tuple[int, int]] = []
        self.rejected = 0

    def step(self, t_ns: int, inbox: Inbox) -> list[Message]:  # noqa: ARG002
        self.heard += [(a.received_t_ns, a.sequence) for a in inbox if isinstance(a.message, PressureDepth)]
        self.rejected += sum(isinstance(a.message, RejectedFrame) for a in inbox)
        return []


def in_lockstep(way: MessageFaults | None) -> Listener:
    listener = Listener()
    LockStep([Speaker(), listener], start_ns=0, transport=way).advance(3 * S)
    return listener


def test_in_lock_step_a_delayed_message_is_heard_when_it_arrives():
    heard = in_lockstep(message_faults(MessageFault.DELAY, 0.25)).heard
    assert heard[:10] == [(t, i) for i, t in enumerate(range(0, S, PERIOD_NS))]
    assert (S + 250 * MS, 10) in heard
    assert (S, 10) not in heard
    assert len(heard) == 31


def test_in_lock_step_what_the_door_refuses_is_told_and_not_heard():
    listener = in_lockstep(message_faults(MessageFault.CORRUPTION, 1.0))
    assert [sequence for _, sequence in listener.heard] == [*range(10), *range(20, 31)]
    assert listener.rejected == 10


def test_without_faults_a_way_between_the_nodes_changes_nothing():
    way = MessageFaults([], encode=lambda _: b"", receive=by_validation)
    assert in_lockstep(way).heard == in_lockstep(None).heard


def test_numbers_that_are_none_are_all_met():
    way = message_faults(MessageFault.NOT_A_NUMBER)
    values = {
        str(way.carry("a", "b", ReceivedMessage(depth(S), 1, i, S))[0].message.message.depth_m) for i in range(60)
    }
    assert values == {str(math.nan), str(math.inf), str(-math.inf)}
