"""The second caller of nodes: one pure node on a Zenoh session, by the vehicle clock.

All that a step sees has passed message validation and comes through its inbox, one ordered list. The step's record goes
out before the step's outputs. Records of steps without outputs wait for the next step that has some, at most half a
second.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from typing import Any, Protocol, runtime_checkable

from ltv_mpc.messages import (
    Clock,
    ClockCommand,
    Command,
    CycleTiming,
    Message,
    NodeStatus,
    Plan,
    RejectedFrame,
    StepRecord,
)
from ltv_mpc.node import Node, OnMessage
from services.bus.mailbox import Frame, Mailbox
from services.bus.message_validation import MessageValidator, rejection
from services.bus.options import BusOptions
from services.bus.outbox import Outbox, new_epoch
from services.bus.session import Session, open_session
from services.bus.topics import OPERATOR, STATES
from services.bus.wire import WireError, crc, decode
from services.runtime import ports
from services.runtime.clock import VehicleClock, monotonic_us
from services.runtime.clock_master import ClockMaster, ClockMasterSettings
from services.runtime.clock_sync import SHARED_CLOCK, STAMPED_INPUTS, ClockOffset, ClockSync
from services.runtime.deadlines import DeadlineQueue
from services.runtime.inbox import PendingInbox
from services.runtime.node_status import NodeStatusReporter
from services.runtime.schedule import StepSchedule
from services.runtime.stage_timer import StageTimer
from services.runtime.stopping import Say, StopRequest
from services.runtime.supervisor_link import SUPERVISOR_LINK

INPUTS_ARRIVE_US = 6_000
"""What is measured at an instant arrives so much later: a cycle that started at that instant would miss it by a hair,
and plan on an estimate that is a whole period old."""

MAX_DRAIN_US = 20_000
"""So long a step that is due waits, at most, for what has arrived to be taken: a flood must not keep it from acting."""

LAST_FRAMES_US, LAST_SILENCE_US = 300_000, 20_000
"""A process that is told to stop takes what is on its way until nothing has come for so long, and at most so long."""


@runtime_checkable
class Waiting(Protocol):
    """A node that knows what it cannot begin without, in words; empty once it has begun."""

    @property
    def waiting_for(self) -> str: ...


class Report(Protocol):
    """What a process says of itself at its own times; ``due_us`` is the next one."""

    due_us: int

    @property
    def writes(self) -> tuple[type[Message], ...]: ...
    def on_input(self, signal: Message) -> None:
        """An input was let in."""
        ...

    def on_step(self, outputs: Sequence[Message], took_us: int, now_us: int) -> None:
        """A step is done and published."""
        ...

    def status(self, now_us: int, t_ns: int, validator: MessageValidator, clock: ClockOffset) -> Message:
        """What is due."""
        ...


class Runner:
    """Runs ``node`` until ``stop`` is asked for, or until the last step of a grid that ends.

    ``clock_master`` makes it the time-keeper; ``foreign`` lets it go by the other side's stamps where nobody keeps the
    time for all, ``input_delay_ns`` being the smallest delay of what comes from there; ``speed`` is what it was told to
    expect of the time-keeper. ``stages`` is the stopwatch that the node was given; ``compute_delay_ns`` is added
    between a plan and its publication. ``report`` is what it says of itself besides its status.
    """

    def __init__(
        self,
        node: Node,
        *,
        stop: StopRequest,
        say: Say,
        clock_master: ClockMasterSettings | None = None,
        foreign: bool = False,
        input_delay_ns: int = 0,
        speed: float | None = None,
        compute_delay_ns: int = 0,
        stages: StageTimer | None = None,
        report: Report | None = None,
    ) -> None:
        self._node = node
        self.stop = stop
        self._say = say
        self._keeps_time = clock_master
        self._follows = clock_master is None
        self._compute_delay_ns = compute_delay_ns
        self._stages = stages or StageTimer()
        self._report = report
        self._causes = frozenset(node.schedule.types if isinstance(node.schedule, OnMessage) else ())
        self._schedule = StepSchedule(node.schedule, end_ns=clock_master.end_ns if clock_master else None)
        self._times_cycles = ports.times_cycles(node)
        self.mailbox = Mailbox()
        stop.on_request(self.mailbox.wake)
        self.epoch = new_epoch()
        self._validator = MessageValidator()
        self._clock = VehicleClock(speed=speed)
        self.clock_sync = ClockSync(self._clock, epoch=self.epoch, input_delay_ns=input_delay_ns) if foreign else None
        self._inbox = PendingInbox()
        self._asked = ""  # the key of a command that the next cycle must not wait for
        self._records: list[StepRecord] = []
        self._master: ClockMaster | None = None
        self._deadlines = DeadlineQueue()
        self._out: Outbox
        self._status: NodeStatusReporter

    @property
    def finished(self) -> bool:
        """Whether every step that was asked for is done."""
        return self._schedule.finished

    def serve(self, bus: BusOptions, state: bytes = b"") -> None:
        """Open, say "ready", run, say the last word, close.

        ``state``, a message as it travels, is what the node's first step is given first: the newest state that a node
        of this name has published. It is published once more, as the first state of this process.

        Raises ``BusError``, ``ClockError``, ``Stopped`` (told to before it was connected), or what the node raised.
        """
        gc.collect()
        gc.freeze()  # what lives until the end is not looked at again by any collection
        with open_session(bus, stop=self.stop, say=self._say) as session:
            self._connect(session)
            if state:
                self._restore(state)
            try:
                self._run()
            finally:
                self._flush()
                self._status.publish(monotonic_us(), finished=True)

    # --- the loop ----------------------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self.finished and self._wait(self._due_us):
            self._step_by_time()
        SUPERVISOR_LINK.last_beat()
        if self._master is not None:
            self._master.stop(monotonic_us())
        self._take_last()

    def _wait(self, due_us: Callable[[], int | None]) -> bool:
        """Take what arrives until ``due_us`` has passed and nothing more is there; False when told to stop."""
        entered_us = monotonic_us()
        while not self.stop():
            now_us = monotonic_us()
            self._deadlines.run_due(now_us)
            due = due_us()
            frame = self.mailbox.take((self._deadlines.next_us(due) - now_us) / 1e6)
            if frame is not None:
                self._take(frame)
            if due is None:
                continue
            if monotonic_us() >= (due if frame is None else max(due, entered_us) + MAX_DRAIN_US):
                return True
        return False

    def _due_us(self) -> int | None:
        if self._asked:
            return monotonic_us()
        return None if self._schedule.next_ns is None else self._clock.due_us(self._schedule.next_ns)

    def _step_by_time(self) -> None:
        now_us = monotonic_us()
        self._stages.start()
        if self._asked:  # a cycle between the others, whose times stay
            cause, self._asked = self._asked, ""
            self._step(self._now_ns(now_us), cause, now_us)
            return
        t_ns = self._schedule.next_ns
        assert t_ns is not None
        if self._schedule.on_grid:
            if self._master is not None:
                self._master.on_late_step(now_us, self._clock.due_us(t_ns) or now_us, self._node.name)
            self._step(t_ns, "grid", now_us)
        else:
            self._step(max(t_ns, self._now_ns(now_us)), "cycle", now_us)
        self._schedule.advance(self._now_ns(monotonic_us()))

    def _add_deadlines(self) -> None:
        """Add the periodic duties of the process to the deadline queue."""
        status, master, report = self._status, self._master, self._report
        self._deadlines.add(lambda: SUPERVISOR_LINK.due_us, SUPERVISOR_LINK.beat)
        if master is not None:
            self._deadlines.add(lambda: master.due_us, master.run_due)
        self._deadlines.add(lambda: status.due_us, self._publish_status)
        if report is not None:
            self._deadlines.add(lambda: report.due_us, lambda now_us: self._publish_report(report, now_us))

    def _publish_status(self, now_us: int) -> None:
        """Publish the waiting step records, then the status of the process."""
        self._flush()
        self._status.publish(now_us, others=self._master.waiting_for if self._master else "")

    def _publish_report(self, report: Report, now_us: int) -> None:
        """Publish the node's own status, as the controller's."""
        self._out.publish(report.status(now_us, self._now_ns(now_us), self._validator, self._clock_reading(now_us)))

    def _take_last(self) -> None:
        """What was said before this process was told to stop may still be on its way."""
        now_us = monotonic_us()
        end_us, silent_us = now_us + LAST_FRAMES_US, now_us + LAST_SILENCE_US
        while now_us < min(end_us, silent_us):
            frame = self.mailbox.take((silent_us - now_us) / 1e6)
            if frame is not None:  # None also where the request itself woke
                self._take(frame)
                silent_us = monotonic_us() + LAST_SILENCE_US
            now_us = monotonic_us()

    # --- one step ----------------------------------------------------------------------------------------------------

    def _step(self, t_ns: int, cause: str, started_us: int) -> None:
        arrivals, entries = self._inbox.take()
        self._records.append(
            StepRecord(
                node=self._node.name, epoch=self.epoch, step=self._status.steps, t_ns=t_ns, cause=cause, inbox=entries
            )
        )
        self._stages("read")
        (outputs,) = self._node.steps([(t_ns, arrivals)])
        self._status.on_step(monotonic_us() - started_us)
        if not outputs:
            return
        self._flush()
        plan = next((signal for signal in outputs if isinstance(signal, Plan)), None) if self._times_cycles else None
        if plan is not None and self._compute_delay_ns:
            self._hold(self._compute_delay_ns)
        for signal in outputs:
            now_us = monotonic_us()
            sent = self._out.publish(signal)
            if self.clock_sync is not None and isinstance(signal, Plan):
                self.clock_sync.on_plan_sent(sent.sequence, now_us)
        if plan is not None:
            self._time_cycle(plan, t_ns, started_us)
        if self._report is not None:
            now_us = monotonic_us()
            self._report.on_step(outputs, now_us - started_us, now_us)

    def _flush(self) -> None:
        for record in self._records:
            self._out.publish(record)
        self._records.clear()

    def _hold(self, delay_ns: int) -> None:
        """Be slow on purpose: a slower machine's computation, on the vehicle's clock."""
        until_ns = self._now_ns(monotonic_us()) + delay_ns
        self._wait(lambda: self._clock.due_us(until_ns))
        self._stages.resume()

    def _time_cycle(self, plan: Plan, t_ns: int, started_us: int) -> None:
        """Publish what the cycle cost, and hand it to the next one as any other message."""
        self._stages("publish")
        now_us = monotonic_us()
        now_ns = self._now_ns(now_us)
        timing = CycleTiming(
            t_ns=t_ns,
            compute_ns=max(0, now_ns - t_ns),
            compute_wall_ns=(now_us - started_us) * 1000,
            estimate_age_ns=t_ns - plan.estimate_t_ns,
            stage_us=self._stages.stage_us,
        )
        self._hand_own(timing, now_ns)

    # --- what arrives ------------------------------------------------------------------------------------------------

    def _take(self, frame: Frame) -> None:
        now_ns = self._now_ns(frame.received_monotonic_us)
        try:
            signal, header = self._validator.validate(frame)
        except WireError as error:
            self._refuse(frame, str(error), now_ns)
            return
        kind = type(signal)
        if frame.topic is not None and frame.topic.written_by == OPERATOR and self._clock.newest is None:
            reason = "no estimate received yet, so there is no vehicle time: retry when the status shows estimates"
        else:
            reason = self._of_another_time(signal, frame.received_monotonic_us)
        if reason:
            self._validator.reject(reason)
            self._refuse(frame, reason, now_ns)
            return
        self._status.on_input(kind)
        self._status.on_delivery(header.sent_monotonic_us, frame.received_monotonic_us, monotonic_us())
        if self._report is not None:
            self._report.on_input(signal)
        if isinstance(signal, Clock):
            self._hear_clock(signal)
        elif isinstance(signal, NodeStatus) and self._master is not None:
            self._master.on_status(signal, monotonic_us(), self._node.name)
        elif isinstance(signal, ClockCommand) and self._master is not None:
            self._master.on_command(signal, monotonic_us(), self._node.name)
        if kind not in self._node.reads:
            return
        self._inbox.add(
            signal,
            key=frame.key,
            epoch=header.epoch,
            sequence=header.sequence,
            crc=crc(frame.payload),
            received_t_ns=self._received_ns(signal, frame.received_monotonic_us),
        )
        if kind is Command and self._schedule.next_ns is not None:
            self._asked = frame.key
        if kind in self._causes:
            validity: Any = signal  # a type that causes steps has its validity time
            self._step(validity.t_ns, frame.key, monotonic_us())

    def _of_another_time(self, signal: Message, received_us: int) -> str:
        """Why a signal does not fit the time that the process goes by; empty where it does."""
        sync = self.clock_sync
        if sync is None:
            return ""
        if isinstance(signal, Clock):
            return (
                "vehicle time already follows the estimates: restart this process to use the clock"
                if sync.active
                else ""
            )
        clock_steps, begun = sync.clock_steps, sync.active
        reason = sync.check_stamp(signal, received_us)
        if sync.clock_steps > clock_steps:
            self._schedule.reset()
            self._say("the stamps of the other side jumped: its clock was set")
        if sync.active and (not begun or sync.clock_steps > clock_steps):
            self._begin()
        return reason

    def _refuse(self, frame: Frame, reason: str, now_ns: int) -> None:
        rejected = rejection(frame, reason, node=self._node.name, t_ns=now_ns)
        if RejectedFrame in self._node.reads:
            self._hand_own(rejected, now_ns)
        else:
            self._out.publish(rejected)

    def _restore(self, state: bytes) -> None:
        kind = STATES[self._node.name]
        restored = decode(kind, state)[0]
        self._hand_own(restored, restored.t_ns)

    def _hand_own(self, signal: Message, now_ns: int) -> None:
        sent = self._out.publish(signal)
        self._inbox.add(
            signal, key=sent.key, epoch=self.epoch, sequence=sent.sequence, crc=sent.crc, received_t_ns=now_ns
        )

    def _hear_clock(self, message: Clock) -> None:
        self._status.on_clock(monotonic_us())
        if self._clock.follow(message):
            self._begin()

    # --- before the first step ---------------------------------------------------------------------------------------

    def _connect(self, session: Session) -> None:
        node, clock_master = self._node, self._keeps_time
        kinds = ports.outputs(node, clock_master=clock_master is not None)
        kinds += self._report.writes if self._report is not None else ()
        self._out = Outbox(session, node=node.name, epoch=self.epoch, kinds=kinds)
        self._status = NodeStatusReporter(
            node.name,
            outbox=self._out,
            counts=self._validator,
            mailbox=self.mailbox,
            clock=self._clock,
            reads=ports.inputs(node),
            say=self._say,
            foreign=self.clock_sync is not None,
            missing=(lambda: node.waiting_for) if isinstance(node, Waiting) else None,
        )
        of_all: list[type[Message]] = [] if clock_master is None else [NodeStatus, ClockCommand]
        for_itself = [Clock] if self._follows else of_all
        ports.subscribe(session, [*ports.inputs(node), *for_itself], self.mailbox)
        if clock_master is not None:
            self._master = ClockMaster(
                clock_master, self._clock, epoch=self.epoch, now_us=monotonic_us(), publish=self._out.publish
            )
        self._add_deadlines()
        self._begin()

    def _begin(self) -> None:
        """The clock is known: the first step has its time."""
        newest = self._clock.newest
        if newest is not None:
            reading = self._clock.read(monotonic_us())
            phase_ns = INPUTS_ARRIVE_US * 1000 * newest.num // newest.den
            self._schedule.start(newest.vehicle_ns if reading is None else reading, phase_ns=phase_ns)

    def _clock_reading(self, now_us: int) -> ClockOffset:
        return SHARED_CLOCK if self.clock_sync is None else self.clock_sync.offset(now_us)

    def _received_ns(self, signal: Message, received_us: int) -> int:
        """When it came; before there is a time, the one that it says itself."""
        if isinstance(signal, STAMPED_INPUTS) and self._clock.read(received_us) is None:
            return signal.t_ns
        return self._now_ns(received_us)

    def _now_ns(self, now_us: int) -> int:
        reading = self._clock.read(now_us)
        return 0 if reading is None else reading
