"""Run events of the supervisor: shown on the screen at once, published as soon as they can be recorded."""

from __future__ import annotations

import math

from ltv_mpc.messages import RunEvent
from services.bus.outbox import Outbox
from services.bus.roles import SUPERVISOR
from services.recording.writer import ENDED
from services.supervisor.bus_monitor import BusMonitor
from services.supervisor.screen import Screen

RECORDING_PROCESSES = frozenset({"router", "recorder"})
"""Processes without which no event is recorded."""

RECONNECT_S = 1.0
"""Time after the router's return in which all processes have found it again."""


class RunEvents:
    """Log of failures and restarts."""

    def __init__(self, outbox: Outbox, monitor: BusMonitor, screen: Screen) -> None:
        self._outbox = outbox
        self._monitor = monitor
        self._screen = screen
        self._pending: list[RunEvent] = []
        self._publish_from_s = 0.0

    @property
    def pending(self) -> bool:
        """True while some events are not published yet."""
        return bool(self._pending)

    def report(self, kind: str, text: str) -> None:
        """Show an event, and queue it for publication."""
        event = RunEvent(t_ns=self._monitor.t_ns() or 0, node=SUPERVISOR, kind=kind, text=text)
        self.show(event)
        self._pending.append(event)

    def end(self, why: str) -> None:
        """Publish at once why the run ends early; the screen shows it as the outcome of the run."""
        self._pending.append(RunEvent(t_ns=self._monitor.t_ns() or 0, node=SUPERVISOR, kind=ENDED, text=why))
        self.publish_pending(math.inf)

    def show(self, event: RunEvent) -> None:
        """Print an event on the screen."""
        self._screen.say(f"{event.t_ns / 1e9:.1f} s  {event.node}: {event.text}")

    def on_recovery(self, name: str, now_s: float) -> None:
        """Note that a process works again. After router or recorder, publication waits for ``RECONNECT_S``."""
        if name in RECORDING_PROCESSES:
            self._publish_from_s = now_s + RECONNECT_S

    def publish_pending(self, now_s: float) -> None:
        """Publish the queued events, unless ``RECONNECT_S`` has not passed yet."""
        if self._pending and now_s >= self._publish_from_s:
            for event in self._pending:
                self._outbox.publish(event)
            self._pending.clear()
