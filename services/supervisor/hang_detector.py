"""Is a process alive? By the pulse of the loop that does its work, and by nothing else.

    silent = now - max(last pulse, excused)
    hung  <=>  silent - starved > patience      from its first pulse until it says that its loop has ended

``excused`` is the last time the supervisor itself came late: whoever was stopped together with it, as by a machine that
was suspended, has had no time to beat either. ``starved`` is how long of its silence the loop has waited for a
processor that others had: a stopped loop waits for none, nor one that is blocked, and one that is ready to run but is
not let does not get there sooner by a restart. A loop that spins is found by the time that it has the processor. Times
are seconds of one monotonic clock.
"""

from __future__ import annotations

from collections.abc import Callable

HANG_TIMEOUT_S = 0.5
"""Ten pulses. A step of a node takes milliseconds."""

QUIET_S = 0.1
"""Two pulses: until then nobody asks who has the processor."""

LATE_S = 0.25
"""Between two looks of the supervisor, who looks twenty times a second."""


class HangDetector:
    """One process's pulse."""

    def __init__(self, patience_s: float = HANG_TIMEOUT_S) -> None:
        self._patience_s = patience_s
        self._last_s: float | None = None
        self._excused_s = float("-inf")
        self._waited_s: float | None = None  # for a processor, when its silence was first noticed
        self._ended = False

    def beat(self, at_s: float) -> None:
        """A pulse that was sent at ``at_s``."""
        self._last_s = at_s if self._last_s is None else max(self._last_s, at_s)

    def end(self) -> None:
        """Its loop has ended as it should."""
        self._ended = True

    def excuse(self, now_s: float) -> None:
        """Whoever watches has come late."""
        self._excused_s = now_s

    @property
    def last_s(self) -> float | None:
        """When it was last seen alive; None before its first pulse."""
        return self._last_s

    def hung(self, now_s: float, waited_s: Callable[[], float]) -> bool:
        """Whether it has been silent for too long; to be asked often. ``waited_s``: how long its loop has waited for a
        processor in all its life.
        """
        if self._last_s is None or self._ended:
            return False
        silent_s = now_s - max(self._last_s, self._excused_s)
        if silent_s < QUIET_S:
            self._waited_s = None
            return False
        waited = waited_s()
        if self._waited_s is None:
            self._waited_s = waited
        starved_s = waited - self._waited_s
        return silent_s - starved_s > self._patience_s
