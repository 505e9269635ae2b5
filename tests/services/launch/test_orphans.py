"""What outlives a supervisor is ended two seconds later, by pid, and nothing else is."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from services.launch import guard
from services.launch.orphans import Guard


@pytest.fixture
def sleeper() -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(["sleep", "600"])
    yield process
    process.kill()
    process.wait()


def test_what_is_left_two_seconds_after_the_end_is_killed_even_if_it_is_stopped(
    sleeper: subprocess.Popen[bytes],
) -> None:
    watch = Guard()
    watch.watch(sleeper.pid)
    sleeper.send_signal(19)  # SIGSTOP
    began = time.monotonic()
    watch.close()  # what the kernel does when the supervisor dies, by whatever death
    assert sleeper.wait(5.0) == -9
    assert guard.GRACE_S <= time.monotonic() - began < guard.GRACE_S + 1.5


def test_a_guard_with_nothing_left_to_watch_ends_at_once(sleeper: subprocess.Popen[bytes]) -> None:
    watch = Guard()
    watch.watch(sleeper.pid)
    watch.release(sleeper.pid)
    began = time.monotonic()
    watch.close()
    assert time.monotonic() - began < guard.GRACE_S
    assert sleeper.poll() is None


def test_a_pid_that_was_given_to_another_process_since_is_left_alone(
    sleeper: subprocess.Popen[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    ticks = guard.start_ticks(sleeper.pid)
    assert ticks is not None
    with monkeypatch.context() as patched:
        patched.setattr(guard, "start_ticks", lambda _: ticks - 1)
        watch = Guard()
        watch.watch(sleeper.pid)
    watch.close()
    assert sleeper.poll() is None


def test_the_guard_is_a_few_megabytes() -> None:
    watch = Guard()
    try:
        pages = int(Path(f"/proc/{watch.pid}/statm").read_text().split()[1])
        assert pages * 4096 < 16e6
    finally:
        watch.close()
