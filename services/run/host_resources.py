"""Resources of this machine for a run: processor cores and disk space."""

from __future__ import annotations

import errno
import os
import shutil
from pathlib import Path

BYTES_PER_VEHICLE_S = 200_000  # of recording, with a margin: 200 s have about 12 MB


def core_count() -> int:
    """Return the number of processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def check_disk_space(folder: Path, duration_s: float) -> None:
    """Raise ``OSError`` if a recording of ``duration_s`` vehicle seconds may not fit on the disk of ``folder``.

    Call it before the folder is made: on a full disk the end of the recording would be lost.
    """
    there = next((path for path in (folder, *folder.absolute().parents) if path.exists()), Path("/"))
    needed = round(duration_s * BYTES_PER_VEHICLE_S)
    free = shutil.disk_usage(there).free
    if free < needed:
        problem = (
            f"{free / 1e6:.0f} MB free, {needed / 1e6:.0f} MB may be needed: free disk space, or choose another --out"
        )
        raise OSError(errno.ENOSPC, problem, str(folder))
