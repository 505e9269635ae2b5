"""Fork server of ``multiprocessing``: worker processes that share the imports, which take seconds of processor time.

A fork of the process itself would inherit threads of BLAS and of a bus session. The fork server has none. It imports
once, and forks all workers of the process that started it.
"""

from __future__ import annotations

import multiprocessing
import os
from multiprocessing.context import ForkServerContext

from services.supervisor.parent_death import die_with_parent

PRELOADED = ["services.tools.lockstep_run"]
"""Modules that nearly all workers need."""


def context() -> ForkServerContext:
    """Return the context that makes such processes. The first of them starts the fork server."""
    made = multiprocessing.get_context("forkserver")
    made.set_forkserver_preload(PRELOADED)
    return made


def die_with_parent_process() -> None:
    """Request SIGKILL for this worker at the death of the process that started it; exit at once if it is dead."""
    die_with_parent(os.getppid())  # the fork server, which ends with that process
    parent = multiprocessing.parent_process()
    if parent is None or not parent.is_alive():
        os._exit(1)
