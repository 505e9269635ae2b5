"""How the supervisor's children begin: ``python -P -m services.launch.child PARENT COMMAND...``.

They bind themselves to their parent's life, and are then the command that a person would type.
"""

from __future__ import annotations

import sys

from services.cli.app import main as command_line
from services.launch.orphans import die_with_parent, stop_at_end_of_input


def main() -> None:
    """``sys.argv``: the parent's pid, then a command line of ``ltv-mpc``."""
    parent, *command = sys.argv[1:]
    if command[0] == "recorder":
        stop_at_end_of_input()
    else:
        die_with_parent(int(parent))
    command_line(command)


if __name__ == "__main__":
    main()
