"""Parent-death handling: no child process outlives the supervisor, however the supervisor ends.

    every child     asks the kernel for SIGKILL at its parent's death (PR_SET_PDEATHSIG)
    the recorder    asks for SIGTERM instead, so that it can finish its file
    orphan cleanup  a small separate process, which leads the process group of all children and kills the group two
                    seconds after the supervisor's end: a recorder that is stopped or holds the GIL ends by it

The cleanup itself asks for SIGCONT, in case it is stopped. PDEATHSIG also fires when only the spawning thread ends; so
children are started by the supervisor's main thread. Their group is not that of the terminal, so Ctrl-C reaches the
supervisor alone.
"""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys

PR_SET_PDEATHSIG = 1
GRACE_S = 2.0

PROGRAM = f"""
import ctypes, os, signal, sys, time
ctypes.CDLL(None).prctl({PR_SET_PDEATHSIG}, signal.SIGCONT)
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, signal.SIG_IGN)
sys.stdin.read()
time.sleep({GRACE_S})
os.killpg(0, signal.SIGKILL)
"""
"""Program of the orphan cleanup. The end of its input means that the supervisor has ended, however it ended."""


def die_with_parent(parent: int, number: signal.Signals = signal.SIGKILL) -> None:
    """Request a signal at the death of process ``parent``; exit at once if it is already dead."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, number)
    if os.getppid() != parent:
        os._exit(1)


class OrphanCleanup:
    """Handle of the process that kills orphaned children, which are in its process group.

    If that process dies, the run continues without it: the kernel still ends most children with their parent.
    """

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", "-c", PROGRAM],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            process_group=0,
        )

    @property
    def group(self) -> int:
        """Process group for the children; it is also the pid of the cleanup process."""
        return self._process.pid

    def close(self) -> None:
        """End the cleanup process: no child is left."""
        self._process.kill()
        self._process.communicate()
