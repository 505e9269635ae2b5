"""Orphan cleanup: children that outlive their supervisor by two seconds are killed by pid, and no other process is."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from services.supervisor import orphan_cleanup
from services.supervisor.parent_death import OrphanCleanup
from tests.waiting import until


@pytest.fixture
def sleeper() -> Iterator[subprocess.Popen[bytes]]:
    process = subprocess.Popen(["sleep", "600"])
    yield process
    process.kill()
    process.wait()


def test_children_left_after_two_seconds_are_killed_even_if_stopped(sleeper: subprocess.Popen[bytes]) -> None:
    cleanup = OrphanCleanup()
    cleanup.add(sleeper.pid)
    sleeper.send_signal(19)  # SIGSTOP
    began = time.monotonic()
    cleanup.close()  # what the kernel does when the supervisor dies, by whatever death
    assert sleeper.wait(60.0) == -9
    assert time.monotonic() - began >= orphan_cleanup.GRACE_S


def test_a_removed_or_reused_pid_is_not_killed(
    sleeper: subprocess.Popen[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    cleanup = OrphanCleanup()
    cleanup.add(sleeper.pid)
    cleanup.remove(sleeper.pid)
    cleanup.close()
    assert sleeper.poll() is None
    ticks = orphan_cleanup.start_ticks(sleeper.pid)
    assert ticks is not None
    with monkeypatch.context() as patched:
        patched.setattr(orphan_cleanup, "start_ticks", lambda _: ticks - 1)
        cleanup = OrphanCleanup()
        cleanup.add(sleeper.pid)
    cleanup.close()
    assert sleeper.poll() is None


def test_the_orphan_cleanup_needs_a_few_megabytes() -> None:
    cleanup = OrphanCleanup()
    try:
        pages = int(Path(f"/proc/{cleanup.pid}/statm").read_text().split()[1])
        assert pages * 4096 < 16e6
    finally:
        cleanup.close()


SUPERVISOR = """
import subprocess, sys, time
from services.supervisor.parent_death import OrphanCleanup
guard = OrphanCleanup()
begin = "import os, re, sys, time; from services.supervisor.parent_death import die_with_parent, stop_at_end_of_input;"
tasks = {
    "stopped": "die_with_parent(int(sys.argv[1])); print(flush=True); time.sleep(600)",
    "holds the GIL": "die_with_parent(int(sys.argv[1])); print(flush=True); re.match('(a+)+$', 'a' * 60 + 'b')",
    "recorder that holds it": "stop_at_end_of_input(); print(flush=True); re.match('(a+)+$', 'a' * 60 + 'b')",
}
for task in tasks.values():
    child = subprocess.Popen(
        [sys.executable, "-P", "-c", begin + task, str(__import__("os").getpid())],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True,
    )
    guard.add(child.pid)
    child.stdout.readline()
    print(child.pid, flush=True)
time.sleep(600)
"""


def test_a_killed_supervisor_leaves_no_child_even_if_stopped_or_holding_the_gil() -> None:
    """Children that no thread of their own could end: the kernel ends two of them, the orphan cleanup the third."""
    supervisor = subprocess.Popen([sys.executable, "-P", "-c", SUPERVISOR], stdout=subprocess.PIPE, text=True)
    assert supervisor.stdout is not None
    pids = [int(supervisor.stdout.readline()) for _ in range(3)]
    os.kill(pids[0], signal.SIGSTOP)
    try:
        supervisor.kill()
        supervisor.wait()
        until(lambda: all(orphan_cleanup.start_ticks(pid) is None for pid in pids))
    finally:
        supervisor.stdout.close()
        for pid in pids:
            if orphan_cleanup.start_ticks(pid) is not None:
                os.kill(pid, signal.SIGKILL)
