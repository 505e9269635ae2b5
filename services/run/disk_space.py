"""Room on the disk for a run, looked for before its folder is made: a full disk would cost the end of the recording."""

from __future__ import annotations

import errno
import shutil
from pathlib import Path

from sim.scenario import Run

BYTES_PER_VEHICLE_S = 200_000  # of recording, generously: 200 s were 12 MB


def check(folder: Path, run: Run) -> None:
    """Raises ``OSError`` where the recording of ``run`` may not fit where ``folder`` is, or is to be made."""
    there = next((path for path in (folder, *folder.absolute().parents) if path.exists()), Path("/"))
    needed = round((run.surface_time_s + run.duration_s) * BYTES_PER_VEHICLE_S)
    free = shutil.disk_usage(there).free
    if free < needed:
        problem = f"{free / 1e6:.0f} MB free, {needed / 1e6:.0f} MB may be needed: free some, or name another --out"
        raise OSError(errno.ENOSPC, problem, str(folder))
