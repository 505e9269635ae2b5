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
        self.state = b""
        """Encoded state that this process continues from; empty if there is none."""
        self._heartbeat_fd: int | None = None

    def connect(self, heartbeat_fd: int, *, stdin: int = STDIN) -> None:
        """Use the supervisor's heartbeat pipe, and read the state from its other pipe.

        Raises ``SystemExit`` if the supervisor has died.
        """
        os.set_blocking(heartbeat_fd, False)
        self._heartbeat_fd, self.due_us = heartbeat_fd, 0
        with open(stdin, "rb", closefd=False) as pipe:
            head = pipe.read(STATE_LENGTH.size)
            (length,) = STATE_LENGTH.unpack(head) if len(head) == STATE_LENGTH.size else (1,)
            self.state = pipe.read(length)
        if len(self.state) < length:
            raise SystemExit(1)

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

    def _write(self, value: int) -> None:
        assert self._heartbeat_fd is not None
        with contextlib.suppress(BlockingIOError, BrokenPipeError):  # the supervisor is stopped or dead
            os.write(self._heartbeat_fd, HEARTBEAT_FORMAT.pack(value))


SUPERVISOR_LINK = SupervisorLink()
"""The link of this process."""
