"""Runner: a pure node as a process on the bus, stepped by the vehicle clock. Its other caller is lock step (``sim``).

    bus -> Mailbox -> InputReceiver (validation, rejection) -> NodeIO (inbox) -> node.step -> NodeIO (outbox) -> bus

The parts, each in its own file: ``step_loop.py`` waits and steps, ``input_receiver.py`` validates inputs,
``node_io.py`` holds inbox, records and outbox, ``process_time.py`` the clock and the schedule, ``deadlines.py`` the
periodic duties (heartbeat, clock, status). Every input passes validation and reaches the node through one inbox, in
order of arrival.
"""

from __future__ import annotations

import gc
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from ltv_mpc.messages import (
    Clock,
    ClockCommand,
    ClockStep,
    CycleTiming,
    Message,
    NodeSettings,
    NodeStatus,
    RejectedFrame,
    RunEvent,
    StepRecord,
)
from ltv_mpc.node import Node
from services.bus.mailbox import Mailbox
from services.bus.message_validation import MessageValidator
from services.bus.options import BusOptions
from services.bus.outbox import Outbox, new_epoch
from services.bus.rate_limit import RateLimit
from services.bus.session import Session, open_session
from services.bus.topics import BY_TYPE, NAMED, expression
from services.runtime.clock import monotonic_us
from services.runtime.clock_master import ClockMaster
from services.runtime.clock_sync import ClockSync
from services.runtime.input_receiver import Connected
from services.runtime.node_io import NodeIO
from services.runtime.node_status import CLOCK_MESSAGE, CLOCK_OR_ESTIMATE, NodeStatusReporter, WaitingFor
from services.runtime.process_time import ClockOptions, ProcessTime
from services.runtime.saved_state import SavedState
from services.runtime.service_manager import SERVICE_MANAGER
from services.runtime.stage_timer import StageTimer
from services.runtime.step_loop import StepLoop, times_cycles
from services.runtime.stopping import Say, StopRequest

if TYPE_CHECKING:  # only a controller needs it
    from services.runtime.controller_status import ControllerStatusReporter

DELIVERED_BY_PROCESS: tuple[type[Message], ...] = (RejectedFrame, Clock)
"""Types that each process delivers to its own node, although others publish them too."""

CLOCK_MASTER_INPUTS: tuple[type[Message], ...] = (NodeStatus, ClockCommand)
"""Types that the clock master's process reads for its clock."""


@runtime_checkable
class WaitingNode(Protocol):
    """Node that names the inputs it needs before its first output; empty once it has them."""

    @property
    def waiting_for(self) -> str: ...


class Runner:
    """Process of one node: runs until a stop is requested, or until the last step of a schedule that ends.

    ``clock`` selects the clock that the process follows. ``stages`` is the stopwatch that the node was given.
    ``compute_delay_ns`` is added between a plan and its publication, in vehicle time. ``report`` publishes a status of
    the node's own, besides the node status of every process. ``settings`` are published for recorders.
    """

    def __init__(
        self,
        node: Node,
        *,
        clock: ClockOptions = ClockOptions(),  # noqa: B008
        compute_delay_ns: int = 0,
        stages: StageTimer | None = None,
        report: ControllerStatusReporter | None = None,
        settings: NodeSettings | None = None,
    ) -> None:
        self.stop = StopRequest()
        self.mailbox = Mailbox()
        self.stop.on_request(self.mailbox.wake)
        self._node = node
        self._master_settings = clock.master
        self._compute_delay_ns = compute_delay_ns
        self._stages = stages or StageTimer()
        self._report = report
        self._settings = settings
        self._epoch = new_epoch()
        self._time = ProcessTime(node, clock, epoch=self._epoch)

    @property
    def name(self) -> str:
        """Name of the node."""
        return self._node.name

    @property
    def finished(self) -> bool:
        """True once the last step of a schedule that ends is done."""
        return self._time.schedule.finished

    @property
    def clock_sync(self) -> ClockSync:
        """Synchronisation with the other side's clock, for a process that may take the time from its inputs."""
        return self._time.sync

    def serve(self, bus: BusOptions, saved: SavedState | None = None, say: Say = print) -> None:
        """Connect, report ready, run the steps, report finished, disconnect.

        ``saved`` has the state that the node continues from, if there is one: the newest one that a node of this name
        has published. The node's first step receives it first. It is also published again, as the first state of this
        process. Later states of the node are kept in ``saved`` before they are published.

        Raises ``BusError``, ``ClockError``, ``Stopped`` (a stop was requested before the connection), or any exception
        of the node.
        """
        gc.collect()
        gc.freeze()  # objects that live until the end: no later collection visits them
        with open_session(bus, stop=self.stop, say=say) as session:
            connected = self._connect(session, saved, say)
            loop = StepLoop(connected, stop=self.stop, stopwatch=self._stages, compute_delay_ns=self._compute_delay_ns)
            SERVICE_MANAGER.ready()
            try:
                loop.run()
            finally:
                loop.finish()

    def _connect(self, session: Session, saved: SavedState | None, say: Say) -> Connected:
        """Declare publishers and subscribers, and start the clock's part of the process."""
        node, time, keeps_time = self._node, self._time, self._master_settings is not None
        inputs = [kind for kind in node.reads if BY_TYPE[kind].written_by != node.name]  # its own need no bus
        inputs = [kind for kind in inputs if kind not in DELIVERED_BY_PROCESS]
        optional: dict[type[Message], bool] = {
            CycleTiming: times_cycles(node),
            ClockStep: ClockStep in node.reads,
            Clock: keeps_time,
            NodeSettings: self._settings is not None,
        }
        kinds: list[type[Message]] = [*node.writes, StepRecord, NodeStatus, RejectedFrame, RunEvent]
        kinds += [kind for kind, is_written in optional.items() if is_written]
        kinds += self._report.writes if self._report is not None else ()
        outbox = Outbox(session, node=node.name, epoch=self._epoch, kinds=kinds)
        validator = MessageValidator(RateLimit(lambda: time.speed))
        waiting = WaitingFor(
            time.clock,
            inputs,
            clock_source=CLOCK_OR_ESTIMATE if time.syncs else CLOCK_MESSAGE,
            node_waits=(lambda: node.waiting_for) if isinstance(node, WaitingNode) else None,
        )
        status = NodeStatusReporter(
            node.name, outbox=outbox, counts=validator, mailbox=self.mailbox, waiting=waiting, say=say
        )
        for kind in dict.fromkeys([*inputs, *(CLOCK_MASTER_INPUTS if keeps_time else (Clock,))]):
            topic = BY_TYPE[kind]  # one mailbox for all, so that arrivals have one order
            session.subscribe(expression(topic), None if kind in NAMED else topic, self.mailbox)
        if self._master_settings is not None:
            time.master = ClockMaster(
                self._master_settings, time.clock, epoch=self._epoch, now_us=monotonic_us(), publish=outbox.publish
            )
        time.start_schedule()
        io = NodeIO(node.name, outbox, saved)
        return Connected(node, self.mailbox, io, time, status, self._report, self._settings, validator)
