"""Executor of a batch: jobs in processes of this machine, or on the workers of a Dask cluster.

A job that is lost with its worker is done again; the third time it is given up. Nothing else is repeated.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from ltv_mpc.errors import ConfigError, one_line
from services.run.host_resources import core_count

T = TypeVar("T")
R = TypeVar("R")

MAX_LOSSES = 3
"""Number of lost workers after which a job is given up."""

POLL_S = 0.2
"""Interval at which a stop request is noticed."""

SPAWN = multiprocessing.get_context("spawn")
"""Not fork: a child would inherit threads of BLAS and of a bus session."""

AHEAD = 3
"""Jobs submitted for each worker of a cluster, so that the next one is ready when one ends."""

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
    stop: Callable[[], bool] = lambda: False,
    lost: Callable[[T], R] | None = None,
) -> Iterator[tuple[int, R]]:
    """Execute all jobs; yield the index and result of each as it ends.

    Raises what a job raises, and ends all others then, as it does when the reader closes it or ``stop`` returns True.

    Parameters
    ----------
    work, jobs
        Pickled: ``work`` is a function of a module.
    workers
        Processes; None: one a core. One process is this one, unless ``lost`` is given.
    cluster
        Address of a Dask scheduler, whose workers do the jobs. Raises ``ConfigError`` where it cannot be reached.
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
    waiting, losses, running = deque(range(len(jobs))), Counter[int](), dict[Future[R], int]()
    pool = _Processes(work, count) if cluster is None else _Cluster(work, cluster)
    with contextlib.closing(pool):
        while (waiting or running) and not stop():
            while waiting and len(running) < pool.places:
                place = waiting.popleft()
                running[pool.submit(jobs[place])] = place
            for future in wait(running, timeout=POLL_S, return_when=FIRST_COMPLETED).done:
                place, error = running.pop(future), future.exception()
                if error is None:
                    yield place, future.result()
                    continue
                if not isinstance(error, pool.losses):
                    raise error
                losses[place] += 1
                if losses[place] < MAX_LOSSES:
                    waiting.append(place)
                elif lost is None:
                    raise WorkerLost(f"job {place} of {len(jobs)}: its process was lost {MAX_LOSSES} times")
                else:
                    yield place, lost(jobs[place])


def in_order(
    work: Callable[[T], R], jobs: Sequence[T], *, workers: int | None = None, progress: Callable[[float], None]
) -> list[R]:
    """Execute all jobs on this machine; return the results in the order of the jobs.

    ``progress`` receives the share done as each job ends.
    """
    found: dict[int, R] = {}
    for place, result in run_each(work, jobs, workers=workers):
        found[place] = result
        progress(len(found) / len(jobs))
    return [found[place] for place in range(len(jobs))]


class _Processes:
    """Processes of this machine, each a pool of its own, so that the loss of one is that of one job.

    Each holds the end of a pipe whose other end only this process has: they end with this process, however it ends.
    """

    losses: tuple[type[BaseException], ...] = (BrokenProcessPool,)

    def __init__(self, work: Callable[[Any], Any], count: int) -> None:
        self.places = count
        self._work = work
        self._theirs, self._ours = SPAWN.Pipe(duplex=False)
        self._newest: dict[ProcessPoolExecutor, Future[Any]] = {}

    def submit(self, job: Any) -> Future[Any]:
        """Have a process do a job; there are never more jobs than ``places``."""
        for pool in [pool for pool, newest in self._newest.items() if newest.done()]:
            with contextlib.suppress(BrokenProcessPool):
                self._newest[pool] = pool.submit(self._work, job)
                return self._newest[pool]
        pool = ProcessPoolExecutor(1, SPAWN, _begin, (self._theirs,))
        self._newest[pool] = pool.submit(self._work, job)
        return self._newest[pool]

    def close(self) -> None:
        """Return when no process is left."""
        self._ours.close()
        for pool in self._newest:
            pool.shutdown(cancel_futures=True)
        self._theirs.close()


def _begin(theirs: Connection) -> None:
    """Prepare a process of ``_Processes``; only its parent handles an interrupt of the terminal."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, args=(theirs,), daemon=True).start()


def _end_with_parent(theirs: Connection) -> None:
    with contextlib.suppress(EOFError):
        theirs.recv()
    os._exit(1)  # in the middle of a job


class _Cluster:
    """Workers of a Dask scheduler, which tries a job on others before it is lost."""

    def __init__(self, work: Callable[[Any], Any], address: str) -> None:
        """Connect, and wait for a first worker. Raises ``ConfigError``."""
        from distributed import CancelledError, Client, KilledWorker

        try:
            self._client = Client(address, timeout=f"{CLUSTER_TIMEOUT_S:g}s", set_as_default=False)
            self._client.wait_for_workers(1, timeout=CLUSTER_TIMEOUT_S)
        except (OSError, ValueError) as error:
            raise ConfigError("option --cluster", "", one_line(str(error)), value=address) from None
        workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
        self.losses = KilledWorker, CancelledError
        self.places = AHEAD * sum(info["nthreads"] for info in workers)
        # Not pure: the same settings are not taken for the same result by the scheduler's memory.
        self.submit: Callable[[Any], Future[Any]] = partial(self._client.get_executor(pure=False).submit, work)

    def close(self) -> None:
        """Cancel what has not ended."""
        self._client.close()
