"""Hang detection by heartbeats, with an excuse for a suspended machine and for a process without a processor."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable

import pytest

from services.supervisor.hang_detector import HangDetector, ProcessorLack
from tests.waiting import until

TICK_S = 0.05


def never() -> float:
    """Return 0: the process had a processor whenever it wanted one."""
    return 0.0


def found_s(lacked_s: Callable[[], float], until_s: float, *, heart: HangDetector | None = None) -> float | None:
    """Return when the silence after 3.0 s, checked twenty times a second, is found to be a hang; None: not yet."""
    heart = heart or HangDetector(lacked_s)
    for k in range(1, round(until_s / TICK_S) + 1):
        if k * TICK_S <= 3.0:
            heart.beat(k * TICK_S)
        if heart.hung(k * TICK_S):
            return k * TICK_S
    return None


def test_a_process_without_a_first_heartbeat_is_not_hung() -> None:
    assert not HangDetector(never).hung(1e9)


def test_silence_for_longer_than_the_patience_is_a_hang_and_not_before() -> None:
    assert found_s(never, 9.0) == pytest.approx(3.55, abs=0.06)


def test_a_heartbeat_ends_the_silence_and_a_delayed_one_does_not_replace_a_newer_one() -> None:
    heart = HangDetector(never)
    assert found_s(never, 3.45, heart=heart) is None
    heart.beat(3.47)
    heart.beat(1.0)
    assert heart.last_s == 3.47
    assert [heart.hung(3.5 + k * TICK_S) for k in range(11)] == [*[False] * 10, True]


def test_a_process_whose_loop_has_ended_is_not_hung() -> None:
    heart = HangDetector(never)
    heart.end()
    assert found_s(never, 9.0, heart=heart) is None


def test_a_late_supervisor_restarts_the_timeout_of_every_process() -> None:
    """The machine was suspended for ten seconds."""
    heart = HangDetector(never)
    assert found_s(never, 3.0, heart=heart) is None
    assert [heart.hung(13.02 + k * TICK_S) for k in range(13)] == [*[False] * 11, True, True]


def test_a_process_without_a_processor_is_not_hung_and_one_that_has_it_half_of_the_time_is_found_later() -> None:
    assert found_s(lambda: float("inf"), 60.0) is None
    assert found_s(lambda: 0.2, 60.0) is None  # several threads waited
    assert found_s(lambda: 0.5 * TICK_S, 60.0) == pytest.approx(3.8, abs=0.06)


SPIN = "import os, time; os.sched_setaffinity(0, {one}); t = time.time() + 0.6\nwhile time.time() < t: pass\n"
IN_A_THREAD = (
    "import threading; exec('''def spin():\n {spin}'''); t = threading.Thread(target=spin); t.start(); t.join()\n"
)


@pytest.mark.parametrize("thread", [False, True])
def test_linux_says_how_long_each_thread_waited_for_a_processor(thread: bool) -> None:
    """Two processes spin on one processor, in their loop or in another thread: each waits about half of the time."""
    spin = SPIN.format(one=sorted(os.sched_getaffinity(0))[:1])
    program = IN_A_THREAD.format(spin=spin.strip().replace("\n", "\n ")) if thread else spin
    processes = [subprocess.Popen([sys.executable, "-S", "-c", program + "input()"], stdin=-1) for _ in range(2)]
    lacks = [ProcessorLack(process.pid) for process in processes]
    total_s = [0.0, 0.0]

    def waited() -> bool:
        for k, lack in enumerate(lacks):
            total_s[k] += min(lack(), TICK_S)
        return max(total_s) >= 0.1

    try:
        until(waited)
    finally:
        for process in processes:
            process.kill()
            process.communicate()


def test_a_stopped_process_lacks_nothing() -> None:
    process = subprocess.Popen([sys.executable, "-S", "-c", "while True: pass"])
    lack = ProcessorLack(process.pid)
    try:
        process.send_signal(19)
        os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WNOWAIT)
        lack()
        assert [lack() for _ in range(3)] == [0.0, 0.0, 0.0]
    finally:
        process.kill()
        process.wait()
