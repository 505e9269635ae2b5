"""Runner: a pure node as a process on the bus, stepped by the vehicle clock. Its other caller is lock step (``sim``).

    bus -> Mailbox -> InputReceiver (validation, rejection) -> NodeIO (inbox) -> node.step -> NodeIO (outbox) -> bus

    while steps remain and no stop is requested:
        wait    take inputs from the mailbox and do the periodic duties, until the next step is due
        step    node.step(t_ns, inbox) -> outputs: published at once, after the records of the steps

A step is due by the node's schedule, by an input that causes it, or by a command. ``input_receiver.py`` validates
inputs, ``node_io.py`` holds inbox, records and outbox, ``process_time.py`` the clock and the schedule. The periodic
duties are heartbeat, clock, settings and status. Every input reaches the node through one inbox, in order of arrival.

If the inputs stop, nothing changes here: the controller's cycles continue by the clock, and the controller itself
decides what to do when its estimates stop (``ltv_mpc/safety/health.py``). If the estimator process has died or hangs,
the supervisor restarts it (``services/supervisor/failure_handler.py``).
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from ltv_mpc.messages import (
    Clock,
    ClockCommand,
    ClockMode,
    ClockStep,
    ControllerStatus,
    CycleTiming,
    Message,
    NodeSettings,
    NodeStatus,
    Plan,
    RejectedFrame,
    RunEvent,
    StepRecord,
)
from ltv_mpc.node import Cycle, Node
from ltv_mpc.safety.source_selector import Source
from services.bus.mailbox import Mailbox
from services.bus.message_validation import MessageValidator
from services.bus.options import BusOptions
from services.bus.outbox import Outbox, new_epoch
from services.bus.rate_limit import RateLimit
from services.bus.session import Session, open_session
from services.bus.topics import BY_TYPE, NAMED, expression
from services.runtime.clock import monotonic_us
from services.runtime.console import Console
from services.runtime.input_receiver import InputReceiver
from services.runtime.lifeline import LIFELINE
from services.runtime.node_io import NodeIO, SavedState
from services.runtime.node_status import NodeStatusReporter, WaitingFor
from services.runtime.process_time import ClockOptions, ProcessTime
from services.runtime.serve import run_until_stopped
from services.runtime.stage_timer import StageTimer
from services.runtime.stopping import Say, StopRequest

if TYPE_CHECKING:  # only a controller needs it
    from services.runtime.controller_status import ControllerStatusReporter

CLOCK_MASTER_INPUTS: tuple[type[Message], ...] = (NodeStatus, ClockCommand)
"""Types that the clock master's process reads for its clock."""


SETTINGS_PERIOD_US = BY_TYPE[NodeSettings].period_ns // 1000

MAX_DRAIN_US = 20_000
"""Longest time that taking inputs may delay a due step, so that a message flood cannot starve the controller."""

