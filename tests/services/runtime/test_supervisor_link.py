"""Link to the supervisor: heartbeats one way, the restored state the other way."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from services.runtime.stage_timer import StageTimer
from services.runtime.supervisor_link import (
    HEARTBEAT_FORMAT,
    HEARTBEAT_PERIOD_US,
    LAST_HEARTBEAT,
    STATE_LENGTH,
    SupervisorLink,
)


@pytest.fixture
def pipe() -> Iterator[tuple[int, int]]:
    """Read end, write end."""
    ends = os.pipe()
    os.set_blocking(ends[0], False)
    yield ends
    for end in ends:
        os.close(end)


def connected(pipe: tuple[int, int], given: bytes = STATE_LENGTH.pack(0)) -> SupervisorLink:
    """Return a link to a supervisor that has written ``given``."""
    link, (reading, writing) = SupervisorLink(), os.pipe()
    os.write(writing, given)
    os.close(writing)
    try:
        link.connect(pipe[1], stdin=reading)
    finally:
        os.close(reading)
    return link


def beats(pipe: tuple[int, int]) -> list[int]:
    try:
        return [value for (value,) in HEARTBEAT_FORMAT.iter_unpack(os.read(pipe[0], 1 << 16))]
    except BlockingIOError:
        return []


def test_a_loop_sends_a_heartbeat_each_turn_up_to_the_expected_rate(pipe: tuple[int, int]) -> None:
    process = connected(pipe)
    for now_us in range(1_000_000, 1_200_001, 10_000):
        process.beat(now_us)
    assert beats(pipe) == list(range(1_000_000, 1_200_001, HEARTBEAT_PERIOD_US))
    StageTimer(process)("build")  # so does each stage of a cycle
    assert len(beats(pipe)) == 1
    process.last_beat()
    process.beat(9_000_000)
    assert beats(pipe) == [LAST_HEARTBEAT]


def test_an_unsupervised_process_sends_no_heartbeats_and_starts_at_once() -> None:
    process = SupervisorLink()
    process.beat(1)
    process.last_beat()
    assert process.due_us is None
    assert process.state == b""


def test_a_supervisor_that_does_not_read_blocks_no_process(pipe: tuple[int, int]) -> None:
    process = connected(pipe)
    for k in range(20_000):
        process.beat(k * HEARTBEAT_PERIOD_US)
    assert 0 < len(beats(pipe)) <= (1 << 16) // HEARTBEAT_FORMAT.size


@pytest.mark.parametrize("state", [b"state", b""])
def test_a_restarted_process_reads_its_restored_state(pipe: tuple[int, int], state: bytes) -> None:
    assert connected(pipe, STATE_LENGTH.pack(len(state)) + state).state == state


@pytest.mark.parametrize("given", [STATE_LENGTH.pack(100) + b"half", b"\0", b""])
def test_a_process_whose_supervisor_is_dead_exits_before_it_starts(pipe: tuple[int, int], given: bytes) -> None:
    with pytest.raises(SystemExit):
        connected(pipe, given)
