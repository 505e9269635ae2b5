"""Parallel runs of processes, as many at a time as the machine supports.

Limits in wall time can only be met on a machine that is not overloaded. So the first run is made alone and measured;
its processor use determines how many of the others run at the same time.
"""

from __future__ import annotations

import math
import os
import resource
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

from services.tools.batch.executor import run_each

T = TypeVar("T")
R = TypeVar("R")

CORES_A_RUN = 0.4
LOAD = 0.7
"""Assumed processor use of a run at twice real time (cores), and the share of all cores that runs may use."""


class Machine:
    """Processor time, wall time and cores of this machine."""

    def processor_s(self) -> float:
        """Return the processor time (s) of all child processes that have ended, and of their children."""
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return used.ru_utime + used.ru_stime

    def wall_s(self) -> float:
        """Return a wall time (s) from an arbitrary origin."""
        return time.monotonic()

    @property
    def cores(self) -> int:
        """Number of cores."""
        return os.cpu_count() or 1

    def at_a_time(self, cores_a_run: float) -> int:
        """Return the number of simultaneous runs if each of them uses ``cores_a_run`` cores."""
        return max(1, math.floor(LOAD * self.cores / max(cores_a_run, 0.01) + 1e-9))


def run_in_parallel(
    make: Callable[[T], R],
    tasks: Sequence[T],
    ended: Callable[[T, R], None],
    cores: float | None,
    machine: Machine | None = None,
) -> float | None:
    """Make as many runs at a time as the machine supports, and call ``ended`` with each as it ends.

    Parameters
    ----------
    make : function that makes the run of a task.
    tasks : runs to make.
    ended : receives each task and its result.
    cores : processor use of one run; None: it is measured on the first run, which is made alone.
    machine : clocks and number of cores; None: those of this machine.

    Returns
    -------
    The processor use of one run, if it is known.
    """
    machine = machine or Machine()
    if cores is None and len(tasks) > 1:
        first, *tasks = tasks
        processor_s, wall_s = machine.processor_s(), machine.wall_s()
        ended(first, make(first))
        cores = (machine.processor_s() - processor_s) / (machine.wall_s() - wall_s)
    if not tasks:
        return cores
    workers = machine.at_a_time(cores or CORES_A_RUN)
    for place, result in run_each(make, tasks, workers=workers, threads=True):
        ended(tasks[place], result)
    return cores
