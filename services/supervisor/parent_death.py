"""No orphan, however the supervisor ends: children die with it, the recorder finishes its file, a guard sees to both.

A thread that waits for a pipe's end leaves a child that is stopped or holds the GIL; PDEATHSIG alone would cut the
recording, and fires when only the spawning thread ends. So children are spawned from the supervisor's main thread, in
sessions of their own; each asks for SIGKILL at its parent's death, the recorder for a clean stop at its input's end.
"""

from __future__ import annotations

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
    """SIGKILL at the death of process ``parent``, and at once if it is dead already."""
    libc = ctypes.CDLL(None)
    if hasattr(libc, "prctl"):  # Linux; elsewhere the guard alone does it
        libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def stop_at_end_of_input() -> None:
    """SIGTERM to this very process when its standard input ends: its supervisor wants it to finish, or is no more."""

    def wait() -> None:
        while os.read(0, 1):
            pass
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=wait, name="end of input", daemon=True).start()


class OrphanCleanup:
    """The supervisor's end of the guard."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", str(Path(orphan_cleanup.__file__))],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
        )

    @property
    def pid(self) -> int:
        """Of the guard itself."""
        return self._process.pid

    def watch(self, pid: int) -> None:
        """A child was spawned."""
        ticks = orphan_cleanup.start_ticks(pid)
        if ticks is not None:
            self._tell(f"+{pid} {ticks}")

    def release(self, pid: int) -> None:
        """A child has ended and was waited for."""
        self._tell(f"-{pid}")

    def close(self) -> None:
        """The supervisor's work is done; ends at once when every child was released."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()

    def _tell(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()
