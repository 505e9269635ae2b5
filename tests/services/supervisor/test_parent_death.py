"""Orphan cleanup: what outlives its supervisor by two seconds is killed with the process group, and nothing else is."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from services.supervisor.parent_death import GRACE_S, OrphanCleanup
from tests.waiting import until


@pytest.fixture
def cleanup() -> Iterator[OrphanCleanup]:
    cleanup = OrphanCleanup()
    yield cleanup
    cleanup.close()


def test_the_orphan_cleanup_needs_a_few_megabytes(cleanup: OrphanCleanup) -> None:
    pages = int(Path(f"/proc/{cleanup.group}/statm").read_text().split()[1])
    assert pages * 4096 < 16e6


def test_the_end_of_the_cleanup_in_order_kills_no_process_of_the_group(cleanup: OrphanCleanup) -> None:
    sleeper = subprocess.Popen(["sleep", "600"], process_group=cleanup.group)
    cleanup.close()
    assert sleeper.poll() is None
    sleeper.kill()
    sleeper.wait()


SUPERVISOR = """
import subprocess, time
from services.supervisor.parent_death import OrphanCleanup
group = OrphanCleanup().group
child = subprocess.Popen(["sleep", "600"], process_group=group)
print(group, child.pid, flush=True)
time.sleep(600)
"""


def test_children_left_after_two_seconds_are_killed_even_if_they_and_the_cleanup_are_stopped() -> None:
    supervisor = subprocess.Popen([sys.executable, "-P", "-c", SUPERVISOR], stdout=subprocess.PIPE, text=True)
    assert supervisor.stdout is not None
    pids = [int(word) for word in supervisor.stdout.readline().split()]
    supervisor.stdout.close()
    try:
        until(lambda: int(field(pids[0], "SigIgn"), 16) & 1)  # it handles signals: it is ready
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        began = time.monotonic()
        supervisor.kill()
        supervisor.wait()
        until(lambda: not any(alive(pid) for pid in pids))
        assert time.monotonic() - began >= GRACE_S
    finally:
        for pid in filter(alive, pids):
            os.kill(pid, signal.SIGKILL)


def field(pid: int, name: str) -> str:
    """Return a field of the status of a process; "Z" if there is no such process."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return "Z"
    return next(line.split()[1] for line in lines if line.startswith(f"{name}:"))


def alive(pid: int) -> bool:
    return field(pid, "State") != "Z"
