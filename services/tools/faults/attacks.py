"""Attacks on the processes of a run by signals and resource limits; a process is found by its parent and its name.

crash     SIGKILL
hang      SIGSTOP, without SIGCONT
slow      stopped for a share of each period, too short to count as hung
full disk no file of the process may grow beyond its present size for some time (RLIMIT_FSIZE)
"""

from __future__ import annotations

import os
import resource
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from services.tools.faults.fault import Fault

PROC = Path("/proc")

ENDING = ("process_crash", "process_hang", "router_killed", "disk_full")
"""Classes after which a process must work again."""

ATTACKS = (*ENDING, "process_slow")

SLOW_PERIOD_S = 0.25
FULL_S = 2.0
"""Wall time for which the disk stays full."""

PAGE = 4096


class NotFound(RuntimeError):
    """No process of the requested name exists."""


def children(parent: int) -> Iterator[tuple[int, str]]:
    """List pid and name of every live process that `parent` has started."""
    for folder in PROC.iterdir():
        if not folder.name.isdigit():
            continue
        try:
            name, _, rest = (folder / "stat").read_text(encoding="utf-8", errors="replace").rpartition(")")
        except OSError:  # it has ended meanwhile
            continue
        state, ppid = rest.split()[:2]
        if int(ppid) == parent and state != "Z":
            yield int(folder.name), name.partition("(")[2]


def pid_of(node: str, parent: int) -> int:
    """Return the pid of a node's process. Raises ``NotFound``."""
    for pid, name in children(parent):
        if name == f"ltv-{node}":
            return pid
    raise NotFound(f"no process of {node} is running")


def attack(fault: Fault, pid: int, *, lasts: Callable[[], bool]) -> None:
    """Attack process `pid`; return at once, or when ``lasts`` returns False."""
    match fault.kind:
        case "process_crash" | "router_killed":
            os.kill(pid, signal.SIGKILL)
        case "process_hang":
            os.kill(pid, signal.SIGSTOP)
        case "process_slow":
            _slow(pid, fault.size, lasts)
        case "disk_full":
            _full(pid)
        case _:
            raise ValueError(f"{fault.kind} is not a fault of a process")


def _slow(pid: int, share: float, lasts: Callable[[], bool]) -> None:
    try:
        while lasts():
            os.kill(pid, signal.SIGSTOP)
            time.sleep(share * SLOW_PERIOD_S)
            os.kill(pid, signal.SIGCONT)
            time.sleep((1.0 - share) * SLOW_PERIOD_S)
    except ProcessLookupError:  # it was taken for dead, and ended
        return


def _full(pid: int) -> None:
    _, most = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (PAGE, most))
    time.sleep(FULL_S)
    try:
        resource.prlimit(pid, resource.RLIMIT_FSIZE, (most, most))
    except ProcessLookupError:
        return
