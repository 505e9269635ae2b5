"""Link of a process to its supervisor: heartbeats one way, the state to continue from the other way.

Heartbeat   the monotonic time, written to a pipe every ``HEARTBEAT_PERIOD_US`` by the loop that does the work, like a
            systemd watchdog ping. A process that is stopped, or whose loop hangs, sends none, even if its other threads
            run. Heartbeats do not travel over the bus, because its router may be what has failed.
State       of a process that is started in place of a dead one: written to its standard input before it starts.

A process without a supervisor sends no heartbeats and starts without a state.
"""

from __future__ import annotations

import contextlib
import os
import struct

HEARTBEAT_PERIOD_US = 100_000
HEARTBEAT_FORMAT = struct.Struct("<q")
LAST_HEARTBEAT = -1
"""Value in place of a time: the loop has ended, and no heartbeats follow. The supervisor then waits for the exit."""

STATE_LENGTH = struct.Struct("<I")
STDIN = 0


class SupervisorLink:
    """Link to the supervisor; idle until ``connect``."""

    def __init__(self) -> None:
        self.due_us: int | None = None
        """Monotonic time at which the next heartbeat is due; None without a supervisor."""
        self._heartbeat_fd: int | None = None
        self._stdin = STDIN
        self._state_is_unread = False

    def connect(self, heartbeat_fd: int, *, stdin: int = STDIN) -> None:
        """Use the supervisor's heartbeat pipe and standard input."""
        os.set_blocking(heartbeat_fd, False)
        self._heartbeat_fd, self._stdin = heartbeat_fd, stdin
        self._state_is_unread, self.due_us = True, 0

    def beat(self, now_us: int) -> None:
        """Send a heartbeat if one is due."""
        if self.due_us is not None and now_us >= self.due_us:
            self.due_us = now_us + HEARTBEAT_PERIOD_US
            self._write(now_us)

    def last_beat(self) -> None:
        """Report that the loop has ended in order."""
        if self.due_us is not None:
            self.due_us = None
            self._write(LAST_HEARTBEAT)

    def restored_state(self) -> bytes:
        """Return the encoded state that this process continues from; empty if there is none.

        Raises ``SystemExit`` if the supervisor has died.
        """
        if not self._state_is_unread:
            return b""
        self._state_is_unread = False
        (length,) = STATE_LENGTH.unpack(self._read(STATE_LENGTH.size))
        return self._read(length)

    def _read(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            piece = os.read(self._stdin, size - len(data))
            if not piece:
                raise SystemExit(1)
            data += piece
        return data

    def _write(self, value: int) -> None:
        assert self._heartbeat_fd is not None
        with contextlib.suppress(BlockingIOError, BrokenPipeError):  # the supervisor is stopped or dead
            os.write(self._heartbeat_fd, HEARTBEAT_FORMAT.pack(value))


SUPERVISOR_LINK = SupervisorLink()
"""The link of this process."""