FINAL_DRAIN_US, FINAL_SILENCE_US = 300_000, 20_000
"""After a stop request the mailbox is drained until no frame has arrived for FINAL_SILENCE_US, at most FINAL_DRAIN_US:
messages published before the request may still be on their way."""


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
        self._compute_delay_ns = compute_delay_ns
        self._stopwatch = stages or StageTimer()
        self._report, self._settings = report, settings
        self._settings_due_us = 0
        self._time = ProcessTime(node, clock, epoch=new_epoch(), publish=lambda message: self._io.publish(message))
        self._source: Source | None = None  # of the estimates in use
        self._duties: list[tuple[Callable[[], int | None], Callable[[int], None]]] = []
        """Periodic duties: when each is due (monotonic µs; None: never), and what does it and sets its next time.

        An event can bring a duty forward: a change of the clock is announced at once.
        """
        # From the connection on:
        self._io: NodeIO
        self._status: NodeStatusReporter
        self._receiver: InputReceiver

    @property
    def finished(self) -> bool:
        """True once the last step of a schedule that ends is done."""
        return self._time.schedule.finished

    def main(self, console: Console, bus: BusOptions, saved: SavedState | None = None) -> int:
        """Serve until the node is done or a signal stops it. Return the exit code, as ``run_until_stopped``.

        ``saved`` is where its states are kept; None: the supervisor keeps them, if there is one.
        """
        return run_until_stopped(console, lambda _, say: self.serve(bus, saved, say), request=self.stop)

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
            self._connect(session, saved, say)
            LIFELINE.ready()
            try:
                self._run()
            finally:
                self._io.publish_record()
                self._status.publish(monotonic_us(), finished=True)

    def _connect(self, session: Session, saved: SavedState | None, say: Say) -> None:
        """Declare publishers and subscribers, and start the clock's part of the process."""
        node, time, keeps_time = self._node, self._time, self._time.master is not None
        inputs = [kind for kind in node.reads if BY_TYPE[kind].written_by != node.name]  # its own need no bus
        inputs = [kind for kind in inputs if kind is not Clock]  # delivered by the process
        optional: dict[type[Message], bool] = {
            CycleTiming: times_cycles(node),
            ClockStep: ClockStep in node.reads,
            Clock: keeps_time,
            NodeSettings: self._settings is not None,
            ControllerStatus: self._report is not None,
        }
        kinds: list[type[Message]] = [*node.writes, StepRecord, NodeStatus, RejectedFrame, RunEvent]
        kinds += [kind for kind, is_written in optional.items() if is_written]
        outbox = Outbox(session, node=node.name, epoch=time.epoch, kinds=kinds)
        validator = MessageValidator(RateLimit(lambda: time.speed))
        waiting = WaitingFor(
            time.clock,
            inputs,
            from_inputs=time.syncs,
            node_waits=(lambda: node.waiting_for) if isinstance(node, WaitingNode) else None,
        )
        self._status = NodeStatusReporter(
            node.name, outbox=outbox, counts=validator, mailbox=self.mailbox, waiting=waiting, say=say
        )
        for kind in dict.fromkeys([*inputs, *(CLOCK_MASTER_INPUTS if keeps_time else (Clock,))]):
            topic = BY_TYPE[kind]  # one mailbox for all, so that arrivals have one order
            session.subscribe(expression(topic), None if kind in NAMED else topic, self.mailbox)
        time.start_schedule()
        self._io = NodeIO(node.name, outbox, saved)
        self._receiver = InputReceiver(node, self._io, time, self._status, self._report, validator)
        self._add_duties(validator)

    def _run(self) -> None:
        """Step until a stop is requested or the schedule ends; then take the inputs that are still on their way."""
        while not self.finished and self._wait(lambda: self._step_due_us):
            self._scheduled_step()
        LIFELINE.stopping()
        if self._time.master is not None:
            self._time.master.stop(monotonic_us())
        self._drain()

    # --- waiting -----------------------------------------------------------------------------------------------------

    def _add_duties(self, validator: MessageValidator) -> None:
        """Add the periodic duties of the process, in the order in which they are done if several are due."""
        master, report = self._time.master, self._report
        self._duties.append((lambda: LIFELINE.due_us, LIFELINE.beat))
        if master is not None:
            self._duties.append((lambda: master.due_us, master.run_due))
        if self._settings is not None:  # they come before the first status and the first step
            self._duties.append((lambda: self._settings_due_us, partial(self._publish_settings, self._settings)))
        self._duties.append((lambda: self._status.due_us, self._publish_status))
        if report is not None:

            def publish(now_us: int) -> None:
                time = self._time
                self._io.publish(report.status(now_us, time.now_ns(now_us), validator, time.sync.offset(now_us)))

            self._duties.append((lambda: report.due_us, publish))

    def _wait(self, due_us: Callable[[], int | None]) -> bool:
        """Take inputs until ``due_us`` has passed and the mailbox is empty. Return False if a stop is requested."""
        entered_us = monotonic_us()
        while not self.stop():
            now_us = monotonic_us()
            for duty_due_us, run in self._duties:
                if (at_us := duty_due_us()) is not None and now_us >= at_us:
                    run(now_us)
            due = due_us()
            dues = [due, *(duty_due_us() for duty_due_us, _ in self._duties)]
            taken = self._take((min(at_us for at_us in dues if at_us is not None) - now_us) / 1e6)
            if due is None:
                continue
            if monotonic_us() >= (max(due, entered_us) + MAX_DRAIN_US if taken else due):
                return True
        return False

    @property
    def _step_due_us(self) -> int | None:
        return monotonic_us() if self._receiver.command else self._time.next_step_us

    def _take(self, timeout_s: float) -> bool:
        """Take the next input, if one arrives in time, and the step that it causes. Return False if none arrived."""
        frame = self.mailbox.take(timeout_s)
        trigger = None if frame is None else self._receiver.take(frame)
        if trigger is not None:
            self._step(trigger.t_ns, trigger.cause, monotonic_us())
        return frame is not None

    def _drain(self) -> None:
        """Take the inputs that were published before the stop request and are still on their way."""
        now_us = monotonic_us()
        end_us, silent_us = now_us + FINAL_DRAIN_US, now_us + FINAL_SILENCE_US
        while now_us < min(end_us, silent_us):
            if self._take((silent_us - now_us) / 1e6):  # False also when the stop request itself wakes the mailbox
                silent_us = monotonic_us() + FINAL_SILENCE_US
            now_us = monotonic_us()

    # --- steps -------------------------------------------------------------------------------------------------------

    def _scheduled_step(self) -> None:
        """Take the step that is due by the schedule, or the one that a command requests between two of them."""
        now_us, time = monotonic_us(), self._time
        if self._receiver.command:
            cause, self._receiver.command = self._receiver.command, ""
            self._step(time.now_ns(now_us), cause, now_us)
            return
        schedule = time.schedule
        assert schedule.next_ns is not None
        if schedule.on_grid:
            if time.master is not None:
                time.master.on_late_step(now_us, time.next_step_us or now_us)
            self._step(schedule.next_ns, "grid", now_us)
        else:
            self._step(max(schedule.next_ns, time.now_ns(now_us)), "cycle", now_us)
        schedule.advance(time.now_ns(monotonic_us()))

    def _step(self, t_ns: int, cause: str, due_us: int) -> None:
        """Take a step that was due at the monotonic time ``due_us``; publish its outputs after its record."""
        status, report = self._status, self._report
        self._stopwatch.start()
        if status.steps == 0:
            self._settings_due_us = 0  # a recorder that receives the first step can replay the node
        self._follow_source(getattr(self._node, "active_source", None), t_ns)
        self._io.shift_ns = self._time.sync.published_shift_ns
        if status.steps == 0:
            own_clock = self._time.sync.offset(due_us).mode is not ClockMode.SHARED
            self._io.restore_state(t_ns, due_us, own_clock=own_clock)
        inbox = self._io.take_inbox(t_ns, cause)
        # Stage "read": reading the inbox. The controller uses the same recorded name for reading the QP's solution out,
        # and the stage timer adds both.
        self._stopwatch("read")
        outputs = self._node.step(t_ns, inbox)
        status.on_step(monotonic_us() - due_us)
        if not outputs:
            return
        plan = _plan_in(outputs) if times_cycles(self._node) else None
        if plan is not None and self._compute_delay_ns:
            self._io.publish_record()
            self._hold(self._compute_delay_ns)
        self._publish(outputs)
        if plan is not None:
            self._publish_timing(plan, t_ns, due_us)
        if report is not None:
            now_us = monotonic_us()
            for event in report.on_step(outputs, now_us - due_us, now_us):
                self._io.publish(event)

    def _follow_source(self, source: Source | None, t_ns: int) -> None:
        """Publish a change of the source of the estimates in the last step, and follow its clock.

        None: of a node that uses no estimates, or before the first.
        """
        if source is None or source == self._source:
            return
        before, self._source = self._source, source
        self._time.sync.follow_source(source.epoch, monotonic_us())
        if before is not None:
            text = f"source of the estimates: {before} -> {source}"
            self._io.publish(RunEvent(t_ns=t_ns, node=self._node.name, kind="source", text=text))

    def _publish(self, outputs: Sequence[Message]) -> None:
        now_us = monotonic_us()
        for message, frame in zip(outputs, self._io.publish_outputs(outputs), strict=True):
            if isinstance(message, Plan):
                self._time.sync.on_plan_sent(frame.sequence, now_us)

    def _hold(self, delay_ns: int) -> None:
        """Wait on the vehicle's clock before the plan is published: the computing time of a slower machine."""
        until_ns = self._time.now_ns(monotonic_us()) + delay_ns
        self._wait(lambda: self._time.clock.due_us(until_ns))
        self._stopwatch.resume()

    def _publish_timing(self, plan: Plan, t_ns: int, started_us: int) -> None:
        """Publish the computing time of a cycle, and put it into the inbox of the next one."""
        self._stopwatch("publish")
        now_us = monotonic_us()
        now_ns = self._time.now_ns(now_us)
        timing = CycleTiming(
            t_ns=t_ns,
            compute_ns=max(0, now_ns - t_ns),
            compute_wall_ns=(now_us - started_us) * 1000,
            estimate_age_ns=t_ns - plan.estimate_t_ns,
            stage_us=self._stopwatch.stage_us,
        )
        self._io.publish_to_self(timing, now_ns)

    # --- reporting ---------------------------------------------------------------------------------------------------

    def _publish_settings(self, settings: NodeSettings, now_us: int) -> None:
        """Publish the settings, for recorders."""
        self._settings_due_us = now_us + SETTINGS_PERIOD_US
        self._io.publish(settings)

    def _publish_status(self, now_us: int) -> None:
        """Publish the record of the last steps, then the status of the process."""
        self._io.publish_record()
        master = self._time.master
        self._status.publish(now_us, others=master.waiting_for if master else "")


def times_cycles(node: Node) -> bool:
    """Return True if the runtime measures each cycle and delivers the timing to the node's next cycle."""
    return isinstance(node.schedule, Cycle) and CycleTiming in node.reads


def _plan_in(outputs: Sequence[Message]) -> Plan | None:
    return next((message for message in outputs if isinstance(message, Plan)), None)
