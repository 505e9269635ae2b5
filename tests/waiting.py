"""Wait for an event: on a busy machine it comes late, so that no test measures how long it took."""

from __future__ import annotations

import time
from collections.abc import Callable

PATIENCE_S = 240.0


def until(condition: Callable[[], object], within_s: float = PATIENCE_S) -> None:
    """Wait until ``condition()`` is true; fail after ``within_s``."""
    deadline = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < deadline, "it never came to that"
        time.sleep(0.01)
