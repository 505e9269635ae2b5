"""Restart policy: whether a process that died or hangs is restarted, or the run ends.

    restart  <=>  the process may be restarted, all processes had been ready before, and fewer than ``MAX_RESTARTS``
                  restarts of any process were done within the last ``WINDOW_S`` (as systemd's StartLimitBurst)

Another restart does not repair a process that fails again and again; the run then ends in order, with the reason.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

MAX_RESTARTS = 5
WINDOW_S = 60.0


class RestartBudget:
    """Limit on the restarts of all processes together; times are seconds of one monotonic clock."""

    def __init__(self, max_restarts: int = MAX_RESTARTS, window_s: float = WINDOW_S) -> None:
        self._max_restarts, self._window_s = max_restarts, window_s
        self._restarts_s: deque[float] = deque()

    def spend(self, now_s: float) -> bool:
        """Spend one restart. Return False if none is left."""
        while self._restarts_s and now_s - self._restarts_s[0] >= self._window_s:
            self._restarts_s.popleft()
        if len(self._restarts_s) >= self._max_restarts:
            return False
        self._restarts_s.append(now_s)
        return True


class ProcessFailure(NamedTuple):
    """Death or hang of one process."""

    node: str
    how: str  # "was ended by SIGKILL", "hung: ..."
    alive_s: float  # last sign of life: the newest heartbeat
    seen_s: float  # when the supervisor noticed


class Recovery(NamedTuple):
    """Restarted process that has not shown yet that it works."""

    failure: ProcessFailure
    old_epoch: int  # epoch of the process that failed; 0 if it has none
    started_s: float

    def is_over(self, epoch: int, arrived_s: float) -> bool:
        """Return True if a message of ``epoch`` that arrived at ``arrived_s`` shows that the new process works."""
        return arrived_s > self.started_s and (epoch != self.old_epoch or self.old_epoch == 0)


class RestartRefusal(NamedTuple):
    """Decision against a restart: the run ends."""

    why: str
    in_order: bool  # the other processes are well and may finish one after the other


def restart_refusal(
    failure: ProcessFailure, *, restartable: bool, had_started: bool, budget: RestartBudget
) -> RestartRefusal | None:
    """Return why a failed process is not restarted; None if it is. A restart is then spent."""
    if not restartable or not had_started:
        return RestartRefusal(f"{failure.node} {failure.how}", in_order=False)
    if not budget.spend(failure.seen_s):
        limit = f"the limit of {MAX_RESTARTS} restarts within {WINDOW_S:.0f} s is reached"
        return RestartRefusal(f"{failure.node} {failure.how}; {limit}: stopping safely", in_order=True)
    return None
