"""Frames on their way through the injector: byte for byte, but for those that a fault concerns."""

from __future__ import annotations

import pytest

from benchmarks.faults import inject
from benchmarks.faults.inject import Injection, Interference
from benchmarks.faults.message_faults import MessageFault
from ltv_mpc.errors import ConfigError
from ltv_mpc.messages import PressureDepth
from services.bus.topics import BY_TYPE
from services.bus.wire import Header, encode

MS, S = 1_000_000, 1_000_000_000
TOPIC = BY_TYPE[PressureDepth]


def frame(sequence: int) -> bytes:
    header = Header(epoch=5, sequence=sequence, sent_monotonic_us=1000 + sequence)
    return encode(PressureDepth(t_ns=sequence * 100 * MS, depth_m=float(sequence)), header)


def fault(harm: MessageFault, size: float = 1.0, key: str = TOPIC.key) -> Injection:
    return Injection(key=key, harm=harm, start_s=1.0, end_s=2.0, size=size, seed=2)


def through(way: Interference) -> list[tuple[int, bytes]]:
    """Ten frames a second for three seconds."""
    return [come for i in range(30) for come in way.carry(TOPIC, frame(i), i * 100 * MS)]


@pytest.mark.parametrize("way", [Interference(), Interference([fault(MessageFault.LOSS, key="estimate")])])
def test_what_no_fault_concerns_passes_byte_for_byte(way):
    assert through(way) == [(i * 100 * MS, frame(i)) for i in range(30)]


def test_a_fault_of_the_command_line_is_read_field_by_field():
    asked = inject.parse("delay,plan,3,4.5,0.25,6")
    assert (asked.harm, asked.key, asked.size, asked.seed) == (MessageFault.DELAY, "plan", 0.25, 6)
    assert asked.interval == (3 * S, 4_500_000_000)


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("loss,plan,3", "must be HARM,KEY,START_S,END_S"),
        ("lost,plan,3,4", "harm"),
        ("loss,plane,3,4", "key: must be a key of `ltv-mpc topics`"),
        ("loss,estimate/gps,3,4", "key: must be estimate: a fault there concerns all of its sources"),
        ("not_a_number,command,3,4", "key: has no field that can be NaN"),
        ("loss,plan,4,4", "end_s: must be > start_s = 4"),
        ("delay,plan,3,4,100", "size: must be > 0 and <= 60"),
    ],
)
def test_what_cannot_be_done_is_refused_by_field_and_bound(word, said):
    with pytest.raises(ConfigError) as refused:
        inject.parse(word)
    assert said in str(refused.value)
