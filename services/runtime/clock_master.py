"""Clock master: starts the clock when all nodes are ready, announces it ten times a second, and slows it.

The clock slips when a node cannot keep up, this one included; then ``clock_rate.py`` also lowers its speed.
"""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from ltv_mpc.messages import Clock, ClockCommand, ClockState, NodeStatus, RunEvent
from services.runtime.clock import ClockSource, VehicleClock, fraction_of
from services.runtime.clock_rate import ClockRate
from services.runtime.node_status import MAX_BACKLOG_US

REPEAT_US = 100_000
REPORT_INTERVAL_US = 1_000_000
"""Shortest interval between two events that report slips. One is published when the number of slips has doubled since
the last event, or the speed has halved. Slips are always counted."""
MAX_CATCH_UP_US = 100_000
"""Wall time by which grid steps may be late and still catch up; the clock slips by what is beyond it."""


class ClockMasterSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Settings of the clock master."""

    start_ns: int
    end_ns: int
    speed: float  # vehicle seconds per second
    expects: tuple[str, ...]  # nodes that must be ready before the clock starts


class ClockMaster:
    """Driver of a ``ClockSource``, called by the step loop. ``clock`` is the clock that the process itself reads."""

    def __init__(
        self,
        settings: ClockMasterSettings,
        clock: VehicleClock,
        *,
        epoch: int,
        now_us: int,
        publish: Callable[[Clock | RunEvent], object],
    ) -> None:
        self._source = ClockSource(epoch=epoch, start_ns=settings.start_ns, speed=settings.speed, now_us=now_us)
        self._rate = ClockRate(self._source.speed)
        self._slipping_until_us = 0  # until then the newest slip is still to pass
        self._clock = clock
        self._publish = publish
        self._missing = dict.fromkeys(settings.expects)  # a dict keeps the order of the process table
        self._repeat_us = 0
        self._reported_us, self._reported_slips, self._reported_speed = -REPORT_INTERVAL_US, 0, self._source.speed
        self._ended = False
        clock.follow(self._source.set_speed(now_us, self._rate.speed))

    @property
    def due_us(self) -> int:
        """Monotonic time (us) of the next start, speed change or repetition."""
        match self._source.message.state:
            case ClockState.WAITING if not self._missing:
                return 0
            case ClockState.RUNNING:
                return min(self._repeat_us, self._rate.window_end_us)
            case _:
                return self._repeat_us

    @property
    def waiting_for(self) -> str:
        """Names of the nodes that are not ready yet."""
        return ", ".join(self._missing)

    def on_status(self, status: NodeStatus, now_us: int, node: str) -> None:
        """Note a node's status. If the node cannot keep up, the clock slips, as it does for this process."""
        if status.ready and not status.finished:
            self._missing.pop(status.node, None)
        if self._source.message.state is ClockState.RUNNING:
            self._slip(status.min_queue_delay_us if status.min_queue_delay_us > MAX_BACKLOG_US else 0, now_us, node)

    def on_command(self, command: ClockCommand, now_us: int, node: str) -> None:
        """Change speed, pause or continue, as an operator requests; not before the start or after the run's end."""
        if self._ended:
            return
        changes = []
        if fraction_of(command.speed) != self._source.speed:
            self._rate.request(fraction_of(command.speed))
            self._change(self._source.set_speed(now_us, self._rate.speed, requested=command.speed), now_us)
            changes.append(f"at {command.speed:g} x real time")
        if command.paused and self._source.message.state is ClockState.RUNNING:
            self._change(self._source.pause(now_us), now_us)
            changes.append("paused")
        elif not command.paused and self._source.message.state is ClockState.PAUSED:
            self._change(self._source.run(now_us), now_us)
            changes.append("resumed")
        self._rate.restart_window()
        if changes:
            text = f"clock {', '.join(changes)}, as requested"
            self._publish(RunEvent(t_ns=self._clock.read(now_us) or 0, node=node, kind="clock", text=text))

    def run_due(self, now_us: int) -> None:
        """Start the clock, change its speed, or repeat its announcement, whichever is due."""
        if self._source.message.state is ClockState.WAITING and not self._missing:
            self._change(self._source.run(now_us), now_us)
        elif self._source.message.state is ClockState.RUNNING and self._rate.window_over(now_us):
            self._change(self._source.set_speed(now_us, self._rate.speed), now_us)
        elif now_us >= self._repeat_us:
            self._send(now_us)

    def on_late_step(self, now_us: int, due_us: int, node: str) -> None:
        """Note that a grid step that was due at ``due_us`` starts only now."""
        self._slip(now_us - due_us - MAX_CATCH_UP_US, now_us, node)

    def _slip(self, us: int, now_us: int, node: str) -> None:
        """Slip by ``us`` of wall time, unless an earlier slip has not passed yet."""
        if us <= 0 or now_us < self._slipping_until_us:
            return
        self._change(self._source.slip(now_us, us), now_us)
        self._rate.add_slip(us)
        self._slipping_until_us = self._source.message.at_monotonic_us + us
        much_more = self._source.slips >= 2 * self._reported_slips or 2 * self._rate.speed < self._reported_speed
        if now_us - self._reported_us < REPORT_INTERVAL_US or not much_more:
            return
        self._reported_us, self._reported_slips, self._reported_speed = now_us, self._source.slips, self._rate.speed
        text = (
            f"machine too slow: waits of the clock so far: {self._source.slips},"
            f" in all {self._source.slipped_ns / 1e9:.2f} s of vehicle time;"
            f" it continues at {float(self._rate.speed):.3g} x real time"
        )
        self._publish(RunEvent(t_ns=self._clock.read(now_us) or 0, node=node, kind="slowed", text=text))

    def stop(self, now_us: int) -> None:
        """Stop the clock: the run is complete."""
        self._ended = True
        self._change(self._source.pause(now_us), now_us)

    def _change(self, message: Clock, now_us: int) -> None:
        self._clock.follow(message)
        self._send(now_us)

    def _send(self, now_us: int) -> None:
        self._publish(self._source.message)
        self._repeat_us = now_us + REPEAT_US
