"""Orphan cleanup: a process of a few MB that kills, by pid, the children that outlive their supervisor by two seconds.

It is run by its path with ``python -I -S``, in a session of its own. Its standard input has lines ``+PID TICKS`` and
``-PID``. TICKS is the child's start time, so that a pid that the system has reused is not mistaken for the child. The
end of the input means that the supervisor has ended, however it ended. To stay small, it imports nothing of the
project.
"""

import contextlib
import os
import signal
import sys
import time

GRACE_S = 2.0
POLL_S = 0.05


def start_ticks(pid: int) -> int | None:
    """Return the start time of a process in clock ticks since boot; None if there is none, or only a zombie."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            fields = file.read().rpartition(")")[2].split()
    except OSError:
        return None
    return None if fields[0] == "Z" else int(fields[19])


def main() -> None:
    """Keep the list of children until the input ends; then kill those that still run after ``GRACE_S``."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    children: dict[int, int | None] = {}
    for line in sys.stdin:
        pid, _, ticks = line[1:].partition(" ")
        if line[0] == "+":
            children[int(pid)] = int(ticks)
        else:
            children.pop(int(pid), None)
    until = time.monotonic() + GRACE_S
    left = children
    while left and time.monotonic() < until:
        time.sleep(POLL_S)
        left = {pid: ticks for pid, ticks in left.items() if start_ticks(pid) == ticks}
    for pid in left:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


if __name__ == "__main__":
    main()
