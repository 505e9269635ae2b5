"""Where a campaign's trials are done: on this machine's cores, or by the workers of a Dask cluster.

Both are executors of futures. A task that is lost with its worker is done again: alone, so that it is known which run
ends its worker; the third time that happens to one run it is given up, and its row says so. Nothing else is repeated.
"""

from __future__ import annotations

import multiprocessing
import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Executor, Future, wait
from typing import NamedTuple, Protocol, TypeAlias

from ltv_mpc.errors import ConfigError, one_line
from services.campaign.trial import Row, Trial, row_of
from services.measure.batch import pool

MOST_LOSSES = 3
LOOK_S = 0.2
"""Between two looks whether it shall stop."""

AHEAD = 3
"""Tasks handed over for each worker: the next one is there when one ends."""

Work: TypeAlias = Callable[[tuple[Trial, ...]], list[Row]]


class Engine(Protocol):
    """Something that does work elsewhere."""

    workers: int

    @property
    def executor(self) -> Executor:
        """That takes tasks now."""
        ...

    def lost(self, error: BaseException) -> bool:
        """Whether ``error`` of a task means that its worker is gone."""
        ...

    def renew(self) -> None:
        """After a loss, when nothing is running: ``executor`` works again."""
        ...

    def close(self) -> None:
        """Nothing that has not begun is begun."""
        ...


class Local:
    """A pool of processes on this machine."""

    def __init__(self, workers: int | None = None) -> None:
        """``workers``: None for as many as there are cores."""
        self.workers = workers or os.cpu_count() or 1
        self._pool = pool(self.workers)

    @property
    def executor(self) -> Executor:
        """As in ``Engine``."""
        return self._pool

    def lost(self, error: BaseException) -> bool:
        """As in ``Engine``: with one worker the whole pool is gone."""
        return isinstance(error, BrokenExecutor)

    def renew(self) -> None:
        """As in ``Engine``."""
        self._pool.shutdown(wait=False, cancel_futures=True)
        self._pool = pool(self.workers)

    def close(self) -> None:
        """As in ``Engine``."""
        self._pool.shutdown(wait=False, cancel_futures=True)
        for process in multiprocessing.active_children():
            process.terminate()


class Cluster:
    """The workers of a Dask scheduler."""

    def __init__(self, address: str, *, patience_s: float = 30.0) -> None:
        """Connect, and wait for a first worker. Raises ``ConfigError``."""
        try:
            from distributed import Client
        except ImportError:
            problem = "needs distributed: install the extra campaign"
            raise ConfigError("option --cluster", "", problem, value=address) from None
        try:
            self._client = Client(address, timeout=f"{patience_s:g}s", set_as_default=False)
            self._client.wait_for_workers(1, timeout=patience_s)
        except (OSError, ValueError) as error:
            raise ConfigError("option --cluster", "", one_line(str(error)), value=address) from None
        self.workers = sum(info["nthreads"] for info in self._client.scheduler_info(n_workers=-1)["workers"].values())
        # Not pure: the same settings are not taken for the same result by the scheduler's memory.
        self._executor: Executor = self._client.get_executor(pure=False)

    @property
    def executor(self) -> Executor:
        """As in ``Engine``."""
        return self._executor

    def lost(self, error: BaseException) -> bool:
        """As in ``Engine``: the scheduler has handed it to other workers some times already."""
        from distributed import CancelledError, KilledWorker

        return isinstance(error, KilledWorker | CancelledError)

    def renew(self) -> None:
        """As in ``Engine``: the scheduler has workers left, or waits for new ones."""

    def close(self) -> None:
        """As in ``Engine``."""
        self._client.close()


class _Task(NamedTuple):
    trials: tuple[Trial, ...]
    alone: bool = False  # so that its loss is its own
    losses: int = 0


def batches(trials: Sequence[Trial], workers: int) -> list[tuple[Trial, ...]]:
    """Tasks of some runs each: few enough that handing them over costs nothing, enough to keep all workers at it."""
    size = min(max(len(trials) // (32 * workers), 1), 32)
    return [tuple(trials[i : i + size]) for i in range(0, len(trials), size)]


def done(
    engine: Engine, work: Work, tasks: Sequence[tuple[Trial, ...]], version: str, *, stop: Callable[[], bool]
) -> Iterator[list[Row]]:
    """The rows of each task, as they come; ``stop`` ends it. Raises what a task raised but for a lost worker."""
    waiting = deque(_Task(trials) for trials in tasks)
    suspects: deque[_Task] = deque()
    while (waiting or suspects) and not stop():
        queue, most = (suspects, 1) if suspects else (waiting, AHEAD * engine.workers)
        gone: list[_Task] = []
        for task, rows in _through(engine, work, queue, most, stop):
            if rows is None:
                gone.append(task)
            else:
                yield rows
        for task in gone:
            if len(task.trials) > 1 or not task.alone:
                suspects += (_Task((trial,), alone=True) for trial in task.trials)
            elif task.losses + 1 < MOST_LOSSES:
                suspects.append(_Task(task.trials, alone=True, losses=task.losses + 1))
            else:
                yield [row_of(trial, version, f"its process was lost {MOST_LOSSES} times") for trial in task.trials]
        if gone:
            engine.renew()


def _through(
    engine: Engine, work: Work, queue: deque[_Task], most: int, stop: Callable[[], bool]
) -> Iterator[tuple[_Task, list[Row] | None]]:
    """Tasks off the queue, ``most`` at a time, with their rows; None for one that was lost, after which no other is
    begun. Ends when the queue is empty or all that were begun are done.
    """
    running: dict[Future[list[Row]], _Task] = {}
    lost = False
    while (running or (queue and not lost)) and not stop():
        try:
            while queue and not lost and len(running) < most:
                running[engine.executor.submit(work, queue[0].trials)] = queue[0]
                queue.popleft()
        except BrokenExecutor:  # it broke since the last look: its tasks say so by themselves
            lost = True
            if not running:
                yield queue.popleft(), None
        for future in wait(running, timeout=LOOK_S, return_when=FIRST_COMPLETED).done:
            task, error = running.pop(future), future.exception()
            if error is None:
                yield task, future.result()
            elif engine.lost(error):
                lost = True
                yield task, None
            else:
                raise error
