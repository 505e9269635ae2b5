"""Status reporters of a process: the node status that every process publishes, and the node's own status."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from ltv_mpc.messages import Message, NodeSettings, RunEvent
from services.bus.message_validation import MessageValidator
from services.bus.outbox import Outbox
from services.bus.topics import BY_TYPE
from services.runtime.clock_offset import ClockOffset
from services.runtime.node_status import NodeStatusReporter

SETTINGS_PERIOD_US = BY_TYPE[NodeSettings].period_ns // 1000


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
        self.due_us = now_us + SETTINGS_PERIOD_US
        self._outbox.publish(self._settings)


class NodeReporter(Protocol):
    """Reporter of one kind of node, as the controller's (``controller_status.py``); ``due_us`` is its next deadline."""

    due_us: int

    @property
    def writes(self) -> tuple[type[Message], ...]: ...
    def on_input(self, message: Message) -> None:
        """Note an accepted input."""
        ...

    def on_step(self, outputs: Sequence[Message], took_us: int, now_us: int) -> list[RunEvent]:
        """Note a step whose outputs are published; return the events to publish."""
        ...

    def status(self, now_us: int, t_ns: int, validator: MessageValidator, clock: ClockOffset) -> Message:
        """Return the status that is due and set the next deadline."""
        ...


class Reporters(NamedTuple):
    """Reporters of one process."""

    process: NodeStatusReporter
    node: NodeReporter | None
    settings: SettingsPublisher | None = None
