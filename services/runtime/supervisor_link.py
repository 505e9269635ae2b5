"""What a process owes its supervisor, and gets from it: a pulse from its own loop, and the state to go on from.

Pulse   the monotonic time, written to a pipe by the loop that does the work, every ``HEARTBEAT_PERIOD_US``. A process
        that is stopped, or whose loop does not come round, has none, however well its other threads live; and it does
        not take the way of the messages, whose router may be what has failed.
State   of a process that is started anew in the place of a dead one; it stands on its standard input from the start.
A process that nobody supervises owes nothing, and begins anew.
"""

from __future__ import annotations

import contextlib
import os
import struct
from collections.abc import Callable

HEARTBEAT_PERIOD_US = 50_000
HEARTBEAT_FORMAT = struct.Struct("<q")
LAST_HEARTBEAT = -1
"""In place of a time: the loop has come to its end, and what follows is waited for by another clock."""

STATE_LENGTH = struct.Struct("<I")
STDIN = 0


class SupervisorLink:
    """The two lines to a supervisor; without one both are idle."""

    def __init__(self) -> None:
        self._pulse: int | None = None
        self._restored: Callable[[], None] | None = None
        self._has_state = False
        self.due_us: int | None = None
        """When the next pulse is due, monotonic; None where nobody listens."""

    def by(self, pulse: int, *, restored: Callable[[], None] | None = None) -> None:
        """A supervisor reads from the pipe ``pulse``. ``restored`` is called once the state was read."""
        os.set_blocking(pulse, False)
        self._pulse, self._restored, self._has_state, self.due_us = pulse, restored, True, 0

    def beat(self, now_us: int) -> None:
        """The loop has come round."""
        if self.due_us is not None and now_us >= self.due_us:
            self.due_us = now_us + HEARTBEAT_PERIOD_US
            self._write(now_us)

    def last_beat(self) -> None:
        """The loop has ended as it should."""
        if self.due_us is not None:
            self.due_us = None
            self._write(LAST_HEARTBEAT)

    def state(self) -> bytes:
        """Return the state that this process continues from, as it travels; empty where there is none.

        Raises ``SystemExit`` where the supervisor is no more.
        """
        if not self._has_state:
            return b""
        self._has_state = False
        (length,) = STATE_LENGTH.unpack(_read(STATE_LENGTH.size))
        state = _read(length)
        if self._restored is not None:
            self._restored()
        return state

    def _write(self, word: int) -> None:
        assert self._pulse is not None
        with contextlib.suppress(BlockingIOError, BrokenPipeError):  # a supervisor that is stopped, or no more
            os.write(self._pulse, HEARTBEAT_FORMAT.pack(word))


def _read(size: int) -> bytes:
    data = b""
    while len(data) < size:
        piece = os.read(STDIN, size - len(data))
        if not piece:
            raise SystemExit(1)
        data += piece
    return data


SUPERVISOR_LINK = SupervisorLink()
"""This process's own."""
