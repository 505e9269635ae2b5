"""Hang detection by heartbeats, with an excuse for a suspended machine and a starved process."""

from __future__ import annotations

import os
import subprocess
import sys

from services.supervisor.hang_detector import HangDetector
from services.supervisor.managed_process import cpu_wait_s
from tests.waiting import until


def never() -> float:
    """Return a constant: the process has not waited for a processor."""
    return 7.0


def beating(until_s: float, timeout_s: float = 0.5) -> HangDetector:
    heart = HangDetector(timeout_s)
    for k in range(1, round(until_s * 20) + 1):
        heart.beat(k / 20)
    return heart


def test_a_process_without_a_first_heartbeat_is_not_hung() -> None:
    assert not HangDetector().hung(1e9, never)


def test_silence_for_longer_than_the_patience_is_a_hang_and_not_before() -> None:
    heart = beating(3.0)
    assert not heart.hung(3.5, never)
    assert heart.hung(3.501, never)
    heart.beat(3.6)
    assert not heart.hung(4.0, never)


def test_a_delayed_heartbeat_does_not_replace_a_newer_one() -> None:
    heart = beating(3.0)
    heart.beat(1.0)
    assert heart.last_s == 3.0


def test_a_process_whose_loop_has_ended_is_not_hung() -> None:
    heart = beating(3.0)
    heart.end()
    assert not heart.hung(100.0, never)


def test_a_late_supervisor_restarts_the_timeout_of_every_process() -> None:
    """The machine was suspended for ten seconds."""
    heart = beating(3.0)
    heart.excuse(13.0)
    assert not heart.hung(13.4, never)
    assert heart.hung(13.6, never)


def test_a_process_waiting_for_a_processor_is_not_hung_and_a_spinning_one_is() -> None:
    """Silence since 3.0 s; from 3.25 s on other processes have the processor."""
    heart = beating(3.0)
    assert not heart.hung(3.25, lambda: 1.0)
    assert not heart.hung(3.8, lambda: 1.4)
    assert not heart.hung(4.5, lambda: 2.2)
    assert not heart.hung(9.0, lambda: 6.6)
    assert heart.hung(9.0, lambda: 6.4)


def test_waiting_for_a_processor_before_the_silence_is_no_excuse() -> None:
    heart = beating(3.0)
    assert not heart.hung(3.25, lambda: 100.0)
    assert heart.hung(3.6, lambda: 100.0)
    heart.beat(3.7)
    assert not heart.hung(3.75, lambda: 101.0)
    assert not heart.hung(3.9, lambda: 101.0)
    assert heart.hung(4.3, lambda: 101.0)


def test_linux_says_how_long_a_process_waited_for_a_processor() -> None:
    """Two processes spin on one processor: each waits about half of the time."""
    one = sorted(os.sched_getaffinity(0))[:1]
    spin = f"import os, time; os.sched_setaffinity(0, {one}); t = time.time() + 0.6\nwhile time.time() < t: pass"
    processes = [subprocess.Popen([sys.executable, "-S", "-c", spin + "\ninput()"], stdin=-1) for _ in range(2)]
    try:
        until(lambda: max(cpu_wait_s(process.pid) for process in processes) >= 0.1)
    finally:
        for process in processes:
            process.kill()
            process.communicate()
