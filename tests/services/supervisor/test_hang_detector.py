"""Hang detection by heartbeats, with an excuse for a suspended machine and for a process without a processor."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from collections.abc import Callable

import pytest

from services.supervisor.managed_process import HangDetector, ProcessorLack
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


@pytest.mark.parametrize(
    ("lacked_s", "found_after_s"),
    [
        (0.0, 0.55),
        (math.inf, None),  # a process without a processor
        (0.2, None),  # several threads waited
        (0.5 * TICK_S, 0.8),  # it had one half of the time
    ],
)
def test_silence_with_a_processor_for_longer_than_the_patience_is_a_hang(lacked_s, found_after_s) -> None:
    found = found_s(lambda: lacked_s, 60.0)
    assert found is None if found_after_s is None else found == pytest.approx(3.0 + found_after_s, abs=0.06)


def test_a_process_before_its_first_heartbeat_or_after_the_end_of_its_loop_is_not_hung() -> None:
    heart = HangDetector(never)
    assert not heart.hung(1e9)
    heart.end()
    assert found_s(never, 9.0, heart=heart) is None


@pytest.mark.parametrize(
    ("at_s", "ticks"),
    [
        (3.0, 12),
        (13.02, 12),  # the machine was suspended for ten seconds: the timeout begins anew
    ],
)
def test_a_heartbeat_or_a_late_supervisor_restarts_the_timeout(at_s: float, ticks: int) -> None:
    heart = HangDetector(never)
    assert found_s(never, 3.0, heart=heart) is None
    assert [heart.hung(at_s + k * TICK_S) for k in range(ticks)] == [*[False] * (ticks - 1), True]


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
