"""How the supervisor's children begin: ``python -P -m services.launch.child PARENT COMMAND... PULSE [TURN]``.

They bind themselves to their parent's life, and are then the command that a person would type. PULSE is ``pulse=FD``,
the pipe for their pulse. With TURN, ``turn=now`` or ``turn=later``, they wait on their standard input for the word to
begin; who has time until then loads what it will need as gently as possible.
"""

from __future__ import annotations

import ctypes
import sys
from functools import partial

from services.launch import spare
from services.launch.orphans import die_with_parent, stop_at_end_of_input

PR_SET_NAME = 15
PULSE, TURN = "pulse=", "turn="
NOW, LATER = "now", "later"


def main() -> None:
    """``sys.argv``: the parent's pid, a command line of ``ltv-mpc``, then what is between parent and child alone."""
    parent, *command = sys.argv[1:]
    turn = command.pop().removeprefix(TURN) if command[-1].startswith(TURN) else ""
    pulse = int(command.pop().removeprefix(PULSE))
    node = command[0]
    if node != "recorder":
        die_with_parent(int(parent))
    if turn:
        call_oneself("ltv-spare")
        if turn == LATER:
            spare.load_gently(node)
    begin = partial(_begin, node)
    if not turn:
        begin()

    from services.process.supervised import SUPERVISED

    SUPERVISED.by(pulse, on_turn=begin if turn else None)
    from services.cli.app import main as command_line

    command_line(command)


def _begin(node: str) -> None:
    """It is this process's turn."""
    call_oneself(f"ltv-{node}")
    if node == "recorder":
        stop_at_end_of_input()


def call_oneself(name: str) -> None:
    """What ``ps`` and ``top`` show; at most 15 characters."""
    libc = ctypes.CDLL(None)
    if hasattr(libc, "prctl"):
        libc.prctl(PR_SET_NAME, name.encode())


if __name__ == "__main__":
    main()
