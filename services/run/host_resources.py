"""Resources of this machine for a run: processor cores, disk space and open files."""

from __future__ import annotations

import errno
import os
import resource
import shutil
from pathlib import Path

BYTES_PER_VEHICLE_S = 200_000  # of recording, with a margin: 200 s have about 12 MB


MIN_OPEN_FILES = 64
"""Open files that the supervisor of a run may need: it needs about 40."""


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
        found = f"{free / 1e6:.0f} MB free, {needed / 1e6:.0f} MB may be needed"
        raise OSError(errno.ENOSPC, f"{found}: free disk space, or choose another --out", str(folder))


def check_open_files() -> None:
    """Raise ``OSError`` if this process may not open enough files for a run. The soft limit is raised if possible."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft == resource.RLIM_INFINITY or soft >= MIN_OPEN_FILES:
        return
    if hard != resource.RLIM_INFINITY and hard < MIN_OPEN_FILES:
        found = f"the limit on open files is {hard} (`ulimit -n`), a run needs {MIN_OPEN_FILES}"
        raise OSError(
            errno.EMFILE, f"{found}: raise it with `ulimit -n {MIN_OPEN_FILES}` or in /etc/security/limits.conf"
        )
    resource.setrlimit(resource.RLIMIT_NOFILE, (MIN_OPEN_FILES, hard))
