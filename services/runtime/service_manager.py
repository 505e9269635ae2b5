"""Notifications to the service manager of the host, by the protocol of systemd: sd_notify(3).

    READY=1      everything is compiled, the process is connected, and its cycles may begin
    WATCHDOG=1   the step loop runs; sent by that loop alone, so a process that is stopped or hangs sends none
    STATUS=...   one line for ``systemctl status``
    STOPPING=1   the step loop has ended

A notification is one datagram to the socket that ``NOTIFY_SOCKET`` names: a path, or @NAME in the abstract namespace. A
process without a service manager sends nothing.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Mapping

SOCKET, WATCHDOG_US, WATCHDOG_PID = "NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"

NOTIFICATIONS_PER_TIMEOUT = 4
"""Watchdog notifications within the manager's time-out; systemd recommends at least two."""


class ServiceManager:
    """Link to the service manager; idle until ``connect``."""

    def __init__(self) -> None:
        self.due_us: int | None = None
        """Monotonic time at which the next watchdog notification is due; None if the manager expects none."""
        self._socket: socket.socket | None = None
        self._watchdog_period_us: int | None = None
        self._status = ""

    def connect(self, environment: Mapping[str, str]) -> None:
        """Use the socket and the watchdog that the manager has put into the environment of this process."""
        address = environment.get(SOCKET, "")
        if not address.startswith(("/", "@")):
            return
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._socket.setblocking(False)  # a manager that does not read must not stop the controller
        with contextlib.suppress(OSError):
            self._socket.connect(f"\0{address[1:]}" if address[0] == "@" else address)
        timeout_us = environment.get(WATCHDOG_US, "")
        if timeout_us.isdecimal() and environment.get(WATCHDOG_PID, str(os.getpid())) == str(os.getpid()):
            self._watchdog_period_us = max(int(timeout_us) // NOTIFICATIONS_PER_TIMEOUT, 1)

    def ready(self) -> None:
        """Report that the process has started; its watchdog notifications begin."""
        self._notify("READY=1")
        if self._watchdog_period_us is not None:
            self.due_us = 0

    def beat(self, now_us: int) -> None:
        """Send a watchdog notification if one is due."""
        if self._watchdog_period_us is not None and self.due_us is not None and now_us >= self.due_us:
            self.due_us = now_us + self._watchdog_period_us
            self._notify("WATCHDOG=1")

    def status(self, text: str) -> None:
        """Report what the process does, if it has changed."""
        line = " ".join(text.split())
        if line != self._status:
            self._status = line
            self._notify(f"STATUS={line}")

    def stopping(self) -> None:
        """Report that the process ends in order, and send nothing more."""
        self._notify("STOPPING=1")
        if self._socket is not None:
            self._socket.close()
        self._socket = self.due_us = None

    def _notify(self, text: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):  # the manager is restarting, or its queue is full
                self._socket.send(text.encode())


SERVICE_MANAGER = ServiceManager()
"""The link of this process."""
