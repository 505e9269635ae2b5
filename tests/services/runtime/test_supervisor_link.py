"""What passes between a process and its supervisor: a pulse one way, the state to go on from the other."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from services.runtime import stage_timer, supervisor_link
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


@pytest.fixture
def stdin(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A file in the place of standard input."""
    path = tmp_path / "stdin"
    path.touch()
    number = os.open(path, os.O_RDONLY)
    monkeypatch.setattr(supervisor_link, "STDIN", number)
    yield path
    os.close(number)


def words(pipe: tuple[int, int]) -> list[int]:
    try:
        return [word for (word,) in HEARTBEAT_FORMAT.iter_unpack(os.read(pipe[0], 1 << 16))]
    except BlockingIOError:
        return []


def test_a_loop_sends_a_heartbeat_each_turn_up_to_the_expected_rate(pipe: tuple[int, int]) -> None:
    process = SupervisorLink()
    process.by(pipe[1])
    for now_us in range(1_000_000, 1_200_001, 10_000):
        process.beat(now_us)
    assert words(pipe) == list(range(1_000_000, 1_200_001, HEARTBEAT_PERIOD_US))
    process.last_beat()
    process.beat(9_000_000)
    assert words(pipe) == [LAST_HEARTBEAT]


def test_a_cycle_beats_with_each_of_its_stages(pipe: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    process = SupervisorLink()
    process.by(pipe[1])
    monkeypatch.setattr(stage_timer, "SUPERVISOR_LINK", process)
    timer = stage_timer.StageTimer()
    timer.start()
    timer("build")
    assert len(words(pipe)) == 1


def test_a_process_that_nobody_supervises_beats_for_nobody_and_begins_at_once() -> None:
    process = SupervisorLink()
    process.beat(1)
    process.last_beat()
    assert process.due_us is None
    assert process.state() == b""


def test_a_supervisor_that_does_not_listen_holds_nobody_up(pipe: tuple[int, int]) -> None:
    process = SupervisorLink()
    process.by(pipe[1])
    for k in range(20_000):
        process.beat(k * HEARTBEAT_PERIOD_US)
    assert 0 < len(words(pipe)) <= (1 << 16) // HEARTBEAT_FORMAT.size


def test_a_process_in_another_s_place_is_given_the_state_to_go_on_from_once(pipe: tuple[int, int], stdin: Path) -> None:
    stdin.write_bytes(STATE_LENGTH.pack(5) + b"state")
    read: list[None] = []
    process = SupervisorLink()
    process.by(pipe[1], restored=lambda: read.append(None))
    assert (process.state(), len(read)) == (b"state", 1)
    assert process.state() == b""  # it has had it


def test_there_may_be_no_state_to_go_on_from(pipe: tuple[int, int], stdin: Path) -> None:
    stdin.write_bytes(STATE_LENGTH.pack(0))
    process = SupervisorLink()
    process.by(pipe[1])
    assert process.state() == b""


def test_a_process_whose_supervisor_is_no_more_never_begins(pipe: tuple[int, int], stdin: Path) -> None:
    stdin.write_bytes(STATE_LENGTH.pack(100) + b"half")
    read: list[None] = []
    process = SupervisorLink()
    process.by(pipe[1], restored=lambda: read.append(None))
    with pytest.raises(SystemExit):
        process.state()
    assert read == []
