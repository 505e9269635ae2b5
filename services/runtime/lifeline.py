"""Lifeline of a process: notifications to what started it, a run's supervisor or the service manager of the host.

Both receive them by the protocol of systemd, sd_notify(3), one datagram each:

    READY=1      everything is compiled, the process is connected, and its cycles may begin
    WATCHDOG=1   the loop that does the work runs; sent by that loop alone, so a process that is stopped or hangs sends
                 none, even if its other threads run
    STATUS=...   one line for ``systemctl status``
    STOPPING=1   the loop has ended

A service manager gives the address of its socket in ``NOTIFY_SOCKET``: a path, or @NAME in the abstract namespace. A
supervisor gives one end of a socket pair, on which it lets the process go on, and as the standard input a file with the
state to continue from, of a process in place of a dead one. Notifications do not travel over the bus, because its
router may be what has failed. A process that nobody watches sends none.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Mapping

SOCKET, WATCHDOG_US, WATCHDOG_PID = "NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"

WATCHDOG, STOPPING = b"WATCHDOG=1", b"STOPPING=1"

NOTIFICATIONS_PER_TIMEOUT = 4
"""Watchdog notifications within the manager's time-out; systemd recommends at least two."""

HEARTBEAT_PERIOD_US = 100_000
"""Time between two watchdog notifications to a supervisor."""

GO = b"go"
"""What a supervisor sends once: the process is the one that it has started."""

STDIN = 0


class Lifeline:
    """Lifeline of one process; idle until it is connected."""

    def __init__(self) -> None:
        self.due_us: int | None = None
        """Monotonic time at which the next watchdog notification is due; None if none is expected."""
        self.state = b""
        """Encoded state that this process continues from; empty if a supervisor has given none."""
        self._fd: int | None = None  # of the socket
        self._watchdog_period_us: int | None = None
        self._status = ""

    def connect(self, environment: Mapping[str, str]) -> None:
        """Use the socket and the watchdog that a service manager has put into the environment of this process."""
        address = environment.get(SOCKET, "")
        if self._fd is not None or not address.startswith(("/", "@")):
            return
        manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        with contextlib.suppress(OSError):
            manager.connect(f"\0{address[1:]}" if address[0] == "@" else address)
        self._use(manager.detach())
        timeout_us = environment.get(WATCHDOG_US, "")
        if timeout_us.isdecimal() and environment.get(WATCHDOG_PID, str(os.getpid())) == str(os.getpid()):
            self._watchdog_period_us = max(int(timeout_us) // NOTIFICATIONS_PER_TIMEOUT, 1)

    def connect_to_supervisor(self, fd: int, *, stdin: int = STDIN) -> None:
        """Wait on the supervisor's socket until it lets this process go on, and read the state.

        Raises ``SystemExit`` if the supervisor has died, or has started another process in its place.
        """
        if os.read(fd, len(GO)) != GO:
            raise SystemExit(1)
        self._use(fd)
        self._watchdog_period_us, self.due_us = HEARTBEAT_PERIOD_US, 0
        with open(stdin, "rb", closefd=False) as file:
            file.seek(0)
            self.state = file.read()

    def ready(self) -> None:
        """Report that the process has started; its watchdog notifications begin."""
        self._notify(b"READY=1")
        if self._watchdog_period_us is not None:
            self.due_us = 0

    def beat(self, now_us: int) -> None:
        """Send a watchdog notification if one is due."""
        if self._watchdog_period_us is not None and self.due_us is not None and now_us >= self.due_us:
            self.due_us = now_us + self._watchdog_period_us
            self._notify(WATCHDOG)

    def status(self, text: str) -> None:
        """Report what the process does, if it has changed."""
        line = " ".join(text.split())
        if line != self._status:
            self._status = line
            self._notify(f"STATUS={line}".encode())

    def stopping(self) -> None:
        """Report that the loop has ended in order, and send nothing more; the socket stays open until the exit."""
        self._notify(STOPPING)
        self.due_us = self._fd = None

    def _use(self, fd: int) -> None:
        os.set_blocking(fd, False)  # a receiver that does not read must not stop the controller
        self._fd = fd

    def _notify(self, notification: bytes) -> None:
        if self._fd is not None:
            with contextlib.suppress(OSError):  # the receiver is restarting or dead, or its queue is full
                os.write(self._fd, notification)


LIFELINE = Lifeline()
"""The lifeline of this process."""
