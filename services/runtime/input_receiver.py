"""Receiving end of a process: validates each message, answers rejected ones, and passes the others on.

An accepted message goes to the reporters, the clock and the inbox of the node's next step. A rejected one is answered
with a ``RejectedFrame`` message that names the reason.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from ltv_mpc.messages import (
    Action,
    ClockCommand,
    ClockStep,
    Command,
    Heartbeat,
    InboxEntry,
    NodeStatus,
    RunEvent,
)
from ltv_mpc.node import Node, OnMessage
from services.bus.mailbox import Frame
from services.bus.message_validation import MessageValidator, RateExceeded, rejection
from services.bus.time_shift import shifted
from services.bus.topics import OPERATOR
from services.bus.wire import WireError, crc
from services.runtime.clock import monotonic_us
from services.runtime.node_io import NodeIO
from services.runtime.node_status import NodeStatusReporter
from services.runtime.process_time import ProcessTime, step_text

if TYPE_CHECKING:  # only a controller needs it
    from services.runtime.controller_status import ControllerStatusReporter

NO_TIME = "no estimate received yet, so there is no vehicle time: retry when the status shows estimates"
"""Rejection reason of a command before there is a time: its age is unknown when it is carried out.

``stop`` is carried out at any time, at vehicle time 0 while there is none.
"""


class StepTrigger(NamedTuple):
    """Request for a step by an input."""

    cause: str
    """Key of the input."""
    t_ns: int
    """Time of the step."""


class InputReceiver:
    """Validation and routing of one process's inputs."""

    def __init__(
        self,
        node: Node,
        io: NodeIO,
        time: ProcessTime,
        status: NodeStatusReporter,
        report: ControllerStatusReporter | None,
        validator: MessageValidator,
    ) -> None:
        self._node, self._io, self._time, self._status = node, io, time, status
        self._report, self._validator = report, validator
        self.command = ""
        """Key of a command that the next step must not wait for."""
        schedule = node.schedule
        self._triggers = frozenset(schedule.types if isinstance(schedule, OnMessage) else ())

    def take(self, frame: Frame) -> StepTrigger | None:
        """Accept or reject a frame. Return the step that it causes, if any."""
        time, io = self._time, self._io
        received_us = frame.received_monotonic_us
        try:
            message, header = self._validator.validate(frame)
        except RateExceeded:
            return None
        except WireError as error:
            self._reject(frame, str(error))
            return None
        stops = isinstance(message, Command) and message.action is Action.STOP
        by_operator = frame.topic is not None and frame.topic.written_by == OPERATOR and type(message) is not Heartbeat
        if by_operator and time.clock.newest is None and not stops:
            reason = NO_TIME
        else:
            reason = time.take(message, header.epoch, received_us)
            self._report_clock_steps(received_us)
        if reason:
            self._validator.reject(reason)
            self._reject(frame, reason)
            return None
        shift_ns = time.sync.shift_ns(header.epoch, received_us)
        message = shifted(message, shift_ns)
        kind = type(message)
        now_us = monotonic_us()
        self._status.waiting.on_input(kind, now_us)
        self._status.on_delivery(header.sent_monotonic_us, received_us, now_us)
        if self._report is not None:
            self._report.on_input(message)
        if time.master is not None and isinstance(message, NodeStatus):
            time.master.on_status(message, now_us)
        elif time.master is not None and isinstance(message, ClockCommand):
            time.master.on_command(message, now_us)
        if kind not in self._node.reads:
            return None
        entry = InboxEntry(
            key=frame.key,
            epoch=header.epoch,
            sequence=header.sequence,
            crc=crc(frame.payload),
            received_t_ns=time.received_ns(message, received_us),
            shift_ns=shift_ns,
        )
        io.add_to_inbox(message, entry)
        if kind in self._triggers:
            stamped: Any = message  # a type that causes steps has its validity time
            return StepTrigger(frame.key, stamped.t_ns)
        if kind is Command and (stops or time.schedule.next_ns is not None):
            self.command = frame.key
        return None

    def _report_clock_steps(self, now_us: int) -> None:
        """Pass the steps of the publishers' clocks to the node, and publish each as an event."""
        for step in self._time.sync.take_steps():
            now_ns = self._time.now_ns(now_us)
            self._io.publish(RunEvent(t_ns=now_ns, node=self._node.name, kind="clock", text=step_text(step)))
            if ClockStep in self._node.reads:
                self._io.publish_to_self(step, now_ns)
            if self._report is not None:
                self._report.on_input(step)

    def _reject(self, frame: Frame, reason: str) -> None:
        now_ns = self._time.now_ns(frame.received_monotonic_us)
        self._io.publish(rejection(frame, reason, node=self._node.name, t_ns=now_ns))
