"""How the supervisor's children begin: ``python -P -m services.launch.child PARENT COMMAND... PULSE``, or forked.

They bind themselves to their parent's life, and are then the command that a person would type. PULSE is ``pulse=FD``,
the pipe for their pulse; on their standard input stands the state to go on from.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Sequence
from pathlib import Path

from services.launch.orphans import die_with_parent, stop_at_end_of_input

PR_SET_NAME = 15
PULSE = "pulse="
RECORDER = "recorder"


def run(words: Sequence[str]) -> None:
    """The parent's pid, a command line of ``ltv-mpc``, then what is between parent and child alone. To the end of it.

    The recorder does not die with its parent: it finishes its file.
    """
    parent, *command, pulse = words
    node = command[0]
    if node != RECORDER:
        die_with_parent(int(parent))
    call_oneself(f"ltv-{node}")

    from services.process.supervised import SUPERVISED

    SUPERVISED.by(int(pulse.removeprefix(PULSE)), restored=stop_at_end_of_input if node == RECORDER else None)
    from services.cli.app import main as command_line

    command_line(command)


def call_oneself(name: str) -> None:
    """What ``ps`` and ``top`` show; at most 15 characters."""
    libc = ctypes.CDLL(None)
    if hasattr(libc, "prctl"):
        libc.prctl(PR_SET_NAME, name.encode())


class Room:
    """The memory that holds this process's command line, of which ``/proc/PID/cmdline`` is a window."""

    def __init__(self) -> None:
        numbers = Path("/proc/self/stat").read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        self._first, self._last = (int(numbers[field - 3]) for field in (48, 49))  # arg_start, arg_end of proc(5)

    def write(self, words: Sequence[str]) -> None:
        """Be known by another one; what does not fit is left out."""
        size = self._last - self._first
        text = b"".join(word.encode() + b"\0" for word in words)[: size - 1]
        ctypes.memmove(self._first, text.ljust(size, b"\0"), size)


if __name__ == "__main__":
    run(sys.argv[1:])
