"""What becomes of a process that has died or hangs: started anew, as often as the budget allows, or the end of the run.

    restart  <=>  the process may be restarted, it had come to work before, and fewer than ``MAX_RESTARTS`` restarts
                  process were done within the last ``WINDOW_S``

Whoever dies again and again is not mended by another start; then the run ends in order, with the reason.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

MAX_RESTARTS = 5
WINDOW_S = 60.0


class RestartBudget:
    """Restarts of all processes together; times are seconds of one monotonic clock."""

    def __init__(self, most: int = MAX_RESTARTS, window_s: float = WINDOW_S) -> None:
        self._most, self._window_s = most, window_s
        self._spent: deque[float] = deque()

    def spend(self, now_s: float) -> bool:
        """Whether there was one left; it is spent then."""
        while self._spent and now_s - self._spent[0] >= self._window_s:
            self._spent.popleft()
        if len(self._spent) >= self._most:
            return False
        self._spent.append(now_s)
        return True


class ProcessFailure(NamedTuple):
    """One process's death, however it came about."""

    node: str
    how: str  # "was ended by SIGKILL", "hung: ..."
    alive_s: float  # when it was last known to live
    seen_s: float


class Recovery(NamedTuple):
    """A process that was started anew and has not done any work yet."""

    fault: ProcessFailure
    before: int  # epoch of its former self; 0 where it has none
    begun_s: float

    def is_over(self, epoch: int, arrived_s: float) -> bool:
        """Whether a message of ``epoch`` that came at ``arrived_s`` shows that it works again."""
        return arrived_s > self.begun_s and (epoch != self.before or self.before == 0)


class RestartRefusal(NamedTuple):
    """No restart: the run ends."""

    why: str
    in_order: bool  # there is nothing to hurry from: everyone else is well


def judge(
    fault: ProcessFailure, *, restartable: bool, had_worked: bool, budget: RestartBudget
) -> RestartRefusal | None:
    """None: it is to be started anew."""
    if not restartable or not had_worked:
        return RestartRefusal(f"{fault.node} {fault.how}", in_order=False)
    if not budget.spend(fault.seen_s):
        text = f"{fault.node} {fault.how}, and {MAX_RESTARTS} restarts within {WINDOW_S:.0f} s are the limit: stopping"
        return RestartRefusal(text, in_order=True)
    return None
