"""Parent-death handling: no child process outlives the supervisor, however the supervisor ends.

    every child     asks the kernel for SIGKILL at its parent's death (PR_SET_PDEATHSIG)
    the recorder    asks for SIGTERM at the end of its standard input instead, so that it can finish its file
    orphan cleanup  a small separate process that kills, by pid, what is left after two seconds

Each covers what the others cannot: a thread that waits for the end of a pipe cannot end a child that is stopped or
holds the GIL. PDEATHSIG alone would cut the recording. PDEATHSIG also fires when only the spawning thread ends; so
children are spawned by the supervisor's main thread, in sessions of their own.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

from services.supervisor import orphan_cleanup

PR_SET_PDEATHSIG = 1


def die_with_parent(parent: int) -> None:
    """Request SIGKILL at the death of process ``parent``; exit at once if it is already dead."""
    libc = ctypes.CDLL(None)
    if hasattr(libc, "prctl"):  # Linux; elsewhere the orphan cleanup alone does it
        libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def stop_at_end_of_input() -> None:
    """Send SIGTERM to this process when its standard input ends: the supervisor has closed it, or has died."""

    def wait() -> None:
        while os.read(0, 1):
            pass
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=wait, name="end of input", daemon=True).start()


class OrphanCleanup:
    """Handle of the process that kills orphaned children (``orphan_cleanup.py``).

    If that process dies, the run continues without it: on Linux the kernel still ends most children with their parent.
    """

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", str(Path(orphan_cleanup.__file__))],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            bufsize=0,
            start_new_session=True,
        )

    @property
    def pid(self) -> int:
        """Process id of the cleanup process."""
        return self._process.pid

    def add(self, pid: int) -> None:
        """Add a child that was started."""
        ticks = orphan_cleanup.start_ticks(pid)
        if ticks is not None:
            self._send(f"+{pid} {ticks}")

    def remove(self, pid: int) -> None:
        """Remove a child that has ended and was waited for."""
        self._send(f"-{pid}")

    def close(self) -> None:
        """Close the input of the cleanup process and wait for its end. It ends at once if no child is left."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()

    def _send(self, line: str) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.write(f"{line}\n".encode())
