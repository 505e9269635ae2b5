"""Executor of a batch: jobs on this machine's cores, in threads, or on the workers of a Dask cluster.

A job that is lost with its worker is done again, alone, so that it is known which job ends its worker. The third time
that happens to one job it is given up. Nothing else is repeated.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from multiprocessing.connection import wait as wait_for_any
from typing import Protocol, TypeVar

from ltv_mpc.errors import ConfigError, one_line
from services.run.host_resources import core_count
from services.supervisor.parent_death import die_with_parent

T = TypeVar("T")
R = TypeVar("R")

MAX_LOSSES = 3
"""Number of lost workers after which a job that runs alone is abandoned."""

POLL_S = 0.2
"""Interval at which a stop request is noticed."""

TERM_S = 5.0
"""Time for all workers to end after SIGTERM; those that are left are killed."""

AHEAD = 3
"""Jobs submitted for each worker, so that the next one is ready when one ends."""

CLUSTER_TIMEOUT_S = 30.0
"""Longest wait for the answer of a scheduler, and for its first worker."""


class WorkerLost(RuntimeError):
    """Failure of a job that has ended its worker at each attempt."""


def run_each(
    work: Callable[[T], R],
    jobs: Sequence[T],
    *,
    workers: int | None = None,
    cluster: str | None = None,
    cluster_timeout_s: float = CLUSTER_TIMEOUT_S,
    threads: bool = False,
    stop: Callable[[], bool] = lambda: False,
    lost: Callable[[T], R] | None = None,
) -> Iterator[tuple[int, R]]:
    """Execute all jobs; yield the index and result of each as it ends.

    Raises what a job raises, and ends all others then, as it does when the reader closes it or ``stop`` returns True.

    Parameters
    ----------
    work, jobs
        Pickled, unless they run in threads: ``work`` is a function of a module.
    workers
        Processes or threads; None: one a core. One process is this one, unless ``lost`` is given.
    cluster
        Address of a Dask scheduler, whose workers do the jobs. Raises ``ConfigError`` where it cannot be reached.
    cluster_timeout_s
        Time for the scheduler's answer, and for its first worker.
    threads
        For jobs that only wait for processes that they start. A running job is waited for.
    lost
        Result of a job that is given up; without it ``WorkerLost`` is raised.
    """
    count = min(len(jobs), workers or core_count())
    if not jobs:
        return
    if cluster is None and count == 1 and lost is None:
        for place, job in enumerate(jobs):
            if stop():
                return
            yield place, work(job)
        return
    pool: _Pool
    if cluster is not None:
        pool = _Cluster(cluster, cluster_timeout_s)
    else:
        pool = _Threads(count) if threads else _Processes(count)
    waiting, suspects = deque(range(len(jobs))), deque[int]()
    losses: Counter[int] = Counter()  # of jobs that were suspected, each alone
    running: dict[Future[R], int] = {}
    broken = False
    try:
        while (waiting or suspects or running) and not stop():
            if broken and not running:
                pool.renew()
                broken = False
            alone = bool(suspects) or any(place in losses for place in running.values())
            queue, at_once = (suspects, 1) if alone else (waiting, AHEAD * pool.workers)
            while queue and not broken and len(running) < at_once:
                try:
                    running[pool.executor.submit(work, jobs[queue[0]])] = queue[0]
                    queue.popleft()
                except BrokenExecutor:  # since the last look: the running jobs say so by themselves
                    broken = True
            for future in wait(running, timeout=POLL_S, return_when=FIRST_COMPLETED).done:
                place, error = running.pop(future), future.exception()
                if error is None:
                    yield place, future.result()
                    continue
                if not pool.lost(error):
                    raise error
                broken = True
                if losses[place] < MAX_LOSSES:
                    suspects.append(place)
                elif lost is None:
                    raise WorkerLost(f"job {place} of {len(jobs)}: its process was lost {MAX_LOSSES} times")
                else:
                    yield place, lost(jobs[place])
                losses[place] += 1
    finally:
        pool.close(early=bool(running))


class _Pool(Protocol):
    """Executor of ``concurrent.futures`` that can be replaced after a lost worker."""

    workers: int
    executor: Executor

    def lost(self, error: BaseException) -> bool:
        """Return True if ``error`` of a job means that its worker has ended."""
        ...

    def renew(self) -> None:
        """Make ``executor`` work again after a loss; called when no job is running."""
        ...

    def close(self, *, early: bool) -> None:
        """Release everything; ``early``: some jobs have not ended."""
        ...


class _Processes:
    """Processes of this machine, which always end with this process."""

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self._others = set(multiprocessing.active_children())
        self.renew()

    def renew(self) -> None:
        # spawn: a forked child would inherit threads of BLAS and of a bus session
        context = multiprocessing.get_context("spawn")
        self.executor: Executor = ProcessPoolExecutor(
            self.workers, mp_context=context, initializer=_begin, initargs=(os.getpid(),)
        )

    def lost(self, error: BaseException) -> bool:
        """Return True if the pool is broken: one lost worker breaks all of it."""
        return isinstance(error, BrokenExecutor)

    def close(self, *, early: bool) -> None:
        """Return when no worker is left.

        The pool's own thread waits for the end of each worker, so this one must not: if two threads wait for the same
        process, ``multiprocessing`` reports to one of them that it still runs.
        """
        if early:
            workers = set(multiprocessing.active_children()) - self._others
            for process in workers:
                process.terminate()
            running, until = [process.sentinel for process in workers], time.monotonic() + TERM_S
            while running and (left_s := until - time.monotonic()) > 0.0:
                ended = wait_for_any(running, left_s)
                running = [sentinel for sentinel in running if sentinel not in ended]
            for process in workers:
                if process.sentinel in running:
                    process.kill()
        self.executor.shutdown(cancel_futures=True)


def _begin(parent: int) -> None:
    """Initialise a worker: only its parent handles an interrupt from the terminal."""
    die_with_parent(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)


class _Threads:
    """Threads of this process."""

    def __init__(self, workers: int) -> None:
        self.workers = workers
        self.executor: Executor = ThreadPoolExecutor(workers)

    def renew(self) -> None:
        """Do nothing: threads are never lost."""

    def lost(self, _error: BaseException) -> bool:
        return False

    def close(self, *, early: bool) -> None:
        self.executor.shutdown(cancel_futures=early)


class _Cluster:
    """Workers of a Dask scheduler."""

    def __init__(self, address: str, timeout_s: float) -> None:
        """Connect, and wait for a first worker. Raises ``ConfigError``."""
        try:
            from distributed import Client
        except ImportError:
            problem = "needs the package distributed: pip install distributed (extra campaign)"
            raise ConfigError("option --cluster", "", problem, value=address) from None
        try:
            self._client = Client(address, timeout=f"{timeout_s:g}s", set_as_default=False)
            self._client.wait_for_workers(1, timeout=timeout_s)
        except (OSError, ValueError) as error:
            raise ConfigError("option --cluster", "", one_line(str(error)), value=address) from None
        self.workers = sum(info["nthreads"] for info in self._client.scheduler_info(n_workers=-1)["workers"].values())
        # Not pure: the same settings are not taken for the same result by the scheduler's memory.
        self.executor: Executor = self._client.get_executor(pure=False)

    def renew(self) -> None:
        """Do nothing: the scheduler has workers left, or waits for new ones."""

    def lost(self, error: BaseException) -> bool:
        """Return True if the scheduler has given up the job after it tried other workers."""
        from distributed import CancelledError, KilledWorker

        return isinstance(error, KilledWorker | CancelledError)

    def close(self, *, early: bool) -> None:  # noqa: ARG002  # what has not ended is cancelled with its client
        self._client.close()
