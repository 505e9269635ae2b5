"""How a launcher's page begins: ``python -P -m services.dashboard.child PARENT OPTIONS...``.

It dies with its parent and gives way to every process of the run: to be watched must cost the vehicle nothing.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from pathlib import Path

from services.cli.app import main as command_line
from services.launch.orphans import die_with_parent

NICE = 10
AUTOGROUP = Path("/proc/self/autogroup")
"""Where Linux shares the processor out by sessions, of which each process of a run is one, first."""


def main() -> None:
    """``sys.argv``: the parent's pid, then the options of ``ltv-mpc dashboard``."""
    parent, *options = sys.argv[1:]
    die_with_parent(int(parent))
    os.nice(NICE)
    with suppress(OSError):  # there is none where it is shared out by processes alone
        AUTOGROUP.write_text(str(NICE))
    command_line(["dashboard", *options])


if __name__ == "__main__":
    main()
