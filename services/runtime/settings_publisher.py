"""Periodic publication of a process's settings, from which a replay builds its node again."""

from __future__ import annotations

from ltv_mpc.messages import NodeSettings
from services.bus.outbox import Outbox
from services.bus.topics import BY_TYPE

PERIOD_US = BY_TYPE[NodeSettings].period_ns // 1000


class SettingsPublisher:
    """Publisher of one process's settings: at its start, and again for recorders that start later.

    The step loop sets ``due_us`` at the first step.
    """

    def __init__(self, settings: NodeSettings, outbox: Outbox) -> None:
        self.due_us = 0
        self._settings = settings
        self._outbox = outbox

    def publish(self, now_us: int) -> None:
        """Publish the settings and set the next deadline."""
        self.due_us = now_us + PERIOD_US
        self._outbox.publish(self._settings)
